"""One case of a sweep, from the scene to the scores; paths and samples are shared by content.

Every function here may run in any process and any number of times: files appear whole, under names that follow
from what made them, and what is there is not made again.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

from estimation.channel.calibration.self_calibration import calibration_rows, self_calibrate
from estimation.channel.estimate import ChannelEstimator
from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.chain import channel_estimator, known_receiver, map_both, score_simulated
from isac_arena.campaign.files import read_record, write_record, write_text
from isac_arena.campaign.load import scene_in_use
from isac_arena.campaign.recording import recorded_run
from isac_arena.scoring.metrics.metric import to_json
from isac_arena.scoring.score import Scores
from isac_arena.sweep.cases import Case
from isac_arena.sweep.job import Job, store_scene, tracing_config
from scenes.record import Record
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.signal.hardware.apply_impairments import with_surveyed_pose
from sim.signal.link import Link, make_link
from sim.simulate import clock_biases_s, observe, simulate_truth
from sim.truth import Truth

P = ParamSpec("P")
R = TypeVar("R")
K = TypeVar("K", bound=Record)


def check_case(case: Case) -> Scene:
    """The scene of a case; `ValueError`, one line, where it or the estimator cannot be used."""
    try:
        channel_estimator(case.config, case.estimator)
    except ValueError as error:
        raise ValueError(f"axis 'estimator', point {case.point}: {error}") from error
    with tempfile.TemporaryDirectory() as folder:
        store_scene(Path(folder), case.scene)
        file = next(Path(folder).rglob("scene.toml"))
        try:
            config = case.config
            return scene_in_use(file, config.waveform.carrier_ghz, config.tx, config.walk)
        except ValueError as error:
            message = str(error).replace(f"{file}: ", "")
            raise ValueError(f"scene '{case.config.scene}' of point {case.point}: {message}") from error


def trace_stops(job: Job, stops: Sequence[int]) -> None:
    """Trace the paths of the given stops that are not stored yet, or are damaged."""
    _traced(job, stops)


def make_signals(job: Job, stops: Sequence[int]) -> None:
    """Store the samples of the given stops for the cases that wait for them."""
    missing = [stop for stop in stops if _read(job.signal_file(stop), BeamSweep) is None]
    link = make_link(job.config)
    for truth in truths(job, missing):
        write_record(job.signal_file(truth.stop), observe(job.config, link, job.scene, truth))


def run_cases(jobs: Sequence[Job]) -> list[str | None]:
    """Run cases that share their samples and store them; why each one failed, None where it is done.

    Raises `OSError` where a directory cannot be written: that is no fault of a case.
    """
    missing = [job for job in jobs if not job.is_done]
    reasons: dict[str, str] = {}
    for job, scores in zip(missing, score_cases(missing), strict=True):
        if isinstance(scores, Scores):
            store_case(job, scores)
        else:
            reasons[job.key] = reason(scores)
    return [reasons.get(job.key) for job in jobs]


def reason(error: BaseException) -> str:
    """An error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def score_case(job: Job, stops: Sequence[int] | None = None) -> Scores:
    """The scores of a case over all its stops or some; nothing is stored but paths not traced before."""
    (scores,) = score_cases([job], stops)
    if isinstance(scores, Exception):
        raise scores
    return scores


def score_cases(jobs: Sequence[Job], stops: Sequence[int] | None = None) -> Iterator[Scores | Exception]:
    """The scores of cases that share their samples, or the error of a case; samples are read once for all."""
    if not jobs:
        return
    first = jobs[0]
    link, known = make_link(first.config), truths(first, first.stops if stops is None else stops)
    for job, channel in zip(jobs, _channels(jobs, link, known), strict=True):
        yield channel if isinstance(channel, Exception) else _tried(_scored, job, link, known, channel)


def _channels(
    jobs: Sequence[Job], link: Link, known: Sequence[Truth]
) -> list[list[ChannelEstimate] | Exception]:
    """The channel estimates of every case at every stop, or the error that ended it."""
    found: list[list[ChannelEstimate] | Exception] = [[] for _ in jobs]
    with threadpool_limits(limits=1):  # the last digits of sums depend on the number of threads
        estimators = [_tried(_estimator, job, link, known) for job in jobs]
        for truth in known:
            sweep = _sweep(jobs[0], link, truth)
            for case, (estimator, so_far) in enumerate(zip(estimators, found, strict=True)):
                if isinstance(so_far, Exception):
                    continue
                estimate = estimator if isinstance(estimator, Exception) else _tried(estimator, sweep)
                found[case] = estimate if isinstance(estimate, Exception) else [*so_far, estimate]
    return found


def _scored(job: Job, link: Link, known: Sequence[Truth], channel: Sequence[ChannelEstimate]) -> Scores:
    receiver = known_receiver(with_surveyed_pose(job.config, truth) for truth in known)
    with threadpool_limits(limits=1):
        results = map_both(job.config, channel, (), job.scene.tx, receiver)
        return score_simulated(job.config, link, job.scene, known, results)


def _tried(function: Callable[P, R], *arguments: P.args, **options: P.kwargs) -> R | Exception:
    """What a step of a case returns, or the error in which it ended: the cases beside it go on."""
    try:
        return function(*arguments, **options)
    except Exception as error:
        return error


def store_case(job: Job, scores: Scores) -> None:
    """Write the directory of a case under another name, then give it its own: it is there whole or not at all."""
    partial = job.directory.with_name(f".{job.key}.{os.getpid()}.part")
    shutil.rmtree(partial, ignore_errors=True)
    settings = {
        "point": job.point,
        "repeat": job.repeat,
        "stop_every": job.stop_every,
        "estimator": job.estimator,
        "scene": job.scene_hash,
        "campaign": job.config.model_dump(mode="json"),
    }
    try:
        with recorded_run(partial):
            write_text(partial / "campaign.json", json.dumps(settings, indent=1) + "\n")
            write_record(partial / "provenance.nc", scores.tables)
            write_text(partial / "scores.json", json.dumps(to_json(scores.metrics), indent=1) + "\n")
        if not job.is_done:
            shutil.rmtree(job.directory, ignore_errors=True)  # a case that lost some of its files
            partial.rename(job.directory)
    except OSError:
        if not job.is_done:  # another worker may have been first
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def truths(job: Job, stops: Sequence[int]) -> list[Truth]:
    """The truth of every stop: the paths, traced where they are not stored, with the clock of the case."""
    biases_s = clock_biases_s(job.config, job.n_stops)
    return [replace(truth, clock_bias_s=float(biases_s[truth.stop])) for truth in _traced(job, stops)]


def _traced(job: Job, stops: Sequence[int]) -> list[Truth]:
    """The paths of the given stops as stored, traced and stored where they are missing or damaged."""
    found = {stop: _read(job.paths_file(stop), Truth) for stop in stops}
    missing = [stop for stop, truth in found.items() if truth is None]
    if missing:
        for truth in simulate_truth(tracing_config(job.config), job.scene, missing):
            write_record(job.paths_file(truth.stop), truth)
            found[truth.stop] = truth
    return [truth for truth in found.values() if truth is not None]


def _estimator(job: Job, link: Link, known: Sequence[Truth]) -> ChannelEstimator:
    """The channel estimator of a case, calibrated on some of its stops where the settings ask for it."""
    settings, calibration = job.config.channel.self_calibration, None
    if settings is not None and job.estimator is None:
        rows = calibration_rows(len(known), settings)
        calibration = self_calibrate((_sweep(job, link, known[row]) for row in rows), settings)
    return channel_estimator(job.config, job.estimator, calibration)


def _sweep(job: Job, link: Link, truth: Truth) -> BeamSweep:
    """The samples of a stop as stored, made where they are not."""
    stored = _read(job.signal_file(truth.stop), BeamSweep)
    return stored if stored is not None else observe(job.config, link, job.scene, truth)


def _read(file: Path, kind: type[K]) -> K | None:
    """A record, None where it is missing or damaged."""
    try:
        return read_record(file, kind)
    except (FileNotFoundError, ValueError):
        return None
