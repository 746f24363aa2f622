"""Several TX that the receiver hears at every stop: their poses, and the parts of the records that belong to each.

A stop has one pose and one clock bias per TX. Its channel estimate holds the paths of all TX, one TX after the
other; every path carries the index of its TX. A single TX is given as its `Pose` everywhere.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.record import IncidencePoints, PoseEstimates
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray, IntArray, concatenate


@dataclass(frozen=True)
class Transmitters:
    """The TX of a campaign and what the receiver knows about them.

    Attributes
    ----------
    poses : position and heading of every TX
    level_db : (tx,) nominal power of a line of sight over that of the first TX at the same distance
    sync_std_s : standard deviation of the clock of a TX about the common time; None where every clock is free
    hears_itself : (tx,) whether TX and receiver are one device with one clock: its bias is known; by default none
    """

    poses: tuple[Pose, ...]
    level_db: FloatArray
    sync_std_s: float | None = None
    hears_itself: BoolArray | None = None

    def __len__(self) -> int:
        return len(self.poses)

    def alone(self, tx: int) -> "Transmitters":
        """One of the TX."""
        own = None if self.hears_itself is None else self.hears_itself[tx : tx + 1]
        return Transmitters((self.poses[tx],), np.zeros(1), self.sync_std_s, own)

    @property
    def rows(self) -> FloatArray:
        """[x, y, heading] (tx, 3) as the laws of the plane take it."""
        from estimation.laws.plane import tx_row  # noqa: PLC0415  (brings numba)

        return np.array([tx_row(pose) for pose in self.poses])

    @property
    def clock_information(self) -> FloatArray:
        """Information (tx, tx) in m^-2 on the differences of the clock biases of one stop, as lengths.

        The receiver clock is common and unknown: with TX errors of variance s^2 it is (I - 1 1' / n) / s^2.
        """
        n = len(self)
        if self.sync_std_s is None or n == 1:
            return np.zeros((n, n))
        return np.asarray((np.eye(n) - 1 / n) / (SPEED_OF_LIGHT_M_S * self.sync_std_s) ** 2)


AnyTx = Pose | Transmitters


def transmitters_of(tx: AnyTx) -> Transmitters:
    """All TX: a `Pose` is one TX alone."""
    return tx if isinstance(tx, Transmitters) else Transmitters((tx,), np.zeros(1))


def seen_from_nodes(estimates: Sequence[ChannelEstimate], is_uplink: BoolArray) -> Sequence[ChannelEstimate]:
    """The estimates with departures at fixed nodes and arrivals at what walks, whichever of them sends.

    `is_uplink` (tx,) tells which of the links end at their node.
    """
    if not is_uplink.any():
        return estimates
    return [_turned(estimate, is_uplink[estimate.tx]) for estimate in estimates]


def _turned(estimate: ChannelEstimate, turns: BoolArray) -> ChannelEstimate:
    """The estimate with departures and arrivals of some paths (path,) exchanged.

    Raises `ValueError` where only some are, and the two ends observe different angles.
    """
    kinds = estimate.aod_angle_kind, estimate.aoa_angle_kind
    if turns.any() and not turns.all() and kinds[0] != kinds[1]:
        raise ValueError(f"stop {estimate.stop}: with links both ways both ends must observe the same angles")
    size = estimate.covariance.shape[1]
    order = np.array([0, 2, 1, 4, 3])[:size]
    other = estimate.covariance[:, order][:, :, order]
    pairs = (("aod_azimuth_rad", "aoa_azimuth_rad"), ("aod_elevation_rad", "aoa_elevation_rad"))
    changes: dict[str, Any] = {"covariance": np.where(turns[:, None, None], other, estimate.covariance)}
    for ends in (*pairs, *(pair[::-1] for pair in pairs)):
        own, far = (getattr(estimate, name) for name in ends)
        changes[ends[0]] = np.where(turns, far, own)
    if turns.all():
        changes |= {"aod_angle_kind": kinds[1], "aoa_angle_kind": kinds[0]}
    return replace(estimate, **changes)


def joined_paths(parts: Sequence[ChannelEstimate] | Mapping[int, ChannelEstimate]) -> ChannelEstimate:
    """The paths of one stop from all TX, in the order of the TX; those of the first TX alone are unchanged.

    `parts` are those of every TX, or of some TX by their index.

    Raises `ValueError` where some azimuths are cone angles and others are not, or only some have elevations.
    """
    numbers = list(parts) if isinstance(parts, Mapping) else range(len(parts))
    parts = list(parts.values()) if isinstance(parts, Mapping) else parts
    if list(numbers) == [0]:
        return parts[0]
    kinds = {(one.aod_angle_kind, one.aoa_angle_kind, one.covariance.shape[1]) for one in parts if len(one)}
    if len(kinds) > 1:
        raise ValueError(
            f"stop {parts[0].stop}: beams of all TX must observe the same angles (azimuth or cone, with or without"
            " elevation)"
        )
    first = next((one for one in parts if len(one)), parts[0])
    size = first.covariance.shape[1]
    marked = [
        replace(
            one,
            tx=np.full(len(one), index),
            correlated=None,
            pointing=None,
            hall=None,
            covariance=one.covariance[:, :size, :size] if len(one) else np.zeros((0, size, size)),
        )
        for index, one in zip(numbers, parts, strict=True)
    ]
    joined = concatenate(marked, "path")
    reasons = dict.fromkeys(one.reason for one in parts if one.reason)
    return replace(
        joined,
        aod_angle_kind=first.aod_angle_kind,
        aoa_angle_kind=first.aoa_angle_kind,
        status=max((one.status for one in parts), key=[one.status for one in parts].count),
        reason="; ".join(reasons),
    )


def rows_of_tx(estimates: Sequence[ChannelEstimate], tx: int) -> list[IntArray]:
    """Indices (path,) of the paths of one TX in every estimate."""
    return [np.flatnonzero(estimate.tx == tx) for estimate in estimates]


def of_tx(estimates: Sequence[ChannelEstimate], tx: int) -> list[ChannelEstimate]:
    """The paths of one TX at every stop."""
    return [e.take("path", rows) for e, rows in zip(estimates, rows_of_tx(estimates, tx), strict=True)]


def replaced_paths(
    estimates: Sequence[ChannelEstimate], parts: Sequence[Sequence[ChannelEstimate]]
) -> list[ChannelEstimate]:
    """The estimates with delays, azimuths and covariances from `parts` (tx, stop), as paths of the plane."""
    found = []
    for stop, estimate in enumerate(estimates):
        own = [part[stop] for part in parts]
        size = min(one.covariance.shape[1] for one in own)
        found.append(
            replace(
                estimate,
                delay_s=np.concatenate([one.delay_s for one in own]),
                aod_azimuth_rad=np.concatenate([one.aod_azimuth_rad for one in own]),
                aoa_azimuth_rad=np.concatenate([one.aoa_azimuth_rad for one in own]),
                covariance=np.concatenate([one.covariance[:, :size, :size] for one in own]),
                aod_angle_kind=min(one.aod_angle_kind for one in own),  # azimuth before cone
                aoa_angle_kind=min(one.aoa_angle_kind for one in own),
            )
        )
    return found


MapOne = Callable[..., IncidencePoints]


def map_each_tx(
    map_one: MapOne,
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx: AnyTx,
    config: Any,
    *,
    is_los: Sequence[BoolArray] | None = None,
    is_inlier: Sequence[BoolArray] | None = None,
    state_covariance: Sequence[FloatArray] | None = None,
) -> IncidencePoints:
    """Incidence points of all TX, in order of stop and path, by `map_one`: `map_stops`, or that in space.

    `state_covariance` is (state, state) per stop with the clock biases of all TX.
    """
    if not isinstance(tx, Transmitters):
        return map_one(
            estimates, poses, tx, config, is_los=is_los, is_inlier=is_inlier, state_covariance=state_covariance
        )
    parts = []
    for index, pose in enumerate(tx.poses):
        rows = rows_of_tx(estimates, index)
        state = np.ix_(*2 * [[0, 1, 2, 3 + index]])
        points = map_one(
            of_tx(estimates, index),
            poses.of_tx(index),
            pose,
            config,
            is_los=_at_rows(is_los, rows),
            is_inlier=_at_rows(is_inlier, rows),
            state_covariance=None if state_covariance is None else [one[state] for one in state_covariance],
        )
        at = np.searchsorted(poses.stop, points.stop)
        path = np.array([rows[k][p] for k, p in zip(at, points.path, strict=True)], int)
        parts.append(replace(points, path=path, tx=np.full(len(points), index)))
    every = concatenate(parts, "ip")
    return every.take("ip", np.lexsort([every.path, np.searchsorted(poses.stop, every.stop)]))


def _at_rows(flags: Sequence[BoolArray] | None, rows: Sequence[IntArray]) -> list[BoolArray] | None:
    return None if flags is None else [flag[row] for flag, row in zip(flags, rows, strict=True)]
