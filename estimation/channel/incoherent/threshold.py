"""The threshold of the phase-incoherent likelihood ratio for a false-alarm probability.

l(eta) is the marginal log-likelihood ratio of one path with parameters eta (log amplitude, delay, angles) to
noise. exp l is a likelihood ratio for every fixed eta, so noise exceeds t anywhere with probability

    P(max l > t) = integral d eta  E_eta[ 1(max l > t) / integral d eta' exp l(eta') ]

(Siegmund and Yakir, The Statistics of Gene Mapping 2007, section 5; the likelihood-ratio identity for maxima of
random fields). Laplace's method about the maximum, with the Fisher information J of d parameters, gives

    P ~ integral d eta |J|^(1/2) (2 pi)^(-d/2) E_eta[exp(-max l); max l > t],    max l ~ l(eta) + chi^2_d / 2,

and l(eta), a sum over beam pairs, is nearly Gaussian under eta in the relevant range, about max l = t. Its moments
and J follow from the SNR of every pair; no simulation is needed.

In pairs that known paths illuminate the phases are known too. A further path has its own phase there, and its
ratio is that of a coherent search, in which noise reaches higher levels: chi-square of 2 degrees of freedom at
every place (`estimation.channel.model.false_alarms`). For a path partly in such pairs,
its share there interpolates the level.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product

import numpy as np
from scipy.optimize import brentq
from scipy.special import i0e, log_ndtr, logsumexp

from estimation.channel.coherent.plan import NEAR_SHARE
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.model.false_alarms import (
    delay_curvatures,
    detection_level,
    direction_curvatures,
    region_curvatures,
)
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.phase_information import pair_information
from scenes.record import FloatArray

_DIRECTIONS = 12  # at most, of each end, over which the false alarms are summed
_LOG_POWER = np.linspace(np.log(1.0), np.log(400.0), 28)  # of a path: its SNR summed over all beam pairs
_TABLE_SNR = np.geomspace(1e-6, 1e3, 600)
_WEAKEST = 1e-3  # share of the strongest pair's SNR below which pairs are left out
_LARGEST_THRESHOLD = 500.0


@dataclass(frozen=True, eq=False)
class NullTail:
    """Tail probability P(max l > t) of noise: with no phase known, and with all phases known.

    Attributes
    ----------
    mean, variance, log_weight : (term,) of l, in the sum per delay bin with no phase known
    curvatures : (dimension,) of the directions of both ends, for known phases
    """

    mean: FloatArray
    variance: FloatArray
    log_weight: FloatArray
    curvatures: FloatArray

    def log_probability(self, threshold: float, n_bins: float) -> float:
        """Log of the expected number of false alarms over `n_bins` delay bins."""
        std = np.sqrt(self.variance)
        beyond = log_ndtr((self.mean - self.variance - threshold) / std)
        return float(np.log(n_bins) + logsumexp(self.log_weight - self.mean + self.variance / 2 + beyond))

    @lru_cache(maxsize=64)  # noqa: B019  tails are few and live long
    def threshold(self, probability: float, n_bins: float) -> float:
        """Log-likelihood ratio that noise exceeds anywhere in `n_bins` delay bins with this probability."""
        # The number of false alarms is Poisson.
        target = float(np.log(-np.log1p(-probability)))
        return float(
            brentq(lambda t: self.log_probability(t, n_bins) - target, 0.0, _LARGEST_THRESHOLD, xtol=1e-3)
        )

    @lru_cache(maxsize=64)  # noqa: B019
    def coherent_threshold(self, probability: float, n_bins: float, n_subcarriers: int) -> float:
        """The same with known phases of all beam pairs; at least that with unknown ones."""
        region = region_curvatures(delay_curvatures(n_bins, n_subcarriers), self.curvatures)
        return max(detection_level(probability, region), self.threshold(probability, n_bins))


@dataclass(frozen=True)
class DetectionLevels:
    """Likelihood ratios that paths need by their delay; most false alarms are allowed where paths are expected."""

    tail: NullTail
    config: MaximumLikelihoodConfig
    bin_s: float
    n_bins: int

    def first(self, delay_bins: FloatArray) -> FloatArray:
        """Level (path,) that a path needs as the strongest of a stop."""
        early, late = (1e-9 * ns / self.bin_s for ns in self.config.expected_delay_ns)
        return self._inside(delay_bins, early, late)

    def further(self, delay_bins: FloatArray, strongest_bins: float, known: FloatArray) -> FloatArray:
        """Level (path,) of the others, with the delay of the strongest path known.

        `known` (path,) is the share of each path in beam pairs whose phases other paths determine.
        """
        before, after = (
            1e-9 * ns / self.bin_s for ns in (self.config.delay_before_ns, self.config.delay_after_ns)
        )
        return self._inside(delay_bins, strongest_bins - before, strongest_bins + after, known)

    @property
    def lowest(self) -> float:
        """The lowest level of any path."""
        return float(min(self.first(np.zeros(1))[0], self.further(np.zeros(1), 0.0, np.zeros(1))[0]))

    def _inside(
        self, delay_bins: FloatArray, early: float, late: float, known: FloatArray | float = 0.0
    ) -> FloatArray:
        probability, n_near = self.config.false_alarm_probability, late - early
        if n_near >= self.n_bins:
            return np.full(len(delay_bins), self._between(probability, self.n_bins, known))
        near = self._between(NEAR_SHARE * probability, n_near, known)
        other = self._between((1 - NEAR_SHARE) * probability, self.n_bins - n_near, known)
        return np.where((delay_bins - early) % self.n_bins <= n_near, near, other)

    def _between(self, probability: float, n_bins: float, known: FloatArray | float) -> FloatArray:
        """Level between those of unknown and known phases, by the share of the latter."""
        ends = (
            self.tail.threshold(probability, n_bins),
            self.tail.coherent_threshold(probability, n_bins, self.n_bins),
        )
        return np.asarray(ends[0] + known * (ends[1] - ends[0]))


@lru_cache(maxsize=8)
def null_tail(tx: Manifold, rx: Manifold) -> NullTail:
    """The tail for two ends; the noise of the RX beams is taken as equal: small differences matter little."""
    tx_profile, tx_slope, tx_cell = _patterns(tx)
    rx_profile, rx_slope, rx_cell = _patterns(rx)
    terms = [
        _terms(tx_profile[i], tx_slope[i], rx_profile[j], rx_slope[j], tx_cell[i] * rx_cell[j])
        for i, j in product(range(len(tx_profile)), range(len(rx_profile)))
    ]
    mean, variance, log_weight = (np.concatenate(part) for part in zip(*terms, strict=True))
    curvatures = region_curvatures(direction_curvatures(tx), direction_curvatures(rx))
    return NullTail(mean, variance, log_weight, curvatures)


def _patterns(manifold: Manifold) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Power shares (direction, beam), slopes (direction, angle, beam) of log amplitude, and cell areas."""
    azimuth = _thinned(manifold.azimuths(), _DIRECTIONS if manifold.n_angles == 1 else 8)
    elevation = _thinned(manifold.elevations(), 3)
    width = np.ptp(manifold.azimuths()) / len(azimuth)
    if manifold.n_angles == 1:
        angles, cell = azimuth[:, None], np.full(len(azimuth), width)
    else:
        angles = np.array(list(product(azimuth, elevation)))
        cell = np.full(len(angles), width * np.ptp(manifold.elevations()) / len(elevation))
    tangents = manifold.tangents(angles)
    power = np.abs(tangents[:, 0]) ** 2
    total = power.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.real(tangents[:, 1:] * tangents[:, :1].conj()) / power[:, None]
    seen = total[:, 0] > 0
    slope = np.where(power[:, None] > 1e-9 * total[:, None], slope, 0.0)
    return power[seen] / total[seen], slope[seen], cell[seen]


def _thinned(values: FloatArray, most: int) -> FloatArray:
    """At most this many of evenly spaced values, evenly spaced again and away from the ends."""
    n = min(most, len(values))
    return np.asarray(np.interp((np.arange(n) + 0.5) / n, np.linspace(0, 1, len(values)), values))


def _terms(
    tx_profile: FloatArray, tx_slope: FloatArray, rx_profile: FloatArray, rx_slope: FloatArray, cell: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Terms (power,) of one pair of directions."""
    share = np.outer(tx_profile, rx_profile)
    m, n = np.nonzero(share > _WEAKEST * share.max())
    snr = np.exp(_LOG_POWER)[:, None] * share[m, n]
    mean, variance = (np.interp(snr, _TABLE_SNR, table).sum(axis=1) for table in _moments())
    a, b = pair_information(snr)
    slopes = np.concatenate([np.ones((1, len(m))), tx_slope[:, m], rx_slope[:, n]])
    shape = np.einsum("ap,sp,bp->sab", slopes, 4 * a, slopes)
    delay = 2 * (b * snr).sum(axis=1) * np.pi**2 / 3
    n_parameters = len(slopes) + 1
    _, log_volume = np.linalg.slogdet(shape)
    # A step of log power is half a step of log amplitude.
    log_weight = (log_volume + np.log(delay) - n_parameters * np.log(2 * np.pi)) / 2
    log_weight += np.log(cell * (_LOG_POWER[1] - _LOG_POWER[0]) / 2)
    log_weight[~np.isfinite(log_weight)] = -np.inf
    return mean + n_parameters / 2, np.maximum(variance, 1e-9), log_weight


@cache
def _moments() -> tuple[FloatArray, FloatArray]:
    """Mean and variance of log I0(2 sqrt(s) |sqrt(s) + w|) - s over the table of SNRs s, by quadrature."""
    node, weight = np.polynomial.legendre.leggauss(160)
    centre = np.sqrt(_TABLE_SNR)[:, None]
    low, high = np.maximum(centre - 7.0, 0.0), centre + 7.0
    amplitude = (low + high) / 2 + (high - low) / 2 * node
    argument = 2 * centre * amplitude
    density = 2 * amplitude * np.exp(-np.square(amplitude - centre)) * i0e(argument)
    share = density * weight * (high - low) / 2
    ratio = np.log(i0e(argument)) + argument - _TABLE_SNR[:, None]
    mean = (share * ratio).sum(axis=1)
    return mean, (share * np.square(ratio)).sum(axis=1) - mean**2
