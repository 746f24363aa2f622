"""The `arena` command: one Typer application, one module per group of verbs.

Modules import heavy libraries inside their functions only, so `--help` answers at once.
"""

from __future__ import annotations

import os
import sys

import typer

from scripts import campaign, doctor, link, scene, sigmf, validate

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
app.command("link")(link.link)
app.command("export-sigmf")(sigmf.export_sigmf)
app.command("doctor")(doctor.doctor)
app.command("validate")(validate.validate)
app.command("bench")(validate.bench)
app.add_typer(scene.app, name="scene")


def main() -> None:
    """Run the command line; every failure ends in one line on stderr and a non-zero exit code."""
    try:
        app()
    except KeyboardInterrupt:
        _fail("interrupted; the same command goes on where it stopped", 130)
    except (ValueError, OSError, RuntimeError) as error:
        _fail(_one_line(error), 2)
    except Exception as error:  # a defect of ours: still one line, with a way to see more
        _fail(f"{type(error).__name__}: {_one_line(error)} (ARENA_DEBUG=1 shows where)", 70)


def _fail(message: str, code: int) -> None:
    if os.environ.get("ARENA_DEBUG") and sys.exc_info()[0] is not None:
        raise  # noqa: PLE0704
    sys.stderr.write(f"arena: {message}\n")
    sys.exit(code)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__
