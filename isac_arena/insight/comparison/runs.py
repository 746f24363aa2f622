"""Paired comparison of two runs over the same stops: by stop, by true path and by object."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from isac_arena.insight.comparison.difference import PairedDifference, PairedValues, paired_difference
from isac_arena.scoring.metrics.metric import Direction
from isac_arena.scoring.metrics.statistics import quantile
from isac_arena.scoring.record import MapScores, OutlineScores, ScoreTables
from isac_arena.scoring.stages.shapes import best_rows
from scenes.record import FloatArray, IntArray

SAME_PLACE_M = 1e-6
SAME_DIRECTION_RAD = 1e-9
DEGREES = float(np.rad2deg(1.0))

Values = dict[Hashable, float]  # of one run, by the item that makes a pair


@dataclass(frozen=True)
class RunComparison:
    """All differences of two runs, the number of stops in both, and notes on items that could not be paired."""

    differences: tuple[PairedDifference, ...]
    n_stops: int
    notes: tuple[str, ...]


def compare_runs(first: ScoreTables, second: ScoreTables) -> RunComparison:
    """Paired differences of two runs, second minus first; quantities that neither run has are omitted.

    Raises `ValueError` where no receiver stop is the same in both.
    """
    runs = (first, second)
    stops = common_stops(first, second)
    if not len(stops):
        raise ValueError("no receiver stop is the same in both; only runs over the same stops can be paired")
    notes = []
    n_stops = (len(first.poses.stop), len(second.poses.stop))
    if max(n_stops) > len(stops):
        notes.append(f"{len(stops)} stops are the same in both, of {n_stops[0]} in A and {n_stops[1]} in B")
    pairs = [*_pose_pairs(runs, stops), *_set_pairs(runs, stops)]
    if _same_paths(runs, stops):
        pairs += _path_pairs(runs, stops)
        notes += _angle_notes(first, second)
    else:
        counts = [int(np.isin(run.significant.stop, stops).sum()) for run in runs]
        notes.append(f"the true paths differ ({counts[0]} in A, {counts[1]} in B): paths are not paired")
    for name in ("mapping", "slam"):
        maps = getattr(first, name), getattr(second, name)
        pairs += [*_ip_pairs(name, maps, stops), *_object_pairs(name, maps)]
    pairs += _track_pairs(runs, stops)
    differences = tuple(one for one in map(paired_difference, pairs) if one.verdict)
    notes += [f"SLAM located no stop in {name}" for name, run in zip("AB", runs, strict=True) if _is_lost(run)]
    return RunComparison(differences, len(stops), tuple(notes))


def _angle_notes(first: ScoreTables, second: ScoreTables) -> Iterator[str]:
    """Angles that are cone angles in one run and azimuths in the other."""
    one, other = first.paths.angle_names, second.paths.angle_names
    for key, name in (("aod", "AoD"), ("aoa", "AoA")):
        if one[key] != other[key]:
            told = f"{name} errors are those of {one[key]}s in A and of {other[key]}s in B"
            yield f"{told}: not of the same angle, so their difference is not one of methods alone"


def _is_lost(run: ScoreTables) -> bool:
    return not np.isfinite(run.poses.position_error_m).any()


def common_stops(first: ScoreTables, second: ScoreTables) -> IntArray:
    """Indices (stop,) of the stops that have the same true receiver position in both runs."""
    _, one, other = np.intersect1d(first.poses.stop, second.poses.stop, return_indices=True)
    apart = np.abs(first.poses.true_position_m[one] - second.poses.true_position_m[other]).max(axis=1)
    return np.asarray(first.poses.stop[one[apart <= SAME_PLACE_M]])


def pair_values(key: str, unit: str, direction: Direction, first: Values, second: Values) -> PairedValues:
    """The values of two runs by item, NaN where a run has none.

    The group of an item is the first part of its key where that is a tuple, else the item itself.
    """
    items = list(dict.fromkeys([*first, *second]))
    groups = [item[0] if isinstance(item, tuple) else item for item in items]
    number = {group: index for index, group in enumerate(dict.fromkeys(groups))}
    sides = (np.array([run.get(item, np.nan) for item in items], float) for run in (first, second))
    return PairedValues(key, unit, direction, np.array([number[group] for group in groups], int), *sides)


def _pose_pairs(runs: Sequence[ScoreTables], stops: IntArray) -> Iterator[PairedValues]:
    for key, unit, field, scale in (
        ("slam.position_error", "m", "position_error_m", 1.0),
        ("slam.height_error", "m", "height_error_m", 1.0),
        ("slam.heading_error", "deg", "heading_error_rad", DEGREES),
        ("slam.clock_error", "ns", "clock_error_s", 1e9),
    ):
        sides = (_of_stops(run.poses.stop, scale * np.abs(getattr(run.poses, field)), stops) for run in runs)
        yield pair_values(key, unit, "lower", *sides)


def _set_pairs(runs: Sequence[ScoreTables], stops: IntArray) -> Iterator[PairedValues]:
    sides = (_of_stops(run.stops.stop, run.stops.gospa, stops) for run in runs)
    yield pair_values("channel.gospa", "1", "lower", *sides)


def _track_pairs(runs: Sequence[ScoreTables], stops: IntArray) -> Iterator[PairedValues]:
    """GOSPA of the tracks at every stop, and the errors at every mover and stop; none where nothing moves."""
    tables = [run.tracks for run in runs if run.tracks is not None]
    if len(tables) < len(runs):
        return
    sets = (_of_stops(one.stop, one.gospa_m, stops) for one in tables)
    yield pair_values("tracks.gospa", "m", "lower", *sets)
    for key, unit, field in (("position", "m", "position_error_m"), ("velocity", "m/s", "velocity_error_m_s")):
        sides: list[Values] = []
        for one in tables:
            rows = zip(one.mover.tolist(), one.mover_stop.tolist(), getattr(one, field).tolist(), strict=True)
            sides.append({(stop, mover): value for mover, stop, value in rows if stop in stops})
        yield pair_values(f"tracks.{key}_error", unit, "lower", *sides)


def _same_paths(runs: Sequence[ScoreTables], stops: IntArray) -> bool:
    """Whether all true paths with the same stop and index have the same directions; false where there are none."""
    known = []
    for paths in (run.significant for run in runs):
        directions = np.column_stack([paths.aod_azimuth_rad, paths.aoa_azimuth_rad])
        rows = zip(paths.stop.tolist(), paths.path.tolist(), directions, strict=True)
        known.append({(stop, path): angles for stop, path, angles in rows if stop in stops})
    common = known[0].keys() & known[1].keys()
    apart = [np.abs(known[0][item] - known[1][item]).max() for item in common]
    return bool(common) and max(apart) <= SAME_DIRECTION_RAD


def _path_pairs(runs: Sequence[ScoreTables], stops: IntArray) -> Iterator[PairedValues]:
    """Detection of the significant true paths, and the errors of the detected ones."""
    tables = (run.significant for run in runs)
    detected = (_of_paths(one.stop, one.path, one.is_detected.astype(float), stops) for one in tables)
    yield pair_values("channel.detected", "1", "higher", *detected)
    for key, unit, field, scale in (
        ("channel.delay_error", "ns", "delay_error_s", 1e9),
        ("channel.aod_error", "deg", "aod_error_rad", DEGREES),
        ("channel.aoa_error", "deg", "aoa_error_rad", DEGREES),
        ("channel.power_error", "dB", "power_error_db", 1.0),
    ):
        errors = (
            _of_paths(run.paths.stop, run.paths.true_path, scale * np.abs(getattr(run.paths, field)), stops)
            for run in runs
        )
        yield pair_values(key, unit, "lower", *errors)


def _ip_pairs(name: str, maps: Sequence[MapScores], stops: IntArray) -> Iterator[PairedValues]:
    """Medians of the inlier incidence points of every stop: distance to the nearest surface, height error."""
    for key, field in (("ip_to_surface", "surface_distance_m"), ("ip_height_error", "height_error_m")):
        sides: list[Values] = []
        for ips in (one.ips.take("ip", one.ips.is_inlier) for one in maps):
            value = np.abs(getattr(ips, field))
            sides.append({stop: quantile(value[ips.stop == stop], 0.5) for stop in stops.tolist()})
        yield pair_values(f"{name}.{key}", "m", "lower", *sides)


def _object_pairs(name: str, maps: Sequence[MapScores]) -> Iterator[PairedValues]:
    columns: tuple[tuple[str, str, Direction], ...] = (
        ("iou", "1", "higher"),
        ("modified_hausdorff_m", "m", "lower"),
        ("seen_rmse_m", "m", "lower"),
        ("full_rmse_m", "m", "lower"),
    )
    kinds: dict[str, list[OutlineScores]] = {
        "shapes": [one.clusters for one in maps],
        "contours": [one.contours for one in maps],
    }
    for kind, tables in kinds.items():
        rows = [best_rows(table) for table in tables]
        for field, unit, direction in columns:
            sides: list[Values] = [
                {item: float(getattr(table, field)[row]) for item, row in best.items()}
                for table, best in zip(tables, rows, strict=True)
            ]
            yield pair_values(f"{kind}.{name}.{field.removesuffix('_m')}", unit, direction, *sides)


def _of_stops(stop: IntArray, value: FloatArray, wanted: IntArray) -> Values:
    known = np.isin(stop, wanted)
    return dict(zip(stop[known].tolist(), value[known].tolist(), strict=True))


def _of_paths(stop: IntArray, path: IntArray, value: FloatArray, wanted: IntArray) -> Values:
    """Values by (stop, true path); unassigned estimates have no value."""
    known = np.isin(stop, wanted) & (path >= 0) & np.isfinite(value)
    keys = zip(stop[known].tolist(), path[known].tolist(), strict=True)
    return dict(zip(keys, value[known].tolist(), strict=True))
