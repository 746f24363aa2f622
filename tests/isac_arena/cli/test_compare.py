"""`arena compare`: two scored directories, and those that cannot be compared."""

import json
import shutil
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.files import write_record, write_text
from isac_arena.cli.compare import changed_settings, read_run, read_tables
from isac_arena.cli.main import app
from isac_arena.insight.comparison.names import group_of, name_of
from isac_arena.insight.comparison.runs import compare_runs
from isac_arena.insight.comparison.table import difference_table, setting_table
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance
from isac_arena.scoring.metrics.metric import to_json
from isac_arena.validation.scenarios.perfect_campaign import make_campaign, power_dbm

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


def settings(**changes):
    config = CampaignConfig.model_validate({"name": "made", "scene": "made_up", **changes})
    return json.dumps({"measured": None, "campaign": config.model_dump(mode="json")})


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    made = make_campaign()
    scores = score_campaign(
        made.scene, iter(made.truths), made.results, true_power_dbm=power_dbm, significance=LIMITS
    )
    folder = tmp_path_factory.mktemp("runs") / "first"
    write_text(folder / "campaign.json", settings())
    write_text(folder / "scene.toml", 'name = "made_up"\n[[objects]]\nname = "pillar"\nradius_m = 0.3\n')
    write_record(folder / "provenance.nc", scores.tables)
    write_text(folder / "scores.json", json.dumps(to_json(scores.metrics)))
    return folder


def run(*arguments):
    return CliRunner().invoke(app, ["compare", *map(str, arguments)])


def test_a_table_a_figure_and_all_scores(directory, tmp_path):
    result = run(directory, directory, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "same" in result.output and "settings: all are the same" in result.output
    assert "note:" not in result.output
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
    for name in ("provenance.nc", "scores.json"):
        (tmp_path / "bare" / name).write_bytes((directory / name).read_bytes()[:2000])
    for text in ("{}", "[1]", '{"campaign": {"name": "x"}}', "not json"):
        write_text(tmp_path / "bare" / "campaign.json", text)
        message = str(run(tmp_path / "bare", directory, "--out", tmp_path).exception)
        assert "campaign.json: no settings of a campaign (" in message and "\n" not in message
    write_text(tmp_path / "bare" / "campaign.json", settings())
    assert "not a readable ScoreTables file" in str(run(tmp_path / "bare", directory, "--out", tmp_path).exception)
    (tmp_path / "sweep").mkdir()
    write_text(tmp_path / "sweep" / "sweep.json", "{}")
    assert "holds a sweep" in str(run(directory, tmp_path / "sweep", "--out", tmp_path / "out").exception)


@pytest.fixture
def other(directory, tmp_path):
    """The same run with other settings, another scene, a score less and one that could not be measured."""
    folder = tmp_path / "other"
    shutil.copytree(directory, folder)
    write_text(folder / "campaign.json", settings(link={"tx_power_dbm": 7.5}))
    scene = (folder / "scene.toml").read_text(encoding="utf-8")
    write_text(folder / "scene.toml", scene.replace("0.3", "0.4"))
    rows = json.loads((folder / "scores.json").read_text(encoding="utf-8"))
    rows = [row for row in rows if row["key"] != "channel.missed_per_stop"]
    rows[0]["value"] = None
    write_text(folder / "scores.json", json.dumps(rows))
    return folder


def test_settings_that_differ_and_scores_of_one_run_are_told(directory, other, tmp_path):
    result = run(directory, other, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    content = json.loads((tmp_path / "out" / "compare.json").read_text(encoding="utf-8"))
    told = {row["field"]: (row["first"], row["second"]) for row in content["settings"]}
    power = CampaignConfig(name="made", scene="made_up").link.tx_power_dbm
    assert told == {"link.tx_power_dbm": (power, 7.5), "scene.objects.pillar.radius_m": (0.3, 0.4)}
    assert "scene.objects.pillar.radius_m" in result.output
    note = next(note for note in content["notes"] if "only in A" in note)
    assert note.startswith("2 scores are known only in A: ") and "channel.missed_per_stop" in note
    (other / "scene.toml").unlink()
    assert "the scene of B is not there" in run(directory, other, "--out", tmp_path / "out").output


def test_the_tables_fit_80_columns(directory, other):
    """Nothing is cut off, and lines are broken only where a name or a count is too long."""
    tables = read_tables(directory)
    rng = np.random.default_rng(1)
    errors = rng.uniform(1e-3, 2e-3, len(tables.poses.stop))
    changed = replace(tables, poses=replace(tables.poses, position_error_m=errors, clock_error_s=1e-9 * errors),
                      slam=replace(tables.slam, contours=tables.slam.contours.take("outline", [0])))  # fmt: skip
    compared = compare_runs(tables, changed)
    for width in (80, 120):
        console = Console(width=width, file=StringIO(), highlight=False)
        console.print(difference_table(compared))
        console.print(setting_table(changed_settings(read_run(directory), read_run(other))))
        text = console.file.getvalue()
        assert "…" not in text and max(map(len, text.splitlines())) <= width
        words = text.split()
        for one in compared.differences:
            assert f"{one.first:.3g}" in words and f"{one.second:.3g}" in words
            if one.verdict not in ("same", "too few"):
                assert f"({one.low:.2g}, {one.high:.2g})" in text
            assert all(word in text for word in (*name_of(one.key).split(), group_of(one.key).split()[0]))
        assert "4|1" in words and "Contours, mapping" in text
