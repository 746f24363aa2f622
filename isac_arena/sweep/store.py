"""The directory of a sweep beside its cases: its settings, its plan and its failures.

sweep.json          the resolved sweep and its base campaign
plan.json           key, point, repeat, seed and axis values of every case
failures/KEY.json   the error of a case (KEY.txt: traceback of a user's function); removed when it is tried again
"""

import json
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from isac_arena.campaign.files import remove_file, remove_leftovers, write_json, write_text
from isac_arena.campaign.integrity import file_digest
from isac_arena.campaign.manifest import check_unchanged, read_manifest
from isac_arena.setting_differences import first_difference, line_difference
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.job import CASE_FILES, Job
from scenes.inputs import read_input
from scenes.names import path_in
from scenes.toml_config import validate_stored

SWEEP = "sweep.json"
MAY_CHANGE = {"repeats", "until"}  # in a sweep directory: they only add cases
MAY_GROW = {"axes"}  # where all planned cases stay


@dataclass(frozen=True)
class PlannedCase:
    """A case of a sweep by its name and its place in the design."""

    key: str
    point: int
    repeat: int
    seed: int
    values: tuple[Any, ...]  # of every axis


def open_sweep(directory: Path, config: SweepConfig, base_text: str, keys: Collection[str]) -> None:
    """Use a directory for a new sweep, or continue its sweep with the cases `keys`.

    Repeats may change. Axes may grow: more values, or one more axis with the value that all cases had. Then
    finished cases are used again.

    Raises `ValueError` where the directory holds another sweep or other files.
    """
    if (directory / SWEEP).is_file():
        held, held_base = read_sweep(directory)
        grows = _keeps_all(directory, config, keys)
        may = MAY_CHANGE | (MAY_GROW if grows else set())
        there, here = (one.model_dump(mode="json", exclude=may) for one in (held, config))
        what = first_difference(there, here)
        if what is None and held_base != base_text:
            what = f"the base campaign{line_difference(held_base, base_text)}"
        if what is not None:
            raise ValueError(
                f"--out = {directory}: holds a sweep with other settings ({what}); choose another directory. "
                "Only repeats and until may change, and axes may grow"
            )
    elif directory.is_dir() and any(not entry.name.endswith(".part") for entry in directory.iterdir()):
        raise ValueError(f"--out = {directory}: holds other files; choose an empty or a new directory")
    content = {"sweep": config.model_dump(mode="json"), "base": base_text}
    write_json(directory / SWEEP, content)
    remove_unfinished(directory)


def _keeps_all(directory: Path, config: SweepConfig, keys: Collection[str]) -> bool:
    """Whether all cases planned before are among `keys`, except seeds beyond the repeats."""
    try:
        planned = read_plan(directory)
    except ValueError:  # damaged: it is written again
        return False
    return all(case.key in keys for case in planned if case.repeat < config.repeats)


def remove_unfinished(directory: Path) -> None:
    """Remove what processes that have ended left half written anywhere in a sweep."""
    for folder in {leftover.parent for leftover in directory.rglob(".*.part")}:
        remove_leftovers(folder)


def read_sweep(directory: Path) -> tuple[SweepConfig, str]:
    """The sweep in a directory and the text of its base campaign.

    Raises `ValueError`, one line, where the directory holds no sweep or its settings are damaged.
    """
    file = directory / SWEEP
    if not file.is_file():
        raise ValueError(f"{directory}: holds no sweep (no {SWEEP}); make one with 'arena sweep'")
    try:
        content = json.loads(read_input(file))
        return validate_stored(content["sweep"], SweepConfig, "settings"), str(content["base"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(
            f"{file}: damaged, or of another version ({_first_line(error)}); put it back as it was, or sweep into "
            "a new directory"
        ) from error


def write_plan(directory: Path, cases: Iterable[PlannedCase]) -> None:
    """Store which cases the sweep has."""
    content = {"cases": [asdict(case) for case in cases]}
    write_text(directory / "plan.json", json.dumps(content) + "\n")


def read_plan(directory: Path) -> list[PlannedCase]:
    """The cases of a sweep; `ValueError`, one line, where the plan is missing or damaged."""
    file = directory / "plan.json"
    try:
        content = json.loads(read_input(file))
        return [PlannedCase(**{**case, "values": tuple(case["values"])}) for case in content["cases"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = _first_line(error)
        raise ValueError(f"{file}: missing or damaged ({reason}); run 'arena sweep' again") from error


def plan_of_jobs(jobs: Iterable[Job]) -> list[PlannedCase]:
    """The plan of some jobs, ordered by point and repeat."""
    cases = [PlannedCase(job.key, job.point, job.repeat, job.config.seed, job.values) for job in jobs]
    return sorted(cases, key=lambda case: (case.point, case.repeat))


def stale_names(directory: Path, names: Iterable[str]) -> list[str]:
    """Those file names of a sweep that are of unfinished cases: they will be made again."""
    keys = {name: Path(name).parts[1] for name in names if name.startswith("cases/")}
    stale = {key for key in set(keys.values()) if not is_done(directory, key)}
    return [name for name, key in keys.items() if key in stale]


def is_done(directory: Path, key: str) -> bool:
    """Whether all files of a case exist."""
    case = path_in(directory / "cases", key)
    return all((case / name).is_file() for name in CASE_FILES)


def damaged_cases(directory: Path) -> dict[str, str]:
    """What is wrong with each case that is no longer as it was written, in one line, by the key of the case."""
    keys = [each.name for each in sorted((directory / "cases").glob("[!.]*")) if each.is_dir()]
    return {key: what for key in keys if (what := _damage(path_in(directory / "cases", key))) is not None}


def _damage(case: Path) -> str | None:
    for name in CASE_FILES:
        if not (case / name).is_file():
            return f"{case / name}: missing"
    try:
        check_unchanged(case, CASE_FILES)
    except ValueError as error:
        return str(error).partition("; ")[0]
    return None


def read_scores(directory: Path, key: str) -> list[dict[str, Any]]:
    """The metrics of a finished case; `ValueError` where they changed since they were written."""
    case = path_in(directory / "cases", key)
    file = case / "scores.json"
    if read_manifest(case).files.get(file.name, {}).get("sha256") != file_digest(file):
        raise ValueError(f"{file}: damaged or edited since it was written; remove {case} and run again")
    return json.loads(read_input(file))  # type: ignore[no-any-return]


def read_failures(directory: Path) -> dict[str, str]:
    """The errors of the failed cases, one line each, by the key of the case; damaged files are ignored."""
    found = {}
    for file in sorted((directory / "failures").glob("*.json")):
        try:
            found[file.stem] = str(json.loads(read_input(file))["error"])
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    return found


def write_failure(directory: Path, key: str, reason: str) -> None:
    """Record that a case failed and why."""
    write_text(path_in(directory / "failures", f"{key}.json"), json.dumps({"error": reason}) + "\n")


def forget_failures(directory: Path, keys: Iterable[str]) -> None:
    """Remove recorded failures, so that their cases run again."""
    for key in keys:
        for ending in ("json", "txt"):
            remove_file(path_in(directory / "failures", f"{key}.{ending}"))


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def takes_stops_alone(case: Path) -> bool:
    """Whether the settings of a finished case make SLAM take every stop alone; false where they are not there."""
    file = case / "campaign.json"
    if not file.is_file():
        return False
    settings = json.loads(read_input(file))["campaign"]
    return bool(settings["trajectory"]["method"] == "single" or settings["functions"]["slam"])
