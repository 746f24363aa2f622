"""Scores of the channel estimates: detected, missed and false paths, errors and their consistency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from estimation.channel.record import ChannelEstimate
from estimation.scoring.association import assign, inside_gate, parameter_errors, path_gospa
from estimation.scoring.config import ScoringConfig, Significance
from estimation.scoring.metric import Metric
from estimation.scoring.provenance import PathOrigin, path_origin
from estimation.scoring.record import PathKind, PathScores, PathStatus, SignificantPaths, StopScores
from estimation.scoring.statistics import maximum, mean, ratio, rms, squared_mahalanobis
from scenes.pose import Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray
from sim.paths import Paths
from sim.truth import Truth


@dataclass(frozen=True)
class _Stop:
    """One stop prepared for scoring: true paths as the devices see them."""

    truth: Truth
    origin: PathOrigin
    parameters: FloatArray  # (path, 3) in (s, rad, rad)
    power_dbm: FloatArray


def device_parameters(truth: Truth, tx_pose: Pose) -> FloatArray:
    """True (delay in s with the clock bias, AoD in the TX frame, AoA in the RX frame) (path, 3)."""
    paths = truth.paths
    return np.stack(
        [
            paths.delay_s + truth.clock_bias_s,
            wrap_angle(paths.aod_azimuth_rad - tx_pose.heading_rad),
            wrap_angle(paths.aoa_azimuth_rad - truth.rx_pose.heading_rad),
        ],
        axis=-1,
    )


def significant_paths(paths: Paths, power_dbm: FloatArray, limits: Significance) -> BoolArray:
    """Mask (path,) of the paths an estimator can detect: not diffuse, above noise, within its dynamic range."""
    candidate = ~paths.is_diffuse & (power_dbm >= limits.noise_threshold_dbm)
    if candidate.any():
        candidate &= power_dbm >= power_dbm[candidate].max() - limits.dynamic_range_db
    return np.asarray(candidate)


def score_stop(
    truth: Truth,
    estimate: ChannelEstimate,
    tx_pose: Pose,
    power_dbm: FloatArray,
    limits: Significance,
    config: ScoringConfig,
) -> tuple[PathScores, SignificantPaths, StopScores]:
    """Tables of one stop: each estimated path with its true one, what there was to detect, and how far they are.

    `power_dbm` (path,) is the received power of the true paths in their best beam pairs.
    """
    stop = _Stop(truth, path_origin(truth.paths), device_parameters(truth, tx_pose), power_dbm)
    significant = np.flatnonzero(significant_paths(truth.paths, power_dbm, limits))
    measured = np.stack([estimate.delay_s, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad], axis=-1)
    match = assign(measured, stop.parameters[significant], config.gate)
    true_path = np.append(significant, -1)[match]
    status = np.where(true_path >= 0, PathStatus.DETECTED, PathStatus.FALSE)
    for index in np.flatnonzero(true_path < 0):
        true_path[index] = _weak_origin(
            stop, measured[index], float(estimate.power_dbm[index]), significant, config
        )
        status[index] = PathStatus.WEAK if true_path[index] >= 0 else PathStatus.FALSE
    detected = np.isin(np.arange(len(significant)), match)
    return (
        _path_scores(stop, estimate, measured, true_path, status),
        _significant_scores(stop, significant, detected, config),
        _stop_scores(stop, measured[status != PathStatus.WEAK], significant, config),
    )


def _weak_origin(
    stop: _Stop, measured: FloatArray, estimate_dbm: float, significant: IntArray, config: ScoringConfig
) -> int:
    """The strongest weak or diffuse path behind an estimate, -1 where true energy does not explain it.

    The energy inside the gate that no significant path carries must reach the estimate's power less the margin.
    Of it, the object that contributes most is taken.
    """
    near = inside_gate(parameter_errors(measured, stop.parameters), config.gate)
    near[significant] = False
    candidates = np.flatnonzero(near)
    power_mw = 10 ** (stop.power_dbm[candidates] / 10)
    if power_mw.sum() < 10 ** ((estimate_dbm - config.weak_margin_db) / 10) or not len(candidates):
        return -1
    names, group = np.unique(stop.origin.object[candidates], return_inverse=True)
    strongest_group = np.bincount(group, weights=power_mw, minlength=len(names)).argmax()
    return int(candidates[np.where(group == strongest_group, power_mw, -1.0).argmax()])


def _path_scores(
    stop: _Stop, estimate: ChannelEstimate, measured: FloatArray, true_path: IntArray, status: IntArray
) -> PathScores:
    detected = status == PathStatus.DETECTED
    matched = true_path[detected]
    error = np.full((len(estimate), 3), np.nan)
    error[detected] = parameter_errors(measured[detected], stop.parameters[matched])
    power_error_db = np.full(len(estimate), np.nan)
    power_error_db[detected] = estimate.power_dbm[detected] - stop.power_dbm[matched]
    vertex_m = np.full((len(estimate), 2), np.nan)
    vertex_m[detected] = stop.origin.vertex_m[matched]
    return PathScores(
        stop=np.full(len(estimate), stop.truth.stop),
        path=np.arange(len(estimate)),
        status=status,
        is_los=estimate.is_los,
        true_path=true_path,
        kind=np.append(stop.origin.kind, PathKind.NONE)[true_path],
        object=np.append(stop.origin.object, "")[true_path],
        vertex_m=vertex_m,
        delay_error_s=error[:, 0],
        aod_error_rad=error[:, 1],
        aoa_error_rad=error[:, 2],
        power_error_db=power_error_db,
        nees=squared_mahalanobis(error, estimate.plane_covariance),
    )


def _significant_scores(
    stop: _Stop, significant: IntArray, detected: BoolArray, config: ScoringConfig
) -> SignificantPaths:
    parameters = stop.parameters[significant]
    error = parameter_errors(parameters[:, None], parameters[None, detected])
    near_detected = inside_gate(error, config.gate).any(axis=1)
    return SignificantPaths(
        stop=np.full(len(significant), stop.truth.stop),
        path=significant,
        kind=stop.origin.kind[significant],
        object=stop.origin.object[significant],
        vertex_m=stop.origin.vertex_m[significant],
        delay_s=parameters[:, 0],
        aod_azimuth_rad=parameters[:, 1],
        aoa_azimuth_rad=parameters[:, 2],
        power_dbm=stop.power_dbm[significant],
        is_detected=detected,
        is_unresolved=near_detected & ~detected,
    )


def _stop_scores(
    stop: _Stop, measured: FloatArray, significant: IntArray, config: ScoringConfig
) -> StopScores:
    distance = path_gospa(measured, stop.parameters[significant], config.gate)
    return StopScores(
        stop=np.array([stop.truth.stop]),
        gospa=np.array([distance.value]),
        localisation=np.array([distance.localisation]),
        missed=np.array([distance.missed]),
        false=np.array([distance.false]),
    )


def los_decision_is_right(stops: IntArray, paths: PathScores, significant: SignificantPaths) -> BoolArray:
    """Whether the LOS decision was right, per stop.

    Right is to name the path detected as the true line of sight, or to name none where no significant one exists.
    """
    named = np.isin(stops, paths.stop[paths.is_los])
    is_los = paths.is_los & (paths.kind == PathKind.LOS) & (paths.status == PathStatus.DETECTED)
    exists = np.isin(stops, significant.stop[significant.kind == PathKind.LOS])
    return np.where(named, np.isin(stops, paths.stop[is_los]), ~exists)


def channel_metrics(sets: StopScores, paths: PathScores, significant: SignificantPaths) -> list[Metric]:
    """Scores of the channel estimates over the given stops. Errors are those of detected paths."""
    stops = sets.stop
    return [
        Metric("channel.gospa.mean", mean(sets.gospa), "gates", "lower"),
        Metric("channel.gospa.localisation_mean", mean(sets.localisation), "gates", "lower"),
        Metric("channel.gospa.missed_mean", mean(sets.missed), "gates", "lower"),
        Metric("channel.gospa.false_mean", mean(sets.false), "gates", "lower"),
        *_count_metrics(stops, paths, significant),
        *_error_metrics(paths),
        Metric("channel.nees", mean(paths.nees / 3), "1", "info"),
        Metric("channel.coverage95", _coverage(paths.nees), "1", "info"),
        Metric(
            "channel.los.decision_accuracy",
            mean(los_decision_is_right(stops, paths, significant)),
            "1",
            "higher",
        ),
    ]


def _count_metrics(stops: IntArray, paths: PathScores, significant: SignificantPaths) -> list[Metric]:
    n = len(stops)
    false = paths.status == PathStatus.FALSE
    detected = significant.is_detected
    metrics = [
        Metric("channel.estimated_per_stop", ratio(len(paths.stop), n), "1", "info"),
        Metric("channel.significant_per_stop", ratio(len(detected), n), "1", "info"),
        Metric("channel.detected_per_stop", ratio(detected.sum(), n), "1", "higher"),
        Metric("channel.missed_per_stop", ratio((~detected).sum(), n), "1", "lower"),
        Metric("channel.unresolved_per_stop", ratio(significant.is_unresolved.sum(), n), "1", "info"),
        Metric("channel.weak_per_stop", ratio((paths.status == PathStatus.WEAK).sum(), n), "1", "info"),
        Metric("channel.false_per_stop", ratio(false.sum(), n), "1", "lower"),
        Metric(
            "channel.false_per_stop.max",
            maximum([(paths.stop[false] == stop).sum() for stop in stops]),
            "1",
            "lower",
        ),
        Metric("channel.detection_rate", mean(detected), "1", "higher"),
    ]
    for kind, name in KIND_KEYS.items():
        rate = mean(detected[significant.kind == kind])
        metrics.append(Metric(f"channel.{name}.detection_rate", rate, "1", "higher"))
    return metrics


KIND_KEYS = {
    PathKind.LOS: "los",
    PathKind.SINGLE_BOUNCE: "single_bounce",
    PathKind.MULTI_BOUNCE: "multi_bounce",
}


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
    return metrics


def _coverage(nees: FloatArray) -> float:
    """Share of the detected paths inside the 95 % region of their covariance."""
    return mean(nees[np.isfinite(nees)] <= chi2.ppf(0.95, 3))
