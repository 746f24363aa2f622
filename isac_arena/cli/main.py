"""The `arena` command: one Typer application, one module per group of verbs.

Modules import heavy libraries inside their functions only, so `--help` answers at once.
"""

from __future__ import annotations

import errno
import os
import re
import sys
from pathlib import Path
from typing import Any

import typer

from isac_arena.cli import (
    ablate,
    bound,
    budget,
    campaign,
    compare,
    doctor,
    export,
    golden,
    imports,
    link,
    scene,
    study,
    sweep,
    twin,
    validate,
    verify,
    view,
)
from isac_arena.own_packages import names_in_the_way

USAGE_ERROR: Any = typer.BadParameter.__bases__[0]  # of click, or of the copy of it that typer brings along

INTERRUPTED = 130
FULL = "free some space and run the same command again: it goes on where it stopped"
ELSEWHERE = "choose an --out that can be written"

app = typer.Typer(
    name="arena",
    help="End-to-end 60 GHz ISAC simulator: from a ray-traced hall to scored object shapes.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("run")(campaign.run)
app.command("generate")(campaign.generate)
app.command("estimate")(campaign.estimate)
app.command("score")(campaign.score)
app.command("report")(campaign.report)
app.command("view")(view.view)
app.command("import-mat")(imports.import_mat)
app.command("import-deepmimo")(imports.import_deepmimo)
app.command("export")(export.export)
app.command("link")(link.link)
app.command("export-sigmf")(export.export_sigmf)
app.command("bound")(bound.bound)
app.command("ablate")(ablate.ablate)
app.command("budget")(budget.budget)
app.command("sweep")(sweep.sweep)
app.command("sweep-report")(sweep.sweep_report)
app.command("verify")(verify.verify)
app.command("compare")(compare.compare)
app.command("golden")(golden.golden)
app.command("twin")(twin.twin)
app.command("doctor")(doctor.doctor)
app.command("validate")(validate.validate)
app.command("bench")(validate.bench)
app.add_typer(scene.app, name="scene")
app.add_typer(study.app, name="study")


def main() -> None:
    """Run the command line; every failure ends in one line on stderr and a non-zero exit code."""
    _add_working_folder()
    sys.unraisablehook = lambda _: None  # a damaged file's reader complains once more when it is thrown away
    try:
        code = app(standalone_mode=False)
        if code == INTERRUPTED:  # typer turns Ctrl-C into an exit without a word
            raise KeyboardInterrupt
        sys.exit(code)
    except USAGE_ERROR as error:
        _fail(_usage(error), error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; the same command goes on where it stopped", INTERRUPTED)
    except (ValueError, OSError, RuntimeError) as error:
        _fail(_one_line(error), 2)
    except Exception as error:  # a defect of ours: still one line, with a way to see more
        _fail(f"{type(error).__name__}: {_one_line(error)} (ARENA_DEBUG=1 shows where)", 70)


def _add_working_folder() -> None:
    """Let Python find a user's estimator in the folder where the command runs.

    Where that folder has a package with the name of one of ours, it comes last, so that ours are used. A line on
    stderr says so.
    """
    folder = Path.cwd()
    in_the_way = names_in_the_way(folder)
    if not in_the_way:
        sys.path.insert(0, str(folder))
        return
    sys.path[:] = [*(entry for entry in sys.path if entry not in ("", str(folder))), str(folder)]
    found = ", ".join(map(str, in_the_way))
    sys.stderr.write(f"arena: {found}: has the name of a package of ISAC Arena and is not used\n")


def _fail(message: str, code: int) -> None:
    if os.environ.get("ARENA_DEBUG") and sys.exc_info()[0] is not None:
        raise  # noqa: PLE0704
    sys.stderr.write(f"arena: {message}\n")
    sys.exit(code)


def _usage(error: Any) -> str:
    """What is wrong with an option: its name, the value given and what is allowed, where a value is wrong."""
    details: list[Any] = getattr(error.__cause__, "errors", list)()  # of pydantic, which checks the values
    if not details or error.param is None:
        return " ".join(error.format_message().split())
    option = next((name for name in error.param.opts if name.startswith("--")), error.param.name)
    allowed = details[0]["msg"].removeprefix("Value error, ").replace("Input should", "must")
    return f"{option} = {details[0]['input']}: {allowed}"


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        # A file is written under a temporary name first; the user knows it by its own.
        named = re.sub(r"\.([^/]+)\.\d+\.part(?=/|$)", r"\1", str(error.filename or ""))
        told = f"{named}: {error.strerror}" if named else error.strerror
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return f"{told}; {FULL}"
        return f"{told}; {ELSEWHERE}" if "cannot be written" in told else told
    return " ".join(str(error).split()) or type(error).__name__
