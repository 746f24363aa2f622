"""Gaussian-process (GP) regression of a radial function r = f(angle) + n (paper, section III-B).

The kernel is the periodic squared exponential with period 2 pi, the mean is an unknown constant mu, and mu and
beta = (sigma_f^2, l^2, sigma_n^2) maximise the log marginal likelihood. The search uses its analytic gradient.
Few points use their covariance matrix (`exact.py`), many the harmonics of the kernel (`fourier.py`); small
clusters are searched together in one compiled call (`newton.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from estimation.execution import one_blas_thread
from estimation.shape.gp.exact import ExactPosterior, Likelihood, chord, log_marginal_likelihood
from estimation.shape.gp.fourier import FourierPosterior, FourierSums, log_marginal_likelihood_fourier
from estimation.shape.gp.harmonic_terms import smallest_order
from estimation.shape.gp.newton import ascend, most_likely
from scenes.record import FloatArray

# Bounds of the search: standard deviations relative to the rms radius, and the length scale. They keep the
# covariance matrix well conditioned; an optimum beyond them describes the same function in practice.
SIGNAL_STD_BOUNDS = (1e-4, 10.0)
NOISE_STD_BOUNDS = (1e-3, 10.0)
LENGTH_SCALE_BOUNDS = (0.05, 10.0)
SMALLEST_SCALE_M = 0.01

COARSE_NAT, FINE_NAT = 0.1, 1e-6  # promise of the last step of a start, and of the best: the rest is its square
PAPER_TOLERANCES_NAT = 0.1, 1e-3  # slope by log beta where the search from the start of the paper ends, and again
RELATIVE_TOLERANCE = 2.2e-9  # of the likelihood; the default of L-BFGS-B
LARGEST_TOGETHER = 32  # most points of clusters that one compiled call takes
TOGETHER_NAT = 1e-8  # promise of the last step of small clusters
PAPER_START = np.array([4.0, 4.0, 4.0])  # beta of sigma_f = l = sigma_n = 2


@dataclass(frozen=True)
class RadialGp:
    """A fitted radial function: the learned parameters and their posterior."""

    mean_m: float
    signal_std_m: float
    length_scale: float
    noise_std_m: float
    log_likelihood: float
    mean_uncertainty: bool
    posterior: ExactPosterior | FourierPosterior

    def predict(self, angle_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation in m of the radius f at angles (sample,) in rad.

        These are the printed predictive mean and variance; `mean_uncertainty` adds the variance of the learned
        mean.
        """
        deviation, variance, of_mean = self.posterior.predict(np.asarray(angle_rad, float))
        if self.mean_uncertainty:
            variance = variance + of_mean
        return self.mean_m + deviation, np.sqrt(variance)


class RadialData:
    """Contour points in polar form; the terms of each form of the likelihood are computed at first use."""

    def __init__(self, angle_rad: FloatArray, radius_m: FloatArray) -> None:
        self.angle_rad = np.ascontiguousarray(angle_rad, float)
        self.radius_m = np.ascontiguousarray(radius_m, float)

    @cached_property
    def chords(self) -> FloatArray:
        """Chords (ip, ip) of the angles, for the exact form."""
        return chord(self.angle_rad, self.angle_rad)

    @cached_property
    def sums(self) -> FourierSums:
        """Sums over the points, for the Fourier form."""
        return FourierSums(self.angle_rad, self.radius_m)

    def is_exact(self, beta: FloatArray) -> bool:
        """Whether there are fewer points than harmonics that the length scale needs."""
        return len(self.radius_m) < 2 * smallest_order(float(np.sqrt(beta[1]))) + 1

    def log_marginal_likelihood(self, beta: FloatArray) -> Likelihood:
        """Log marginal likelihood with the most likely mu, in the cheaper form."""
        if self.is_exact(beta):
            return log_marginal_likelihood(self.chords, self.radius_m, beta)
        return log_marginal_likelihood_fourier(self.sums, beta)

    def posterior(self, beta: FloatArray, mu: float) -> ExactPosterior | FourierPosterior:
        """Posterior of the radial function, in the cheaper form."""
        if self.is_exact(beta):
            return ExactPosterior.of(self.angle_rad, self.radius_m, beta, mu)
        return FourierPosterior.of(self.sums, beta, mu)


def fit_radial_gp(
    angle_rad: FloatArray,
    radius_m: FloatArray,
    start: Literal["paper", "data"] = "data",
    mean_uncertainty: bool = True,
    noise_floor_std_m: float = 0.0,
) -> RadialGp:
    """Fit the radial function to contour points at angle (ip,) in rad and radius (ip,) in m, one or more.

    `start` is `paper`: l = sigma_f = sigma_n = 2; or `data`: the most likely result of three starts taken from
    the data. The search runs over log beta with the most likely mu of each beta, so mu needs no start. sigma_n
    is at least `noise_floor_std_m`.

    Raises `ValueError` where there is no point, or angles and radii differ in number.
    """
    return fit_radial_gps([(angle_rad, radius_m)], start, mean_uncertainty, [noise_floor_std_m])[0]


def fit_radial_gps(
    clusters: Sequence[tuple[FloatArray, FloatArray]],
    start: Literal["paper", "data"] = "data",
    mean_uncertainty: bool = True,
    noise_floor_std_m: Sequence[float] | None = None,
) -> list[RadialGp]:
    """Fit the radial function of every cluster (angle (ip,) in rad, radius (ip,) in m), as `fit_radial_gp` does.

    Small clusters share one compiled call. The start of the paper uses L-BFGS-B, because its result depends on
    the search. `noise_floor_std_m` (cluster,) is 0 by default.
    """
    for angle, radius in clusters:
        if len(angle) == 0 or len(angle) != len(radius):
            raise ValueError(
                f"radial GP: {len(angle)} angles and {len(radius)} radii given, the same number of at least 1 is "
                "needed"
            )
    floors = [0.0] * len(clusters) if noise_floor_std_m is None else noise_floor_std_m
    data = [RadialData(*cluster) for cluster in clusters]
    bounds = [_search_bounds(one.radius_m, floor) for one, floor in zip(data, floors, strict=True)]
    is_small = [start == "data" and len(one.radius_m) <= LARGEST_TOGETHER for one in data]
    small = [k for k, compiled in enumerate(is_small) if compiled]
    with one_blas_thread():
        together = iter(_most_likely([data[k] for k in small], [bounds[k] for k in small]))
        return [
            _fitted(one, next(together) if compiled else _searched(one, start, limits), mean_uncertainty)
            for one, limits, compiled in zip(data, bounds, is_small, strict=True)
        ]


def _fitted(data: RadialData, beta: FloatArray, mean_uncertainty: bool) -> RadialGp:
    likelihood = data.log_marginal_likelihood(beta)
    posterior = data.posterior(beta, likelihood.mu)
    signal_std, length_scale, noise_std = (float(value) for value in np.sqrt(beta))
    return RadialGp(
        likelihood.mu, signal_std, length_scale, noise_std, likelihood.value, mean_uncertainty, posterior
    )


def _most_likely(data: list[RadialData], bounds: list[FloatArray]) -> FloatArray:
    """Most likely beta (cluster, 3) of small clusters, from starts taken from their data."""
    if not data:
        return np.zeros((0, 3))
    first = np.cumsum([0, *(len(one.radius_m) for one in data)])
    angle, radius = (np.concatenate([getattr(one, name) for one in data]) for name in ("angle_rad", "radius_m"))
    starts = np.array([_data_starts(one.angle_rad, one.radius_m) for one in data])
    low, high = np.log(np.stack(bounds, axis=1))
    return np.exp(most_likely(first, angle, radius, np.log(starts), low, high, TOGETHER_NAT))


def _searched(data: RadialData, start: Literal["paper", "data"], bounds: FloatArray) -> FloatArray:
    """Most likely beta (3,): from the data's starts by the compiled search, from the paper's by L-BFGS-B."""
    if start == "paper":
        beta = PAPER_START
        for slope_nat in PAPER_TOLERANCES_NAT:
            beta = _maximise_likelihood(data, beta, bounds, slope_nat)
        return beta
    starts = np.log(_data_starts(data.angle_rad, data.radius_m))
    ends = [_ascended(data, first, bounds, COARSE_NAT) for first in starts]
    _, best = max(ends, key=lambda optimum: optimum[0])
    return np.asarray(np.exp(_ascended(data, best, bounds, FINE_NAT)[1]))


def _ascended(
    data: RadialData, start: FloatArray, bounds: FloatArray, enough_nat: float
) -> tuple[float, FloatArray]:
    """Log likelihood and log beta of the optimum above a start, with all harmonics that the search needs."""
    at, (low, high) = start, np.log(bounds)
    chords = data.chords if data.is_exact(bounds[0]) else np.zeros((0, 0))
    order = smallest_order(float(np.exp(start[1] / 2)))
    while True:
        gram, moment = data.sums.up_to(order + order // 2)  # more than asked for: the search may need them next
        order, value, at = ascend(chords, data.radius_m, gram, moment, at, low, high, enough_nat)
        if 2 * order + 1 <= len(gram):
            return value, at


def _maximise_likelihood(data: RadialData, start: FloatArray, bounds: FloatArray, slope_nat: float) -> FloatArray:
    """Beta at the optimum over log beta, by L-BFGS-B; mu follows from beta at each step.

    Its first step is long, and the result of the start of the paper depends on it.
    """
    from scipy.optimize import Bounds, minimize  # noqa: PLC0415  (slow to import)

    def negative(log_beta: FloatArray) -> tuple[float, FloatArray]:
        beta = np.exp(log_beta)
        likelihood = data.log_marginal_likelihood(beta)
        return -likelihood.value, -likelihood.gradient[1:] * beta

    found = minimize(
        negative,
        np.log(np.clip(start, *bounds)),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(*np.log(bounds)),
        options={"gtol": slope_nat, "ftol": RELATIVE_TOLERANCE},
    )
    return np.asarray(np.exp(found.x))


def _search_bounds(radius_m: FloatArray, noise_floor_std_m: float) -> FloatArray:
    """Lower and upper bounds (2, 3) of beta."""
    scale = max(float(np.sqrt(np.mean(radius_m**2))), SMALLEST_SCALE_M)
    noise = np.maximum(scale * np.array(NOISE_STD_BOUNDS), noise_floor_std_m)
    return np.stack([scale * np.array(SIGNAL_STD_BOUNDS), LENGTH_SCALE_BOUNDS, noise], axis=1) ** 2


def _data_starts(angle_rad: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Starts (3, 3) of beta from the spread of the radii and the differences between neighbours in angle.

    Two take the spread as signal, with a short and a long length scale; one takes nearly all of it as noise.
    """
    around = radius_m[np.argsort(angle_rad)]
    spread = max(float(np.var(radius_m)), SMALLEST_SCALE_M**2)
    noise = max(0.5 * float(np.mean((around - np.roll(around, 1)) ** 2)), 1e-4 * spread)
    return np.array([[spread, 0.3**2, noise], [spread, 1.0, noise], [0.01 * spread, 1.0, spread]])
