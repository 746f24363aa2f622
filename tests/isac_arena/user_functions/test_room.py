"""Functions in a process of their own: how their failures are told, and what a run makes of them."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from isac_arena.campaign.chain.inputs import walk_settings
from isac_arena.campaign.config import CampaignConfig, methods
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import MapResult, MemoryResults
from isac_arena.user_functions import room
from isac_arena.user_functions.config import UserFunction, with_functions
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, make_campaign, make_moving_campaign
from scenes.memory import limited_memory

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

LAB = """
import ctypes, os, sys, time
from dataclasses import replace
import numpy as np
from isac_arena import IncidencePoints, Tracks

class Mine(IncidencePoints):
    pass

def points(channel, tx, receiver, shift_m=0.0):
    rows = [(e.stop, path) for e in channel for path in range(1, len(e))]
    n = len(rows)
    return Mine(
        stop=np.array([r[0] for r in rows]), path=np.array([r[1] for r in rows]),
        position_m=np.full((n, 2), shift_m), covariance_m2=np.tile(np.eye(2), (n, 1, 1)),
        cost=np.zeros(n), is_inlier=np.ones(n, bool),
    )

def follow(channel, poses, survey):
    n = len(survey.stop)
    return Tracks(survey, np.zeros(n, int), survey.stop, poses.position_m, np.zeros((n, 2)))

def loses(channel, poses, survey): return follow(channel, poses, survey).take("state", survey.stop != 0)
def misses(channel, poses, survey): raise ValueError("no mover")
def shapes(channel, tx, receiver):
    return replace(receiver, position_m=receiver.position_m[1:])  # the line of the mistake
def leaves(channel, tx, receiver): sys.exit(3)
def dies(channel, tx, receiver): os._exit(7)
def crashes(channel, tx, receiver): ctypes.string_at(0)
def hangs(channel, tx, receiver): time.sleep(600)
def grows(channel, tx, receiver):
    held = [np.ones(2**22) for _ in range(30)]
    time.sleep(600)
def spins(channel, tx, receiver):
    while True: pass
def writes(channel, tx, receiver): receiver.position_m[0] = 0.0
def writes_through(channel, tx, receiver):
    address = channel[2].delay_s.__array_interface__["data"][0]
    (ctypes.c_double * 1).from_address(address)[0] = 1.0
    return points(channel, tx, receiver)
def moves(channel, tx, receiver):
    os.chdir("/")
    np.seterr(all="raise")
    return points(channel, tx, receiver)
def long(channel, tx, receiver): raise ValueError("x\\n" * 100_000)
def generator(channel, tx, receiver): yield 1
def interrupts(channel, tx, receiver): raise KeyboardInterrupt
def pid(channel, tx, receiver): raise ValueError(str(os.getpid()))
number = 3
"""


@pytest.fixture(scope="module")
def made() -> MadeCampaign:
    return make_campaign()


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "lab_of_rooms.py").write_text(LAB)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    room.close_rooms()


def call(made: MadeCampaign, name: str, limit_s: float = 60.0, **settings: Any) -> Any:
    function = UserFunction(function=f"lab_of_rooms:{name}", settings=settings, limit_s=limit_s)
    return room.called("mapping", function, list(made.results.channel), made.scene.tx, made.results.mapping.poses)


FAILURES = {
    "leaves": "SystemExit: 3 (",
    "dies": "ended its process with exit code 7",
    "crashes": "ended its process by SIGSEGV",
    "writes": "ValueError: assignment destination is read-only",
    "writes_through": "changed its input: 0 2 delay_s",
    "long": "ValueError: x x x",
    "generator": "returned a generator, IncidencePoints is needed",
}


@pytest.mark.usefixtures("lab")
def test_failures_are_told_in_one_line_and_the_next_call_works(made: MadeCampaign) -> None:
    before = [estimate.delay_s.tolist() for estimate in made.results.channel]
    for name, words in FAILURES.items():
        with pytest.raises(EstimatorError) as told:
            call(made, name)
        line = str(told.value)
        assert line.startswith(f"mapping = 'lab_of_rooms:{name}': {words}"), line
        assert "\n" not in line and len(line) < 800
    found = call(made, "points", shift_m=2.5)
    assert type(found).__name__ == "IncidencePoints" and (found.position_m == 2.5).all()
    assert (call(made, "moves").position_m == 0.0).all() and Path.cwd() != Path("/")
    with pytest.raises(KeyboardInterrupt):
        call(made, "interrupts")
    assert [estimate.delay_s.tolist() for estimate in made.results.channel] == before


def test_a_mistake_that_a_library_finds_is_told_at_the_line_that_made_it(lab: Path, made: MadeCampaign) -> None:
    with pytest.raises(EstimatorError) as told:
        call(made, "shapes")
    lines = LAB.splitlines()
    number = next(n for n, line in enumerate(lines, start=1) if "the line of the mistake" in line)
    assert f"({lab / 'lab_of_rooms.py'}, line {number})" in str(told.value)
    assert "scenes/record.py" in told.value.trace


@pytest.mark.usefixtures("lab")
def test_a_function_that_takes_too_much_memory_is_ended(made: MadeCampaign) -> None:
    with limited_memory("600MB"), pytest.raises(EstimatorError, match=r"took more than 0\.6 GB of memory$"):
        call(made, "grows")


@pytest.mark.usefixtures("lab")
@pytest.mark.parametrize("name", ["hangs", "spins"])
def test_a_function_that_hangs_is_ended_with_its_process(made: MadeCampaign, name: str) -> None:
    before = set(psutil.Process().children())
    with pytest.raises(EstimatorError, match=r"took longer than 0\.5 s$"):
        call(made, name, limit_s=0.5)
    left = set(psutil.Process().children()) - before
    assert not [each for each in left if each.status() != psutil.STATUS_ZOMBIE]


def test_a_process_stays_for_the_next_call_until_the_source_changes(made: MadeCampaign, lab: Path) -> None:
    numbers = []
    for _ in range(2):
        with pytest.raises(EstimatorError, match=r"ValueError: \d+") as told:
            call(made, "pid")
        numbers.append(str(told.value).split("ValueError: ")[1].split()[0])
    assert numbers[0] == numbers[1] != str(os.getpid())
    source = lab / "lab_of_rooms.py"
    source.write_text(LAB.replace("shift_m=0.0", "shift_m=4.0"))
    assert (call(made, "points").position_m == 4.0).all()


@pytest.mark.usefixtures("lab")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("lab_of_rooms:absent", "cannot be imported: AttributeError"),
        ("no_such_lab:f", "cannot be imported: ModuleNotFoundError"),
        ("lab_of_rooms:number", "cannot be imported: TypeError: is no function"),
        ("nobody_offers_this", "no installed package offers it"),
        (":", "write it as package.module:function"),
        ("lab_of_rooms:", "write it as package.module:function"),
    ],
)
def test_a_name_that_is_no_function_is_told(name: str, words: str) -> None:
    with pytest.raises(EstimatorError, match=f"^slam = '{name}': {words}"):
        room.check_functions(with_functions(CampaignConfig(name="a", scene="b"), {"slam": name}).functions)


@pytest.mark.usefixtures("lab")
def test_settings_that_do_not_fit_the_arguments_are_told(made: MadeCampaign) -> None:
    with pytest.raises(EstimatorError, match=r"cannot be called with 3 arguments and its settings: .*'shift'"):
        call(made, "points", shift=1.0)


def test_an_installed_package_offers_functions_by_name(made: MadeCampaign, lab: Path) -> None:
    about = lab / "their_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[isac_arena.estimators]\nshifted = lab_of_rooms:points\n")
    function = UserFunction(function="shifted", settings={"shift_m": 7.0})
    channel, poses = list(made.results.channel), made.results.mapping.poses
    assert (room.called("mapping", function, channel, made.scene.tx, poses).position_m == 7.0).all()
    other = lab / "other-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[isac_arena.estimators]\nshifted = lab_of_rooms:dies\n")
    room.close_rooms()
    with pytest.raises(EstimatorError, match="several packages offer it: name one of lab_of_rooms:dies, lab_of_"):
        room.called("mapping", function, channel, made.scene.tx, poses)


@pytest.mark.usefixtures("lab")
def test_a_run_goes_on_without_a_stage_that_fails_and_tries_it_again(made: MadeCampaign) -> None:
    ours = CampaignConfig(name="made", scene="box_room")
    channel, receiver = list(made.results.channel), made.results.mapping.poses
    config = with_functions(ours, {"mapping": "lab_of_rooms:dies", "slam": "lab_of_rooms:points"})
    assert methods(config)["mapping"] == "lab_of_rooms:dies"
    with pytest.raises(EstimatorError, match=r"^mapping = 'lab_of_rooms:dies': ended its process"):
        CampaignRun(config, made.scene).maps(channel, receiver)
    failures: list[EstimatorError] = []
    kept = MemoryResults()
    maps = CampaignRun(config, made.scene, kept, on_failure=failures.append).maps(channel, receiver)
    assert [str(one).partition(":")[0] for one in failures] == ["mapping = 'lab_of_rooms", "slam = 'lab_of_rooms"]
    assert len(maps["mapping"].ips) == 0 and (maps["mapping"].poses.position_m == receiver.position_m).all()
    assert np.isnan(maps["slam"].poses.position_m).all() and "returned a Mine" in maps["slam"].problem
    mended = with_functions(config, {"mapping": "lab_of_rooms:points", "slam": "ours"})
    again = CampaignRun(mended, made.scene, kept).maps(channel, receiver)
    assert len(again["mapping"].ips) and not again["mapping"].problem and not again["slam"].problem
    alone = CampaignRun(ours, made.scene).maps(channel, receiver)
    assert (again["slam"].poses.position_m == alone["slam"].poses.position_m).all()
    assert walk_settings(mended, made.scene.walk.positions_m()) is not None


@pytest.mark.usefixtures("lab")
def test_a_tracker_that_fails_loses_its_tracks_alone() -> None:
    moving = make_moving_campaign(np.array([0.4, -0.2, 0.0]))
    channel, receiver = list(moving.results.channel), moving.results.mapping.poses

    def maps(name: str, failures: list[EstimatorError]) -> MapResult:
        named = {"slam": "lab_of_rooms:leaves"} if "misses" in name else {}
        config = with_functions(CampaignConfig(name="made", scene="box_room"), {"tracker": name, **named})
        assert methods(config)["tracker"] == name
        return CampaignRun(config, moving.scene, on_failure=failures.append).maps(channel, receiver)["slam"]

    failures: list[EstimatorError] = []
    found = maps("lab_of_rooms:follow", failures)
    assert not failures and found.tracks is not None and found.tracks.n_tracks == 1
    assert (found.tracks.position_m == found.poses.position_m).all()
    fewer = maps("lab_of_rooms:loses", failures)
    assert fewer.tracks is not None and fewer.tracks.stop.tolist() == list(range(1, len(channel)))
    lost = maps("lab_of_rooms:misses", failures)
    assert lost.tracks is None and [str(one).partition(" ")[0] for one in failures] == ["slam", "tracker"]
    assert lost.problem.splitlines() == [str(one) for one in failures] and "no mover" in lost.problem


def test_the_process_ends_with_the_one_that_started_it(lab: Path) -> None:
    code = (
        "import os, time\n"
        "from isac_arena.user_functions import room\n"
        "from isac_arena.user_functions.config import UserFunction\n"
        "one = room.room('mapping', UserFunction(function='lab_of_rooms:points')); one.start()\n"
        "print(one._process.pid, flush=True); time.sleep(600)\n"
    )
    path = os.pathsep.join([str(lab), *sys.path])
    ours = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path}
    )
    assert ours.stdout is not None
    theirs = psutil.Process(int(ours.stdout.readline()))
    ours.kill()
    ours.wait()
    ends = time.monotonic() + 60
    while theirs.is_running() and theirs.status() != psutil.STATUS_ZOMBIE and time.monotonic() < ends:
        time.sleep(0.05)
    assert not theirs.is_running() or theirs.status() == psutil.STATUS_ZOMBIE


def test_named_functions_keep_the_settings_of_the_file() -> None:
    given = {"slam": {"function": "a:b", "settings": {"k": 2}, "limit_s": 9.0}}
    config = CampaignConfig.model_validate({"name": "a", "scene": "b", "functions": given})
    assert methods(config)["slam"] == "a:b (k = 2)"
    same = with_functions(config, {"slam": "a:b"}, limit_s=5.0).functions.slam
    assert same is not None and same.settings == {"k": 2} and same.limit_s == 5.0
    other = with_functions(config, {"slam": "a:c"}).functions.slam
    assert other is not None and not other.settings
    assert with_functions(config, {"slam": "ours"}).functions.given == {}


def test_a_function_that_cannot_be_imported_from_here_is_named() -> None:
    given = {"channel": {"function": "nowhere_to_be_found:estimate"}, "slam": {"function": "os:getcwd"}}
    config = CampaignConfig.model_validate({"name": "a", "scene": "b", "functions": given})
    cause = room.not_found(config.functions)
    assert cause.startswith("the function nowhere_to_be_found:estimate of these settings cannot be imported")
    assert "PYTHONPATH" in cause
    there = {"slam": {"function": "os:getcwd"}}
    usable = CampaignConfig.model_validate({"name": "a", "scene": "b", "functions": there})
    assert not room.not_found(usable.functions)
