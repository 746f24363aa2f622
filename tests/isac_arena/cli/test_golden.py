"""Golden scores: the small campaigns keep theirs, and what is out of tolerance is named."""

import json
import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from isac_arena.cli.main import app
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.validation import golden

FILES = sorted((Path(__file__).resolve().parents[2] / "golden").glob("*.json"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_scores_are_kept(file):
    deviations = golden.check_file(file)
    assert not deviations, "\n".join(
        f"{one.key}: {one.found:.6g}, golden {one.golden:.6g} +- {one.tolerance:.2g}" for one in deviations
    )


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_files_say_what_they_are_of(file):
    content = golden.read_golden(file)
    config, scene = golden.golden_campaign(content)
    assert max(content["stops"]) < len(scene.stops)
    assert config.propagation.diffuse_samples == 0  # no ray tracer: its library differs between machines
    keys = [row["key"] for row in content["metrics"]]
    assert len(keys) == len(set(keys)) > 100
    assert all(math.isfinite(row["value"]) and row["tolerance"] > 0 for row in content["metrics"])
    assert golden.golden_text(content) == file.read_text(encoding="utf-8")


def test_a_tolerance_is_what_rounding_can_do_and_more():
    def metrics(steady, shaken, lost):
        return [
            Metric("steady", steady, "m", "lower"),
            Metric("shaken", shaken, "1", "higher"),
            Metric("lost", lost, "m", "lower"),
        ]

    rows = golden.golden_rows(metrics(2.0, 10.0, 1.0), [metrics(2.0, 9.5, math.nan), metrics(2.0, 10.2, 1.0)])
    tolerance = {row["key"]: row["tolerance"] for row in rows}
    assert tolerance == {"steady": pytest.approx(2e-3), "shaken": pytest.approx(2.5)}


@pytest.mark.parametrize(
    ("found", "named"),
    [
        ({"a": 1.0, "b": 2.0}, []),
        ({"a": 1.05, "b": 2.0, "new": 7.0}, []),
        ({"a": 1.2, "b": 2.0}, ["a"]),
        ({"b": 1.0}, ["a", "b"]),
        ({"a": math.nan, "b": 2.0}, ["a"]),
    ],
)
def test_deviations_beyond_the_tolerance_and_missing_scores_are_named(found, named):
    kept = [{"key": "a", "value": 1.0, "tolerance": 0.1}, {"key": "b", "value": 2.0, "tolerance": 0.1}]
    assert [one.key for one in golden.deviations_of("room", kept, found)] == named


def test_remade_files_are_kept_and_changed_ones_are_found(tmp_path, monkeypatch):
    file = tmp_path / "room.json"
    head = {"campaign": "box_room", "settings": {}, "stops": [0]}
    file.write_text(golden.golden_text({**head, "metrics": []}), encoding="utf-8")
    monkeypatch.setattr(golden, "run_golden", lambda content, nudge=None: [Metric("a", 1.5, "m", "lower")])
    run = lambda *more: CliRunner().invoke(app, ["golden", "--folder", str(tmp_path), *more])  # noqa: E731
    assert run("--remake").exit_code == 0
    content = json.loads(file.read_text(encoding="utf-8"))
    assert {name: content[name] for name in head} == head
    assert [row["value"] for row in content["metrics"]] == [1.5]
    assert run().exit_code == 0
    monkeypatch.setattr(golden, "run_golden", lambda content, nudge=None: [Metric("a", 1.6, "m", "lower")])
    result = run()
    assert result.exit_code == 1 and "1 golden scores out of tolerance" in result.output


def test_other_files_are_refused(tmp_path):
    missing = CliRunner().invoke(app, ["golden", "--folder", str(tmp_path)])
    assert "holds no golden file" in str(missing.exception)
    (tmp_path / "other.json").write_text('{"campaign": "box_room"}', encoding="utf-8")
    with pytest.raises(ValueError, match=r"no golden file \('settings' is missing\)"):
        golden.read_golden(tmp_path / "other.json")
