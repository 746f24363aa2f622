"""Receiver states in space from few paths: the line of sight and one bounce, or four bounces.

The horizontal equation of a single bounce does not contain the height. With departure a, arrival b in the world
and elevations e, f it is, relative to the TX,

    -(cos e sin a + cos f sin b) x + (cos e cos a + cos f cos b) y + cos e cos f sin(b - a) (range - bias) = 0.

Four paths agree where the determinant of their rows in [x, y, bias, 1] vanishes. It is a trigonometric
polynomial of degree four in the heading; for horizontal paths it is the closed form of the plane. The height
follows from the point where each ray meets the IP.
"""

import numpy as np

from estimation.laws.space import bounce_equations
from estimation.slam.snapshot.problem import path_subsets
from estimation.slam.space.problem import SpatialProblem
from scenes.pose import direction, wrap_angle
from scenes.record import ComplexArray, FloatArray, IntArray

_DEGREE = 4
_N_SEARCH = 120
# Share of the root mean square of a determinant: noise may keep it from zero where two roots meet.
_NEAR_ROOT = 0.15


def los_states(problem: SpatialProblem, strongest: IntArray) -> FloatArray:
    """States (path, 5) from the line of sight and each other path, a single bounce that fulfils its equations."""
    first = problem.direct
    others = strongest[strongest != first]
    direct, tx = problem.measured[first], problem.tx
    heading = wrap_angle(tx.heading_rad + direct[1] + np.pi - direct[2])
    ray = direction(tx.heading_rad + direct[1], direct[3])
    # p = p_TX + (range_0 - bias) ray: the equations are linear in the bias alone.
    places = [(tx.position_m + (direct[0] - bias) * ray, bias) for bias in (0.0, 1.0)]
    at = [
        bounce_equations(tx, np.array([*place, heading, bias]), problem.measured[others]) for place, bias in places
    ]
    slope = at[1].value_m - at[0].value_m
    bias = -np.sum(slope * at[0].value_m, axis=-1) / np.maximum(np.sum(slope**2, axis=-1), 1e-12)
    position = tx.position_m + (direct[0] - bias)[:, None] * ray
    return _credible(problem, np.column_stack([position, np.full(len(others), heading), bias]))


def bounce_states(problem: SpatialProblem, strongest: IntArray) -> FloatArray:
    """States (hypothesis, 5) from every four paths, one for each heading at which they agree."""
    sets = path_subsets(strongest, 4)
    index, heading = four_path_headings(problem, sets)
    chosen = sets[index]
    rows = _rows(problem, chosen, heading[:, None])
    rows = rows / np.maximum(np.linalg.norm(rows[..., :3], axis=-1, keepdims=True), 1e-9)
    left, right = rows[..., :3], -rows[..., 3]
    normal = np.swapaxes(left, 1, 2) @ left + 1e-12 * np.eye(3)
    solved = np.linalg.solve(normal, np.einsum("hpi,hp->hi", left, right)[..., None])[..., 0]
    height = _height(problem, chosen, solved, heading)
    return _credible(
        problem, np.column_stack([problem.tx.position_m[:2] + solved[:, :2], height, heading, solved[:, 2]])
    )


def four_path_headings(problem: SpatialProblem, sets: IntArray) -> tuple[IntArray, FloatArray]:
    """Set (root,) and heading (root,) of all roots of the determinants of sets (set, 4) of paths."""
    order = np.arange(-_DEGREE, _DEGREE + 1)
    samples = 2 * np.pi * np.arange(2 * _DEGREE + 1) / (2 * _DEGREE + 1)
    value = np.stack([np.linalg.det(_rows(problem, sets, alpha)) for alpha in samples], axis=-1)
    coefficient = value @ np.exp(-1j * np.outer(samples, order)) / len(samples)
    heading = 2 * np.pi * np.arange(_N_SEARCH) / _N_SEARCH
    wave = np.exp(1j * np.outer(order, heading))
    grid = (coefficient @ wave).real
    ahead, behind = np.roll(grid, -1, axis=1), np.roll(grid, 1, axis=1)
    crossing = grid * ahead <= 0
    level = np.sqrt(np.mean(grid**2, axis=1, keepdims=True))
    size = np.abs(grid)
    touching = (size <= np.abs(ahead)) & (size <= np.abs(behind)) & (size <= _NEAR_ROOT * level)
    touching &= ~crossing & ~np.roll(crossing, 1, axis=1)
    index, at = np.nonzero(crossing)
    here, there = grid[index, at], ahead[index, at]
    share = here / np.where(here == there, 1.0, here - there)
    root = _polished(coefficient[index], heading[at] + share * 2 * np.pi / _N_SEARCH)
    touched, at = np.nonzero(touching)
    low, high = _pair(coefficient[touched], heading[at])
    ends = [np.where(low == high, end, _polished(coefficient[touched], end)) for end in (low, high)]
    return np.concatenate([index, touched, touched]), np.asarray(wrap_angle(np.concatenate([root, *ends])))


def _series(coefficient: ComplexArray, heading_rad: FloatArray, derivative: int = 0) -> FloatArray:
    """Trigonometric polynomials (root, 9) or their derivatives, each at its own heading (root,)."""
    order = 1j * np.arange(-_DEGREE, _DEGREE + 1)
    return np.asarray(np.sum(coefficient * order**derivative * np.exp(heading_rad[:, None] * order), axis=1).real)


def _polished(coefficient: ComplexArray, root: FloatArray) -> FloatArray:
    """Roots after three Newton steps of at most 0.05 rad."""
    for _ in range(3):
        slope = _series(coefficient, root, 1)
        step = _series(coefficient, root) / np.where(slope == 0, np.inf, slope)
        root = root - np.clip(step, -0.05, 0.05)
    return root


def _pair(coefficient: ComplexArray, near: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The two roots next to an extremum close to zero; twice the extremum where there are none."""
    for _ in range(3):
        bend = _series(coefficient, near, 2)
        step = _series(coefficient, near, 1) / np.where(bend == 0, np.inf, bend)
        near = near - np.clip(step, -0.05, 0.05)
    bend = _series(coefficient, near, 2)
    square = -2 * _series(coefficient, near) / np.where(bend == 0, np.inf, bend)
    apart = np.sqrt(np.maximum(square, 0.0))
    return near - apart, near + apart


def _rows(problem: SpatialProblem, sets: IntArray, heading_rad: FloatArray | float) -> FloatArray:
    """Horizontal equations (set, 4 paths, 4) in [x, y, bias, 1] of sets of paths at a heading."""
    range_m, departure, arrival, e, f = np.moveaxis(problem.measured[sets], -1, 0)
    a, b = problem.tx.heading_rad + departure, heading_rad + arrival
    ce, cf = np.cos(e), np.cos(f)
    across = ce * cf * np.sin(b - a)
    parts = (-ce * np.sin(a) - cf * np.sin(b), ce * np.cos(a) + cf * np.cos(b), -across, across * range_m)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def _height(problem: SpatialProblem, chosen: IntArray, solved: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """Median height (hypothesis,) over the paths of a set: from the TX to the IP, and from there to the RX."""
    range_m, departure, arrival, e, f = np.moveaxis(problem.measured[chosen], -1, 0)
    a, b = problem.tx.heading_rad + departure, heading_rad[:, None] + arrival
    length = range_m - solved[:, 2, None]
    v = np.stack([np.cos(f) * np.cos(b), np.cos(f) * np.sin(b)], axis=-1)
    eta = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a)], axis=-1) + v
    loop = solved[:, None, :2] + length[..., None] * v
    reach = np.sum(eta * loop, axis=-1) / np.maximum(np.sum(eta**2, axis=-1), 1e-9)
    rise = reach * np.sin(e) - (length - reach) * np.sin(f)
    return np.asarray(problem.tx.position_m[2] + np.median(rise, axis=1))


def _credible(problem: SpatialProblem, state: FloatArray) -> FloatArray:
    """States that are finite and give every path a positive length."""
    shortest = problem.measured[:, 0].min(initial=np.inf)
    return np.asarray(state[np.isfinite(state).all(axis=1) & (state[:, 4] < shortest)])
