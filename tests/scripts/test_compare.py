"""`arena compare`: two scored directories, and those that cannot be compared."""

import json

import pytest
from typer.testing import CliRunner

from estimation.scoring.config import Significance
from estimation.scoring.metric import to_json
from estimation.scoring.score import score_campaign
from estimation.validation.made_campaign import make_campaign, power_dbm
from scripts.arena import app
from sim.store import write_record, write_text

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    made = make_campaign()
    scores = score_campaign(
        made.scene, iter(made.truths), made.results, true_power_dbm=power_dbm, significance=LIMITS
    )
    folder = tmp_path_factory.mktemp("runs") / "first"
    write_text(folder / "campaign.json", "{}")
    write_record(folder / "provenance.nc", scores.tables)
    write_text(folder / "scores.json", json.dumps(to_json(scores.metrics)))
    return folder


def run(*arguments):
    return CliRunner().invoke(app, ["compare", *map(str, arguments)])


def test_a_table_a_figure_and_all_scores(directory, tmp_path):
    result = run(directory, directory, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "same" in result.output
    content = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))
    assert content["n_stops"] == 12 and content["paired"][0]["verdict"] == "same"
    scores = json.loads((directory / "scores.json").read_text(encoding="utf-8"))
    assert [row["key"] for row in content["scores"]] == [row["key"] for row in scores]
    assert all(row["difference"] in (0, None) for row in content["scores"])
    assert (tmp_path / "compare.png").read_bytes().startswith(b"\x89PNG")


def test_directories_without_scores_are_named(directory, tmp_path):
    (tmp_path / "bare").mkdir()
    message = str(run(directory, tmp_path / "bare", "--out", tmp_path).exception)
    assert message.endswith("bare: holds no scored run (no campaign.json); make one with 'arena run'")
    write_text(tmp_path / "bare" / "campaign.json", "{}")
    assert "no provenance.nc" in str(run(tmp_path / "bare", directory, "--out", tmp_path).exception)
    (tmp_path / "bare" / "provenance.nc").write_bytes((directory / "provenance.nc").read_bytes()[:2000])
    assert "not a readable ScoreTables file" in str(
        run(tmp_path / "bare", directory, "--out", tmp_path).exception
    )
