"""`arena validate`: options that a set of checks does not have are refused in one line."""

import pytest
from typer.testing import CliRunner

from isac_arena.cli import validate
from isac_arena.cli.main import app
from isac_arena.validation.measurement import Measurement

ROW = Measurement("a.key", 0.5, "1", "lower", 1.0, "made up")


def run(*arguments):
    return CliRunner().invoke(app, ["validate", *arguments])


@pytest.mark.parametrize("option", [("--trials", "3"), ("--estimator", "a:b")])
def test_options_without_meaning_are_refused(option):
    result = run("signal", "--quick", *option)
    assert isinstance(result.exception, ValueError)
    assert str(result.exception) == f"{option[0]}: the checks of 'signal' have none; leave it out"


def test_options_reach_the_checks_that_have_them(monkeypatch, tmp_path):
    calls = []

    def check_all(seed, quick, trials=None, estimator=None):
        calls.append((seed, quick, trials, estimator))
        return [ROW]

    def check_plain(seed, quick):
        calls.append((seed, quick))
        return [ROW]

    monkeypatch.setattr(validate, "_checks", lambda *_: iter([("all", check_all), ("plain", check_plain)]))
    file = tmp_path / "rows.json"
    result = run("channel", "--seed", "7", "--trials", "12", "--estimator", "my.lab:fit", "--json", str(file))
    assert result.exit_code == 0, result.output
    assert calls == [(7, False, 12, "my.lab:fit"), (7, False)]
    assert file.read_text(encoding="utf-8").count('"a.key"') == 2


def test_every_module_of_the_channel_has_checks():
    checks = [title for title, _ in validate._checks(validate.MODULES["channel"], "check_")]
    assert checks[0] == "coherent scenes" and len(checks) == len(set(checks)) == 10
