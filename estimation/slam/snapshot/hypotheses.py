"""RX states from minimal sets of paths, and the distinct ones among many; compiled.

States are [x, y, heading, bias] in m, m, rad, m, with x and y relative to the TX, angles in the world frame.
"""

import math

import numpy as np

from estimation.execution import compiled
from estimation.slam.snapshot.path_table import PathTable
from scenes.record import FloatArray, IntArray

# Two states this close in position and heading are one mode.
_MODE_DISTANCE_M = 0.3
_MODE_HEADING_RAD = math.radians(5.0)
# Where noise keeps the determinant above zero by at most this factor, the heading of its extremum is used.
_MAX_EXCESS = 1.3


@compiled
def four_bounce_states(paths: PathTable, candidates: IntArray) -> FloatArray:
    """States (hypothesis, 4) at which four of the candidates are consistent single bounces, at most two per set.

    Four equations have a solution [x, y, bias, 1] where the determinant of [row, -right side] vanishes. In the
    heading alpha it is exactly A + C cos alpha + S sin alpha; A, C, S follow from three samples.
    """
    n = len(candidates)
    minors = _pair_minors(paths, candidates)
    states = np.empty((n * (n - 1) * (n - 2) * (n - 3) // 12, 4))
    found = 0
    for a in range(n):
        for b in range(a + 1, n):
            for c in range(b + 1, n):
                for d in range(c + 1, n):
                    d0 = _determinant(minors[0], a, b, c, d)
                    d1 = _determinant(minors[1], a, b, c, d)
                    d2 = _determinant(minors[2], a, b, c, d)
                    mean, cosine, sine = ((d0 + d1 + d2) / 3, (2 * d0 - d1 - d2) / 3, (d1 - d2) / math.sqrt(3.0))
                    amplitude = math.hypot(cosine, sine)
                    if amplitude < 1e-12 or abs(mean) > _MAX_EXCESS * amplitude:
                        continue
                    half = math.acos(min(max(-mean / amplitude, -1.0), 1.0))
                    centre = math.atan2(sine, cosine)
                    for sign in (1.0, -1.0):
                        states[found, 2] = centre + sign * half
                        four = (candidates[a], candidates[b], candidates[c], candidates[d])
                        found += _placed(paths, four, states[found])
                        if abs(mean) >= amplitude:
                            break
    return states[:found]


@compiled
def line_of_sight_states(paths: PathTable, los: int, angles_rad: FloatArray, others: IntArray) -> FloatArray:
    """States (hypothesis, 4) from the line of sight with these two angles and one single bounce each."""
    departure, heading = angles_rad[0], angles_rad[0] + math.pi - angles_rad[1]
    sine, cosine = math.sin(0.5 * heading), math.cos(0.5 * heading)
    states, row = np.empty((len(others), 4)), np.empty(4)
    found = 0
    for other in others:
        _row(paths, other, sine, cosine, row)
        along = row[0] * math.cos(departure) + row[1] * math.sin(departure) - row[2]
        distance = -(row[3] + row[2] * paths.range_m[los]) / along if abs(along) > 1e-9 else -1.0
        if distance > 0.0:
            states[found, 0] = distance * math.cos(departure)
            states[found, 1] = distance * math.sin(departure)
            states[found, 2], states[found, 3] = heading, paths.range_m[los] - distance
            found += 1
    return states[:found]


@compiled
def distinct_states(states: FloatArray, score: FloatArray, n: int, max_deficit: float) -> IntArray:
    """Indices of up to n distinct states of the highest finite scores, at most `max_deficit` below the best."""
    remaining = np.where(np.isfinite(score), score, -np.inf)
    if len(remaining):
        remaining[remaining < remaining.max() - max_deficit] = -np.inf
    chosen = np.empty(n, np.int64)
    found = 0
    while found < n:
        best = -1
        for k in range(len(remaining)):
            if remaining[k] > -np.inf and (best < 0 or remaining[k] > remaining[best]):
                best = k
        if best < 0:
            break
        chosen[found] = best
        found += 1
        for k in range(len(remaining)):
            dx, dy = states[k, 0] - states[best, 0], states[k, 1] - states[best, 1]
            if dx * dx + dy * dy < _MODE_DISTANCE_M**2:
                turn = (states[k, 2] - states[best, 2] + math.pi) % (2 * math.pi) - math.pi
                if abs(turn) < _MODE_HEADING_RAD:
                    remaining[k] = -np.inf
        remaining[best] = -np.inf
    return chosen[:found]


@compiled
def _row(paths: PathTable, j: int, sine: float, cosine: float, row: FloatArray) -> None:
    """Equation row' [x, y, bias, 1] = 0 of path j as a single bounce, from sine and cosine of half the heading."""
    row[0] = -paths.mean[j, 0] * cosine - paths.mean[j, 1] * sine
    row[1] = paths.mean[j, 1] * cosine - paths.mean[j, 0] * sine
    row[2] = -paths.half[j, 0] * cosine - paths.half[j, 1] * sine
    row[3] = -row[2] * paths.range_m[j]


@compiled
def _pair_minors(paths: PathTable, candidates: IntArray) -> FloatArray:
    """Minors (3, n, n, 2) of every two rows at 0, 120 and 240 deg, of the first two and the last two columns."""
    n = len(candidates)
    rows, minors = np.empty((n, 4)), np.empty((3, n, n, 2))
    for h in range(3):
        for i in range(n):
            _row(paths, candidates[i], math.sin(math.pi / 3 * h), math.cos(math.pi / 3 * h), rows[i])
        for i in range(n):
            for j in range(i + 1, n):
                minors[h, i, j, 0] = rows[i, 0] * rows[j, 1] - rows[j, 0] * rows[i, 1]
                minors[h, i, j, 1] = rows[i, 2] * rows[j, 3] - rows[j, 2] * rows[i, 3]
    return minors


@compiled
def _determinant(minors: FloatArray, a: int, b: int, c: int, d: int) -> float:
    """Determinant of four rows by the minors (row, row, 2) of their two halves (Laplace expansion)."""
    return float(
        minors[a, b, 0] * minors[c, d, 1]
        - minors[a, c, 0] * minors[b, d, 1]
        + minors[a, d, 0] * minors[b, c, 1]
        + minors[b, c, 0] * minors[a, d, 1]
        - minors[b, d, 0] * minors[a, c, 1]
        + minors[c, d, 0] * minors[a, b, 1]
    )


@compiled
def _placed(paths: PathTable, four: tuple[int, int, int, int], state: FloatArray) -> int:
    """Least-squares x, y and bias of four bounces at the state's heading, in place.

    Returns 1, or 0 where they are singular or a bounce is infeasible.
    """
    sine, cosine = math.sin(0.5 * state[2]), math.cos(0.5 * state[2])
    row = np.empty((4, 4))
    a = b = c = d = e = f = p = q = r = 0.0
    for i in range(4):
        _row(paths, four[i], sine, cosine, row[i])
        x, y, z, one = row[i]
        a, b, c, d, e, f = a + x * x, b + x * y, c + x * z, d + y * y, e + y * z, f + z * z
        p, q, r = p - x * one, q - y * one, r - z * one
    cof_a, cof_b, cof_c = d * f - e * e, c * e - b * f, b * e - c * d
    cof_d, cof_e, cof_f = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * cof_a + b * cof_b + c * cof_c
    if not abs(determinant) > 1e-12 * a * d * f:
        return 0
    state[0] = (cof_a * p + cof_b * q + cof_c * r) / determinant
    state[1] = (cof_b * p + cof_d * q + cof_e * r) / determinant
    state[3] = (cof_c * p + cof_e * q + cof_f * r) / determinant
    for i in range(4):
        # The IP must be between the devices' rays, up to the errors of the angles.
        j = four[i]
        length = paths.range_m[j] - state[3]
        cos_delta = paths.half[j, 1] * cosine - paths.half[j, 0] * sine
        reach = length * (abs(cos_delta) + paths.slack_rad[j] * abs(row[i, 2]))
        if not (length > 0.0 and abs(state[0] * row[i, 1] - state[1] * row[i, 0]) <= reach):
            return 0
    return 1
