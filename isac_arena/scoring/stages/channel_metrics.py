"""Scores of the channel estimates: detected, missed and false paths with their causes, errors and bounds."""

import numpy as np

from estimation.channel.hall.record import HallClass
from isac_arena.scoring.causes import FALSE_CAUSES, MISS_CAUSES, Cause
from isac_arena.scoring.metrics.consistency import consistency_metrics
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import finite_entries, maximum, mean, quantile, ratio, rms
from isac_arena.scoring.record import PathKind, PathScores, PathStatus, SignificantPaths, StopScores
from scenes.record import BoolArray, IntArray

CLASS_KEYS = {name: name.name.lower() for name in HallClass}


def los_decision_is_right(stops: IntArray, paths: PathScores, significant: SignificantPaths) -> BoolArray:
    """Whether the LOS decision was correct (stop,).

    It is correct to choose the path that is assigned to the true line of sight, or to choose none where there is
    no significant line of sight.
    """
    named = np.isin(stops, paths.stop[paths.is_los])
    is_los = paths.is_los & (paths.kind == PathKind.LOS) & (paths.status == PathStatus.DETECTED)
    exists = np.isin(stops, significant.stop[significant.kind == PathKind.LOS])
    return np.where(named, np.isin(stops, paths.stop[is_los]), ~exists)


def channel_metrics(sets: StopScores, paths: PathScores, significant: SignificantPaths) -> list[Metric]:
    """Scores of the channel estimates over all stops. Errors are those of detected paths."""
    stops = sets.stop
    los_is_right = mean(los_decision_is_right(stops, paths, significant))
    return [
        Metric("channel.gospa.mean", mean(sets.gospa), "gates", "lower"),
        Metric("channel.gospa.localisation_mean", mean(sets.localisation), "gates", "lower"),
        Metric("channel.gospa.missed_mean", mean(sets.missed), "gates", "lower"),
        Metric("channel.gospa.false_mean", mean(sets.false), "gates", "lower"),
        *_count_metrics(stops, paths, significant),
        *_cause_metrics(paths, significant),
        *_error_metrics(paths),
        *_bound_metrics(paths, significant),
        *consistency_metrics("channel", paths.nees, 3),
        Metric("channel.los.decision_accuracy", los_is_right, "1", "higher"),
        *_class_metrics(paths),
    ]


def class_right(paths: PathScores, name: HallClass) -> BoolArray:
    """Whether the class of each path (path,) that is of this class was told."""
    of_it = (paths.true_class == list(HallClass).index(name)) & (paths.hall_class >= 0)
    return np.asarray((paths.hall_class == paths.true_class)[of_it])


def _class_metrics(paths: PathScores) -> list[Metric]:
    """Shares of the paths of each class of a hall that were told as such; none where no hall was read."""
    if (paths.hall_class < 0).all():
        return []
    return [
        Metric(f"channel.class_right.{key}", mean(class_right(paths, name)), "1", "higher")
        for name, key in CLASS_KEYS.items()
    ]


def _count_metrics(stops: IntArray, paths: PathScores, significant: SignificantPaths) -> list[Metric]:
    n = len(stops)
    false = paths.status == PathStatus.FALSE
    unresolved, expected = significant.cause == Cause.UNRESOLVED, significant.is_separable
    detected, hidden = significant.is_detected[expected], ~expected & ~significant.is_detected
    most_false = maximum([(paths.stop[false] == stop).sum() for stop in stops])
    metrics = [
        Metric("channel.estimated_per_stop", ratio(len(paths.stop), n), "1", "info"),
        Metric("channel.significant_per_stop", ratio(len(expected), n), "1", "info"),
        Metric("channel.inseparable_per_stop", ratio((~expected).sum(), n), "1", "info"),
        Metric("channel.inseparable_undetected_per_stop", ratio(hidden.sum(), n), "1", "info"),
        Metric("channel.detected", significant.is_detected.sum(), "1", "info"),
        Metric("channel.detected_per_stop", ratio(significant.is_detected.sum(), n), "1", "higher"),
        Metric("channel.missed_per_stop", ratio((~detected).sum(), n), "1", "lower"),
        Metric("channel.unresolved_per_stop", ratio(unresolved.sum(), n), "1", "info"),
        Metric("channel.weak_per_stop", ratio((paths.status == PathStatus.WEAK).sum(), n), "1", "info"),
        Metric("channel.false_per_stop", ratio(false.sum(), n), "1", "lower"),
        Metric("channel.false_per_stop.max", most_false, "1", "lower"),
        Metric("channel.detection_rate", mean(detected), "1", "higher"),
    ]
    for kind, name in KIND_KEYS.items():
        rate = mean(detected[significant.kind[expected] == kind])
        metrics.append(Metric(f"channel.{name}.detection_rate", rate, "1", "higher"))
    return metrics


KIND_KEYS = {kind: kind.name.lower() for kind in (PathKind.LOS, PathKind.SINGLE_BOUNCE, PathKind.MULTI_BOUNCE)}


def _error_metrics(paths: PathScores) -> list[Metric]:
    errors = {
        ("delay", "ns"): 1e9 * paths.delay_error_s,
        ("aod", "deg"): np.rad2deg(paths.aod_error_rad),
        ("aoa", "deg"): np.rad2deg(paths.aoa_error_rad),
        ("power", "dB"): paths.power_error_db,
    }
    metrics = []
    for (name, unit), error in errors.items():
        suffix = unit.lower()
        metrics.append(Metric(f"channel.{name}.rmse_{suffix}", rms(error), unit, "lower"))
        metrics.append(Metric(f"channel.{name}.bias_{suffix}", mean(error), unit, "info"))
    power_db = np.abs(finite_entries(paths.power_error_db))
    metrics.append(Metric("channel.power.median_db", quantile(power_db, 0.5), "dB", "lower"))
    metrics.append(Metric("channel.power.max_db", maximum(power_db), "dB", "lower"))
    metrics.append(Metric("channel.power.off_10db", (power_db >= 10.0).sum(), "1", "lower"))
    return metrics


def _cause_metrics(paths: PathScores, significant: SignificantPaths) -> list[Metric]:
    """Numbers of missed and of false paths of the campaign by cause."""
    false = paths.cause[paths.status == PathStatus.FALSE]
    missed = significant.cause[~significant.is_detected]
    return [
        Metric(f"channel.{name}.{cause}", (found == cause).sum(), "1", "info")
        for name, found, causes in (("missed", missed, MISS_CAUSES), ("false", false, FALSE_CAUSES))
        for cause in causes
    ]


def _bound_metrics(paths: PathScores, significant: SignificantPaths) -> list[Metric]:
    """Errors of the detected paths over the bounds of their true paths: the RMS of an efficient estimator is 1."""
    detected, bound = detected_paths(paths, significant)
    metrics = []
    for name, error, std in (
        ("delay", detected.delay_error_s, bound.delay_bound_s),
        ("aod", detected.aod_error_rad, bound.aod_bound_rad),
        ("aoa", detected.aoa_error_rad, bound.aoa_bound_rad),
    ):
        known = np.isfinite(std) & (std > 0)
        share = np.abs(error[known]) / std[known]
        metrics.append(Metric(f"channel.{name}.over_bound.rms", rms(share), "1", "lower"))
        metrics.append(Metric(f"channel.{name}.over_bound.median", quantile(share, 0.5), "1", "lower"))
    return metrics


def detected_paths(paths: PathScores, significant: SignificantPaths) -> tuple[PathScores, SignificantPaths]:
    """The detected paths and, row by row, the significant path that each was assigned to.

    Paths of a measured campaign have no true path and are left out.
    """
    is_known = (paths.status == PathStatus.DETECTED) & (paths.true_path >= 0)
    detected = paths.take("estimate", is_known)
    keys = zip(significant.stop.tolist(), significant.path.tolist(), strict=True)
    row = {key: index for index, key in enumerate(keys)}
    of_path = [row[key] for key in zip(detected.stop.tolist(), detected.true_path.tolist(), strict=True)]
    return detected, significant.take("true_path", np.array(of_path, int))
