import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import dask.config
import pyarrow.parquet as pq
import pytest
from distributed import wait
from typer.testing import CliRunner, Result

from isac_arena.campaign.lock import one_run
from isac_arena.cli.main import app
from isac_arena.scoring.score import Scores
from isac_arena.sweep import store as sweep_store
from isac_arena.sweep.cases import make_cases
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.job import make_job, store_scene
from isac_arena.sweep.plan import make_plan, metric_keys
from isac_arena.sweep.run import read_times, score_case, score_cases
from isac_arena.validation.robustness.sweeps import OLD, SCHEDULER, Processes
from isac_arena.verification.compare import compare_records
from isac_arena.workers.tasks import Future, outcome
from isac_arena.workers.workers import Workers
from scenes.toml_config import load_config
from tests.command_line import arena_here
from tests.isac_arena.cli.sweep_files import N_CASES, results, write_sweep

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

UNTIL = """
[until]
metric = "{metric}"
half_width = 1e-9
max_repeats = 3
"""
ESTIMATOR = """
import os
import signal
from pathlib import Path

from estimation.channel.power.paths import estimate_power


def estimate(sweep):
    if Path(__file__).with_name("broken").exists():
        raise RuntimeError("broken on purpose")
    return estimate_power(sweep)


def deadly(sweep):
    os.kill(os.getppid(), signal.SIGKILL)  # the worker: the function has a process of its own
"""


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}")  # workers find `mine` there
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "mine.py").write_text(ESTIMATOR)
    write_sweep(tmp_path)
    yield tmp_path
    sys.modules.pop("mine", None)  # the next test has its own


def run(folder: Path, out: str, *options: str) -> Result:
    return CliRunner().invoke(app, ["sweep", str(folder / "sweep.toml"), "--out", str(folder / out), *options])


def verify(folder: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["verify", str(folder), *options])


def test_two_workers_and_a_resumed_sweep_give_the_same_bytes(undisturbed: Path, files: Path) -> None:
    write_sweep(files, repeats=N_CASES // 2)
    first = run(files, "out", "--workers", "2")
    assert first.exit_code == 0, first.output
    assert results(files / "out") == results(undisturbed / "out")
    done = sorted((files / "out" / "cases").iterdir())
    assert len(done) == N_CASES
    for case, name in zip(done[:2], ("scores.json", "manifest.json"), strict=True):
        (case / name).unlink()  # a case that lost a file is none
    for case, name in zip(done[2:4], ("campaign.json", "provenance.nc"), strict=True):
        (case / name).write_bytes((case / name).read_bytes()[:-3])  # nor is a damaged one
    (files / "out" / "plan.json").write_text("{}")
    for file in (files / "out" / "paths").rglob("*.nc"):
        file.write_bytes(file.read_bytes()[:-100])  # nor are damaged paths used
    again = run(files, "out", "--workers", "1")
    assert again.exit_code == 0 and "".join(again.output.split()).count("runsagain") == 4
    assert results(files / "out") == results(undisturbed / "out")
    assert verify(files / "out", "--share", "0").exit_code == 0
    assert not list((files / "out").rglob("*.part"))
    table = pq.read_table(files / "out" / "results.parquet").to_pydict()
    assert set(table["power"]) == {0.0, 20.0}
    assert set(table["seed"]) == set(range(1, 1 + N_CASES // 2))
    rows = list(zip(table["case"], table["key"], strict=True))
    assert len(set(rows)) == len(rows)


def test_a_failed_case_is_recorded_and_stops_no_other(files: Path) -> None:
    (files / "broken").touch()
    estimators = '["mine:estimate", "estimation.channel.power.paths:estimate_power"]'
    write_sweep(files, 1, **{"link.tx_power_dbm": "estimator", "[0.0, 20.0]": estimators})
    failed = run(files, "out", "--workers", "1")
    assert failed.exit_code == 1
    assert "1 of 2 cases done, 1 failed" in failed.output
    assert "broken on purpose" in " ".join(failed.output.split())
    (trace,) = (files / "out" / "failures").glob("*.txt")
    assert "raise" in trace.read_text() and trace.name in "".join(failed.output.split())
    again = run(files, "out", "--workers", "1")
    assert again.exit_code == 1 and "1 failed" in again.output
    (files / "broken").unlink()
    mended = run(files, "out", "--workers", "1", "--retry-failed")
    assert mended.exit_code == 0, mended.output
    assert "2 of 2 cases done, 0 failed" in mended.output


@pytest.mark.slow
@pytest.mark.parametrize("together", [8, 1])  # in one task; or as tasks that wait on one worker
def test_a_case_that_takes_its_worker_down_fails_alone(
    files: Path, monkeypatch: pytest.MonkeyPatch, together: int
) -> None:
    monkeypatch.setattr("isac_arena.sweep.engine.CASES_PER_TASK", together)
    estimators = '["mine:deadly", "mine:estimate", "estimation.channel.power.paths:estimate_power"]'
    write_sweep(files, 1, **{"link.tx_power_dbm": "estimator", "[0.0, 20.0]": estimators})
    result = run(files, "out", "--workers", "1")
    assert result.exit_code == 1
    assert "2 of 3 cases done, 1 failed" in result.output
    assert "its worker died each time" in " ".join(result.output.split())


def test_a_result_that_is_lost_with_its_worker_is_made_again() -> None:
    with Workers(1, None) as one:
        client = one.client
        future = client.submit(list, [None])
        wait(future)
        (worker,) = client.run(os.getpid).values()
        os.kill(worker, signal.SIGKILL)
        while future.status == "finished":
            time.sleep(0.01)
        assert future.status == "lost"
        assert outcome(future) == [None]


@pytest.mark.slow
def test_a_worker_that_dask_gives_up_is_replaced_by_one_like_it(tmp_path: Path) -> None:
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1ms"}), Workers(1, None) as one:
        client = one.client
        (before,) = client.run(os.getpid).values()
        os.kill(before, signal.SIGKILL)
        assert client.submit(os.getpid, pure=False).result(timeout=120) != before
        (profiles,) = client.run(dask.config.get, "distributed.worker.profile.enabled").values()
        assert profiles is False  # samples of its stack are kept, without a limit


def test_cases_that_share_their_samples_score_as_they_do_alone(files: Path) -> None:
    estimators = '["mine:estimate", "estimation.channel.power.paths:estimate_power"]'
    write_sweep(files, 1, **{"link.tx_power_dbm": "estimator", "[0.0, 20.0]": estimators})
    plan = make_plan(
        str(files / "sweep.toml"), load_config(files / "sweep.toml", SweepConfig), files / "out", range(1)
    )
    for scene in plan.scenes.values():
        store_scene(files / "out", scene)
    assert len({job.signal_hash for job in plan.jobs}) == 1
    together = list(score_cases(plan.jobs))
    for job, scores in reversed(list(zip(plan.jobs, together, strict=True))):
        assert isinstance(scores, Scores)
        assert compare_records(job.key, score_case(job).tables, scores.tables).holds(exact=True)


def test_points_are_repeated_until_the_mean_is_known_also_later_in_the_same_directory(files: Path) -> None:
    write_sweep(files, 2)
    assert run(files, "out", "--workers", "1").exit_code == 0
    first = {path.name for path in (files / "out" / "cases").iterdir()}
    with (files / "sweep.toml").open("a") as file:
        file.write(UNTIL.format(metric="slam.position.rmse_m"))
    result = run(files, "out", "--workers", "1")
    assert result.exit_code == 0, result.output
    cases = {
        file.parent.name: json.loads(file.read_text()) for file in (files / "out").glob("cases/*/campaign.json")
    }
    assert first < set(cases)
    assert max(case["repeat"] for case in cases.values()) == 2
    write_sweep(files, 1)  # fewer again: a smaller table, and nothing is lost
    assert run(files, "out").exit_code == 0
    assert pq.read_table(files / "out" / "results.parquet").to_pydict()["repeat"].count(1) == 0
    assert {path.name for path in (files / "out" / "cases").iterdir()} == set(cases)
    write_sweep(files, 1, **{"[0.0, 20.0]": "[0.0, 10.0]"})
    assert "(axes.0.values = [0.0, 20.0] there, [0.0, 10.0] here)" in str(run(files, "out").exception)


def test_a_dry_run_writes_nothing_and_wrong_sweeps_are_refused(files: Path) -> None:
    planned = run(files, "out", "--dry-run")
    assert planned.exit_code == 0
    assert "4 cases, 2 points of 1 axis, 1 scene, paths traced 1 time" in planned.output
    assert re.search(r"on \d workers? of this machine: about .* of wall time", planned.output)
    assert not (files / "out").exists()
    (files / "taken").mkdir()
    (files / "taken" / "thesis.txt").touch()
    assert "holds other files" in str(run(files, "taken").exception)
    assert (files / "taken" / "thesis.txt").exists()
    with one_run(files / "out"):
        assert "another run is at work in this directory" in str(run(files, "out").exception)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.0, 20.0]", '[0.0, "loud"]', "sweep.toml: case link.tx_power_dbm = loud"),
        ("stop_every = 2", "stop_every = 0", "sweep.toml: stop_every = 0"),
        (
            '"link.tx_power_dbm"\nlabel = "power"\nvalues = [0.0, 20.0]',
            '"estimator"\nvalues = ["mine:nothing"]',
            "sweep.toml: point 0: channel = 'mine:nothing': cannot be imported",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_file_before_anything_is_written(
    files: Path, old: str, new: str, message: str
) -> None:
    write_sweep(files, 2, **{old: new})
    refused = run(files, "out")
    assert message in str(refused.exception)
    assert not (files / "out").exists()


def test_an_unknown_metric_is_refused_before_a_case_runs(files: Path) -> None:
    with (files / "sweep.toml").open("a") as file:
        file.write(UNTIL.format(metric="slam.position.rmse"))
    message = str(run(files, "out").exception)
    assert "sweep.toml: until.metric = 'slam.position.rmse'" in message
    assert "did you mean slam.position.rmse_m" in message
    assert not (files / "out").exists()


def test_the_metrics_of_a_scene_are_known_without_a_run(undisturbed: Path) -> None:
    from scenes.config import load_scene  # noqa: PLC0415

    scores = json.loads(next((undisturbed / "out" / "cases").glob("*/scores.json")).read_text())
    assert metric_keys(load_scene("box_room")) == [row["key"] for row in scores]


def test_a_wrong_scheduler_address_is_told_with_its_option(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("isac_arena.workers.cluster.ANSWER_S", 1)
    for address in ("tcp://127.0.0.1:9", "nonsense::"):
        message = str(run(files, "out", "--scheduler", address).exception)
        assert f"--scheduler = '{address}'" in message


@pytest.mark.slow
def test_a_scheduler_of_another_version_is_refused(files: Path) -> None:
    processes = Processes(files)
    try:
        _, address = processes.scheduler(sys.executable, "-c", OLD, *SCHEDULER[1:])
        message = str(run(files, "out", "--scheduler", address).exception)
    finally:
        processes.close()
    assert "the scheduler has distributed 2020.1.0, here it is" in message


def test_a_full_disk_ends_the_sweep_in_one_line_and_fails_no_case(
    files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/data/out/.stop_000.nc.12.part")
    monkeypatch.setattr(Future, "exception", lambda self, **_: error)
    refused = run(files, "out", "--workers", "1")
    assert refused.exception is error
    assert not list((files / "out" / "failures").glob("*"))


def test_a_directory_that_cannot_be_written_is_one_line(files: Path) -> None:
    (files / "file").touch()
    for command in (("sweep", "sweep.toml", "--out", "file/out"), ("run", "small.toml", "--out", "file/out")):
        result = arena_here(*command, cwd=files)
        assert result.returncode == 2
        assert result.stderr.count("\n") == 1 and "file/out: Not a directory" in result.stderr


def test_what_a_lost_worker_left_half_written_is_removed(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    assert ended.stdout is not None and not ended.stdout.read()  # it has ended, and nobody asked for its exit code
    while f"{ended.pid} (" in (state := Path(f"/proc/{ended.pid}/stat").read_text()) and ") Z " not in state:
        time.sleep(0.01)
    half, stop = f"cases/.key.{ended.pid}.part/scores.json", f"paths/ab/.stop.nc.{ended.pid}.part"
    lost = [tmp_path / half, tmp_path / stop]
    held = [tmp_path / "cases/key/scores.json", tmp_path / f"paths/ab/.stop.nc.{os.getpid()}.part"]
    for file in (*lost, *held):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    sweep_store.remove_unfinished(tmp_path)
    assert [file.exists() for file in (*lost, *held)] == [False, False, True, True]
    assert not lost[0].parent.exists()
    ended.wait()


def test_an_edited_case_is_not_taken_for_a_result(undisturbed: Path, tmp_path: Path) -> None:
    case = next((undisturbed / "out" / "cases").iterdir())
    copy = tmp_path / "cases" / case.name
    copy.mkdir(parents=True)
    for file in case.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    assert sweep_store.read_scores(tmp_path, case.name)
    text = (copy / "scores.json").read_text()
    (copy / "scores.json").write_text(text.replace("1", "2", 1))
    with pytest.raises(ValueError, match=r"scores.json: damaged or edited since it was written; remove"):
        sweep_store.read_scores(tmp_path, case.name)


def test_a_case_that_ends_at_the_channel_scores_it_as_the_whole_chain_does(files: Path) -> None:
    config = load_config(files / "sweep.toml", SweepConfig)
    plan = make_plan(str(files / "sweep.toml"), config, files / "out", range(1))
    for scene in plan.scenes.values():
        store_scene(files / "out", scene)
    case = next(make_cases(str(files / "sweep.toml"), config, [(20.0,)], range(1)))
    short = make_job(replace(case, stages="channel"), files / "out", plan.jobs[1].n_stops)
    assert short.key != plan.jobs[1].key and short.channel_hash == plan.jobs[1].channel_hash
    whole, channel = score_case(plan.jobs[1]), score_case(short)
    assert compare_records("paths", whole.tables.paths, channel.tables.paths).holds(exact=True)
    assert channel.value("channel.detection_rate") == whole.value("channel.detection_rate")
    assert {metric.key.partition(".")[0] for metric in channel.metrics} == {"channel"}
    times = read_times(short)
    assert sorted(times, key=int) == [str(stop) for stop in short.stops]
    again = score_case(short)  # from the stored estimates
    assert read_times(short) == times
    assert compare_records("paths", again.tables.paths, channel.tables.paths).holds(exact=True)
