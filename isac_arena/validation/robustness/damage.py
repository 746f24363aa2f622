"""Damaged files of runs and sweeps: every file x every damage x every verb that may read it."""

import random
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isac_arena.validation.robustness.attempt import Outcome, Trial, attempt, command, tree, warm
from isac_arena.validation.robustness.files import DAMAGES
from isac_arena.validation.robustness.runs import RUN, expect

VERBS: dict[str, tuple[str, ...]] = {
    **{
        kind: ("export", "run", "--format", kind, "--out", "out")
        for kind in ("tum", "geojson", "mat", "deepmimo", "glb")
    },
    "sigmf": ("export-sigmf", "run", "--stop", "0", "--tx-beam", "0", "--out", "out"),
    "view": ("view", "run", "--no-open", "--out", "out/view.html"),
    "compare": ("compare", "run", "run", "--out", "out"),
    "verify": ("verify", "run", "--share", "0"),
    **{verb: (verb, "run") for verb in ("estimate", "score", "report")},
    "run": RUN,
    "verify-sweep": ("verify", "sweep", "--share", "0"),
    "sweep-report": ("sweep-report", "sweep"),
    "sweep": ("sweep", "sweep.toml", "--out", "sweep", "--workers", "1"),
}
BUDGET = ("budget", "small.toml", "--out", "run/budget", "--stops", "0:1")
CPU_S = 120
TRIED = "delete"  # of a file that a verb never opens: the other damages change its bytes alone


@dataclass(frozen=True)
class Undamaged:
    """What a verb makes of the files as they are, and those of them that it opens."""

    files: dict[str, bytes]
    opened: frozenset[str]


def with_budget_and_sweep(made: Path) -> Path:
    """A copy of a finished run with an error budget in its report, and a finished sweep beside it."""
    folder = made.parent / "whole"
    shutil.copytree(made, folder)
    for arguments in (BUDGET, VERBS["report"], VERBS["sweep"]):
        expect(attempt(arguments[0], command(*arguments), folder, CPU_S))
    return folder


def damage_files(made: Path, rng: random.Random, count: int | None) -> Iterator[Trial]:
    """Every file x every damage x every verb: refused, or all other results are as without damage.

    A file that a verb never opens is only deleted: its content cannot matter to that verb.
    """
    files = _results(made)
    cases = [
        (verb, name, damage)
        for verb, words in VERBS.items()
        for name in _representatives(files)
        if name.startswith("sweep/" if "sweep" in words[:2] or words[0].startswith("sweep") else "run/")
        for damage in DAMAGES
    ]
    clean: dict[str, Undamaged] = {}
    for verb, name, damage in cases if count is None else rng.sample(cases, count):
        if verb not in clean:
            clean[verb] = _undamaged(made, verb)
        content = DAMAGES[damage](files[name], rng)
        if content == files[name]:
            continue
        if name not in clean[verb].opened and damage != TRIED:
            yield Trial(f"{verb}: {damage} {name}", "accepted", "never opened", 0.0)
            continue
        yield _tried(made, verb, name, content, f"{verb}: {damage} {name}", clean[verb].files)


def _tried(made: Path, verb: str, name: str, content: bytes | None, what: str, clean: dict[str, bytes]) -> Trial:
    """Damage a file and run the verb; an internal error where it is accepted with other results."""

    def harm(folder: Path) -> None:
        (folder / name).unlink() if content is None else (folder / name).write_bytes(content)

    ended, files = _after(made, verb, harm)
    manifests = {each for each in clean if each.endswith("manifest.json")}  # a run makes a new one
    changed = {each for each in clean.keys() | files.keys() if files.get(each) != clean.get(each)}
    changed -= manifests
    if files.get(name) == content:  # it stayed as it is
        changed.discard(name)
    if changed and ended.outcome == "accepted":  # dates in files of other tools
        again = _after(made, verb, lambda folder: None)[1]
        changed = {each for each in changed if again.get(each) == clean.get(each)}
    outcome: Outcome = ended.outcome
    line = ended.line
    if ended.outcome == "accepted" and (changed or verb.startswith("verify")):
        outcome, line = "internal", f"accepted, and {min(changed | {name})} differs"
    return Trial(what, outcome, line, ended.peak_mb)


def _undamaged(made: Path, verb: str) -> Undamaged:
    """The results of a verb and the files of the folder that it opens, by the audit events of Python."""
    if verb != "sweep":  # its workers are processes of their own
        _after(made, verb, lambda folder: warm(command(*VERBS[verb]), folder))
    with tempfile.NamedTemporaryFile("r+", encoding="utf-8", suffix=".opened") as log:
        ended, files = _after(made, verb, lambda folder: None, log.name)
        expect(ended)
        return Undamaged(files, frozenset(log.read().splitlines()))


def _after(
    made: Path, verb: str, harm: Callable[[Path], None], log: str | None = None
) -> tuple[Trial, dict[str, bytes]]:
    """How a verb ends on a copy of the files that were harmed, and all files after it."""
    folder = made.parent / "copy" / "work"
    shutil.rmtree(folder.parent, ignore_errors=True)
    shutil.copytree(made, folder)
    harm(folder)
    run = command(*VERBS[verb])
    ended = attempt(verb, run if log is None else _watched(run, folder, log), folder, CPU_S)
    files = _results(folder)
    shutil.rmtree(folder.parent, ignore_errors=True)
    return ended, files


def _watched(run: Callable[[], None], folder: Path, log: str) -> Callable[[], None]:
    """A command that writes the names of the files it opens in a folder to a log."""

    def watched() -> None:
        """Run, with an audit hook that hears what is opened."""
        names: set[str] = set()

        def hear(event: str, arguments: tuple[Any, ...]) -> None:
            if event == "open" and isinstance(arguments[0], str | Path):
                path = (folder / arguments[0]).resolve()
                if path.is_relative_to(folder):
                    names.add(path.relative_to(folder).as_posix())

        sys.addaudithook(hear)
        try:
            run()
        finally:
            Path(log).write_text("\n".join(names), encoding="utf-8")

    return watched


def _results(folder: Path) -> dict[str, bytes]:
    parts = {part: tree(folder / part) for part in ("run", "sweep", "out") if (folder / part).is_dir()}
    return {f"{part}/{name}": content for part, found in parts.items() for name, content in found.items()}


def _representatives(files: dict[str, bytes]) -> list[str]:
    """All files, but of the many variants of a budget one file of each name."""
    inner = [name for name in files if name.startswith("run/budget/")]
    first = {Path(name).name: name for name in reversed(inner)}
    return [name for name in files if name not in inner or first[Path(name).name] == name]
