"""`arena budget` on a small campaign: files, resuming, and bad input."""

import csv
import json
from io import StringIO

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from isac_arena.cli.budget import budget_tables
from isac_arena.cli.main import app
from isac_arena.insight.budget.outcome import FinalErrors
from isac_arena.insight.budget.record import Budget, attributions
from isac_arena.insight.budget.runs import chosen_stops
from tests.isac_arena.cli.sweep_files import CAMPAIGN

# Two bounces beside what the smallest campaign has, and clusters of two points.
BUDGETED = (
    CAMPAIGN.replace("max_bounces = 1\n", "")
    + """
[shapes]
eps_m = 1.0
min_samples = 2
"""
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("budget")
    (path / "small.toml").write_text(BUDGETED)
    return path


def run(folder, *options):
    return CliRunner().invoke(app, ["budget", str(folder / "small.toml"), "--out", str(folder / "out"), *options])


@pytest.fixture(scope="module")
def done(folder):
    result = run(folder, "--stops", "0:4:2", "--repeats", "2")
    assert result.exit_code == 0, result.output
    return result


def test_the_parts_of_every_outcome_add_up_in_the_files(done, folder):
    found = json.loads((folder / "out" / "budget.json").read_text())
    assert found["stops"] == [0, 2] and found["repeats"] == 2
    kinds = {(row["outcome"], row["budget"]) for row in found["rows"]}
    assert {("pose", "stages"), ("pose", "physics"), ("shape", "stages")} <= kinds
    for outcome, kind in kinds:
        rows = [row for row in found["rows"] if (row["outcome"], row["budget"]) == (outcome, kind)]
        total = rows.pop()
        assert total["part"] == "all errors"
        assert sum(row["mean_square_m2"] for row in rows) == pytest.approx(total["mean_square_m2"])
        assert total["objection"] and all(row["share"] is None for row in rows)  # two stops, few objects
        if kind == "stages":
            assert rows[-1]["part"] == "rest" and rows[-1]["rms_m"] <= 1e-9
    physics = [row["part"] for row in found["rows"] if row["budget"] == "physics" and row["outcome"] == "pose"]
    assert physics == ["multi-bounce paths", "noise", "rest", "all errors"]
    with (folder / "out" / "budget.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(found["rows"])
    assert (folder / "out" / "budget.png").read_bytes().startswith(b"\x89PNG")
    assert "pose error by stages" in done.output and "%" not in done.output
    assert "No shares: 2 stops or objects" in " ".join(done.output.split())


def test_a_table_has_shares_and_says_what_is_told():
    rng = np.random.default_rng(1)
    size, noise = 0.1 * rng.uniform(1, 2, 30), 0.003 * rng.standard_normal(30)
    groups = (("large", "nothing"),)
    errors = {
        frozenset(): size,
        frozenset({"large"}): 0.01 + 0 * size,
        frozenset({"nothing"}): np.sqrt(size**2 + noise * size),
        frozenset({"large", "nothing"}): 0.01 + 0.1 * np.abs(noise),
    }
    variants = {parts: [FinalErrors(value, np.zeros(0), np.zeros(0))] for parts, value in errors.items()}
    found = attributions(variants, groups, rng)["pose"]
    (table,) = budget_tables(Budget("made", tuple(range(30)), (), 1, {("pose", "physics"): found}))
    console = Console(width=80, file=StringIO())
    console.print(table)
    rows = {words[0]: words for line in console.file.getvalue().splitlines() if (words := line.split())}
    assert "share %" in console.file.getvalue() and max(map(len, console.file.getvalue().splitlines())) <= 80
    assert rows["large"][-1] == "falls" and rows["nothing"][-1] == "undecided"
    assert 95 < float(rows["large"][1]) < 100


def test_an_interrupted_budget_goes_on_to_the_same_end(done, folder):
    out = folder / "out"
    before = (out / "budget.json").read_bytes()
    kept = out / "repeat_00" / "all" / "channel" / "stop_000.nc"
    made = kept.stat().st_mtime_ns
    (out / "repeat_01" / "without_noise" / "errors" / "none.nc").unlink()
    (out / "repeat_01" / "all" / "errors" / "pose.nc").unlink()
    (out / "repeat_01" / "all" / "channel" / "stop_002.nc").unlink()
    assert run(folder, "--stops", "0:4:2", "--repeats", "2").exit_code == 0
    assert (out / "budget.json").read_bytes() == before
    assert kept.stat().st_mtime_ns == made


@pytest.mark.parametrize("text", ["9", "-1", "a", "0:x", "3:1", "1.5", ""])
def test_wrong_stops_are_named(folder, text):
    result = run(folder, "--stops", text)
    assert isinstance(result.exception, ValueError)
    assert str(result.exception).startswith(f"--stops = '{text}'")


def test_stops_are_chosen_as_in_python():
    assert chosen_stops(None, 3) == (0, 1, 2)
    assert chosen_stops("2,0,2", 3) == (0, 2)
    assert chosen_stops("1:", 4) == (1, 2, 3)
    assert chosen_stops("::2", 4) == (0, 2)
