"""The cases of a sweep, and their cost estimated from a few stops of a few cases."""

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from isac_arena.campaign.load import SceneSource
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.chain import score_metrics
from isac_arena.scoring.record import ScoreTables
from isac_arena.scoring.stages.scene import score_scene
from isac_arena.sweep.cases import ask_cases, design_points, make_cases
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.job import Job, make_job, store_scene
from isac_arena.sweep.run import check_case, make_signals, score_case, store_case, trace_stops
from scenes.record import empty_record
from scenes.scene import Scene

FEW, MORE = 1, 2  # stops that a case is tried with
PLACES = ("tx", "walk", "links", "transmitters")  # settings that choose devices of a scene


@dataclass(frozen=True)
class Plan:
    """The cases of a sweep, and the scenes they need by their hash."""

    jobs: list[Job]
    scenes: dict[str, SceneSource]


@dataclass(frozen=True)
class Cost:
    """Estimated time on one core and disk space of the cases of a sweep that are missing."""

    core_hours: float
    start_up_s: float  # of a worker: libraries loaded, code compiled
    disk_gb: float
    samples_gb: float  # of one set of samples that several cases share; removed after them
    n_tried: int


class CaseCost(NamedTuple):
    """Measured cost of one case: seconds of its start and of each stop, and bytes."""

    trace_start_s: float
    trace_stop_s: float
    case_start_s: float
    case_stop_s: float
    path_bytes: float  # of a stop
    sample_bytes: float  # of a stop
    case_bytes: float


def make_plan(source: str, config: SweepConfig, root: Path, repeats: Iterable[int]) -> Plan:
    """Every case of the sweep; settings and scenes are checked before anything runs or is written.

    Raises `ConfigError`, one line, where a case is no valid campaign, and `ValueError` for a scene, an estimator
    or a metric in `until` that cannot be used; the message names the sweep file.
    """
    repeats = list(repeats)
    ask_cases(config, len(repeats))
    n_stops: dict[Any, int] = {}
    plan = Plan([], {})
    for case in make_cases(source, config, design_points(config), repeats):
        place = (repr([getattr(case.config, name) for name in PLACES]), case.config.waveform.carrier_ghz)
        chosen = (case.scene.hash, *place, repr(case.config.functions))
        if chosen not in n_stops:
            try:
                scene = check_case(case)
                _check_metric(config, scene)
            except ValueError as error:
                raise ValueError(f"{source}: {error}") from error
            n_stops[chosen] = len(scene.stops)
        plan.scenes[case.scene.hash] = case.scene
        like = plan.jobs[-1] if plan.jobs and plan.jobs[-1].point == case.point else None
        plan.jobs.append(make_job(case, root, n_stops[chosen], like))
    return plan


def metric_keys(scene: Scene) -> list[str]:
    """Keys of all metrics of a campaign in a scene, from tables of a campaign without a path."""
    tables = empty_record(ScoreTables)
    empty = tables.mapping
    whole = score_scene(scene, empty_record(MapResult), empty.clusters, empty.contours, tables.significant)
    maps = replace(empty, scene=whole)
    return [metric.key for metric in score_metrics(scene, replace(tables, mapping=maps, slam=maps))]


def estimate_cost(plan: Plan, track: Callable[[Sequence[Job]], Iterable[Job]] = iter) -> Cost:
    """Run the first, the middle and the last case on a few stops in a temporary directory, and scale.

    `track` shows the progress over the cases tried.
    """
    missing = [job for job in plan.jobs if not job.is_done]
    if not missing:
        return Cost(0.0, 0.0, 0.0, 0.0, 0)
    chosen = [missing[index] for index in sorted({0, len(missing) // 2, len(missing) - 1})]
    imports_s = time.process_time()  # a worker loads what this process has loaded
    cold_s, tried = 0.0, list[CaseCost]()
    for job in track(chosen):
        cold_s = cold_s or _try_cold(job, plan.scenes)
        tried.append(_try_case(job, plan.scenes))
    first = tried[0]
    warm_s = first.trace_start_s + first.case_start_s + FEW * (first.trace_stop_s + first.case_stop_s)
    start_up_s = imports_s + max(0.0, cold_s - warm_s)
    mean = CaseCost(*np.mean(tried, axis=0).tolist())
    sets = Counter(job.signal_hash for job in missing)
    traced = {job.paths_hash: len(job.stops) for job in missing}
    n_stops = sum(len(job.stops) for job in missing)
    seconds = mean.trace_start_s * len(traced) + mean.trace_stop_s * sum(traced.values())
    seconds += mean.case_start_s * len(missing) + mean.case_stop_s * n_stops
    size = mean.path_bytes * sum(traced.values()) + mean.case_bytes * len(missing)
    shared = max((len(job.stops) for job in missing if sets[job.signal_hash] > 1), default=0)
    return Cost(seconds / 3600, start_up_s, size / 1e9, mean.sample_bytes * shared / 1e9, len(tried))


def _try_cold(job: Job, scenes: Mapping[str, SceneSource]) -> float:
    """Seconds of the first stop in a process, in which libraries are loaded and code is compiled."""
    with tempfile.TemporaryDirectory() as folder:
        here = _moved(job, folder, scenes)
        started = time.perf_counter()
        score_case(here, here.stops[:FEW])
        return time.perf_counter() - started


def _try_case(job: Job, scenes: Mapping[str, SceneSource]) -> CaseCost:
    """Fit a line through the times of a case on few and on more stops, spread over the walk."""
    taken: dict[int, tuple[float, float]] = {}
    for count in sorted({FEW, min(MORE, len(job.stops))}):
        with tempfile.TemporaryDirectory() as folder:
            here = _moved(job, folder, scenes)
            stops = [here.stops[int(at)] for at in np.linspace(0, len(here.stops) - 1, count)]
            started = time.perf_counter()
            trace_stops(here, stops)
            traced = time.perf_counter()
            store_case(here, score_case(here, stops))
            taken[count] = traced - started, time.perf_counter() - traced
            make_signals(here, stops[:1])
            path_bytes = _size(here.paths_file(0).parent) / count
            sizes = path_bytes, _size(here.signal_file(0).parent), _size(here.directory)
    (trace_start, trace_stop), (case_start, case_stop) = (
        _line({count: times[part] for count, times in taken.items()}) for part in (0, 1)
    )
    return CaseCost(trace_start, trace_stop, case_start, case_stop, *sizes)


def _line(taken: Mapping[int, float]) -> tuple[float, float]:
    """Offset and slope, neither below zero, of the times at one or two counts of stops."""
    (few, first), (more, last) = min(taken.items()), max(taken.items())
    if few == more:
        return 0.0, first / few
    slope = max(0.0, (last - first) / (more - few))
    return max(0.0, last - slope * more), slope


def _moved(job: Job, folder: str, scenes: Mapping[str, SceneSource]) -> Job:
    store_scene(Path(folder), scenes[job.scene_hash])
    return replace(job, root=Path(folder))


def _size(folder: Path) -> float:
    return float(sum(path.stat().st_size for path in folder.iterdir()))


def _check_metric(config: SweepConfig, scene: Scene) -> None:
    if config.until is None:
        return
    metric, keys = config.until.metric, metric_keys(scene)
    if metric not in keys:
        close = get_close_matches(metric, keys, n=3)
        hint = f"did you mean {' or '.join(close)}?" if close else "scores.json of a run lists the keys"
        raise ValueError(f"until.metric = '{metric}': scene '{scene.name}' has no such metric; {hint}")
