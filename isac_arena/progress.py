"""Progress with the time left: a bar in a terminal, elsewhere a line every 30 s."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from threading import Event, Thread
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

PERIOD_S = 30.0  # of the lines where there is no terminal
SPEED_PERIOD_S = 3600.0  # the bar tells the time left from what was done in it: a stop may take minutes
LONGEST_LIST = 6  # names in a sentence
T = TypeVar("T")


class TimedProgress(Progress):
    """A progress bar that prints a line every `PERIOD_S` where the console is no terminal."""

    _lines: AbstractContextManager[None] | None = None

    def start(self) -> None:
        """As `Progress`."""
        super().start()
        if not self.console.is_terminal and self._lines is None:
            self._lines = _lines_every(self.console, self._state)
            self._lines.__enter__()

    def stop(self) -> None:
        """As `Progress`."""
        if self._lines is not None:
            self._lines.__exit__(None, None, None)
            self._lines = None
        super().stop()

    def _state(self) -> str:
        """The unfinished tasks: how much is done, and how long it takes."""
        tasks = [task for task in self.tasks if not task.finished and task.total]
        return "; ".join(
            f"{task.description}: {task.completed:g} of {task.total:g}, {task.elapsed or 0:.0f} s{_left(task)}"
            for task in tasks
        )


def _left(task: Task) -> str:
    """The time left at the mean speed so far; empty where nothing is done yet."""
    if not (task.completed and task.elapsed and task.remaining):
        return ""
    return f", about {duration(task.elapsed / task.completed * task.remaining)} left"


def duration(seconds: float) -> str:
    """A time in words of the size that a reader waits for: s, min or h."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 100 * 60 else f"{seconds / 3600:.1f} h"


def counted(number: int, what: str) -> str:
    """A number of things: "1 case", "2 cases"."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def listed(names: Iterable[object]) -> str:
    """Names in a sentence; of many the first ones and how many more."""
    every = list(map(str, names))
    more = f" and {len(every) - LONGEST_LIST} more" if len(every) > LONGEST_LIST else ""
    return ", ".join(every[:LONGEST_LIST]) + more


def progress_bar(console: Console, *fields: str, **options: Any) -> Progress:
    """A progress bar with counts, some `fields` of its tasks, and elapsed and remaining time."""
    counts = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    texts = [TextColumn(f"{{task.fields[{name}]}}") for name in fields]
    times = TimeElapsedColumn(), TextColumn("remaining"), TimeRemainingColumn()
    options = {"speed_estimate_period": SPEED_PERIOD_S} | options
    return TimedProgress(*counts, *texts, *times, console=console, **options)


def tracked(console: Console, items: Iterable[T], total: int, description: str) -> Iterator[T]:
    """The items, with their progress."""
    with progress_bar(console, transient=True) as progress:
        yield from progress.track(items, total, description=description)


@contextmanager
def working(console: Console, description: str) -> Iterator[None]:
    """Something of unknown length: a spinner in a terminal, elsewhere a line every `PERIOD_S`."""
    if console.is_terminal:
        with console.status(description):
            yield
        return
    started = time.monotonic()
    with _lines_every(console, lambda: f"{description}: {time.monotonic() - started:.0f} s"):
        yield


@contextmanager
def _lines_every(console: Console, line: Callable[[], str]) -> Iterator[None]:
    """Print a line every `PERIOD_S` until the block ends."""
    ended = Event()

    def repeat() -> None:
        while not ended.wait(PERIOD_S):
            if text := line():
                console.print(text, markup=False, soft_wrap=True)

    thread = Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
