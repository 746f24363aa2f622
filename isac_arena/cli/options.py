"""Arguments and options that several commands share, each defined once."""

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

Campaign = Annotated[str, typer.Argument(help="Campaign name of the library, or path of a TOML file.")]
Directory = Annotated[Path, typer.Argument(help="Directory of a campaign.")]
Out = Annotated[Path, typer.Option(help="Directory of the campaign; made where missing.")]
OutFolder = Annotated[Path, typer.Option(help="Directory of the tables and figures; made where missing.")]
Seed = Annotated[int | None, typer.Option(min=0, max=2**63 - 1, help="Seed, in place of the file's.")]
RandomSeed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers of this command.")]
Channel = Annotated[
    str | None,
    typer.Option(
        "--channel", "--estimator",
        help="Your channel estimator: package.module:function, the name of an installed one, or ours.",
    ),
]  # fmt: skip
Mapping = Annotated[str | None, typer.Option(help="Your mapping: as --channel.")]
Slam = Annotated[str | None, typer.Option(help="Your SLAM: as --channel.")]
Shapes = Annotated[str | None, typer.Option(help="Your contours of objects: as --channel.")]
Tracker = Annotated[str | None, typer.Option(help="Your tracks of what moves: as --channel.")]
KeepSweeps = Annotated[bool, typer.Option(help="Keep the samples of every stop (about 40 MB each).")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the rows to this JSON file as well.")]
Quick = Annotated[bool, typer.Option("--quick", help="A subset that takes seconds.")]
WorkerCount = Annotated[
    int | None, typer.Option(min=1, help="Worker processes on this machine, by default one per core.")
]
StopLimit = Annotated[
    float | None,
    typer.Option(
        min=0.1, help="Seconds per stop, and per call of your functions, after which it counts as hanging; 3600."
    ),
]
Memory = Annotated[
    str | None, typer.Option(help="Most memory to take, such as 4GB; by default 80 % of what is free.")
]


def functions(**named: str | None) -> dict[str, str]:
    """The functions that options name, by the stage that they replace."""
    return {stage: name for stage, name in named.items() if name is not None}


def with_clock(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command of unknown length: a spinner in a terminal, elsewhere a line every 30 s."""

    @wraps(command)
    def timed(*arguments: Any, **options: Any) -> Any:
        from rich.console import Console  # noqa: PLC0415

        from isac_arena.progress import working  # noqa: PLC0415

        with working(Console(highlight=False), command.__name__.replace("_", " ")):
            return command(*arguments, **options)

    return timed


def with_kernels(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command that computes from its start: kernels that are not compiled are first."""

    @wraps(command)
    def prepared(*arguments: Any, **options: Any) -> Any:
        from rich.console import Console  # noqa: PLC0415

        from isac_arena.kernels import ensure_kernels  # noqa: PLC0415

        ensure_kernels(Console(stderr=True, highlight=False))
        return command(*arguments, **options)

    return prepared


def with_memory(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command with the option `--memory`."""

    def limited(*arguments: Any, memory: str | None = None, **options: Any) -> Any:
        from scenes.memory import limited_memory  # noqa: PLC0415

        with limited_memory(memory):
            return command(*arguments, **options)

    signature = inspect.signature(command, eval_str=True)
    option = inspect.Parameter("memory", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Memory)
    parameters = [*signature.parameters.values(), option]
    about = {
        "__name__": command.__name__,
        "__doc__": command.__doc__,
        "__signature__": signature.replace(parameters=parameters),
        "__annotations__": {each.name: each.annotation for each in parameters},
    }
    for name, value in about.items():
        setattr(limited, name, value)
    return limited
