"""The attack attacks: every field of every settings file, and every way to end is told apart."""

import sys
from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

from isac_arena.campaign.config import CampaignConfig
from isac_arena.cli.main import COMMANDS
from isac_arena.sweep.config import SweepConfig
from isac_arena.validation.robustness.attempt import attempt, call
from isac_arena.validation.robustness.damage import VERBS
from isac_arena.validation.robustness.functions import BODIES, SOURCE
from isac_arena.validation.robustness.schemas import attacks
from scenes.config import SceneConfig
from scenes.toml_config import ConfigModel


class InnerModel(ConfigModel):
    """A table that a later version adds."""

    share: float = Field(0.5, ge=0, le=1)


class NewModel(ConfigModel):
    """Settings of a later version."""

    inner: tuple[InnerModel, ...] = ()
    path: str | None = None


def test_a_new_field_is_attacked_by_its_type() -> None:
    found = list(attacks(NewModel.model_json_schema()))
    shares = [document["inner"][0]["share"] for field, document in found if field == "inner.share"]
    assert 2 in shares and -1 in shares and "text" in shares and float("inf") in shares
    assert "../../owned" in [document["path"] for field, document in found if field == "path"]


@pytest.mark.parametrize("model", [CampaignConfig, SceneConfig, SweepConfig])
def test_every_field_of_every_table_is_attacked(model: type[ConfigModel]) -> None:
    schema = model.model_json_schema()
    attacked = {field.rpartition(".")[2] for field, _ in attacks(schema)}
    named = {name for table in (schema, *schema["$defs"].values()) for name in table.get("properties", {})}
    assert named <= attacked


def many_lines() -> None:
    print("arena: one\narena: two", file=sys.stderr)
    raise ValueError("three")


def outgrow() -> None:
    raise MemoryError


def spin() -> None:
    while True:
        pass


def refuse() -> None:
    raise ValueError("field = 3: must be 2")


@pytest.mark.parametrize(
    ("function", "outcome"),
    [(refuse, "refused"), (int, "accepted"), (many_lines, "internal"), (outgrow, "internal"), (spin, "hang")],
)
def test_every_end_is_told_apart(tmp_path: Path, function: Callable[[], Any], outcome: str) -> None:
    work = tmp_path / "box" / "work"
    work.mkdir(parents=True)
    ended = attempt("try", call(function), work, cpu_s=1)
    assert ended.outcome == outcome, ended
    if outcome == "refused":
        assert ended.line == "arena: field = 3: must be 2" and ended.peak_mb > 10


def test_there_are_thirty_bad_functions() -> None:
    compile(SOURCE, "bad_lab.py", "exec")
    assert len(BODIES) == 30


def test_every_command_that_reads_a_directory_reads_damaged_files() -> None:
    reading = [each for each in COMMANDS if {"directory", "first"} & signature(each).parameters.keys()]
    reads = {each.__name__.replace("_", "-") for each in reading}
    assert reads - {"twin"} <= {words[0] for words in VERBS.values()}
