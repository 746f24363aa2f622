"""One case of a sweep, from the scene to the scores; paths and samples are shared by content.

Every function here may run in any process and any number of times: files appear whole, under names that follow
from their inputs, and are not made again. All compute with one thread, because the last digits of sums depend on
the number of threads; the manifest of a case records that number.
"""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.files import read_record, write_json, write_record, write_text
from isac_arena.campaign.plan import check_elevations
from isac_arena.campaign.recording import recorded_run
from isac_arena.campaign.results import MemoryResults
from isac_arena.scoring.metrics.metric import to_json
from isac_arena.scoring.score import Scores
from isac_arena.sweep.cases import Case
from isac_arena.sweep.job import Job
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.user_functions.room import check_functions
from scenes.record import Record
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.truth import Truth

P = ParamSpec("P")
R = TypeVar("R")
K = TypeVar("K", bound=Record)


def check_case(case: Case) -> Scene:
    """The scene of a case; `ValueError`, one line, where scene or a user's function cannot be used."""
    try:
        check_functions(case.config.functions)
    except ValueError as error:
        raise ValueError(f"point {case.point}: {error}") from error
    if case.stages != "channel":  # such cases measure what a method misses
        check_elevations(case.config)
    try:
        return case.scene.build(case.config)
    except ValueError as error:
        raise ValueError(f"scene '{case.config.scene}' of point {case.point}: {error}") from error


@dataclass
class CaseResults(MemoryResults):
    """Results of a case or of one of its TX: paths and samples in files that cases share, others in memory."""

    job: Job = field(kw_only=True)
    tx: str = field(default="", kw_only=True)  # _NAME of one of several

    def of_tx(self, name: str) -> MemoryResults:
        """As `ResultStore`."""
        return self.links.setdefault(name, CaseResults(job=self.job, tx=f"_{name}"))

    def truth(self, stop: int) -> Truth | None:
        """The stored paths of a stop."""
        return _read(self.job.paths_file(stop, self.tx), Truth)

    def write_truth(self, truth: Truth) -> None:
        """Store the paths of a stop without the clock, in which cases differ."""
        write_record(self.job.paths_file(truth.stop, self.tx), replace(truth, clock_bias_s=0.0))

    @property
    def keeps_estimates(self) -> bool:
        """Whether channel estimates are stored: later stages that change run again without making them."""
        return self.job.stages != "all"

    def estimate(self, stop: int) -> ChannelEstimate | None:
        """The channel estimate of a stop, from its file where it is kept there."""
        return (
            _read(self.job.estimate_file(stop, self.tx), ChannelEstimate)
            if self.keeps_estimates
            else super().estimate(stop)
        )

    def write_estimate(self, estimate: ChannelEstimate, sweep: BeamSweep) -> None:
        """Store a channel estimate where it is kept in a file."""
        if self.keeps_estimates:
            write_record(self.job.estimate_file(estimate.stop, self.tx), estimate)
        else:
            super().write_estimate(estimate, sweep)

    def sweep(self, stop: int) -> BeamSweep | None:
        """The stored samples of a stop."""
        return _read(self.job.signal_file(stop, self.tx), BeamSweep)

    def write_sweep(self, sweep: BeamSweep) -> None:
        """Store the samples of a stop."""
        write_record(self.job.signal_file(sweep.stop, self.tx), sweep)


def case_run(job: Job, stops: Sequence[int] | None = None, paths: Sequence[Truth] = ()) -> CampaignRun:
    """The run of a case over all its stops or some; `paths` are its truths where they are in memory."""
    stops = job.stops if stops is None else stops
    return CampaignRun(job.config, job.scene, CaseResults(job=job), stops, paths)


def trace_stops(job: Job, stops: Sequence[int]) -> None:
    """Trace the paths of the given stops that are not stored yet, or are damaged."""
    with threadpool_limits(limits=1):
        for _ in case_run(job, stops).truths():
            pass


def make_signals(job: Job, stops: Sequence[int]) -> None:
    """Store the samples of the given stops for the cases that wait for them."""
    run = case_run(job, stops)
    with threadpool_limits(limits=1):
        for truth in run.truths():
            results = run.link_of(truth).results
            if isinstance(results, CaseResults) and results.sweep(truth.stop) is None:
                results.write_sweep(run.sweep(truth))


def run_cases(jobs: Sequence[Job]) -> list[str | None]:
    """Run and store cases that share their samples; the reason of every failure, None where a case is done.

    Raises `OSError` where a directory cannot be written: that is no fault of a case.
    """
    missing = [job for job in jobs if not job.is_done]
    reasons: dict[str, str] = {}
    for job, scores in zip(missing, score_cases(missing), strict=True):
        if isinstance(scores, Scores):
            store_case(job, scores)
        else:
            reasons[job.key] = _told(job, scores)
    return [reasons.get(job.key) for job in jobs]


def _told(job: Job, error: Exception) -> str:
    """The error of a case in one line; the traceback of a user's function goes to the file that the line names."""
    if not isinstance(error, EstimatorError):
        return reason(error)
    case = f"case {job.key}, point {job.point}: {', '.join(map(str, job.values))}; seed {job.config.seed}"
    write_text(job.trace_file, f"{case}\n{error.trace}")
    return f"{error}; traceback in {job.trace_file}"


def reason(error: BaseException) -> str:
    """An error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def score_case(job: Job, stops: Sequence[int] | None = None) -> Scores:
    """The scores of a case over all its stops or some; only newly traced paths are stored."""
    (scores,) = score_cases([job], stops)
    if isinstance(scores, Exception):
        raise scores
    return scores


def score_cases(jobs: Sequence[Job], stops: Sequence[int] | None = None) -> Iterator[Scores | Exception]:
    """The scores or the error of each of some cases that share their samples; samples are read once for all."""
    if not jobs:
        return
    with threadpool_limits(limits=1):
        paths = list(case_run(jobs[0], stops).truths())
        runs = [case_run(job, stops, paths) for job in jobs]
        failures = _failures(runs, paths)
    for job, run, failure in zip(jobs, runs, failures, strict=True):
        with threadpool_limits(limits=1):
            score = run.channel_scores if job.stages == "channel" else run.scores
            scores = _tried(score) if failure is None else failure
        yield scores


def _failures(runs: Sequence[CampaignRun], truths: Sequence[Truth]) -> list[Exception | None]:
    """Make the channel estimates of every run at every stop; the error that ended a run, else None."""
    failures = [_failure(run.calibrate) for run in runs]
    for truth in truths:
        waits = [run.link_of(truth).results.estimate(truth.stop) is None for run in runs]
        if not any(waits):
            continue
        sweep = runs[0].sweep(truth)
        failures = [
            _failure(_timed_estimate, run, truth, sweep) if failure is None and is_waiting else failure
            for run, failure, is_waiting in zip(runs, failures, waits, strict=True)
        ]
    return failures


def _timed_estimate(run: CampaignRun, truth: Truth, sweep: BeamSweep) -> None:
    """Make the channel estimate of a stop, and keep its processor time."""
    started = time.process_time()
    run.estimate(truth, sweep)
    results = run.link_of(truth).results
    if isinstance(results, CaseResults) and results.keeps_estimates:
        taken = {f"{truth.stop}{results.tx}": time.process_time() - started}
        write_json(results.job.times_file, read_times(results.job) | taken)


def _failure(step: Callable[P, object], *arguments: P.args, **options: P.kwargs) -> Exception | None:
    done = _tried(step, *arguments, **options)
    return done if isinstance(done, Exception) else None


def _tried(function: Callable[P, R], *arguments: P.args, **options: P.kwargs) -> R | Exception:
    """The result of a step of a case, or its error: the other cases continue."""
    try:
        return function(*arguments, **options)
    except Exception as error:
        return error


def store_case(job: Job, scores: Scores) -> None:
    """Write the directory of a case under a temporary name, then rename it, so that it is always whole."""
    partial = job.directory.with_name(f".{job.key}.{os.getpid()}.part")
    shutil.rmtree(partial, ignore_errors=True)
    settings = {name: getattr(job, name) for name in ("point", "repeat", "stop_every", "stages")}
    settings |= {"scene": job.scene_hash, "campaign": job.config.model_dump(mode="json")}
    try:
        with recorded_run(partial):
            write_json(partial / "campaign.json", settings)
            write_record(partial / "provenance.nc", scores.tables)
            write_json(partial / "scores.json", to_json(scores.metrics))
        if not job.is_done:
            shutil.rmtree(job.directory, ignore_errors=True)  # a case that lost some of its files
            partial.rename(job.directory)
    except OSError:
        if not job.is_done:  # another worker may have been first
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def read_times(job: Job) -> dict[str, float]:
    """Processor times in s of the kept channel estimates of a case, by stop or STOP_NAME; those that are known."""
    try:
        return dict(json.loads(job.times_file.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def _read(file: Path, kind: type[K]) -> K | None:
    """A record, None where it is missing or damaged."""
    try:
        return read_record(file, kind)
    except (FileNotFoundError, ValueError):
        return None
