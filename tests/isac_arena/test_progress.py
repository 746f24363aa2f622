"""Where there is no terminal, long work prints a line now and then with what is done and what is left."""

import io
import re
import time

import pytest
from rich.console import Console
from rich.progress import Task, TaskID

from estimation.steps import STEPS
from isac_arena import progress


@pytest.fixture
def console(monkeypatch: pytest.MonkeyPatch) -> Console:
    monkeypatch.setattr(progress, "PERIOD_S", 0.02)
    return Console(file=io.StringIO(), force_terminal=False, width=120)


def printed(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_tracked_items_tell_how_many_are_done_and_how_long_the_rest_takes(console: Console) -> None:
    items = [time.sleep(0.03) or k for k in progress.tracked(console, range(8), 8, "stops")]
    assert items == list(range(8))
    lines = [line for line in printed(console).splitlines() if line.startswith("stops: ")]
    assert len(lines) >= 2 and " of 8, " in lines[-1] and "s left" in lines[-1]


def test_the_time_left_is_known_as_soon_as_one_is_done() -> None:
    task = Task(TaskID(0), "stops", total=5, completed=1, _get_time=lambda: 180.0)
    task.start_time = 0.0
    assert progress._left(task) == ", about 12 min left"
    task.fields["more"] = "SLAM"
    assert progress._left(task) == ", about 12 min left, then SLAM"
    task.completed = 0
    assert progress._left(task) == ""


@pytest.mark.parametrize(("seconds", "text"), [(9.6, "10 s"), (600, "10 min"), (36000, "10.0 h")])
def test_durations_have_the_unit_of_their_size(seconds: float, text: str) -> None:
    assert progress.duration(seconds) == text


def test_work_of_unknown_length_tells_its_time_and_ends_with_an_error(console: Console) -> None:
    with pytest.raises(ZeroDivisionError), progress.working(console, "scores"):
        time.sleep(0.1)
        _ = 1 / 0
    before = printed(console)
    assert "scores: 0 s" in before
    time.sleep(0.06)
    assert printed(console) == before


def test_short_work_prints_nothing() -> None:
    console = Console(file=io.StringIO(), force_terminal=False)
    with progress.working(console, "scores"):
        assert list(progress.tracked(console, "abc", 3, "stops")) == ["a", "b", "c"]
    assert not printed(console).strip()


def called(
    seconds: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], first_s: float = 0.02
) -> str:
    """What a series of five calls tells whose first line is due after a time."""
    monkeypatch.setattr(progress, "FIRST_S", first_s)
    monkeypatch.setattr(progress, "PERIOD_S", 0.02)
    monkeypatch.setattr(progress._Calls, "ended", -1.0)

    @progress.told(lambda number: f"call {number}")
    def one(number: int) -> int:
        STEPS.info("stop %d of 3", number)
        time.sleep(seconds)
        return number

    assert [one(number) for number in range(5)] == list(range(5))
    return capsys.readouterr().err


def test_long_calls_of_a_script_tell_their_time_and_steps(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told = called(0.2, monkeypatch, capsys)
    assert re.search(r"call \d, stop \d of 3: \d s", told)
    assert called(0.0, monkeypatch, capsys, first_s=60.0) == ""


def test_calls_inside_of_something_that_tells_its_time_are_silent(
    console: Console, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress.working(console, "scores"):
        assert called(0.05, monkeypatch, capsys) == ""
    with progress.progress_bar(console):
        assert called(0.05, monkeypatch, capsys) == ""
    assert called(0.2, monkeypatch, capsys) != ""


def test_numbers_of_things_have_their_plural() -> None:
    assert [progress.counted(n, "case") for n in (0, 1, 2)] == ["0 cases", "1 case", "2 cases"]
    assert progress.counted(2, "axis", "axes") == "2 axes"
    assert progress.listed(range(8)) == "0, 1, 2, 3, 4, 5 and 2 more"
