"""Joint maximum likelihood of all paths by Levenberg-Marquardt, with its normal equations.

The likelihood of white noise is a sum of squares. Amplitudes are linear and solved for at every point (variable
projection); delays and angles take damped Gauss-Newton steps with analytic derivatives. Products with the samples
are computed with the residual of reference paths, small numbers in single precision; the rest is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.channel.model.cholesky import (
    SMALLEST,
    TINY,
    regular_inverse,
    scaled_matrix,
    solve_positive,
    unit_scale,
)
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import (
    PathParameters,
    PathTangents,
    cells_apart,
    gram_matrix,
    manifold_rates,
    normal_equations,
    own_gram_matrix,
    products_with,
    residual,
    responses,
    tangents,
)
from estimation.inference.least_squares import Attempt, Schedule, minimise
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray

APART_STEPS = 2
NEAR_CELLS = 2.0  # resolution cells along every axis, beyond which coupling between paths is small
REACH_BINS = 24  # of the delay response about a path that a partial refinement sees: 99.6 % of its energy
FEW = 24  # number of paths up to which a partial refinement saves no time
CONVERGED = 1e-3  # decrease of the squared residual, in units of the noise power, that ends the iteration
LARGEST_DAMPING = 1e7
HOPE = 10.0  # times the gain that a step expects: more is not gained by the steps that follow
LONGEST_STEP = 0.5  # resolution cells
TURNS_SPAN = 200.0  # of the turns that a path may have: more than sweeps are searched for


class Reference:
    """Reference paths and the residual of the samples: inner products with any tangents, in double precision.

    `at` holds the tangents of the reference paths, `parts` the residual.
    """

    def __init__(self, sweep: CompressedSweep, paths: PathParameters) -> None:
        self.sweep = sweep
        self.paths = paths
        self.parts = residual(sweep, paths)
        self.at = tangents(sweep, paths)

    def at_bins(self, kept: BoolArray) -> Reference:
        """The reference at the delay bins marked in `kept` (bin,), without products with the samples."""
        rest = copy(self)
        rest.sweep, rest.parts = self.sweep.bins(kept), self.parts[..., kept]
        rest.at = replace(self.at, delay=self.at.delay[..., kept])
        return rest

    def with_path_back(self, path: PathParameters) -> Reference:
        """The reference without one of its paths, which is in the residual again: its negative is taken out."""
        rest = replace(self.sweep, parts=self.parts)
        return Reference(rest, replace(path, amplitude=-path.amplitude))

    @cached_property
    def own_products(self) -> tuple[ComplexArray, ComplexArray]:
        """Inner products of the responses of the reference paths: with the samples (path,), with each other."""
        values = self.at.values
        return self.products(values)[:, 0], gram_matrix(values, values)[:, 0, :, 0]

    def residual_products(self, at: PathTangents) -> ComplexArray:
        """Inner products (path, tangent) of tangents with the residual of the reference paths."""
        return products_with(self.parts, at)

    def products(self, at: PathTangents) -> ComplexArray:
        """Inner products (path, tangent) of tangents with the sweep's samples."""
        explained = gram_matrix(at, self.at.values)[:, :, :, 0] @ self.paths.amplitude
        return np.asarray(self.residual_products(at) + explained)


@dataclass(frozen=True)
class Solution:
    """Paths at a point of the likelihood, with the normal equations there.

    Attributes
    ----------
    paths : with the amplitudes that fit best at their delays and angles
    explained : squared norm of the samples that the paths explain; the likelihood up to a constant
    inner : (path, path) inner products of the responses of the paths
    equations : makes `information` and `slope` when one of them is first used
    """

    paths: PathParameters
    explained: float
    inner: ComplexArray
    equations: Callable[[], tuple[FloatArray, FloatArray]]

    @cached_property
    def _both(self) -> tuple[FloatArray, FloatArray]:
        return self.equations()

    @property
    def information(self) -> FloatArray:
        """Half the Fisher information (path, column, path, column).

        Columns are the real and imaginary part of the amplitude, the delay in bins, the angles of departure and of
        arrival in rad.
        """
        return self._both[0]

    @property
    def slope(self) -> FloatArray:
        """Half the gradient (path, column) of the log-likelihood."""
        return self._both[1]

    @property
    def flat_information(self) -> FloatArray:
        """`information` as a matrix."""
        n = self.slope.size
        return self.information.reshape(n, n)

    @cached_property
    def inverse(self) -> FloatArray:
        """Regular inverse of `flat_information`."""
        return regular_inverse(self.flat_information)


def solve_at(reference: Reference, paths: PathParameters) -> Solution:
    """Best amplitudes at given delays and angles, and the normal equations of all parameters."""
    at = tangents(reference.sweep, paths)
    product, values = reference.products(at), at.values
    inner = gram_matrix(values, values)[:, 0, :, 0]
    amplitude, explained = _amplitudes(product[:, 0], inner)

    def equations() -> tuple[FloatArray, FloatArray]:
        signal = gram_matrix(at, values)[:, :, :, 0] @ amplitude
        return normal_equations(at, product - signal, amplitude)

    return Solution(replace(paths, amplitude=amplitude), explained, inner, equations)


def solve_amplitudes(reference: Reference, paths: PathParameters) -> Solution:
    """The same where the normal equations may not be needed: they are made when they are first used.

    Only paths that are not among the reference's take time.
    """
    known = _places_among(reference.paths, paths)
    at = responses(reference.sweep, paths.take(known < 0))
    ours, theirs = reference.own_products
    across = gram_matrix(at, reference.at.values)[:, 0, :, 0]
    new = reference.residual_products(at)[:, 0] + across @ reference.paths.amplitude
    inner = np.block([[theirs, across.conj().T], [across, gram_matrix(at, at)[:, 0, :, 0]]])
    place = known.copy()
    place[known < 0] = len(theirs) + np.arange(len(new))
    product = np.concatenate([ours, new])[place]
    inner = inner[np.ix_(place, place)]
    amplitude, explained = _amplitudes(product, inner)

    def equations() -> tuple[FloatArray, FloatArray]:
        return solve_at(reference, paths).equations()

    return Solution(replace(paths, amplitude=amplitude), explained, inner, equations)


def _places_among(known: PathParameters, paths: PathParameters) -> IntArray:
    """The place (path,) of the same path among those known, whatever its amplitude; -1 if it is not there."""
    if not len(known):
        return np.full(len(paths), -1)
    order = np.argsort(known.delay_bins, kind="stable")
    place = order[np.searchsorted(known.delay_bins[order], paths.delay_bins).clip(max=len(known) - 1)]
    is_same = known.delay_bins[place] == paths.delay_bins
    is_same &= (known.aod_rad[place] == paths.aod_rad).all(axis=1)
    is_same &= (known.aoa_rad[place] == paths.aoa_rad).all(axis=1)
    return np.where(is_same, place, -1)


def refine_separately(
    reference: Reference, paths: PathParameters, n_steps: int = APART_STEPS, back: PathParameters | None = None
) -> tuple[PathParameters, FloatArray]:
    """Paths refined one by one, alone in the residual of the reference, and their explained power (path,).

    In the residual of each is the path of `back` (path,), where given: one of the reference's in another place.
    Gauss-Newton steps from points of a search grid; a step that explains less is rejected.
    """
    best, power = paths, np.full(len(paths), -np.inf)
    put_back = None if back is None else (tangents(reference.sweep, back).values, back.amplitude[:, None])
    for _ in range(n_steps + 1 if len(paths) else 0):
        at = tangents(reference.sweep, paths)
        product, inner = reference.residual_products(at), own_gram_matrix(at, at)
        if put_back is not None:
            product = product + own_gram_matrix(at, put_back[0])[:, :, 0] * put_back[1]
        energy = np.maximum(inner[:, 0, 0].real, SMALLEST)
        amplitude = product[:, 0] / energy
        explained = np.abs(product[:, 0]) ** 2 / energy
        is_better = explained > power
        power = np.where(is_better, explained, power)
        best = best.replaced(is_better, replace(paths, amplitude=amplitude))
        matrix, slope = _own_equations(inner, product - inner[:, :, 0] * amplitude[:, None], amplitude)
        diagonal = np.einsum("iaa->ia", matrix)
        matrix = matrix + (1e-2 * diagonal + SMALLEST)[:, :, None] * np.eye(matrix.shape[1])
        paths = paths.moved(np.linalg.solve(matrix, slope[..., None])[:, 2:, 0])
    return best, power


def _own_equations(
    inner: ComplexArray, rest: ComplexArray, amplitude: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """As `normal_equations`, of every path alone: matrix (path, column, column) and gradient (path, column)."""
    tangent = np.maximum(np.arange(-1, rest.shape[1]), 0)
    scale = np.repeat(amplitude[:, None], len(tangent), axis=1)
    scale[:, :2] = 1.0, 1j
    matrix = (scale.conj()[:, :, None] * inner[:, tangent[:, None], tangent] * scale[:, None]).real
    return matrix, (scale.conj() * rest[:, tangent]).real


def _amplitudes(product: ComplexArray, inner: ComplexArray) -> tuple[ComplexArray, float]:
    """Best amplitudes (path,) and what they explain, from products with the samples and with each other."""
    ridge = TINY * np.abs(inner.diagonal()).max(initial=0.0) * np.eye(len(inner))
    amplitude = np.linalg.solve(inner + ridge, product)
    return amplitude, float((product.conj() @ amplitude).real)


def refine_paths(
    reference: Reference, paths: PathParameters, max_steps: int, enough: float = np.inf, least: float = -np.inf
) -> Solution:
    """Paths of largest likelihood near the given ones, after at most `max_steps` Levenberg-Marquardt steps.

    The steps end when `enough` is explained, or when there is no hope to explain the `least`.
    """

    def attempt(now: Solution, damping: float) -> Attempt[Solution] | None:
        if now.explained > enough:
            return None
        step, expected = _step(now, damping)
        if expected < CONVERGED or now.explained + HOPE * expected < least:
            return None
        trial = solve_at(reference, now.paths.moved(step))
        return Attempt(trial, -now.explained, -trial.explained)

    schedule = Schedule(max_steps if len(paths) else 0, largest=LARGEST_DAMPING)
    return minimise(solve_at(reference, paths), attempt, schedule)


def refine_near(
    reference: Reference,
    paths: PathParameters,
    about: PathParameters,
    max_steps: int,
    enough: float = np.inf,
    before: PathParameters | None = None,
) -> Solution:
    """As `refine_paths`, for the paths near `about`, the places of a change; the others change amplitudes only.

    Paths that share no resolution cell have little coupling. A few paths are all refined: it takes no longer. With
    the paths as they were `before`, the steps end when there is no hope to explain more than these.
    """
    if len(paths) <= FEW:
        return refine_paths(reference, paths, max_steps, enough)
    moves = paths_near(reference.sweep, paths, about)
    if not moves.any():
        return solve_amplitudes(reference, paths)
    moving = paths.take(moves)
    apart_bins = np.abs(reference.sweep.position[:, None] - moving.delay_bins)
    around = reference.sweep.bins(apart_bins.min(axis=1) <= REACH_BINS)
    rest = replace(around, parts=residual(around, paths.take(~moves)))
    here = Reference(rest, moving)
    least = -np.inf if before is None else solve_amplitudes(here, before.take(moves)).explained
    moved = refine_paths(here, moving, max_steps, least=least)
    order = np.argsort(np.concatenate([np.flatnonzero(~moves), np.flatnonzero(moves)]))
    return solve_amplitudes(reference, paths.take(~moves).joined(moved.paths).take(order))


def paths_near(sweep: CompressedSweep, paths: PathParameters, about: PathParameters) -> BoolArray:
    """Mask (path,) of the paths within `NEAR_CELLS` of any of those in `about`, along every axis."""
    return np.asarray((cells_apart(paths, about, manifold_rates(sweep, about)) <= NEAR_CELLS).any(axis=1))


def _step(now: Solution, damping: float) -> tuple[FloatArray, float]:
    """Damped step (path, parameter) of delays and angles, and its expected gain in likelihood.

    No path moves by more than `LONGEST_STEP` along any axis: further away it has other neighbours.
    """
    diagonal = np.diagonal(now.flat_information)
    scale = unit_scale(diagonal)
    scaled = scaled_matrix(now.flat_information, scale, damping + TINY)
    flat = scale * solve_positive(scaled, scale * now.slope.ravel())
    step = flat.reshape(now.slope.shape)[:, 2:]
    own = diagonal.reshape(now.slope.shape)
    length = np.abs(step) * np.sqrt(own[:, 2:] / own[:, :1]) / np.abs(now.paths.amplitude)[:, None]
    limit = np.minimum(1.0, LONGEST_STEP * CELL / np.maximum(length.max(axis=1), SMALLEST))
    return step * limit[:, None], float(flat @ now.slope.ravel())


def response_powers(solution: Solution) -> FloatArray:
    """Power (path,) over the noise of every path alone, summed over all samples."""
    return np.asarray(np.square(np.abs(solution.paths.amplitude)) * np.diagonal(solution.inner).real)


def joint_covariance(solution: Solution, n_subcarriers: int, lost: FloatArray | float = 0.0) -> FloatArray:
    """Covariance (path, parameter, path, parameter) of delays in bins and angles in rad, amplitudes unknown.

    The inverse of the joint Fisher information of all paths plus a prior: delays are within the period, angles on
    the circle, turns within `TURNS_SPAN`. So an unobservable parameter has the variance of a uniform one. `lost`
    is what other unknowns take from `Solution.information`.
    """
    n, n_columns = solution.slope.shape
    information = 2 * (solution.information - lost)
    prior = np.full(n_columns, 12 / (2 * np.pi) ** 2)
    prior[:3] = [0.0, 0.0, 12 / n_subcarriers**2]
    prior[n_columns - solution.paths.doppler_turns.shape[1] :] = 12 / TURNS_SPAN**2
    information = information + np.einsum("pq,ab,b->paqb", np.eye(n), np.eye(n_columns), prior)
    inverse = regular_inverse(information.reshape(n * n_columns, -1))
    inverse = ((inverse + inverse.T) / 2).reshape(information.shape)
    return np.asarray(inverse[:, 2:, :, 2:])


def marginal_covariances(solution: Solution, n_subcarriers: int, lost: FloatArray | float = 0.0) -> FloatArray:
    """Covariance (path, parameter, parameter) of every path, all others unknown; see `joint_covariance`."""
    return np.asarray(np.einsum("papb->pab", joint_covariance(solution, n_subcarriers, lost)))
