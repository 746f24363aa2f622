"""What each stage gets and returns, and the checks of what a user's function returned. See docs/stages.md.

Every check returns the result as our own records, or raises `ValueError`: stop, field, value, what is allowed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from estimation.channel.estimate import checked_estimate
from estimation.channel.record import ChannelEstimate
from estimation.shape.fit import OK, PRIOR
from estimation.shape.record import CLASS_NAMES, Contours
from estimation.slam.checks import check_estimates
from estimation.slam.level import KnownHeights
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.tracks.record import N_COMPONENTS, EchoSurvey, Tracks
from isac_arena.user_functions.config import Stage
from scenes.pose import LARGEST_LENGTH_M, Pose
from scenes.record import BoolArray, FloatArray, IntArray, Record
from sim.observation import BeamSweep

MOST_CLOCK_S = 1e-3  # of a bias: larger ones are ns for s
POSITIVE = "must be finite, symmetric and positive definite"
TURN_RAD = 2 * np.pi
R = TypeVar("R", bound=Record)


@dataclass(frozen=True)
class Contract:
    """Names of what a function of a stage is called with, in order, and the check of what it returns."""

    arguments: tuple[str, ...]
    check: Callable[..., Any]


def check_channel(found: object, sweep: BeamSweep) -> ChannelEstimate:
    """The paths of a stop."""
    estimate = _own(found, ChannelEstimate)
    checked_estimate(estimate, sweep, "function")
    check_estimates([estimate], Pose(np.zeros(3), 0.0))  # that of the sweep may be unknown
    return estimate


def check_mapping(
    found: object, channel: Sequence[ChannelEstimate], tx: Pose, receiver: PoseEstimates
) -> IncidencePoints:
    """The incidence points of paths, sorted by stop and path."""
    del tx, receiver
    ips = _own(found, IncidencePoints)
    _check_points(ips, channel)
    return ips


def check_slam(
    found: object, channel: Sequence[ChannelEstimate], tx: Pose, heights: KnownHeights | None
) -> tuple[PoseEstimates, IncidencePoints]:
    """A receiver state per stop, and the incidence points of paths."""
    del tx, heights
    if not isinstance(found, tuple) or len(found) != 2:
        raise ValueError(f"returned {_kind(found)}, a tuple of PoseEstimates and IncidencePoints is needed")
    poses, ips = _own(found[0], PoseEstimates), _own(found[1], IncidencePoints)
    _check_poses(poses, [estimate.stop for estimate in channel])
    _check_points(ips, channel)
    return poses, ips


def check_shapes(
    found: object, channel: Sequence[ChannelEstimate], tx: Pose, poses: PoseEstimates, points: IncidencePoints
) -> Contours:
    """The contours of objects."""
    del channel, tx
    contours = _own(found, Contours)
    for name, axis, wanted in (("object", "ip", len(points)), ("session", "stop", len(poses.stop))):
        if contours.size(axis) != wanted:
            raise ValueError(f"{name} has {contours.size(axis)} rows: one for each of {wanted} is needed ({axis})")
    n, where = len(contours), [f"contour {row}: " for row in range(len(contours))]
    _refuse(where, "status", contours.status, ~np.isin(contours.status, (OK, PRIOR)), f"must be {OK} or {PRIOR}")
    if n and contours.size("sample") < 2:
        raise ValueError(f"contour_m has {contours.size('sample')} samples: 2 at least are needed")
    for name in ("center_m", "contour_m"):
        _refuse(where, name, getattr(contours, name), ~_is_place(getattr(contours, name)), "must be finite, in m")
    for name in ("std_m", "extent_m", "extent_std_m"):
        value = getattr(contours, name)
        _refuse(where, name, value, ~(value >= 0) | np.isinf(value), "must be finite and not negative")
    if tuple(contours.class_name) != CLASS_NAMES:
        raise ValueError(f"class_name = {', '.join(contours.class_name)}: must be {', '.join(CLASS_NAMES)}")
    chance = contours.class_probability
    _refuse(where, "class_probability", chance, (chance < 0) | (chance > 1), "must be within 0 to 1, or NaN")
    owner = contours.object
    rows = [f"point {row}: " for row in range(len(owner))]
    _refuse(rows, "object", owner, (owner < -1) | (owner >= n), f"must be -1, or a contour below {n}")
    return contours


def check_tracker(
    found: object, channel: Sequence[ChannelEstimate], poses: PoseEstimates, survey: EchoSurvey
) -> Tracks:
    """The tracks of what moves, sorted by track and stop."""
    del poses
    tracks = replace(_own(found, Tracks), survey=survey)
    n_tracks, where = (
        tracks.n_tracks,
        [f"track {k}: stop {n}: " for k, n in zip(tracks.track, tracks.stop, strict=True)],
    )
    if not np.array_equal(np.unique(tracks.track), np.arange(n_tracks)):
        raise ValueError("track: tracks must be numbered from 0 on, without gaps")
    _refuse(where, "stop", tracks.stop, ~np.isin(tracks.stop, survey.stop), "there is no such stop")
    _check_order("track, stop: states", where, tracks.track, tracks.stop)
    for name, unit in (("position_m", "m"), ("velocity_m_s", "m/s")):
        value = getattr(tracks, name)
        _refuse(where, name, value, ~_is_place(value), f"must be finite, in {unit}")
    _refuse(where, "height_m", tracks.height_m, np.isinf(tracks.height_m), "must be finite, or NaN")
    if tracks.size("component") != N_COMPONENTS:
        raise ValueError(f"covariance has {tracks.size('component')} components: {N_COMPONENTS} are needed")
    _refuse_covariances(where, "covariance", tracks.covariance, np.ones(len(where), bool))
    chance, extent_m = tracks.existence, tracks.extent_m
    _refuse(where, "existence", chance, ~((chance >= 0) & (chance <= 1)), "must be within 0 to 1")
    _refuse(where, "extent_m", extent_m, ~(extent_m >= 0) | np.isinf(extent_m), "must be finite and not negative")
    echoes = [
        f"stop {stop}: echo of path {path}: "
        for stop, path in zip(tracks.echo_stop, tracks.echo_path, strict=True)
    ]
    _check_paths("echoes", echoes, tracks.echo_stop, tracks.echo_path, channel)
    owner = tracks.echo_track
    _refuse(
        echoes, "echo_track", owner, (owner < -1) | (owner >= n_tracks), f"must be -1, or a track below {n_tracks}"
    )
    return tracks


CONTRACTS: dict[Stage, Contract] = {
    "channel": Contract(("sweep",), check_channel),
    "mapping": Contract(("channel", "tx", "receiver"), check_mapping),
    "slam": Contract(("channel", "tx", "heights"), check_slam),
    "shapes": Contract(("channel", "tx", "poses", "points"), check_shapes),
    "tracker": Contract(("channel", "poses", "survey"), check_tracker),
}


def _own(found: object, kind: type[R]) -> R:
    """The record as one of our own type; a user's class below it is left behind."""
    if not isinstance(found, kind):
        raise ValueError(f"returned {_kind(found)}, {kind.__name__} is needed")
    return kind(**{spec.name: getattr(found, spec.name) for spec in fields(kind)})


def _kind(found: object) -> str:
    return "nothing" if found is None else f"a {type(found).__name__}"


def _check_points(ips: IncidencePoints, channel: Sequence[ChannelEstimate]) -> None:
    where = [f"stop {stop}: point of path {path}: " for stop, path in zip(ips.stop, ips.path, strict=True)]
    _check_paths("points", where, ips.stop, ips.path, channel)
    taken = ips.is_inlier
    _refuse(
        where, "position_m", ips.position_m, ~_is_place(ips.position_m) & taken[:, None], "must be finite, in m"
    )
    bad = ~_is_covariance(ips.covariance_m2) & taken
    _refuse(where, "covariance_m2", ips.covariance_m2, bad, POSITIVE)


def _check_paths(
    what: str, where: Sequence[str], stop: IntArray, path: IntArray, channel: Sequence[ChannelEstimate]
) -> None:
    """Refuse rows of paths that are not there, and rows that are there twice or in another order."""
    n_paths = {estimate.stop: len(estimate) for estimate in channel}
    most = np.array([n_paths.get(one, 0) for one in stop.tolist()], int)
    _refuse(where, "path", path, (path < 0) | (path >= most), "there is no such path")
    _check_order(f"stop, path: {what}", where, stop, path)


def _check_order(what: str, where: Sequence[str], first: IntArray, second: IntArray) -> None:
    """Refuse rows that are not sorted by two columns, and those that are there twice."""
    names = what.partition(":")[0].split(", ")
    if (np.diff(np.lexsort((second, first))) != 1).any():
        raise ValueError(f"{what} must be sorted by {names[0]}, then by {names[1]}")
    twice = np.append(False, (np.diff(first) == 0) & (np.diff(second) == 0))[: len(where)]
    _refuse(where, names[1], second, twice, "is there twice")


def _check_poses(poses: PoseEstimates, stops: Sequence[int]) -> None:
    if poses.stop.tolist() != list(stops):
        raise ValueError(f"poses.stop: must be the {len(stops)} stops of the channel estimates, in their order")
    where = [f"stop {stop}: " for stop in stops]
    _refuse(where, "status", poses.status, ~np.isin(poses.status, list(SolveStatus)), "must be a SolveStatus")
    solved = poses.status != SolveStatus.FAILED
    state = np.column_stack([poses.position_m, poses.heading_rad, poses.clock_bias_s])
    empty = "must be NaN where the status is FAILED"
    _refuse(where, "position_m", poses.position_m, ~solved & np.isfinite(state).any(axis=1), empty)
    outside = solved & ~_is_place(poses.position_m).all(axis=1)
    _refuse(where, "position_m", poses.position_m, outside, "must be finite, in m")
    for name, most, unit in (("heading_rad", TURN_RAD, "rad"), ("clock_bias_s", MOST_CLOCK_S, "s")):
        value = getattr(poses, name)
        allowed = f"must be within -{most:.3g} and {most:.3g} {unit}"
        _refuse(where, name, value, solved & ~(np.abs(value) <= most), allowed)
    _refuse_covariances(where, "covariance", poses.covariance, solved)
    _refuse(where, "n_inliers", poses.n_inliers, poses.n_inliers < 0, "must not be negative")
    for name in ("height_std_m", "position_std_m"):
        _refuse(where, name, getattr(poses, name), getattr(poses, name) < 0, "must not be negative")
    chance = poses.los_probability
    _refuse(where, "los_probability", chance, (chance < 0) | (chance > 1), "must be within 0 to 1, or NaN")


def _is_place(value: FloatArray) -> BoolArray:
    return np.asarray(np.isfinite(value) & (np.abs(value) <= LARGEST_LENGTH_M))


def _is_covariance(value: FloatArray) -> BoolArray:
    """Mask (row,) of the matrices (row, n, n) that are finite, symmetric and positive definite, in any units."""
    variance = np.diagonal(value, axis1=1, axis2=2)
    usable = np.asarray(np.isfinite(value).all(axis=(1, 2)) & (variance > 0).all(axis=1))
    std = np.sqrt(np.where(usable[:, None], variance, 1.0))
    shares = np.where(usable[:, None, None], value / (std[:, :, None] * std[:, None, :]), np.eye(value.shape[-1]))
    symmetric = np.isclose(shares, np.swapaxes(shares, 1, 2), rtol=0.0, atol=1e-6).all(axis=(1, 2))
    return np.asarray(usable & symmetric & (np.linalg.eigvalsh(shares) > 0).all(axis=1))


def _refuse_covariances(where: Sequence[str], name: str, value: FloatArray, judged: BoolArray) -> None:
    """Refuse matrices (row, n, n) of judged rows that are neither a covariance nor NaN as a whole."""
    bad = judged & ~np.isnan(value).all(axis=(1, 2)) & ~_is_covariance(value)
    _refuse(where, name, value, bad, f"{POSITIVE}, or NaN")


def _refuse(where: Sequence[str], name: str, value: Any, bad: BoolArray, allowed: str) -> None:
    """Raise where a row has a value that is not allowed: the first such value is named."""
    bad = np.asarray(bad)
    rows = bad.reshape(len(where), -1).any(axis=1) if len(where) else np.zeros(0, bool)
    if rows.any():
        row = int(np.argmax(rows))
        inner, here = np.asarray(value)[row], bad[row]
        shown = inner if np.shape(here) != np.shape(inner) else np.asarray(inner)[here].flat[0]
        text = " ".join(str(shown).split())
        raise ValueError(f"{where[row]}{name} = {text[:120]}: {allowed}")
