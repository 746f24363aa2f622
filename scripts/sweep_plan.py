"""What a sweep will cost, judged by running one stop of a few of its cases."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from estimation.pipeline import channel_estimator
from scripts.sweep_run import Job, store_scene, trace_stops, truths
from sim.campaign import observe
from sim.link import make_link

OTHER_STAGES = 1.2  # mapping, SLAM, shapes and scores beside the channel estimates
CASE_BYTES = 300_000  # settings and scores of a case


@dataclass(frozen=True)
class Cost:
    """Estimated time on one core and disk space of what a sweep has still to do."""

    core_hours: float
    disk_gb: float
    n_tried: int


def estimate_cost(jobs: Sequence[Job]) -> Cost:
    """Time one stop of the first, the middle and the last case in a temporary directory, and scale."""
    with tempfile.TemporaryDirectory() as folder:
        missing = [replace(job, root=Path(folder)) for job in jobs if not job.is_done]
        if not missing:
            return Cost(0.0, 0.0, 0)
        for job in missing:
            store_scene(job)
        return _scaled(missing)


def _scaled(missing: Sequence[Job]) -> Cost:
    tried = [_one_stop(missing[index]) for index in sorted({0, len(missing) // 2, len(missing) - 1})]
    trace_s, case_s, path_bytes = (sum(column) / len(tried) for column in zip(*tried, strict=True))
    traced = {job.paths_hash: len(job.stops) for job in missing}
    seconds = trace_s * sum(traced.values()) + OTHER_STAGES * case_s * sum(len(job.stops) for job in missing)
    size = path_bytes * sum(traced.values()) + CASE_BYTES * len(missing)
    return Cost(seconds / 3600, size / 1e9, len(tried))


def _one_stop(job: Job) -> tuple[float, float, float]:
    """Seconds of tracing, seconds of the rest, and bytes of the paths of one stop in the middle of the walk."""
    stop = job.stops[len(job.stops) // 2]
    trace_stops(job, [job.stops[0]])  # the first one also loads and compiles
    started = time.perf_counter()
    trace_stops(job, [stop])
    traced = time.perf_counter()
    estimator, link = channel_estimator(job.case.config, job.case.estimator), make_link(job.case.config)
    for truth in truths(job, [stop]):
        estimator(observe(job.case.config, link, job.scene, truth))
    return traced - started, time.perf_counter() - traced, float(job.paths_file(stop).stat().st_size)
