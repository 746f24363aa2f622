"""Tables of the channel estimates: estimated paths with their true paths, and significant true paths."""

from dataclasses import replace
from typing import Any

import numpy as np

from estimation.channel.hall.record import HallClass
from estimation.channel.record import MIN_PARAMETERS, AngleKind, ChannelEstimate, EstimateStatus
from isac_arena.scoring.association import (
    GatedPaths,
    assign,
    gated_paths,
    gates_off,
    inside_gate,
    parameter_errors,
    path_gospa,
)
from isac_arena.scoring.causes import WEAK_MARGIN_DB, Evidence, false_causes, miss_causes, weak_causes
from isac_arena.scoring.config import DEFAULT_GATE, Gate
from isac_arena.scoring.link_view import LinkView
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.scoring.provenance import path_class
from isac_arena.scoring.record import PathKind, PathScores, PathStatus, SignificantPaths, StopScores
from isac_arena.scoring.stop_bounds import Kinds, kinds_of
from isac_arena.scoring.true_stop import TrueStop, seen_by, significant_alone
from scenes.record import BoolArray, FloatArray, IntArray


def _in_front(estimate: ChannelEstimate, view: LinkView) -> ChannelEstimate:
    """The estimate with directions behind all panels of a device mirrored to the front, as `LinkView.in_front`."""
    before = estimate.plane_parameters
    after = view.in_front(before)
    sign = np.ones(estimate.covariance.shape[:2])
    sign[:, :3] = np.where(after == before, 1.0, -1.0)  # a mirrored angle errs the other way
    return replace(
        estimate,
        aod_azimuth_rad=after[:, 1],
        aoa_azimuth_rad=after[:, 2],
        covariance=estimate.covariance * sign[:, :, None] * sign[:, None],
    )


def score_stop(
    stop: TrueStop, estimate: ChannelEstimate, gate: Gate = DEFAULT_GATE
) -> tuple[PathScores, SignificantPaths, StopScores]:
    """Tables of one stop: its estimated paths, its significant true paths, and the GOSPA between them."""
    estimate = estimate if stop.view is None else _in_front(estimate, stop.view)
    received_dbm = _received_dbm(stop, estimate)
    measured = gated_paths(estimate, gate)
    seen = seen_by(stop, estimate)
    match = _assigned(seen, received_dbm, measured)
    true_path = np.append(stop.significant, -1)[match]
    status = np.where(true_path >= 0, PathStatus.DETECTED, PathStatus.FALSE)
    for index in np.flatnonzero(true_path < 0):
        true_path[index] = _weak_origin(seen, measured.take(np.array([index])), float(received_dbm[index]))
    unexplained = np.flatnonzero(true_path < 0)
    true_path[unexplained] = _field_origin(seen, estimate.take("path", unexplained), received_dbm[unexplained])
    status[(status == PathStatus.FALSE) & (true_path >= 0)] = PathStatus.WEAK
    detected = np.isin(np.arange(len(stop.significant)), match)
    evidence = _evidence(seen, replace(estimate, power_dbm=received_dbm), measured, status, detected)
    expected = seen.parameters[stop.significant][detected | evidence.is_separable]
    return (
        _path_scores(seen, estimate, true_path, evidence),
        _significant_scores(stop, seen, kinds_of(estimate), evidence),
        replace(_stop_scores(stop, measured.take(status != PathStatus.WEAK), expected), **_read_heights(estimate)),
    )


def _received_dbm(stop: TrueStop, estimate: ChannelEstimate) -> FloatArray:
    """Estimated powers (path,) before the gain of the converters, which no estimator knows."""
    if stop.view is None or not len(estimate):
        return estimate.power_dbm
    return estimate.power_dbm - stop.view.converter_gain_db(stop.truth, stop.view.estimated_cells(estimate))


def _assigned(stop: TrueStop, estimate_dbm: FloatArray, measured: GatedPaths) -> IntArray:
    """Index (estimate,) of the significant path assigned to each estimate, -1 for none.

    An estimate may rather be a weaker specular path that has the power to explain it.
    """
    weaker = np.setdiff1d(np.flatnonzero(~stop.truth.paths.is_diffuse), stop.significant)
    candidates = np.append(stop.significant, weaker)
    explains = stop.power_dbm[candidates] >= estimate_dbm[:, None] - WEAK_MARGIN_DB
    explains[:, : len(stop.significant)] = True
    match = assign(measured.parameters, stop.parameters[candidates], measured.half_width, explains)
    return np.where(match < len(stop.significant), match, -1)


def _weak_origin(stop: TrueStop, measured: GatedPaths, estimate_dbm: float) -> int:
    """The strongest weak or diffuse path that explains an estimate, -1 for none.

    The power of all such paths inside the gate must reach the power of the estimate minus the margin. The path
    belongs to the object that contributes the most power.
    """
    near = inside_gate(parameter_errors(measured.parameters, stop.parameters), measured.half_width)
    near[stop.significant] = False
    candidates = np.flatnonzero(near)
    power_mw = 10 ** (stop.power_dbm[candidates] / 10)
    if power_mw.sum() < 10 ** ((estimate_dbm - WEAK_MARGIN_DB) / 10) or not len(candidates):
        return -1
    names, group = np.unique(stop.origin.object[candidates], return_inverse=True)
    strongest_group = np.bincount(group, weights=power_mw, minlength=len(names)).argmax()
    return int(candidates[np.where(group == strongest_group, power_mw, -1.0).argmax()])


def _field_origin(stop: TrueStop, estimate: ChannelEstimate, received_dbm: FloatArray) -> IntArray:
    """The path (estimate,) that contributes the most to the field that explains each estimate, -1 for none.

    The field is the coherent sum of all weak and diffuse paths in the cell of the estimate: many diffuse paths may
    add up there, from beyond the gate as well. Its power must reach that of the estimate minus the margin.
    """
    weak = np.setdiff1d(np.arange(len(stop.truth.paths)), stop.significant)
    if stop.view is None or not len(weak) or not len(estimate):
        return np.full(len(estimate), -1)
    truth = replace(stop.truth, paths=stop.truth.paths.take("path", weak))
    amplitude = stop.view.cell_amplitudes(truth, stop.view.estimated_cells(estimate))
    field_mw = np.square(np.abs(amplitude.sum(axis=1)))
    is_explained = field_mw >= 10 ** ((received_dbm - WEAK_MARGIN_DB) / 10)
    return np.where(is_explained, weak[np.abs(amplitude).argmax(axis=1)], -1)


def _evidence(
    stop: TrueStop, estimate: ChannelEstimate, measured: GatedPaths, status: IntArray, detected: BoolArray
) -> Evidence:
    """The data of one stop that the causes follow from."""
    own, n_true = stop.parameters[stop.significant], len(stop.significant)
    diffuse = np.flatnonzero(stop.truth.paths.is_diffuse)
    around = inside_gate(parameter_errors(own[:, None], stop.parameters[diffuse][None]), measured.gate)
    diffuse_mw = around @ 10 ** (stop.power_dbm[diffuse] / 10)
    leaked, crosstalk = np.full((len(estimate), n_true), np.nan), np.full((n_true, n_true), np.nan)
    beam_loss = np.full(n_true, np.nan)
    if stop.view is not None:
        truth = significant_alone(stop).truth
        leaked = stop.view.leaked_dbm(truth, stop.view.estimated_cells(estimate))
        crosstalk = stop.view.leaked_dbm(truth, stop.view.true_cells(truth))
        beam_loss = stop.view.beam_loss_db(truth)
    true_dbm, limits = stop.power_dbm[stop.significant], stop.limits
    strongest_dbm = true_dbm.max(initial=-np.inf)
    return Evidence(
        status=status,
        distance=gates_off(measured.parameters, own, measured.half_width),
        true_distance=gates_off(own, own, measured.gate),
        is_detected=detected,
        is_separable=stop.is_separable,
        estimate_dbm=estimate.power_dbm,
        true_dbm=true_dbm,
        leaked_dbm=leaked,
        crosstalk_dbm=crosstalk,
        beam_loss_db=beam_loss,
        diffuse_dbm=10 * np.log10(np.maximum(diffuse_mw, np.finfo(float).tiny)),
        noise_threshold_dbm=limits.noise_threshold_dbm,
        significance_dbm=max(limits.noise_threshold_dbm, strongest_dbm - limits.dynamic_range_db),
        is_limited=estimate.status == EstimateStatus.LIMITED,
        is_refused=estimate.status in (EstimateStatus.REFUSED, EstimateStatus.FAILED),
    )


def _path_scores(stop: TrueStop, estimate: ChannelEstimate, true_path: IntArray, evidence: Evidence) -> PathScores:
    status = evidence.status
    detected = status == PathStatus.DETECTED
    matched = true_path[detected]
    error = np.full((len(estimate), 3), np.nan)
    error[detected] = parameter_errors(
        estimate.plane_parameters[detected], stop.parameters[matched, :MIN_PARAMETERS]
    )
    power_error_db = np.full(len(estimate), np.nan)
    power_error_db[detected] = estimate.power_dbm[detected] - stop.power_dbm[matched]
    vertex_m, height_m = np.full((len(estimate), 2), np.nan), np.full(len(estimate), np.nan)
    vertex_m[detected], height_m[detected] = stop.origin.vertex_m[matched], stop.origin.height_m[matched]
    weak = weak_causes(status, np.append(stop.truth.paths.is_diffuse, False)[true_path])
    return PathScores(
        stop=np.full(len(estimate), stop.truth.stop),
        path=np.arange(len(estimate)),
        status=status,
        cause=np.where(status == PathStatus.WEAK, weak, false_causes(evidence)),
        is_los=estimate.is_los,
        true_path=true_path,
        kind=np.append(stop.origin.kind, PathKind.NONE)[true_path],
        object=np.append(stop.origin.object, "")[true_path],
        plan_object=np.append(stop.origin.plan_object, "")[true_path],
        vertex_m=vertex_m,
        vertex_height_m=height_m,
        delay_error_s=error[:, 0],
        aod_error_rad=error[:, 1],
        aoa_error_rad=error[:, 2],
        **reported_angles(estimate),
        power_error_db=power_error_db,
        nees=squared_mahalanobis(error, estimate.plane_covariance),
        **_classes(stop, estimate, status, true_path),
    )


def _classes(stop: TrueStop, estimate: ChannelEstimate, status: IntArray, true_path: IntArray) -> dict[str, Any]:
    """The columns of `PathScores` with the classes of paths in a hall, as estimated and as they are.

    A path that nothing or a diffuse path explains is weak; a weak specular one may be told either way.
    """
    if estimate.hall is None:
        return {}
    paths, weak = stop.truth.paths, list(HallClass).index(HallClass.WEAK)
    by_path = np.append(path_class(paths, stop.tx_pose.position_m[2], stop.truth.rx_pose.position_m[2]), weak)
    true_class = by_path[true_path]
    true_class[(status != PathStatus.DETECTED) & (true_class != weak)] = -1
    return {"hall_class": estimate.hall.class_probability.argmax(axis=1), "true_class": true_class}


def _read_heights(estimate: ChannelEstimate) -> dict[str, Any]:
    """The columns of `StopScores` with the heights of a hall that was read."""
    if estimate.hall is None:
        return {}
    return dict(zip(("rx_height_m", "ceiling_m"), estimate.hall.heights_m[1:, None], strict=True))


def reported_angles(estimate: ChannelEstimate) -> dict[str, Any]:
    """The columns of `PathScores` with the deviations that an estimate reports, and what its angles are."""
    std = np.sqrt(np.diagonal(estimate.plane_covariance, axis1=1, axis2=2))
    is_cone = (np.full(len(estimate), kind == AngleKind.CONE) for kind in kinds_of(estimate))
    columns = ("delay_std_s", "aod_std_rad", "aoa_std_rad", "aod_is_cone", "aoa_is_cone")
    return dict(zip(columns, (*std.T, *is_cone), strict=True))


def _significant_scores(stop: TrueStop, seen: TrueStop, kinds: Kinds, evidence: Evidence) -> SignificantPaths:
    """The table of significant paths: true azimuths, and bounds of the angles that the estimate reports."""
    significant = stop.significant
    parameters = stop.parameters[significant]
    bound = np.sqrt(np.diagonal(seen.covariance, axis1=1, axis2=2))
    alone = scattered = np.full((len(significant), 3), np.nan)
    if stop.bounds is not None:
        alone, scattered = stop.bounds.std(stop.bounds.alone, kinds), stop.bounds.scattered_std(kinds)
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
        is_detected=evidence.is_detected,
        is_separable=evidence.is_separable,
        share_of_cell=stop.share_of_cell,
        cause=miss_causes(evidence),
        delay_bound_s=bound[:, 0],
        aod_bound_rad=bound[:, 1],
        aoa_bound_rad=bound[:, 2],
        delay_lone_bound_s=alone[:, 0],
        aod_lone_bound_rad=alone[:, 1],
        aoa_lone_bound_rad=alone[:, 2],
        delay_scattered_bound_s=scattered[:, 0],
        aod_scattered_bound_rad=scattered[:, 1],
        aoa_scattered_bound_rad=scattered[:, 2],
    )


def _stop_scores(stop: TrueStop, measured: GatedPaths, expected: FloatArray) -> StopScores:
    """GOSPA against the `expected` paths: those that are separable, and others that were detected."""
    found = path_gospa(measured.parameters, expected, measured.half_width)
    row = (stop.truth.stop, found.value, found.localisation, found.missed, found.false)
    return StopScores(*(np.array([value]) for value in row))
