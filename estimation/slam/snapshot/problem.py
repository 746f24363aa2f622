"""The snapshot problem of one stop, and the linear algebra of its hypotheses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.plane import measurement_vectors
from estimation.slam.config import PathNoise, SnapshotConfig
from estimation.slam.transmitters import AnyTx, Transmitters, transmitters_of
from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray, IntArray

MAX_HYPOTHESIS_PATHS = 12
_TIED_STDS = 3.0
MIN_LOS_INLIERS, MIN_NLOS_INLIERS = 3, 4  # with and without line of sight


def tied_with_first(range_m: FloatArray, variance_m2: FloatArray) -> BoolArray:
    """Which paths (path,) are as early as the first one within their errors: candidates for the line of sight.

    Noise may put a reflection by the floor, or off an object close to the line of sight, before it.
    """
    first = int(np.argmin(range_m))
    spread = np.sqrt(variance_m2 + variance_m2[first])
    return np.asarray(range_m - range_m[first] <= _TIED_STDS * spread)


def direct_path(range_m: FloatArray, variance_m2: FloatArray, power_dbm: FloatArray) -> int:
    """Index of the candidate for the line of sight: the strongest path that may be the earliest."""
    return int(np.argmax(np.where(tied_with_first(range_m, variance_m2), power_dbm, -np.inf)))


def strongest_paths(power_dbm: FloatArray) -> IntArray:
    """Indices of the strongest paths, which hypotheses are made from, in path order; ties go to the first."""
    order = np.argsort(-power_dbm, kind="stable")
    return np.sort(order[:MAX_HYPOTHESIS_PATHS])


@dataclass(frozen=True)
class SnapshotProblem:
    """Paths of one stop in the units of `estimation.laws.plane` (range in m instead of delay in s).

    With several TX, `tx` is the first, `link` (path,) the TX of every path; `of_tx` is the problem of one.
    """

    tx: Pose
    measured: FloatArray  # (path, 3) in m, rad, rad
    covariance: FloatArray  # (path, 3, 3) in (m, rad, rad)^2
    power_dbm: FloatArray  # (path,) as with the power and the array of the first TX
    link: IntArray  # (path,)
    every_tx: Transmitters

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def departure_rad(self) -> FloatArray:
        """Azimuth of departure (path,) in the world frame."""
        return np.asarray(self.measured[:, 1] + self.tx.heading_rad)

    @property
    def earliest(self) -> int:
        """Index of the path that arrives first: the candidate for the line of sight."""
        return int(np.argmin(self.measured[:, 0]))

    def take(self, index: IntArray | BoolArray) -> SnapshotProblem:
        """The same problem with some of its paths."""
        kept = self.measured[index], self.covariance[index], self.power_dbm[index], self.link[index]
        return SnapshotProblem(self.tx, *kept, self.every_tx)

    def of_tx(self, tx: int) -> SnapshotProblem:
        """The paths of one TX as a problem of that TX alone."""
        own = self.take(self.link == tx)
        pose = self.every_tx.poses[tx]
        return replace(own, tx=pose, link=np.zeros(len(own), np.int64), every_tx=transmitters_of(pose))

    @property
    def strongest(self) -> IntArray:
        """Indices of the paths of hypotheses, as `strongest_paths`."""
        return strongest_paths(self.power_dbm)


@dataclass(frozen=True)
class Fit:
    """A solution for the RX state [x, y, heading, bias] in m, m, rad, m, with one bias for each of several TX.

    `cost` is minus the log evidence for the statistical method. `covariance` is NaN where the method gives none.
    """

    state: FloatArray  # (state,)
    is_inlier: BoolArray  # (path,), the line of sight included
    is_los: BoolArray  # (path,)
    cost: float
    covariance: FloatArray  # (state, state)


def reject_uncertain(fits: list[Fit], config: SnapshotConfig) -> list[Fit]:
    """The ranked modes; none where the position of the best one is less certain than `max_position_std_m`."""
    free = bool(fits) and np.trace(fits[0].covariance[:2, :2]) > config.max_position_std_m**2
    return [] if free else fits


def snapshot_problem(estimate: ChannelEstimate, tx: AnyTx, noise: PathNoise) -> SnapshotProblem:
    """Collect the paths of one stop and their covariances."""
    every = transmitters_of(tx)
    measured = measurement_vectors(estimate.delay_s, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad)
    boresight_dbm = estimate.power_dbm + estimate.beam_loss_db
    link = estimate.tx if len(every) > 1 else np.zeros(len(estimate), np.int64)
    level_dbm = boresight_dbm - every.level_db[link] if len(every) > 1 else boresight_dbm
    return SnapshotProblem(every.poses[0], measured, noise.covariance(estimate), level_dbm, link, every)


def path_subsets(items: IntArray, size: int) -> IntArray:
    """All subsets (subset, size) of some path indices, in lexicographic order."""
    chosen = list(combinations(items.tolist(), size))
    return np.array(chosen, dtype=np.int64).reshape(-1, size)


def packed_normal(row: FloatArray, right_side: FloatArray) -> FloatArray:
    """Terms (..., 9) of the normal equations of row' z = right_side: 6 of the symmetric matrix, 3 of the right.

    They add up over equations; `solve_packed` solves the sum.
    """
    i, j = np.triu_indices(3)
    return np.concatenate([row[..., i] * row[..., j], row * right_side[..., None]], axis=-1)


def solve_packed(packed: FloatArray) -> FloatArray:
    """Solution z (..., 3) of packed normal equations (..., 9) by Cramer's rule; NaN where singular."""
    a, b, c, d, e, f, p, q, r = np.moveaxis(packed, -1, 0)
    cof_a, cof_b, cof_c = d * f - e * e, c * e - b * f, b * e - c * d
    cof_d, cof_e, cof_f = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * cof_a + b * cof_b + c * cof_c
    scale = np.abs(a * d * f)
    singular = np.abs(det) <= 1e-12 * scale
    z = np.stack(
        [cof_a * p + cof_b * q + cof_c * r, cof_b * p + cof_d * q + cof_e * r, cof_c * p + cof_e * q + cof_f * r],
        axis=-1,
    )
    return np.where(singular[..., None], np.nan, z / np.where(singular, 1.0, det)[..., None])
