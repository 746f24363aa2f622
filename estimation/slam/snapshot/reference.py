"""Robust snapshot SLAM as published (Kaltiokallio et al., arXiv 2404.10291).

Exhaustive minimal sets, a linear solution per heading, a distance gate, and power weights.
"""

import numpy as np

from estimation.laws.plane import BounceEquation, bounce_equation, bounce_fraction, ray_directions
from estimation.slam.config import SnapshotConfig
from estimation.slam.snapshot.problem import Fit, SnapshotProblem, packed_normal, path_subsets, solve_packed
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

# Published gate on |u + v|^2 of the earliest path: below it the rays are nearly opposite and do not fix its IP.
PARALLEL_GATE = 0.1


def solve_reference(problem: SnapshotProblem, config: SnapshotConfig, with_los: bool) -> Fit | None:
    """Best hypothesis over all minimal sets, with or without a line of sight; None where none is feasible.

    Sets are the pairs {LOS, j}, or all quadruples times a grid of headings. Each is solved, gated at
    `gate_m2`, solved again on its inliers, and judged by sum g min(nu^2, gate), g the linear path power.
    """
    search = _Search(problem, config, with_los)
    if not len(search.sets):
        return None
    h, z, members = search.minimal_solutions()
    keep = search.is_feasible(h, z, members)
    h, z = h[keep], z[keep]
    inlier = search.distance2(h, z) <= config.gate_m2
    keep = np.count_nonzero(inlier, axis=1) >= search.sets.shape[1]
    h, inlier = h[keep], inlier[keep]
    z = solve_packed(np.einsum("nm,nmi->ni", inlier.astype(float), search.packed[h]))
    keep = search.is_feasible(h, z, inlier)
    h, z, inlier = h[keep], z[keep], inlier[keep]
    if not len(h):
        return None
    cost = np.minimum(search.distance2(h, z), config.gate_m2) @ search.weight
    best = int(np.argmin(cost))
    is_los = np.zeros(len(problem), bool)
    is_los[problem.earliest] = with_los
    return Fit(
        state=np.array([z[best, 0], z[best, 1], search.heading[h[best]], z[best, 2]]),
        is_inlier=inlier[best] | is_los,
        is_los=is_los,
        cost=float(cost[best]),
        covariance=np.full((4, 4), np.nan),
    )


class _Search:
    """The linear systems of all paths at all headings of the search; h indexes headings."""

    def __init__(self, problem: SnapshotProblem, config: SnapshotConfig, with_los: bool) -> None:
        self.problem, self.config, self.with_los = problem, config, with_los
        self.first = problem.earliest
        self.weight = 10 ** (problem.power_dbm / 10)
        candidates = problem.strongest
        if with_los:
            others = candidates[candidates != self.first]
            self.sets: IntArray = np.stack([np.full_like(others, self.first), others], axis=1)
            self.heading = np.array([los_heading(problem)])
        else:
            self.sets = path_subsets(candidates, 4)
            self.heading = np.linspace(-np.pi, np.pi, config.n_headings)
        self.equation = bounce_equation(problem.tx, self.heading[:, None], problem.measured)
        self.packed = packed_normal(self.equation.row, self.equation.right_side) * self.weight[:, None]
        self.los_row, self.los_right_side = los_equations(problem, float(self.heading[0]))
        if with_los:
            both = packed_normal(self.los_row, self.los_right_side).sum(axis=0)
            self.packed[:, self.first] = both * self.weight[self.first]

    def minimal_solutions(self) -> tuple[IntArray, FloatArray, BoolArray]:
        """Heading index (n,), z (n, 3) and set membership (n, path) of every minimal set at every heading."""
        member = np.zeros((len(self.sets), len(self.problem)), bool)
        np.put_along_axis(member, self.sets, True, axis=1)
        z = solve_packed(member.astype(float) @ self.packed)
        h = np.repeat(np.arange(len(self.heading)), len(self.sets))
        return h, z.reshape(-1, 3), np.tile(member, (len(self.heading), 1))

    def is_feasible(self, h: IntArray, z: FloatArray, member: BoolArray) -> BoolArray:
        """Whether all lengths are positive and the members' IPs are between the devices' rays."""
        range_m = self.problem.measured[:, 0]
        result = np.asarray(np.min(range_m) >= z[:, 2])  # False for NaN
        row, path = np.nonzero(member & result[:, None])
        at = h[row], path
        equation = BounceEquation(self.equation.row[at], self.equation.right_side[at], self.equation.along[at])
        share = bounce_fraction(self.problem.tx, equation, z[row], range_m[path])
        outside = ~((share >= 0) & (share <= 1))
        outside &= (path != self.first) | (4 * equation.along**2 >= PARALLEL_GATE)
        result[row[outside]] = False
        return result

    def distance2(self, h: IntArray, z: FloatArray) -> FloatArray:
        """Squared residuals nu^2 (n, path) in m^2 of each path's equations."""
        nu2 = (np.einsum("nmi,ni->nm", self.equation.row[h], z) - self.equation.right_side[h]) ** 2
        if self.with_los:
            nu2[:, self.first] = np.sum((z @ self.los_row.T - self.los_right_side) ** 2, axis=1)
        return np.asarray(nu2)


def los_heading(problem: SnapshotProblem) -> float:
    """RX heading in rad that makes the earliest path's two directions opposite."""
    _, aod, aoa = problem.measured[problem.earliest]
    return float(wrap_angle(problem.tx.heading_rad + aod + np.pi - aoa))


def los_equations(problem: SnapshotProblem, heading_rad: float) -> tuple[FloatArray, FloatArray]:
    """Rows (2, 3) and right sides (2,) in m of the earliest path as line of sight, at a given heading."""
    path = problem.measured[problem.earliest]
    _, v = ray_directions(problem.tx, heading_rad, path)
    row = np.column_stack([np.eye(2), -v])
    return row, problem.tx.position_m[:2] - path[0] * v
