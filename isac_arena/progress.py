"""Progress with the time left: a bar in a terminal, elsewhere a line every 30 s."""

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import wraps
from threading import Event, Thread, current_thread, main_thread
from typing import Any, ParamSpec, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from estimation.steps import STEPS

PERIOD_S = 30.0  # of the lines where there is no terminal
FIRST_S = 10.0  # calls of a script are silent so long; a longer pause ends a series of calls
SPEED_PERIOD_S = 3600.0  # the bar tells the time left from what was done in it: a stop may take minutes
LONGEST_LIST = 6  # names in a sentence
T = TypeVar("T")
P = ParamSpec("P")


class TimedProgress(Progress):
    """A progress bar that prints a line every `PERIOD_S` where the console is no terminal."""

    _lines: AbstractContextManager[None] | None = None
    _is_counted = False

    def start(self) -> None:
        """As `Progress`."""
        super().start()
        _Calls.n_silent += not self._is_counted
        self._is_counted = True
        if not self.console.is_terminal and self._lines is None:
            self._lines = _lines_every(self.console, self._state)
            self._lines.__enter__()

    def stop(self) -> None:
        """As `Progress`."""
        if self._lines is not None:
            self._lines.__exit__(None, None, None)
            self._lines = None
        _Calls.n_silent -= self._is_counted
        self._is_counted = False
        super().stop()

    def _state(self) -> str:
        """The unfinished tasks: how much is done, and how long it takes."""
        tasks = [task for task in self.tasks if not task.finished and task.total]
        return "; ".join(
            f"{task.description}: {_done(task)}, {task.elapsed or 0:.0f} s{_left(task)}" for task in tasks
        )


def _done(task: Task) -> str:
    """What is done: a count, or the usual share in the time where the task `is_share`."""
    total = task.total or 1.0
    if task.fields.get("is_share"):
        return f"{task.completed / total:.0%} done"
    return f"{task.completed:g} of {total:g}"


def _left(task: Task) -> str:
    """The time left at the mean speed so far; empty where no more than the share `told_from` is done.

    What several workers make `side_by_side` counts as half done. `more` says which stages it leaves out.
    """
    told_from = task.fields.get("told_from", 0.0) * (task.total or 0.0)
    if not (task.completed > told_from and task.elapsed and task.remaining):
        return ""
    n_begun = min(task.fields.get("side_by_side", 1), task.remaining)
    done = task.completed + (n_begun / 2 if n_begun > 1 else 0.0)
    more = f", then {task.fields['more']}" if task.fields.get("more") else ""
    return f", about {duration(task.elapsed / done * ((task.total or 0.0) - done))} left{more}"


def duration(seconds: float) -> str:
    """A time in words of the size that a reader waits for: s, min or h."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 100 * 60 else f"{seconds / 3600:.1f} h"


def counted(number: int, what: str, many: str = "") -> str:
    """A number of things: "1 case", "2 cases"; `many` is the plural where it takes more than an s."""
    return f"{number} {what}" if number == 1 else f"{number} {many or what + 's'}"


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
    """Something of unknown length: a spinner with its time in a terminal, elsewhere a line every `PERIOD_S`."""
    started = time.monotonic()
    with _Calls.silent():
        if console.is_terminal:
            with _spinner(console, description):
                yield
        else:
            with _lines_every(console, lambda: f"{description}: {time.monotonic() - started:.0f} s"):
                yield


def _spinner(console: Console, description: str) -> Progress:
    """A spinner with its time, removed at its end."""
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    progress = Progress(*columns, console=console, transient=True)
    progress.add_task(description, total=None)
    return progress


@contextmanager
def heard_steps(tell: Callable[[str], None]) -> Iterator[None]:
    """Tell the steps of estimators while the block runs."""
    handler = logging.Handler()
    handler.emit = lambda record: tell(record.getMessage())  # type: ignore[method-assign]
    level = STEPS.level
    STEPS.setLevel(logging.INFO)
    STEPS.addHandler(handler)
    try:
        yield
    finally:
        STEPS.removeHandler(handler)
        STEPS.setLevel(level)


class _Calls:
    """The calls of a user's script that follow one another: none tells anything before `FIRST_S` of them all."""

    started, ended, due, n_silent = 0.0, -PERIOD_S, 0.0, 0

    @classmethod
    @contextmanager
    def silent(cls) -> Iterator[None]:
        """Calls inside print nothing: something else shows their progress."""
        cls.n_silent += 1
        try:
            yield
        finally:
            cls.n_silent -= 1

    @classmethod
    @contextmanager
    def one(cls, what: str) -> Iterator[None]:
        """One call; its words are told in a terminal at once, elsewhere where the calls take long."""
        now, console, said = time.monotonic(), Console(stderr=True, highlight=False), [what]
        if now - cls.ended > FIRST_S:
            cls.started, cls.due = now, now + FIRST_S

        def line() -> str:
            cls.due = time.monotonic() + PERIOD_S
            return f"{said[0]}: {time.monotonic() - cls.started:.0f} s"

        spinner = _spinner(console, what) if console.is_terminal else None
        pause = _lines_every(console, line, lambda: max(cls.due - time.monotonic(), 0.0))

        def step(detail: str) -> None:
            said[0] = f"{what}, {detail}"
            if spinner is not None:
                spinner.update(spinner.task_ids[0], description=said[0])

        try:
            with cls.silent(), heard_steps(step), spinner or pause:
                yield
        finally:
            cls.ended = time.monotonic()


def told(what: Callable[P, str]) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A public function whose calls from a script tell their time; `what` words a call from its arguments.

    In a terminal there is a live line; elsewhere the first line comes after `FIRST_S` of calls that follow one
    another, then one every `PERIOD_S`. Inside of a command or of another such call, and in other threads, nothing
    is told.
    """

    def decorated(function: Callable[P, T]) -> Callable[P, T]:
        """The function, whose calls tell their time."""

        @wraps(function)
        def timed(*arguments: P.args, **options: P.kwargs) -> T:
            if _Calls.n_silent or current_thread() is not main_thread():
                return function(*arguments, **options)
            with _Calls.one(what(*arguments, **options)):
                return function(*arguments, **options)

        return timed

    return decorated


@contextmanager
def _lines_every(
    console: Console, line: Callable[[], str], pause_s: Callable[[], float] = lambda: PERIOD_S
) -> Iterator[None]:
    """Print a line after every pause until the block ends."""
    ended = Event()

    def repeat() -> None:
        while not ended.wait(pause_s()):
            if text := line():
                console.print(text, markup=False, soft_wrap=True)

    thread = Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
