"""Mirror close pairs: a strong path with a weak one before it looks like one with a weak path after it.

Two paths within a resolution cell show mostly their centroid and spread; which of them is the stronger shows in
small terms of third order. So the likelihood has two maxima, images of each other at the centroid, and steps from
one do not reach the other. Groups of several paths have a maximum for every arrangement.
"""

import numpy as np

from estimation.channel.coherent.pairs import refine_pairs
from estimation.channel.coherent.refine import NEAR_CELLS, Reference, Solution, refine_near, response_powers
from estimation.channel.coherent.tried import TriedPaths
from estimation.channel.model.path_model import PathParameters, cells_apart, manifold_rates
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

LEAST_GAIN = 2.0  # units of the noise power: less is a matter of rounding and of few steps


class PairMirror:
    """Mirrors the close pairs of one stop; it knows those that it has tried in vain."""

    def __init__(self) -> None:
        self._stronger, self._weaker = TriedPaths(), TriedPaths()

    def __call__(self, reference: Reference, solution: Solution, max_steps: int) -> Solution:
        """The solution, which is at the reference's paths, with close pairs mirrored where that explains more.

        All pairs are refined at once, with the paths near them linearised. Those that gain are tried with the
        paths near them, the largest gain first; after a success the pairs near it wait for the next call.
        """
        before, rate = solution.paths, manifold_rates(reference.sweep, solution.paths)
        power = response_powers(solution)
        is_near = cells_apart(before, before, rate) <= NEAR_CELLS
        pairs = np.argwhere(is_near & (power < power[:, None]) & ~self._pairs_tried(before, rate))
        if not len(pairs):
            return solution
        refined, gain = refine_pairs(reference, solution, pairs, _mirrored(before, pairs), max_steps)
        in_vain = gain <= LEAST_GAIN
        is_changed: BoolArray = np.zeros(len(before), bool)
        for number in np.argsort(-gain, kind="stable")[: int((~in_vain).sum())]:
            pair, two = pairs[number], refined.take(np.array([2 * number, 2 * number + 1]))
            if is_changed[pair].any():
                continue
            places = solution.paths.with_paths(pair, two)
            trial = refine_near(reference, places, two, max_steps, before=solution.paths)
            in_vain[number] = trial.explained <= solution.explained + LEAST_GAIN
            if not in_vain[number]:
                solution = trial
                is_changed |= is_near[:, pair].any(axis=1)
        self._stronger.add(before.take(pairs[in_vain, 0]))
        self._weaker.add(before.take(pairs[in_vain, 1]))
        return solution

    def _pairs_tried(self, paths: PathParameters, rate: FloatArray) -> BoolArray:
        """Mask (path, path) of the stronger and weaker paths of pairs that were tried."""
        stronger, weaker = (tried.among(paths, rate) for tried in (self._stronger, self._weaker))
        return np.asarray((stronger[:, :, None] & weaker[:, None, :]).any(axis=0))


def _mirrored(paths: PathParameters, pairs: IntArray) -> PathParameters:
    """Pairs (pair, 2) of the paths, mirrored at their centroids: the means weighted by the amplitudes.

    The result has the first and the second path of every pair after those of the pair before.
    """
    each = paths.take(pairs.ravel())
    amplitude = np.abs(paths.amplitude[pairs])
    share = amplitude[:, 1] / amplitude.sum(axis=1)

    def turned(value: FloatArray, difference: FloatArray) -> FloatArray:
        first = value[::2] + 2 * (difference.T * share).T
        return np.stack([first, first - difference], axis=1).reshape(value.shape)

    def apart(value: FloatArray) -> FloatArray:
        return np.asarray(value[1::2] - value[::2])

    return PathParameters(
        turned(each.delay_bins, apart(each.delay_bins)),
        turned(each.aod_rad, wrap_angle(apart(each.aod_rad))),
        turned(each.aoa_rad, wrap_angle(apart(each.aoa_rad))),
        each.amplitude,
        turned(each.doppler_turns, apart(each.doppler_turns)),
    )
