"""One case of a sweep, from the scene to the scores; paths and samples are shared by content.

Every function here may run in any process and any number of times: files appear whole, under names that follow
from what made them, and what is there is not made again.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from estimation.channel.calibration import Calibration, self_calibrate
from estimation.pipeline import channel_estimator, known_receiver, map_both, score_simulated
from estimation.scoring.metric import to_json
from estimation.scoring.score import Scores
from scenes.record import Record
from scenes.scene import Scene
from scripts.campaign_file import scene_in_use
from scripts.manifest import write_manifest
from scripts.sweep_cases import Case
from scripts.sweep_job import Job, store_scene, tracing_config
from sim.campaign import clock_biases_s, observe, simulate_truth
from sim.hardware import surveyed
from sim.link import Link, make_link
from sim.store import read_record, write_record, write_text
from sim.sweep import BeamSweep
from sim.truth import Truth


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
    missing = [stop for stop in stops if not _is_whole(job.paths_file(stop), Truth)]
    if missing:
        for truth in simulate_truth(tracing_config(job.config), job.scene, missing):
            write_record(job.paths_file(truth.stop), truth)


def make_signals(job: Job, stops: Sequence[int]) -> None:
    """Store the samples of the given stops for the cases that wait for them."""
    link = make_link(job.config)
    for truth in truths(job, [stop for stop in stops if not _is_whole(job.signal_file(stop), BeamSweep)]):
        write_record(job.signal_file(truth.stop), observe(job.config, link, job.scene, truth))


def run_case(job: Job) -> None:
    """Run a case from its traced paths to its scores and store them."""
    if not job.is_done:
        store_case(job, score_case(job))


def score_case(job: Job, stops: Sequence[int] | None = None) -> Scores:
    """The scores of a case over all its stops or some; nothing is stored but paths not traced before."""
    stops = job.stops if stops is None else stops
    trace_stops(job, stops)
    config, scene, link = job.config, job.scene, make_link(job.config)
    known = list(truths(job, stops))
    with threadpool_limits(limits=1):  # the last digits of sums depend on the number of threads
        estimator = channel_estimator(config, job.estimator, _calibration(job, link, known))
        channel = tuple(estimator(_sweep(job, link, truth)) for truth in known)
        receiver = known_receiver(surveyed(config, truth) for truth in known)
        results = map_both(config, channel, (), scene.tx, receiver)
        return score_simulated(config, link, scene, known, results)


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
        write_text(partial / "campaign.json", json.dumps(settings, indent=1) + "\n")
        write_record(partial / "provenance.nc", scores.tables)
        write_text(partial / "scores.json", json.dumps(to_json(scores.metrics), indent=1) + "\n")
        write_manifest(partial)
        if not job.is_done:
            shutil.rmtree(job.directory, ignore_errors=True)  # a case that lost some of its files
            partial.rename(job.directory)
    except OSError:
        if not job.is_done:  # another worker may have been first
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def truths(job: Job, stops: Sequence[int]) -> Iterator[Truth]:
    """The truth of every stop: the traced paths with the clock of the case."""
    biases_s = clock_biases_s(job.config, job.n_stops)
    for stop in stops:
        yield replace(read_record(job.paths_file(stop), Truth), clock_bias_s=float(biases_s[stop]))


def _calibration(job: Job, link: Link, known: Sequence[Truth]) -> Calibration | None:
    """The calibration of both arrays from some of the stops, where the settings ask for one."""
    settings = job.config.channel.self_calibration
    if settings is None or job.estimator is not None:
        return None
    chosen = sorted(set(np.linspace(0, len(known) - 1, settings.stops).round().astype(int).tolist()))
    return self_calibrate((_sweep(job, link, known[index]) for index in chosen), settings)


def _sweep(job: Job, link: Link, truth: Truth) -> BeamSweep:
    stored = job.signal_file(truth.stop)
    try:
        return read_record(stored, BeamSweep)
    except (FileNotFoundError, ValueError):
        return observe(job.config, link, job.scene, truth)


def _is_whole(file: Path, kind: type[Record]) -> bool:
    try:
        read_record(file, kind)
    except (FileNotFoundError, ValueError):
        return False
    return True
