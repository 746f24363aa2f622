"""One stop prepared for scoring: its true paths as the devices see them, and the significant ones."""

from dataclasses import dataclass, fields, replace

import numpy as np

from estimation.channel.record import AngleKind, ChannelEstimate
from isac_arena.scoring.association import reported_elevations
from isac_arena.scoring.config import Significance
from isac_arena.scoring.link_view import LinkView
from isac_arena.scoring.provenance import PathOrigin, path_origin
from isac_arena.scoring.stop_bounds import StopBounds, kinds_of, observed_kinds, separable_paths, stop_information
from scenes.pose import Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray
from sim.propagation.paths import Paths
from sim.truth import Truth


@dataclass(frozen=True)
class TrueStop:
    """One stop prepared for scoring: true paths in the frames of the devices, and the significant ones."""

    truth: Truth
    tx_pose: Pose  # the nominal one
    origin: PathOrigin
    parameters: FloatArray  # (path, 3 or 5) in s and rad, as `seen_by` has them: azimuths or cones, elevations
    cone_rad: FloatArray  # (path, 2) cone angles of departure and arrival; azimuths without a view of the link
    power_dbm: FloatArray  # (path,)
    significant: IntArray  # rows of the significant paths
    covariance: FloatArray  # (significant, 3, 3) joint bound in (s, rad, rad)^2, NaN without a view of the link
    bounds: StopBounds | None  # of the significant paths; None without a view of the link
    is_separable: BoolArray  # (significant,) true without a view of the link
    share_of_cell: FloatArray  # (significant,) joint bound over a resolution cell, NaN without a view of the link
    limits: Significance
    view: LinkView | None


def device_parameters(truth: Truth, tx_pose: Pose, rx_pose: Pose | None = None) -> FloatArray:
    """True (delay in s with the clock bias, AoD in the TX frame, AoA in the RX frame) (path, 3)."""
    paths = truth.paths
    aod_rad = wrap_angle(paths.aod_azimuth_rad - tx_pose.heading_rad)
    aoa_rad = wrap_angle(paths.aoa_azimuth_rad - (rx_pose or truth.rx_pose).heading_rad)
    return np.stack([paths.delay_s + truth.clock_bias_s, aod_rad, aoa_rad], axis=-1)


def significant_paths(paths: Paths, power_dbm: FloatArray, limits: Significance) -> BoolArray:
    """Mask (path,) of the paths that an estimator can detect: not diffuse, above noise, within dynamic range."""
    candidate = ~paths.is_diffuse & (power_dbm >= limits.noise_threshold_dbm)
    if candidate.any():
        candidate &= power_dbm >= power_dbm[candidate].max() - limits.dynamic_range_db
    return np.asarray(candidate)


def true_stop(
    truth: Truth,
    tx_pose: Pose,
    power_dbm: FloatArray,
    limits: Significance,
    view: LinkView | None,
    *,
    separates: bool = True,
) -> TrueStop:
    """Prepare one stop; `power_dbm` (path,) is the received power of the true paths in their best beam pairs.

    Without `separates` all paths count as separable, which takes half of the time.
    """
    significant = np.flatnonzero(significant_paths(truth.paths, power_dbm, limits))
    parameters = device_parameters(truth, *((tx_pose,) if view is None else view.ends(truth)))
    cone_rad, covariance, bounds = parameters[:, 1:], np.full((len(significant), 3, 3), np.nan), None
    is_separable, share_of_cell = np.ones(len(significant), bool), np.full(len(significant), np.nan)
    if view is not None:
        cone_rad = np.stack([cones.angle_rad for cones in view.cones(truth)], axis=1)
        information = stop_information(view, truth, significant)
        bounds = information.bounds(np.arange(len(significant)))
        if separates:
            is_separable, share_of_cell = separable_paths(view, truth, significant, information)
        covariance = bounds.in_kinds(bounds.joint, observed_kinds(view))
    return TrueStop(
        truth=truth,
        tx_pose=tx_pose,
        origin=path_origin(truth.paths),
        parameters=parameters,
        cone_rad=cone_rad,
        power_dbm=power_dbm,
        significant=significant,
        covariance=covariance,
        bounds=bounds,
        is_separable=is_separable,
        share_of_cell=share_of_cell,
        limits=limits,
        view=view,
    )


def seen_by(stop: TrueStop, estimate: ChannelEstimate) -> TrueStop:
    """The stop with parameters and bounds in the angles that an estimate reports: cone against cone.

    With elevations where the estimate has them; those of a device that reports none are NaN. Directions behind all
    panels of a device are mirrored to the front if the view is known.
    """
    kinds = kinds_of(estimate)
    is_cone = np.array([kind == AngleKind.CONE for kind in kinds])
    angles = np.where(is_cone, stop.cone_rad, stop.parameters[:, 1:])
    covariance = stop.covariance if stop.bounds is None else stop.bounds.in_kinds(stop.bounds.joint, kinds)
    parameters = np.column_stack([stop.parameters[:, 0], angles])
    if stop.view is not None:
        parameters = stop.view.in_front(parameters)
    if (has_elevation := np.isfinite(reported_elevations(estimate)[0]).any(axis=0)).any():
        paths = stop.truth.paths
        elevation = np.stack([paths.aod_elevation_rad, paths.aoa_elevation_rad], axis=1)
        parameters = np.column_stack([parameters, np.where(has_elevation, elevation, np.nan)])
    return replace(stop, parameters=parameters, covariance=covariance)


def significant_alone(stop: TrueStop) -> TrueStop:
    """The same stop with its significant paths only."""
    keep = stop.significant
    return replace(
        stop,
        truth=replace(stop.truth, paths=stop.truth.paths.take("path", keep)),
        origin=PathOrigin(*(getattr(stop.origin, field.name)[keep] for field in fields(PathOrigin))),
        parameters=stop.parameters[keep],
        cone_rad=stop.cone_rad[keep],
        power_dbm=stop.power_dbm[keep],
        significant=np.arange(len(keep)),
    )
