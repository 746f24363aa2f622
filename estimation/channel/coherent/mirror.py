"""Mirror close pairs: a strong path with a weak one before it looks like one with a weak path after it.

Two paths within a resolution cell show mostly their centroid and spread; which of them is the stronger shows in
small terms of third order. So the likelihood has two maxima, images of each other at the centroid, and steps from
one do not reach the other. Groups of several paths have a maximum for every arrangement.
"""

import numpy as np

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

        Pairs are tried from the strongest on.
        """
        before, rate = solution.paths, manifold_rates(reference.sweep, solution.paths)
        power = response_powers(solution)
        is_close = cells_apart(before, before, rate) <= NEAR_CELLS
        is_close &= ~self._pairs_tried(before, rate)
        for strong in np.argsort(-power, kind="stable"):
            for weak in np.flatnonzero(is_close[strong] & (power < power[strong])):
                pair = np.array([strong, weak])
                mirrored = _mirrored(solution.paths, pair)
                trial = refine_near(reference, mirrored, mirrored.take(pair), max_steps, before=solution.paths)
                if trial.explained > solution.explained + LEAST_GAIN:
                    solution = trial
                else:
                    self._stronger.add(solution.paths.take(pair[:1]))
                    self._weaker.add(solution.paths.take(pair[1:]))
        return solution

    def _pairs_tried(self, paths: PathParameters, rate: FloatArray) -> BoolArray:
        """Mask (path, path) of the stronger and weaker paths of pairs that were tried."""
        stronger, weaker = (tried.among(paths, rate) for tried in (self._stronger, self._weaker))
        return np.asarray((stronger[:, :, None] & weaker[:, None, :]).any(axis=0))


def _mirrored(paths: PathParameters, pair: IntArray) -> PathParameters:
    """The paths, two of them mirrored at their centroid: the mean weighted by the amplitudes."""
    amplitude = np.abs(paths.amplitude[pair])
    share = amplitude[1] / amplitude.sum()
    first, second = pair

    def turned(value: FloatArray, difference: FloatArray) -> FloatArray:
        result = value.copy()
        result[first] = value[first] + 2 * share * difference
        result[second] = result[first] - difference
        return result

    return PathParameters(
        turned(paths.delay_bins, paths.delay_bins[second] - paths.delay_bins[first]),
        turned(paths.aod_rad, wrap_angle(paths.aod_rad[second] - paths.aod_rad[first])),
        turned(paths.aoa_rad, wrap_angle(paths.aoa_rad[second] - paths.aoa_rad[first])),
        paths.amplitude,
        turned(paths.doppler_turns, paths.doppler_turns[second] - paths.doppler_turns[first]),
    )
