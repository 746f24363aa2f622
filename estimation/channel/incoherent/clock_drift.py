"""The drift of the receiver's clock during a sweep: delays that grow from one beam pair to the next.

A clock that is 0.01 ppm fast shifts delays by 0.3 ns over a sweep of 30 ms, a hundred times the error by noise.
Every path that dominates several beam pairs shows the drift in the delays of these pairs, up to a constant. Other
paths in a pair shift its delay too, so the pairs of one path err together, as beams at several elevations do one
after the other: the drift is the mean over paths, with an error of each, and with their scatter where it is larger
(DerSimonian and Laird, 1986).
"""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.incoherent.likelihood import LinkBeams
from estimation.channel.incoherent.spectrum import delay_waves
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray
from sim.observation import BeamSweep
from sim.signal.waveform.prs import PREFIX_SHARE

DOMINANT = 30.0  # energy of a path in a pair over that of all others, and over the noise
LEAST_PHASOR = 0.9  # of the expectation of a known phase
LEAST_PAIRS = 6  # of a path
MISLED_BINS = 1 / np.pi / np.sqrt(3 * DOMINANT)  # rms over a sweep, by a path a bin away in each dominated pair
STEPS = 20  # of the weighted fit
LARGEST_PPM = 0.1  # frequency error of a synchronised receiver, TS 38.101-2 clause 6.4.1
DRIFTING, WANDERING = 0.01, 1.0  # odds of a drift that matters, before the samples, and where phases wander


@dataclass(frozen=True)
class ClockDrift:
    """Growth of all delays from one beam pair to the next, in bins or in s, and its variance.

    Pairs follow each other with all RX beams of a TX beam in turn, as in the record.
    """

    per_pair: float = 0.0
    variance: float = 0.0

    @property
    def is_likely(self) -> bool:
        """Whether a clock that drifts is more likely than one that does not (see `posterior`)."""
        return self.per_pair**2 > self.variance


def clock_drift(
    ends: LinkBeams,
    paths: FloatArray,
    phasor: ComplexArray,
    residual: ComplexArray,
    bins: IntArray,
    n_bins: int,
    removed: ClockDrift,
    odds: float = DRIFTING,
) -> ClockDrift:
    """The drift that the residual (pair, bin) of fitted paths (path, parameter) shows.

    The mean over two hypotheses: no drift, or one within `LARGEST_PPM`, of these `odds` before the samples.
    `phasor` (pair,) is the phase of every pair; the samples are free of the drift `removed` already.
    """
    signal = ends.amplitudes(paths) * phasor[:, None]
    is_dominant = dominant_pairs(ends, paths, phasor, n_bins)
    _, slope = delay_waves(bins, paths[:, 0], n_bins)
    found = []
    for path in np.flatnonzero(is_dominant.sum(axis=0) >= LEAST_PAIRS):
        pair = np.flatnonzero(is_dominant[:, path])
        norm = np.square(np.abs(signal[pair, path])) * np.square(slope[:, path]).sum()
        shift = (residual[pair] @ slope[:, path] * signal[pair, path].conj()).real / norm
        value, variance = _slope(pair.astype(float), shift, 0.5 / norm)
        found.append((value, variance + (MISLED_BINS / len(phasor)) ** 2))
    if not found:
        return removed
    value, variance = _mean(np.array(found))
    return posterior(removed.per_pair + value, variance, prior_variance(n_bins), odds)


def dominant_pairs(ends: LinkBeams, paths: FloatArray, phasor: ComplexArray, n_bins: int) -> BoolArray:
    """Mask (pair, path) of the beam pairs in which one path is much stronger than the noise and all others.

    `phasor` (pair,) is the expected phase of every pair; pairs without one took no part in the fit.
    """
    energy = n_bins * np.square(np.abs(ends.amplitudes(paths)))
    rest = energy.sum(axis=1, keepdims=True) - energy
    return np.asarray((energy > DOMINANT * (1 + rest)) & (np.abs(phasor) > LEAST_PHASOR)[:, None])


def without_drift(sweep: BeamSweep, drift_s: float) -> BeamSweep:
    """The sweep with the delays of all beam pairs as the clock of the first shows them; `drift_s` is per pair."""
    if not drift_s:
        return sweep
    samples, n_rx = np.empty_like(sweep.samples), sweep.samples.shape[1]
    for beam, block in enumerate(sweep.samples):
        late_s = drift_s * (beam * n_rx + np.arange(n_rx))
        turn = np.exp(2j * np.pi * late_s[:, None] * sweep.frequency_offset_hz)
        samples[beam] = block * turn.astype(np.complex64)
    return replace(sweep, samples=samples)


def mean_pairs(ends: LinkBeams, paths: FloatArray) -> FloatArray:
    """Mean number (path,) of the beam pairs in which every path is seen, weighted by its energy there."""
    share = ends.energy_shares(paths)
    return np.asarray(np.arange(len(share)) @ share)


def _slope(position: FloatArray, shift: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Slope of shifts over the position and its variance; outliers count less (least absolute deviations)."""
    weight, slope, error = 1 / variance, 0.0, np.inf
    for _ in range(STEPS):
        centred = position - np.average(position, weights=weight)
        information = float(weight @ np.square(centred))
        slope = float(weight * centred @ shift) / information
        left = shift - np.average(shift, weights=weight) - slope * centred
        spread = 1.4826 * float(np.median(np.abs(left)))
        free = len(position) / (len(position) - 2)
        scattered = float(np.square(weight * centred * left).sum()) / information**2 * free
        error = max(1 / information, scattered)
        weight = 1 / np.maximum(variance, spread * np.maximum(spread, np.abs(left)))
    return slope, error


def _mean(found: FloatArray) -> tuple[float, float]:
    """Mean of slopes with their variances (path, 2) that scatter beyond these, and its variance."""
    value, variance = found.T
    weight = 1 / variance
    spread = weight @ np.square(value - np.average(value, weights=weight)) - (len(value) - 1)
    free = weight.sum() - np.square(weight).sum() / weight.sum()
    weight = 1 / (variance + (max(0.0, float(spread / free)) if len(value) > 1 else 0.0))
    return float(np.average(value, weights=weight)), float(1 / weight.sum())


def prior_variance(n_bins: float) -> float:
    """Variance of the bins per pair if the drift is uniform within `LARGEST_PPM`, with a symbol per pair.

    With the period of the delay spectrum in seconds in place of its bins it is in seconds.

    A symbol without cyclic prefix takes the period of the delay spectrum; a comb of two shortens that by half.
    """
    return ((1 + PREFIX_SHARE["normal"]) * n_bins * LARGEST_PPM * 1e-6) ** 2 / 3


def posterior(value: float, variance: float, prior: float, odds: float = DRIFTING) -> ClockDrift:
    """Mean and variance of the drift over both hypotheses, given its measured value and the odds before it."""
    total = variance + prior
    log_odds = (value**2 / variance - value**2 / total + np.log(variance / total)) / 2 + np.log(odds)
    probability = 1 / (1 + np.exp(-np.clip(log_odds, -500, 500)))
    mean, own = value * prior / total, variance * prior / total
    return ClockDrift(probability * mean, probability * (own + (1 - probability) * mean**2))
