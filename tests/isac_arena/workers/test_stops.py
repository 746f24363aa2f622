"""The stops of a campaign side by side: same bytes for any number of workers, nothing lost in a failure."""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from isac_arena.workers import stops
from scenes.memory import limited_memory
from tests.command_line import arena_here, environment, failure
from tests.isac_arena.cli.sweep_files import CAMPAIGN

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

# Workers start after the first stop
AT_ONCE = "from isac_arena.workers import stops; stops.START_S = float('-inf')"
# A command that a shell starts in the background ignores interrupts
HEARS = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
COMMAND = [sys.executable, "-c", f"{AT_ONCE}; {HEARS}; from isac_arena.cli.main import main; main()"]
RUN = ("run", "small.toml", "--out", "run", "--workers", "2")
LAB = """
import os, time
from pathlib import Path
from estimation.channel.config import ChannelConfig
from estimation.channel.estimate import estimate_channel
from estimation.channel.record import empty_estimate

def good(sweep):
    return estimate_channel(sweep, config=ChannelConfig(method="power"))

def raises(sweep):
    return 1 / 0 if sweep.stop == 2 else good(sweep)

def no_map(channel, tx_pose, receiver):
    return 1 / 0

def dies(sweep):
    os._exit(0) if sweep.stop == 2 else None
    return good(sweep)

def hangs(sweep):  # else it is quick, also on a busy machine
    time.sleep(600) if sweep.stop == 2 else None
    return empty_estimate(sweep.stop, "none", "no paths", "")

def stops(sweep):
    if sweep.stop == 2:
        raise KeyboardInterrupt
    return good(sweep)

def slow(sweep):
    Path("at_work").mkdir(exist_ok=True)
    (Path("at_work") / f"{os.getpid()}_{sweep.stop}").touch()
    time.sleep(1.5 if sweep.stop and Path("slow").exists() else 0.0)
    return good(sweep)
"""


def tree(folder: Path) -> dict[str, bytes]:
    """Contents of all files but those in side folders."""
    found = (file for file in folder.rglob("*") if file.is_file() and ".part" not in str(file))
    return {str(file.relative_to(folder)): file.read_bytes() for file in found}


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stops, "START_S", -math.inf)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "small.toml").write_text(CAMPAIGN)
    (tmp_path / "lab.py").write_text(LAB)
    return tmp_path


@pytest.mark.usefixtures("at_once")
def test_two_workers_and_a_resumed_run_give_the_same_bytes(finished: Path, folder: Path) -> None:
    before = tree(finished / "run")  # made in one process
    assert arena_here(*RUN, cwd=folder).returncode == 0
    assert tree(folder / "run") == before
    made_last = ("manifest.json", "scores.json", "provenance.nc", "report.html", "map/slam.nc")
    for name in (*made_last, "truth/stop_003.nc"):
        (folder / "run" / name).unlink()
    for stop in range(3):
        (folder / "run" / f"channel/stop_{stop:03d}.nc").unlink()
    assert arena_here(*RUN, cwd=folder).returncode == 0
    assert tree(folder / "run") == before
    (folder / "run" / "truth/stop_001.nc").unlink()  # of a finished run: the workers write beside it
    (folder / "run" / "truth/stop_002.nc").unlink()
    assert arena_here("estimate", "run", "--workers", "2", cwd=folder).returncode == 0
    assert tree(folder / "run") == before


@pytest.mark.usefixtures("at_once")
def test_samples_and_a_self_calibration_are_the_same(folder: Path) -> None:
    with (folder / "small.toml").open("a") as file:
        file.write('[channel.self_calibration]\nuse = "always"\nstops = 3\nmin_snr_db = 10.0\n')
        file.write("min_purity = 0.8\n[impairments]\nelement_phase_std_deg = 5.0\n")
    trees = []
    for workers in (1, 2):
        out = f"out{workers}"
        assert arena_here("generate", "small.toml", "--out", out, "--workers", workers, cwd=folder).returncode == 0
        assert arena_here("estimate", out, "--workers", workers, cwd=folder).returncode == 0
        trees.append(tree(folder / out))
    assert trees[0] == trees[1]
    assert {"channel/calibration.nc", "sweep/stop_003.nc", "map/slam.nc"} <= trees[0].keys()


@pytest.mark.usefixtures("at_once")
def test_a_failure_of_a_worker_is_that_of_one_process(finished: Path, folder: Path) -> None:
    shutil.copytree(finished / "run", folder / "run")
    before = tree(folder / "run")
    here, there = (
        failure("estimate", "run", "--estimator", "lab:stops", "--workers", workers, cwd=folder)
        for workers in (1, 2)
    )
    assert here == there
    assert tree(folder / "run") == before
    trees = []
    for workers in (1, 2):
        shutil.rmtree(folder / "run")
        shutil.copytree(finished / "run", folder / "run")
        done = arena_here("estimate", "run", "--channel", "lab:raises", "--workers", workers, cwd=folder)
        assert done.returncode == 1
        assert done.stderr.startswith("arena: channel = 'lab:raises': stop 2: ZeroDivisionError")
        assert done.stderr.endswith("; the run went on without; traceback in run/estimator_error.txt\n")
        trees.append(tree(folder / "run"))
    assert trees[0] == trees[1] != before
    trace = (folder / "run/estimator_error.txt").read_text()
    assert "return 1 / 0" in trace and "room.py" not in trace


@pytest.mark.usefixtures("at_once")
def test_a_map_that_fails_beside_another_is_that_of_one_process(folder: Path) -> None:
    trees, said = [], []
    for workers in (1, 2):
        shutil.rmtree(folder / "run", ignore_errors=True)
        run = (*RUN[:-1], workers, "--mapping", "lab:no_map")
        done = arena_here(*run, cwd=folder)
        assert done.returncode == 1 and "failed: mapping = 'lab:no_map': ZeroDivisionError" in done.stdout
        trees.append(tree(folder / "run"))
        said.append(done.stderr)
    assert trees[0] == trees[1] and said[0] == said[1]


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("name", ["dies", "hangs"])
def test_a_function_that_ends_is_named_by_its_stop_and_the_run_goes_on(folder: Path, name: str) -> None:
    limit = ("--stop-limit", "2") if name == "hangs" else ()
    done = arena_here(*RUN, *limit, "--estimator", f"lab:{name}", cwd=folder)
    why = {"dies": "ended its process with exit code 0", "hangs": "took longer than 2 s"}[name]
    assert (done.returncode, done.stderr) == (
        1, f"arena: channel = 'lab:{name}': stop 2: {why}; the run went on without\n"
    )  # fmt: skip
    assert f"failed: channel = 'lab:{name}': stop 2: {why}" in done.stdout
    assert f"stop 2: {why}" in (folder / "run" / "report.html").read_text().replace("&#39;", "'")
    causes = {row["key"]: row["value"] for row in json.loads((folder / "run" / "scores.json").read_text())}
    assert causes["channel.missed.refused"] > 0
    (folder / "lab.py").write_text(LAB.replace("sweep.stop == 2", "False"))
    before = {file: file.stat().st_mtime_ns for file in (folder / "run" / "truth").glob("*.nc")}
    assert arena_here(*RUN, "--estimator", f"lab:{name}", cwd=folder).returncode == 0
    assert all(file.stat().st_mtime_ns == written for file, written in before.items())
    assert not list((folder / "run").rglob("*.part"))


@pytest.mark.slow  # `arena validate robustness --quick` kills runs too
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_an_ended_command_leaves_no_process_that_writes_on(folder: Path, number: int) -> None:
    (folder / "slow").touch()
    command = [*COMMAND, *RUN, "--estimator", "lab:slow"]
    process = subprocess.Popen(
        command, cwd=folder, env=environment(), text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        start_new_session=True,
    )  # fmt: skip
    ends = time.monotonic() + 120
    while len(list(folder.glob("at_work/*"))) < 3:  # one here, two on workers
        assert process.poll() is None and time.monotonic() < ends
        time.sleep(0.05)
    children = psutil.Process(process.pid).children(recursive=True)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does: every process of the command gets it
    else:
        process.send_signal(number)
    _, told = process.communicate(timeout=120)
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not [each for each in alive if each.status() != psutil.STATUS_ZOMBIE]
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert told.splitlines() == ["arena: interrupted; the same command continues where it stopped"]
    made = tree(folder / "run")
    time.sleep(2.0)
    assert tree(folder / "run") == made
    (folder / "slow").unlink()
    assert arena_here(*RUN, "--estimator", "lab:slow", cwd=folder).returncode == 0
    again = ("run", "small.toml", "--out", "fresh", "--workers", "1", "--estimator", "lab:slow")
    assert arena_here(*again, cwd=folder).returncode == 0
    assert tree(folder / "run") == tree(folder / "fresh")


def test_workers_start_where_they_save_more_than_they_cost() -> None:
    first_s, start_s = stops.FIRST_S, 15.0
    assert not stops.pays(2, 100, [], start_s)  # the first stop is made here
    assert not stops.pays(1, 1000, [0.0, 60.0], start_s)
    assert not stops.pays(2, 3, [first_s + 1.0], start_s)  # what is left takes less than the start
    assert stops.pays(2, 3, [first_s + 60.0], start_s)
    assert not stops.pays(2, 100, [first_s, 0.1], start_s)
    assert stops.pays(2, 1000, [first_s, 0.1], start_s)
    assert stops.pays(8, 20, [0.0, 1.0], start_s) and not stops.pays(2, 20, [0.0, 1.0], start_s)


def test_memory_holds_fewer_workers_and_says_so() -> None:
    each = stops.WORKER_BYTES + 1e9
    with limited_memory(f"{2.5 * each:.0f}B"):
        assert stops.affordable(2, 1e9) == (2, "")
        n_workers, told = stops.affordable(8, 1e9)
    assert n_workers == 2 and "2 in place of 8" in told and "--memory" in told
    with limited_memory("1MB"):
        assert stops.affordable(8, 1e9)[0] == 1
