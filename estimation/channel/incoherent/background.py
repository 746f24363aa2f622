"""Noise from thousands of weak paths, as it affects a path of the incoherent search.

Dense diffuse multipath differs over delay and direction. It affects a path in the beam pairs that the path
illuminates, at the delays around it: the residual power there, weighted by the path's share of every pair, counts
as its noise (the local noise estimate of a constant false-alarm rate detector; the greater one of both sides,
since diffuse power starts at once with the first path; Hansen 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.channel.incoherent.likelihood import LinkBeams
from estimation.channel.incoherent.response_errors import ResponseErrors
from estimation.channel.incoherent.spectrum import delay_waves
from scenes.record import ComplexArray, FloatArray, IntArray

NO_ERRORS = ResponseErrors()
AROUND_BINS = 12  # to either side of a path, for its background
OWN_BINS = 2  # to either side, filled by the path itself
NOTABLE = 1.5  # least background that counts: noise alone stays below
UNEXPLAINED = 3.0  # mean residual power in a path's own cells, above which it is more than noise


@dataclass(frozen=True)
class Background:
    """Residual power over the noise (pair, bin) of the found paths, for all beam pairs at the delay `bins`."""

    power: FloatArray
    bins: IntArray
    n_bins: int
    errors: ResponseErrors = NO_ERRORS

    @classmethod
    def of(
        cls, residual: ComplexArray, bins: IntArray, n_bins: int, errors: ResponseErrors = NO_ERRORS
    ) -> Background:
        """The background in residual samples (pair, bin) of unit noise, and the floor by errors of the arrays."""
        return cls(np.square(residual.real) + np.square(residual.imag), bins, n_bins, errors)

    def noise_factor(self, ends: LinkBeams, paths: FloatArray) -> FloatArray:
        """Noise power (path,) that affects paths (path, parameter) over receiver noise; 1 below `NOTABLE`."""
        profile, n_pairs = self._profile(ends, paths)
        distance = self.bins - paths[:, :1]
        beside = (np.abs(distance) > OWN_BINS) & (np.abs(distance) <= AROUND_BINS)
        factor = np.ones(len(paths))
        for path in range(len(paths)):
            sides = [profile[path, beside[path] & side] for side in (distance[path] < 0, distance[path] > 0)]
            level = max((float(np.median(side)) for side in sides if len(side) > AROUND_BINS / 2), default=1.0)
            # The median of the mean of n unit exponentials (Wilson and Hilferty 1931), and the excess of the
            # greater of two sample medians over it.
            n = n_pairs[path]
            factor[path] = level / ((1 - 1 / (9 * n)) ** 3 * (1 + np.sqrt(0.5 / (n * (AROUND_BINS - OWN_BINS)))))
        return np.where(factor > NOTABLE, factor, 1.0) + self.errors.noise(ends, paths, self.n_bins)

    def covariance_factor(self, ends: LinkBeams, paths: FloatArray) -> FloatArray:
        """Factor (path,) on the covariances of paths: their noise, or the residual in their own cells."""
        profile, _ = self._profile(ends, paths)
        waves, _ = delay_waves(self.bins, paths[:, 0], self.n_bins)
        own = np.einsum("ik,ki->i", profile, waves**2) / self.n_bins
        return np.maximum(self.noise_factor(ends, paths), np.where(own > UNEXPLAINED, own, 1.0))

    def _profile(self, ends: LinkBeams, paths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Power over delay (path, bin) that affects each path, and the number of pairs (path,) in this mean."""
        share = ends.energy_shares(paths).T
        n_pairs = 1 / np.maximum(np.square(share).sum(axis=1), 1e-300)
        return np.asarray(share.astype(np.float32) @ self.power, float), n_pairs
