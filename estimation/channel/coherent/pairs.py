"""Refine many pairs of paths at once: what each pair could explain in another place.

The paths near a pair adapt to it. They hardly move, so they are linearised about where they are, and their
parameters are eliminated from the normal equations of the pair (a Schur complement). All others are fixed. So a
pair costs a few small products, where a joint fit costs those of all paths near it at every step.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from estimation.channel.coherent.refine import (
    CONVERGED,
    HOPE,
    LARGEST_DAMPING,
    LONGEST_STEP,
    NEAR_CELLS,
    REACH_BINS,
    Reference,
    Solution,
)
from estimation.channel.model.cholesky import SMALLEST, TINY
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import (
    PathParameters,
    PathTangents,
    cells_apart,
    group_gram_matrix,
    manifold_rates,
    responses,
    tangents,
)
from estimation.inference.least_squares import Attempt, Schedule, minimise
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray

NEAREST = 10  # paths that adapt to a pair
AT_ONCE = 32  # pairs of similar delays, which need few delay bins
LEAST_OWN_SHARE = 1e-9  # of the information on a parameter of a near path: keeps the others from its place


def refine_pairs(
    reference: Reference, solution: Solution, pairs: IntArray, paths: PathParameters, max_steps: int
) -> tuple[PathParameters, FloatArray]:
    """Pairs (pair, 2) of a solution in other places, `paths` (path of a pair after path,), refined.

    The second result is what each pair (pair,) explains more than it does in the solution, which is at the
    reference's paths. Levenberg-Marquardt steps are as in `refine_paths`; those of a pair end when there is no
    hope to explain more.
    """
    before = solution.paths
    cells = cells_apart(before, before, manifold_rates(reference.sweep, before))
    order = np.argsort(before.delay_bins[pairs].mean(axis=1), kind="stable")
    gain, refined = np.zeros(len(pairs)), paths
    for start in range(0, len(pairs), AT_ONCE):
        some = order[start : start + AT_ONCE]
        each = (2 * some[:, None] + np.arange(2)).ravel()
        own = before.take(pairs[some].ravel())
        apart_bins = np.abs(reference.sweep.position[:, None] - own.delay_bins).min(axis=1)
        around = reference.at_bins(apart_bins <= REACH_BINS)
        problem = _PairSamples.of(around, solution, own, _nearest(cells, pairs[some]))
        moved, gain[some] = _refined(problem, own, paths.take(each), max_steps)
        refined = refined.with_paths(each, moved)
    return refined, gain


def _nearest(cells: FloatArray, pairs: IntArray) -> IntArray:
    """Numbers (pair, place) of the paths nearest to pairs (pair, 2) by distances in cells, padded with -1."""
    apart = cells[pairs].min(axis=1)
    apart[np.arange(len(pairs))[:, None], pairs] = np.inf
    order = np.argsort(apart, axis=1, kind="stable")[:, :NEAREST]
    is_near = np.take_along_axis(apart, order, axis=1) <= NEAR_CELLS
    return np.where(is_near, order, -1)[:, : int(is_near.sum(axis=1).max(initial=0))]


def _refined(
    problem: _PairSamples, before: PathParameters, paths: PathParameters, max_steps: int
) -> tuple[PathParameters, FloatArray]:
    """Pairs refined from `paths`, and what they explain more (pair,) than at their places `before`."""
    least = problem.at(before).explained

    def attempt(now: _PairPoint, damping: Any) -> Attempt[_PairPoint] | None:
        step, expected = _step(now, np.broadcast_to(damping, len(least)))
        hopeful = (expected >= CONVERGED) & (now.explained + HOPE * expected >= least)
        if not hopeful.any():
            return None
        moved = now.take(hopeful).paths.moved(step[hopeful].reshape(-1, step.shape[2]))
        trial = now.replaced(hopeful, problem.take(hopeful).at(moved))
        return Attempt(trial, -now.explained, np.where(hopeful, -trial.explained, np.inf))

    best = minimise(problem.at(paths), attempt, Schedule(max_steps, largest=LARGEST_DAMPING))
    return best.paths, best.explained - least


class _PairPoint(NamedTuple):
    """Pairs at a point of their likelihood: parameters (pair, path, ...), and their normal equations."""

    delay_bins: FloatArray
    aod_rad: FloatArray
    aoa_rad: FloatArray
    amplitude: ComplexArray
    doppler_turns: FloatArray
    explained: FloatArray  # (pair,) up to a constant of the pair
    matrix: FloatArray  # (pair, column, column)
    slope: FloatArray  # (pair, column)

    @property
    def paths(self) -> PathParameters:
        """The paths of all pairs, one pair after the other."""
        parts: list[Any] = [part.reshape(2 * len(part), *part.shape[2:]) for part in self[:5]]
        return PathParameters(*parts)

    def take(self, index: BoolArray) -> _PairPoint:
        """Some of the pairs."""
        parts: list[Any] = [part[index] for part in self]
        return _PairPoint(*parts)

    def replaced(self, where: BoolArray, others: _PairPoint) -> _PairPoint:
        """The pairs, with others in the places of those marked in `where` (pair,)."""
        parts: list[Any] = [part.copy() for part in self]
        for part, other in zip(parts, others, strict=True):
            part[where] = other
        return _PairPoint(*parts)


def _step(now: _PairPoint, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Damped steps (pair, path, parameter), and what they are expected to gain (pair,), as in `refine_paths`."""
    n, size = now.slope.shape
    diagonal = np.einsum("iaa->ia", now.matrix)
    scale = 1 / np.sqrt(np.maximum(diagonal, SMALLEST))
    scaled = now.matrix * scale[:, :, None] * scale[:, None]
    scaled += (damping + TINY)[:, None, None] * np.eye(size)
    flat = scale * np.linalg.solve(scaled, (scale * now.slope)[..., None])[..., 0]
    step, own = flat.reshape(n, 2, -1)[:, :, 2:], diagonal.reshape(n, 2, -1)
    length = np.abs(step) * np.sqrt(np.maximum(own[:, :, 2:], 0) / np.maximum(own[:, :, :1], SMALLEST))
    length /= np.maximum(np.abs(now.amplitude), SMALLEST)[..., None]
    limit = np.minimum(1.0, LONGEST_STEP * CELL / np.maximum(length.max(axis=2), SMALLEST))
    return step * limit[..., None], (flat * now.slope).sum(axis=1)


@dataclass(frozen=True)
class _NearPaths:
    """Paths near pairs, linearised: a column for the real and the imaginary amplitude, and for each parameter.

    Attributes
    ----------
    at : tangents (near path of a pair after near path,)
    scale : (pair, near column) of the tangents, zero where a pair has fewer near paths than others
    inverse : (pair, near column, near column) of half their information
    """

    at: PathTangents
    scale: ComplexArray
    inverse: FloatArray

    @classmethod
    def of(cls, reference: Reference, solution: Solution, number: IntArray) -> _NearPaths:
        """The paths with these numbers (pair, near path) in the solution; -1 stands for none."""
        n, n_near = number.shape
        size = n_near * solution.slope.shape[1]
        is_there = (number >= 0)[..., None]
        scale = np.repeat(solution.paths.amplitude[number][..., None], solution.slope.shape[1], axis=2)
        scale[..., :2] = 1.0, 1j
        matrix = solution.information[number[:, :, None], :, number[:, None]].transpose(0, 1, 3, 2, 4)
        matrix = (matrix * is_there[..., None, None] * is_there[:, None, None]).reshape(n, size, size)
        diagonal = np.einsum("iaa->ia", matrix)
        unit = np.where(diagonal > SMALLEST, 1 / np.sqrt(np.maximum(diagonal, SMALLEST)), 0.0)
        scaled = matrix * unit[:, :, None] * unit[:, None]
        scaled[:, np.arange(size), np.arange(size)] = 1 + LEAST_OWN_SHARE
        inverse = np.linalg.inv(scaled) * unit[:, :, None] * unit[:, None]
        return cls(_taken(reference.at, number.ravel()), (scale * is_there).reshape(n, size), np.asarray(inverse))

    def take(self, index: BoolArray) -> _NearPaths:
        """Those of some of the pairs."""
        each = np.repeat(index, len(self.at.tx) // len(index))
        return _NearPaths(_taken(self.at, each), self.scale[index], self.inverse[index])

    def products(self, at: PathTangents) -> ComplexArray:
        """Products (pair, path, tangent, near column) of tangents of the pairs with the columns."""
        n_near = len(self.at.tx) // len(self.scale)
        if not n_near:
            return group_gram_matrix(at, at, 2)[:, :, :, 0, :0]
        gram = group_gram_matrix(at, self.at, 2, n_near)
        column = np.maximum(np.arange(-1, gram.shape[4]), 0)
        return np.asarray(gram[..., column].reshape(*gram.shape[:3], -1) * self.scale[:, None, None])


@dataclass(frozen=True)
class _PairSamples:
    """The samples of pairs: the residual of a reference with the two paths back in it, and the paths near them.

    Attributes
    ----------
    back : responses (path of a pair after path,) of the paths that are back, of the `amplitude` (pair, path)
    pull : (pair, near column) half the gradient of the parameters of the near paths, with the two paths back
    """

    reference: Reference
    back: PathTangents
    amplitude: ComplexArray
    near: _NearPaths
    pull: FloatArray

    @classmethod
    def of(cls, reference: Reference, solution: Solution, back: PathParameters, number: IntArray) -> _PairSamples:
        """The problem of pairs `back` (path of a pair after path,) with paths `number` (pair, near path) near."""
        near, at = _NearPaths.of(reference, solution, number), responses(reference.sweep, back)
        amplitude = back.amplitude.reshape(-1, 2)
        slope = (solution.slope[number] * (number >= 0)[..., None]).reshape(near.scale.shape)
        return cls(reference, at, amplitude, near, slope + _against(near.products(at), amplitude))

    def take(self, index: BoolArray) -> _PairSamples:
        """That of some of the pairs."""
        back = _taken(self.back, np.repeat(index, 2))
        return _PairSamples(self.reference, back, self.amplitude[index], self.near.take(index), self.pull[index])

    def at(self, paths: PathParameters) -> _PairPoint:
        """The likelihood of the pairs at the places of these paths, the paths near them adapted."""
        at = tangents(self.reference.sweep, paths)
        inner, beside = group_gram_matrix(at, at, 2), self.near.products(at)
        n, _, n_tangents = inner.shape[:3]
        product = self.reference.residual_products(at).reshape(n, 2, n_tangents)
        product = product + np.einsum("ipaq,iq->ipa", group_gram_matrix(at, self.back, 2)[..., 0], self.amplitude)
        amplitude, explained = self._amplitudes(inner[:, :, :1, :, :1], product[:, :, :1], beside[:, :, :1])
        scale = np.repeat(amplitude[:, :, None], n_tangents + 1, axis=2)
        scale[..., :2] = 1.0, 1j
        rest = product - np.einsum("ipaq,iq->ipa", inner[..., 0], amplitude)
        left = self.pull - _against(beside, amplitude)
        matrix, slope = self._equations(scale, inner, rest, beside, left)
        found = replace(paths, amplitude=amplitude.ravel())
        parts: list[Any] = [getattr(found, spec.name) for spec in fields(found)]
        parts = [part.reshape(n, 2, *part.shape[1:]) for part in parts]
        parts += [explained, matrix, slope]
        return _PairPoint(*parts)

    def _amplitudes(
        self, inner: ComplexArray, product: ComplexArray, beside: ComplexArray
    ) -> tuple[ComplexArray, FloatArray]:
        """Best amplitudes (pair, path) and what they explain, from products of the responses alone."""
        unit = np.ones((*product.shape[:2], 2)) * np.array([1.0, 1j])
        matrix, right = self._equations(unit, inner, product, beside, self.pull)
        ridge = TINY * np.einsum("iaa->ia", matrix).max(axis=1, initial=SMALLEST)
        value = np.linalg.solve(matrix + ridge[:, None, None] * np.eye(4), right[..., None])[..., 0]
        return value.reshape(-1, 2, 2) @ np.array([1, 1j]), (value * right).sum(axis=1)

    def _equations(
        self,
        scale: ComplexArray,
        inner: ComplexArray,
        product: ComplexArray,
        beside: ComplexArray,
        pull: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Normal equations (pair, column, ...) of the pairs without those of the near paths.

        Columns are the tangents times `scale` (pair, path, column), the first of them twice. `product` (pair,
        path, tangent) and `pull` (pair, near column) are those with the samples.
        """
        n, size = len(scale), 2 * scale.shape[2]
        tangent = np.maximum(np.arange(-1, inner.shape[2]), 0)
        turned = scale.conj()
        matrix = turned[..., None, None] * inner[:, :, tangent][..., tangent] * scale[:, None, None]
        cross = (turned[..., None] * beside[:, :, tangent]).real.reshape(n, size, -1)
        known = cross @ self.near.inverse
        slope = (turned * product[:, :, tangent]).real.reshape(n, size)
        return (
            matrix.real.reshape(n, size, size) - known @ cross.swapaxes(1, 2),
            slope - (known @ pull[..., None])[..., 0],
        )


def _against(beside: ComplexArray, amplitude: ComplexArray) -> FloatArray:
    """Products (pair, near column) of near columns with the signals of pairs, from those with the responses."""
    return np.asarray(np.einsum("ipc,ip->ic", beside[:, :, 0], amplitude.conj()).real)


def _taken(at: PathTangents, index: IntArray | BoolArray) -> PathTangents:
    return PathTangents(at.tx[index], at.rx[index], at.delay[index], at.is_tied)
