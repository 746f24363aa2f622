"""Oracles: truth in place of the records between stages, as pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import MIN_PARAMETERS, ChannelEstimate, PathMotion, PathsInHall
from estimation.slam.record import IncidencePoints
from isac_arena.scoring.record import PathKind
from isac_arena.scoring.true_stop import TrueStop
from scenes.record import BoolArray, FloatArray, IntArray, TextArray, concatenate
from scenes.scene import Scene


@dataclass(frozen=True)
class TracedPaths:
    """Estimated paths of one stop with the true path (path,) behind each: its row in the truth, -1 for none."""

    estimate: ChannelEstimate
    true_path: IntArray

    def sorted_by_delay(self) -> TracedPaths:
        """The same paths in order of delay, as a channel estimate has to be."""
        order = np.argsort(self.estimate.delay_s, kind="stable")
        return TracedPaths(self.estimate.take("path", order), self.true_path[order])

    def take(self, index: BoolArray) -> TracedPaths:
        """Some of the paths."""
        return TracedPaths(self.estimate.take("path", index), self.true_path[index])


def typical_covariance(estimates: Sequence[ChannelEstimate], fallback: FloatArray) -> FloatArray:
    """Diagonal covariance (parameter, parameter) of the median variances of all paths of a campaign.

    `fallback` (parameter,) are the variances of parameters without any finite variance.
    """
    width = max((estimate.size("parameter") for estimate in estimates), default=MIN_PARAMETERS)
    kept = [estimate.covariance for estimate in estimates if estimate.size("parameter") == width]
    variance = np.concatenate([np.zeros((0, width)), *(np.diagonal(c, axis1=1, axis2=2) for c in kept)])
    finite = (column[np.isfinite(column)] for column in variance.T)
    found = np.array([np.median(column) if len(column) else np.nan for column in finite])
    wide = np.append(fallback, np.full(width - MIN_PARAMETERS, fallback[-1]))
    return np.diag(np.where(np.isfinite(found), found, wide))


def with_true_detection(paths: TracedPaths, stop: TrueStop, covariance: FloatArray) -> TracedPaths:
    """Exactly the significant paths: others are removed, missed ones added with their true parameters.

    Added paths have the given covariance (parameter, parameter), are not marked as line of sight, stand still, and
    have any class in a hall. Errors that paths share are not told.
    """
    alone = replace(paths, estimate=replace(paths.estimate, correlated=None, pointing=None))
    kept = alone.take(np.isin(paths.true_path, stop.significant))
    missed = np.setdiff1d(stop.significant, kept.true_path)
    if not len(missed):
        return kept
    added = _true_estimate(kept.estimate, stop, missed, covariance)
    both = concatenate([_widened(kept.estimate, len(covariance)), added], "path")
    return TracedPaths(both, np.append(kept.true_path, missed)).sorted_by_delay()


def with_true_geometry(paths: TracedPaths, stop: TrueStop) -> TracedPaths:
    """Every path of a true path gets its delay, azimuths and, where estimated, elevations.

    Of several estimates of one true path only the first gets them: two paths cannot have one place.
    """
    estimate, of = paths.estimate, paths.true_path
    first = np.zeros(len(of), bool)
    first[np.unique(of, return_index=True)[1]] = True
    known = (of >= 0) & first
    true, traced = stop.parameters[of], stop.truth.paths
    exact = replace(
        estimate,
        delay_s=np.where(known, true[:, 0], estimate.delay_s),
        aod_azimuth_rad=np.where(known, true[:, 1], estimate.aod_azimuth_rad),
        aoa_azimuth_rad=np.where(known, true[:, 2], estimate.aoa_azimuth_rad),
        aod_elevation_rad=_exact_elevation(known, estimate.aod_elevation_rad, traced.aod_elevation_rad[of]),
        aoa_elevation_rad=_exact_elevation(known, estimate.aoa_elevation_rad, traced.aoa_elevation_rad[of]),
    )
    return TracedPaths(exact, of).sorted_by_delay()


def with_true_association(paths: TracedPaths, stop: TrueStop, scene: Scene) -> TracedPaths:
    """Only the line of sight, marked as such, and single bounces off the scene's upright objects."""
    kind = np.append(stop.origin.kind, PathKind.NONE)[paths.true_path]
    name = np.append(stop.origin.object, "")[paths.true_path]
    is_los = np.zeros(len(kind), bool)
    is_los[np.flatnonzero(kind == PathKind.LOS)[:1]] = True
    used = is_los | np.isin(name, scene.object_names)
    kept, named = paths.take(used), is_los[used]
    return replace(kept, estimate=replace(kept.estimate, is_los=named, los_probability=named.astype(float)))


def object_labels(ips: IncidencePoints, ip_object: TextArray) -> tuple[IntArray, TextArray]:
    """Cluster (ip,) of every inlier by its true object (ip,), -1 for none, and the objects (cluster,)."""
    counts = ips.is_inlier & (ip_object != "")
    names, number = np.unique(ip_object[counts], return_inverse=True)
    label = np.full(len(ips), -1)
    label[counts] = number
    return label, names


def _true_estimate(
    like: ChannelEstimate, stop: TrueStop, rows: IntArray, covariance: FloatArray
) -> ChannelEstimate:
    """The true paths in `rows` as an estimate of the same kind would have them."""
    n, unknown = len(rows), np.full(len(rows), np.nan)
    has_elevation = len(covariance) > MIN_PARAMETERS
    traced = stop.truth.paths
    return ChannelEstimate(
        stop=like.stop,
        delay_s=stop.parameters[rows, 0],
        aod_azimuth_rad=stop.parameters[rows, 1],
        aoa_azimuth_rad=stop.parameters[rows, 2],
        power_dbm=stop.power_dbm[rows],
        beam_loss_db=np.zeros(n),
        snr_db=unknown,
        covariance=np.tile(covariance, (n, 1, 1)),
        is_los=np.zeros(n, bool),
        aod_elevation_rad=traced.aod_elevation_rad[rows] if has_elevation else unknown,
        aoa_elevation_rad=traced.aoa_elevation_rad[rows] if has_elevation else unknown,
        aod_angle_kind=like.aod_angle_kind,
        aoa_angle_kind=like.aoa_angle_kind,
        method=like.method,
        motion=None if like.motion is None else PathMotion(np.zeros(n, bool), np.zeros(n), unknown, np.zeros(n)),
        hall=None if like.hall is None else _any_class(like.hall, n),
    )


def _any_class(hall: PathsInHall, n: int) -> PathsInHall:
    """Paths of which a hall tells nothing."""
    kinds, versions = hall.size("class"), hall.size("version")
    return PathsInHall(
        class_probability=np.full((n, kinds), 1 / kinds),
        version_probability=np.full((n, versions), 1 / versions),
        tied_probability=np.zeros(n),
        heights_m=hall.heights_m,
    )


def _widened(estimate: ChannelEstimate, n_parameters: int) -> ChannelEstimate:
    """The estimate with covariances of `n_parameters`, the new ones unknown."""
    old = estimate.covariance
    if old.shape[1] == n_parameters:
        return estimate
    new = np.full((len(old), n_parameters, n_parameters), np.nan)
    new[:, : old.shape[1], : old.shape[1]] = old
    return replace(estimate, covariance=new)


def _exact_elevation(known: BoolArray, estimated: FloatArray, true: FloatArray) -> FloatArray:
    return np.where(known & np.isfinite(estimated), true, estimated)
