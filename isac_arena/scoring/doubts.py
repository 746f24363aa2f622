"""What is doubtful about a run: by its scores where the truth is known, and by its estimates."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from estimation.slam.record import PoseEstimates, SolveStatus
from isac_arena.progress import counted, listed
from isac_arena.scoring.metrics.metric import Metric

FAR = 5.0  # times a bound: the bar of the worst random hall, see docs/metrics.md
FAR_PATHS = 50.0  # times the bounds of paths, RMS: close paths of unlike power make 20 in box_room
FAR_POWER_RMS_DB = 3.0  # of detected paths: twice the power, or half
FAR_STATED = 3.0  # times a stated deviation: chance takes one error in 370 there
LEAST_COVERAGE = 0.88  # of 95 % regions: the bar of the worst random hall
LEAST_SIGHT = 0.75  # of the stops with a right decision on the line of sight: so few are said
MOST_NEES = 4.0  # 1 where covariances are right: errors of twice what is stated
SMALL_NEES = 0.5  # stated deviations of 1.4 times the errors
LEAST_SHARE = 0.5  # of the points of a map: stated errors of fewer are not called too large for all
TEST_LEVEL = 0.01  # of the chi-square test that a NEES is below 1: several are tested
BEHIND = 1.25  # times the RMSE of the published method: less is chance where both have the same paths
FEW_STOPS = 6  # of a walk; box_room is .046, .007, .0015 and .0015 m off with 2, 4, 6 and 9 stops
NEEDED = (
    "a stop needs its line of sight and a single bounce, or four single bounces. Look at the paths of the stops "
    "in 'arena report', then at beams, power and walk"
)
SHOWN_BY = (
    "'arena report' shows which, under '{}', as the contours of scores.tables.mapping and .slam do in Python"
)
HANGS_M = 0.1  # that one path alone moves a position: more than the paths of a good stop disagree
MORE_STOPS = "more stops (n_stops of the walk)"
STATED = {
    "channel": "paths",
    "mapping.ip_to_surface": "points of mapping across their surface",
    "mapping.ip_position": "points of mapping",
    "mapping.ip_height": "heights of points of mapping",
    "slam.ip_to_surface": "points of SLAM across their surface",
    "slam.ip_position": "points of SLAM",
    "slam.ip_height": "heights of points of SLAM",
}
STATED_POSES = {"slam": "states of SLAM (position, heading, clock)", "slam.height": "receiver heights of SLAM"}
FREEDOM = {  # numbers that one squared error is over
    "channel": 3,
    "mapping.ip_to_surface": 1,
    "mapping.ip_position": 2,
    "mapping.ip_height": 1,
    "slam.ip_to_surface": 1,
    "slam.ip_position": 2,
    "slam.ip_height": 1,
    "slam": 4,
    "slam.height": 1,
}
PATHS = (("delay", "delay"), ("AoD", "aod"), ("AoA", "aoa"))
POSES = (
    ("position", "position.rmse_m", "m"),
    ("heading", "heading.rmse_deg", "deg"),
    ("clock bias", "clock.rmse_ns", "ns"),
)


def values_of(metrics: Sequence[Metric]) -> dict[str, float]:
    """The values of scores by their key."""
    return {metric.key: metric.value for metric in metrics}


def pose_doubts(values: Mapping[str, float]) -> tuple[str, ...]:
    """What is far off in the poses that SLAM found, by scores; empty where nothing is.

    Errors far over their bound or over what covariances state, and positions behind those of the published method
    where that locates as many stops. Scores that are missing or NaN say nothing.
    """
    return tuple(_pose_doubts(values))


def _pose_doubts(values: Mapping[str, float]) -> Iterator[str]:
    halves = []
    for name, key, unit in POSES:
        of = f"slam.{key.partition('.')[0]}"
        over, stated = (values.get(f"{of}.{score}", np.nan) for score in ("over_bound", f"stated_{unit}"))
        if over > FAR:
            error, bound = values[f"slam.{key}"], values.get(f"{of}.bound_{unit}", np.nan)
            some = " at the stops that have one" if abs(error - over * bound) > 0.05 * error else ""
            itself = f" (SLAM itself states {stated:.2g} {unit})" if np.isfinite(stated) else ""
            yield f"{name} {error:.2g} {unit}, {_times(over)} its bound{some}{itself}"
        elif (half := values.get(f"{of}.over_bound.median", np.nan)) > FAR:
            halves.append(f"{_times(half)} ({name})")
    if halves:
        yield f"half of the stops err {', '.join(halves)} their bound or more"
    ours, published = (values.get(f"{one}.position.rmse_m", np.nan) for one in ("slam", "published"))
    as_many = values.get("published.solved_share", 0.0) >= values.get("slam.solved_share", np.inf)
    if as_many and ours > BEHIND * published:
        yield f"position {_times(ours / published)} that of the published method"
    stated = np.sqrt(values.get("slam.nees", np.nan))
    if stated > FAR_STATED:
        yield f"errors {_times(stated)} their stated deviations"


def _times(factor: float) -> str:
    return f"{factor:.2g} times" if factor < 10 else f"{factor:.0f} times"


def score_doubts(metrics: Sequence[Metric]) -> tuple[str, ...]:
    """What is doubtful in paths, stated errors, poses (`pose_doubts`) and contours, and what to do."""
    return doubts_of(values_of(metrics))


def doubts_of(values: Mapping[str, float]) -> tuple[str, ...]:
    """As `score_doubts`, of the values by key; scores that are missing or NaN say nothing."""
    about_paths = (*_path_doubt(values), *_power_doubt(values), *_cut_doubt(values), *_sight_doubt(values))
    about_stated = (*_stated_doubt(values), *_too_large_doubt(values))
    return (*_slam_doubt(values), *about_paths, *about_stated, *_contour_doubt(values))


def in_short(doubts: Sequence[str]) -> str:
    """The first doubt in words, without what to do, and what the others are about; empty without any."""
    if not doubts:
        return ""
    first = doubts[0].partition(" To do: ")[0].partition("; to do: ")[0].rstrip(".")
    others = ", ".join(doubt.partition(":")[0] for doubt in doubts[1:])
    return f"{first}; also: {others}" if others else first


def _path_doubt(values: Mapping[str, float]) -> Iterator[str]:
    """Where errors of paths are far over their bounds."""
    found = []
    for name, key in PATHS:
        of_all, half = (values.get(f"channel.{key}.over_bound.{score}", np.nan) for score in ("rms", "median"))
        if half > FAR or of_all > FAR_PATHS:
            found.append(f"{name} {_times(half)} in the median, {_times(of_all)} in RMS")
    if found:
        yield (
            f"channel: errors of detected paths, times their bounds: {'; '.join(found)}. Where the RMS alone is "
            "large, few paths are far off, often close to others. To do: the tables of stops under 'Explore' of "
            "'arena report', or scores.tables.paths in Python, have the errors of every path"
        )


def _power_doubt(values: Mapping[str, float]) -> Iterator[str]:
    """Where detected paths have far other powers than their true paths."""
    scores = ("power.rmse_db", "power.median_db", "power.max_db", "power.off_10db", "detected")
    rmse, median, most, far, detected = (values.get(f"channel.{score}", np.nan) for score in scores)
    if rmse > FAR_POWER_RMS_DB:
        some = f"{far:.0f} of {counted(int(detected), 'detected path')}" if far >= 0 < detected else "some paths"
        yield (
            f"powers: {some} err by 10 dB or more, up to {most:.0f} dB (RMSE {rmse:.2g} dB, median "
            f"{median:.2g} dB). Delay and angles match a path, the power does not: a strong path may have "
            "been assigned to a faint neighbour, or paths that cancel were taken for one. They are no gains"
        )


def _stated_doubt(values: Mapping[str, float]) -> Iterator[str]:
    """Where covariances of paths, or of the points that they make, are too small."""
    told = []
    for key, name in STATED.items():
        coverage, nees = (values.get(f"{key}.{score}", np.nan) for score in ("coverage95", "nees"))
        if coverage < LEAST_COVERAGE or nees > MOST_NEES:
            notes = [f"NEES {nees:.2g}"] * (nees > 1) + [_share_text(values, key)]
            note = ", ".join(filter(None, notes))
            told.append(f"{100 * coverage:.0f} % of {name}" + (f" ({note})" if note else ""))
    if told:
        mend = 'in your own code, use a cost that bears outliers (Huber, Student-t); method "auto" errs least'
        yield (
            f"stated errors: regions that should hold 95 % hold {', '.join(told)}. Some paths, in dense scenes "
            f"many, err more than they state. To do: {mend}"
        )


def _judged(values: Mapping[str, float], key: str) -> tuple[float, float]:
    """How many points a NEES of a map rests on, and how many points the map has; NaN for other scores."""
    of_map, _, is_of_points = key.partition(".ip_")
    whole = values.get(f"{of_map}.ips", np.nan) if is_of_points else np.nan
    return values.get(f"{key}.nees.count", np.nan), whole


def _share_text(values: Mapping[str, float], key: str) -> str:
    judged, whole = _judged(values, key)
    return f"judged at {judged:.0f} of {whole:.0f}" if np.isfinite([judged, whole]).all() else ""


def _too_large_doubt(values: Mapping[str, float]) -> Iterator[str]:
    """Where covariances are too large, by more than chance explains.

    Of points and states a stop counts as one sample, because they share the errors of its pose: the mean of their
    NEES varies less than a single one. Of paths every detected one counts. Stops count as independent; what all
    stops of a walk share is not tested. Points count where at least `LEAST_SHARE` of those of the map are judged:
    detected paths err least, and say nothing of the weak ones that most points may come from.
    """
    from estimation.distributions import chi_square_quantile  # noqa: PLC0415  (brings scipy)

    n_stops = values.get("slam.stops", np.nan) * values.get("slam.solved_share", np.nan)
    told = []
    for key, name in (STATED | STATED_POSES).items():
        n_samples = values.get("channel.detected", np.nan) if key == "channel" else n_stops
        nees, coverage = (values.get(f"{key}.{score}", np.nan) for score in ("nees", "coverage95"))
        if not (n_samples > 0 and nees < SMALL_NEES and coverage >= LEAST_COVERAGE):
            continue
        judged, whole = _judged(values, key)
        if judged < LEAST_SHARE * whole:
            continue
        freedom = FREEDOM[key] * n_samples
        if nees * freedom < chi_square_quantile(TEST_LEVEL, freedom):
            inside = f"{100 * coverage:.0f} % inside their 95 % regions"
            told.append(
                f"{name} ({', '.join(filter(None, [f'NEES {nees:.2g}', inside, _share_text(values, key)]))})"
            )
    if told:
        yield (
            f"stated errors are too large: {', '.join(told)}. The NEES is 1 where they are right; by a chi-square "
            "test this is no chance. Errors are smaller than stated, so intervals are wider than they need be"
        )


def _sight_doubt(values: Mapping[str, float]) -> Iterator[str]:
    if (right := values.get("channel.los.decision_accuracy", np.nan)) <= LEAST_SIGHT:
        yield (
            f"lines of sight: whether a stop has one, and which path it is, was told right at {100 * right:.0f} % "
            "of the stops; SLAM builds on it. To do: look at the stops under 'Explore' of 'arena report', or at "
            "scores.tables.poses in Python; a channel function of your own can give each path a probability "
            "(los_probability)"
        )


def _cut_doubt(values: Mapping[str, float]) -> Iterator[str]:
    if (cut := values.get("channel.missed.path_limit", np.nan)) > 0:
        yield f"channel: {counted(int(cut), 'significant path')} missed where max_paths was reached: raise it"


def _contour_doubt(values: Mapping[str, float]) -> Iterator[str]:
    told, narrow = [], []
    for of, name in (("mapping", "mapping"), ("slam", "SLAM")):
        scores = ("false", "accepted", "false_on_surface")
        false, total, right = (values.get(f"contours.{of}.{score}", np.nan) for score in scores)
        if false > 0:
            near = f" ({right:.0f} on a true surface, by wrong paths)" if right > 0 else ""
            told.append(f"{false:.0f} of {total:.0f} of {name}{near}")
        for kind in ("pillar", "wall"):
            if (held := values.get(f"contours.{of}.{kind}.seen_coverage95.mean", np.nan)) < LEAST_COVERAGE:
                narrow.append(f"{100 * held:.0f} % ({kind}s, {name})")
    if told:
        yield (
            f"contours: {', '.join(told)} are false (a ghost or a phantom), though their own probability may be "
            f"high. To do: {MORE_STOPS}; {SHOWN_BY.format('Mapping and SLAM')}"
        )
    if narrow:
        yield (
            f"bands of contours: those that should hold 95 % of the seen outline hold {', '.join(narrow)} in the "
            f"mean: {SHOWN_BY.format('Our contours')}"
        )


def _slam_doubt(values: Mapping[str, float]) -> tuple[str, ...]:
    if not (found := pose_doubts(values)):
        return ()
    few = values.get("slam.stops", np.inf) < FEW_STOPS
    what = f"{MORE_STOPS}; then" if few else "look at the stops under 'Explore' of 'arena report';"
    return (f"SLAM: {'; '.join(found)}. To do: {what} 'arena budget' tells which stage errs",)


def few_stops(n_stops: int) -> tuple[str, ...]:
    """What a walk of so few stops means for SLAM; empty where they are enough."""
    if n_stops >= FEW_STOPS:
        return ()
    told = f"{counted(n_stops, 'stop')} of a walk hardly check one another: SLAM may be centimetres off"
    return (f"{told} where {FEW_STOPS} stops are millimetres off; to do: {MORE_STOPS}",)


def case_doubts(values: Mapping[str, float], *, stops_alone: bool = False) -> tuple[str, ...]:
    """As `doubts_of`, with walks of few stops unless SLAM took the `stops_alone`."""
    n_stops = values.get("slam.stops", np.nan)
    return (*doubts_of(values), *(few_stops(int(n_stops)) if n_stops > 0 and not stops_alone else ()))


def run_doubts(metrics: Sequence[Metric], poses: PoseEstimates) -> tuple[str, ...]:
    """All that is doubtful about a finished run: its scores, what SLAM says itself, and a walk of few stops."""
    few = few_stops(len(poses.stop)) if len(poses.stop) and poses.is_of_walk.any() else ()
    return (*score_doubts(metrics), *estimate_doubts(poses), *few)


def estimate_doubts(poses: PoseEstimates) -> tuple[str, ...]:
    """What the estimates of SLAM say themselves: stops not located, with a second solution, or on one path."""
    return tuple(_estimate_doubts(poses.take("stop", poses.status != SolveStatus.GIVEN)))


def _estimate_doubts(poses: PoseEstimates) -> Iterator[str]:
    lost = poses.stop[poses.status == SolveStatus.FAILED].tolist()
    if lost and len(lost) == len(poses.stop):
        yield f"SLAM located no stop, so it made no map: {NEEDED}"
    elif lost:
        of = f"{len(lost)} of {counted(len(poses.stop), 'stop')}"
        yield f"SLAM did not locate {of}, stop {listed(lost)}; its scores and its map leave these out: {NEEDED}"
    poses = poses.take("stop", poses.status != SolveStatus.FAILED)
    if second := poses.stop[poses.is_ambiguous].tolist():
        what = "a second solution that is about as good, or too few paths to tell"
        yield f"SLAM has {what}, at stop {listed(second)}"
    hangs = poses.take("stop", (poses.path_influence_m > HANGS_M) & ~poses.is_ambiguous)
    if stops := hangs.stop.tolist():
        most = f"{hangs.path_influence_m.max():.2g} m at most"
        yield f"SLAM hangs on one path at stop {listed(stops)}: without it the position moves, by {most}"
