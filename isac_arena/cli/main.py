"""The `arena` command: one Typer application, one module per group of verbs.

Modules import heavy libraries inside their functions only, so `--help` answers at once.
"""

import errno
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from isac_arena.cli import (
    ablate,
    budget,
    campaign,
    compare,
    doctor,
    exchange,
    golden,
    link,
    new,
    scene,
    study,
    sweep,
    twin,
    validate,
    verify,
    view,
)
from isac_arena.cli.bounds import bound, place
from isac_arena.cli.learning import dataset, task
from isac_arena.cli.options import with_clock, with_kernels, with_memory
from isac_arena.own_packages import hiding_names
from isac_arena.user_functions.errors import EstimatorError, WentOnError

USAGE_ERROR: Any = typer.BadParameter.__bases__[0]  # of click, or of typer's own copy of click

INTERRUPTED = 130
FULL = "free some space and run the same command again: it continues where it stopped"
ELSEWHERE = "choose an --out that can be written"

app = typer.Typer(
    name="arena",
    help="End-to-end 60 GHz ISAC simulator: from a ray-traced hall to scored object shapes.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
COMMANDS = (
    new.settings,
    campaign.run, campaign.generate, campaign.estimate, campaign.score, campaign.report, with_clock(view.view),
    with_clock(exchange.import_paths), with_clock(exchange.import_mat), with_clock(exchange.import_iq),
    with_clock(exchange.import_deepmimo), with_clock(exchange.export), link.link,
    with_clock(exchange.export_sigmf), bound.bound, place.place,
    with_kernels(ablate.ablate), with_kernels(budget.budget),
    sweep.sweep, sweep.sweep_report, dataset.dataset,
    verify.verify, with_clock(compare.compare), golden.golden,
    with_kernels(twin.twin), doctor.doctor, with_kernels(validate.validate), with_kernels(validate.bench),
)  # fmt: skip
PANELS = {  # of `arena --help`; imports and exports have one of their own
    "Your files": ("campaign", "scene", "new", "settings"),
    "A run and its stages": ("run", "generate", "estimate", "score", "report", "view", "compare", "verify"),
    "Many runs": ("sweep", "sweep-report", "dataset", "task"),
    "What limits the errors": ("link", "bound", "place", "budget", "ablate", "twin", "study"),
    "This installation": ("doctor", "validate", "bench", "golden"),
}


def _panel(name: str) -> str:
    """The panel of the help in which a command stands."""
    if name.startswith(("import", "export")):
        return "From and to other tools"
    return next((title for title, names in PANELS.items() if name in names), "More")


def _flowing(command: Callable[..., Any]) -> str:
    """The help of a command as paragraphs without line breaks: the terminal breaks them."""
    return "\n\n".join(" ".join(part.split()) for part in (command.__doc__ or "").split("\n\n"))


for command in COMMANDS:
    called = command.__name__.replace("_", "-")
    app.command(called, help=_flowing(command), rich_help_panel=_panel(called))(with_memory(command))
GROUPS = {"campaign": campaign, "scene": scene, "new": new, "study": study, "task": task}
for called, group in GROUPS.items():
    for registered in group.app.registered_commands:
        registered.help = _flowing(registered.callback) if registered.callback else None
    app.add_typer(group.app, name=called, rich_help_panel=_panel(called))


def main() -> None:
    """Run the command line; every failure ends in one line on stderr and a non-zero exit code."""
    _add_working_folder()
    sys.unraisablehook = lambda _: None  # the reader of a damaged file fails again at its deletion
    guarded(lambda: app(standalone_mode=False))


def guarded(call: Callable[[], Any]) -> None:
    """Call a function as a command: every failure ends in one line on stderr and a non-zero exit code."""
    try:
        code = call()
        if code == INTERRUPTED:  # typer turns Ctrl-C into an exit without a message
            raise KeyboardInterrupt
        sys.exit(code)
    except USAGE_ERROR as error:
        _fail(_usage(error), error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; the same command continues where it stopped", INTERRUPTED)
    except EstimatorError as error:
        _fail(f"{error}{_kept(error)}", 1 if isinstance(error, WentOnError) else 2)
    except (ValueError, OSError, RuntimeError) as error:
        _fail(_one_line(error), 2)
    except Exception as error:  # a defect of ours: still one line, with a way to see more
        _fail(f"{type(error).__name__}: {_one_line(error)} (ARENA_DEBUG=1 shows where)", 70)


def _kept(error: EstimatorError) -> str:
    """Where the traceback of a user's function is kept, if it can be written."""
    if not error.trace:
        return ""
    try:
        error.trace_file.write_text(error.trace, encoding="utf-8")
    except OSError:
        return ""
    return f"; traceback in {error.trace_file}"


def _add_working_folder() -> None:
    """Let Python find a user's estimator in the folder where the command runs.

    A folder that has a package with the name of one of ours comes last, so that ours are used; stderr says so.
    """
    folder = Path.cwd()
    hiding = ", ".join(map(str, hiding_names(folder)))
    if not hiding:
        sys.path.insert(0, str(folder))
        return
    sys.path[:] = [*(entry for entry in sys.path if entry not in ("", str(folder))), str(folder)]
    sys.stderr.write(f"arena: {hiding}: has the name of a package of ISAC Arena and is not used\n")


def _fail(message: str, code: int) -> None:
    if os.environ.get("ARENA_DEBUG") and sys.exc_info()[0] is not None:
        raise  # noqa: PLE0704
    sys.stderr.write(f"arena: {message}\n")
    sys.exit(code)


def _usage(error: Any) -> str:
    """The message of a usage error; for a wrong value the option, the value and what is allowed."""
    details: list[Any] = getattr(error.__cause__, "errors", list)()  # of pydantic, which checks the values
    if not details or error.param is None:
        return " ".join(error.format_message().split())
    option = next((name for name in error.param.opts if name.startswith("--")), error.param.name)
    allowed = details[0]["msg"].removeprefix("Value error, ").replace("Input should", "must")
    return f"{option} = {details[0]['input']}: {allowed}"


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        # A file is first written under a temporary name; the message gives the final name.
        named = re.sub(r"\.([^/]+)\.\d+\.part(?=/|$)", r"\1", str(error.filename or ""))
        text = f"{named}: {error.strerror}" if named else error.strerror
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return f"{text}; {FULL}"
        return f"{text}; {ELSEWHERE}" if "cannot be written" in text else text
    return " ".join(str(error).split()) or type(error).__name__
