"""The drift of the receiver's clock against all paths of a coherent fit.

A drift moves the delays of every path from one beam pair to the next. Side lobes show a strong path in all pairs
of a sweep, with others beside it there. So the drift is found with all paths known, together with their amplitudes
and mean delays, by linear least squares. Beams that err do so together over the pairs of a TX beam: the variance
is that of the sums over TX beams. Paths that were fitted to a sweep with a drift explain a part of it: so they are
fitted again without what was found.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.clock_drift import (
    DRIFTING,
    WANDERING,
    ClockDrift,
    mean_pairs,
    posterior,
    prior_variance,
    without_drift,
)
from estimation.channel.incoherent.likelihood import LinkBeams, paths_towards
from estimation.channel.model.factors import pair_products
from estimation.channel.phases.pairs import SweepModel
from scenes.record import ComplexArray, FloatArray
from sim.observation import BeamSweep

MOST_PATHS = 16  # the strongest, of which the drift is found
LEAST_BEAMS = 4  # TX beams, whose sums tell the variance
DOUBTED = 2.0  # standard deviations of a drift that is worth a closer look
MOST_TURNS = 4  # fits without the drift found so far


def drift_against(sweep: BeamSweep, fit: PathFit, removed: ClockDrift, odds: float = WANDERING) -> ClockDrift:
    """The drift of a clock, of these `odds` before the samples, in seconds from one beam pair to the next.

    The sweep is free of the drift `removed`. The phases of pairs are free, and the fit has few paths: many
    explain a drift by paths that are none.
    """
    if not _is_shown(sweep, fit):
        return removed
    change, variance = _drift_left(sweep, fit)
    return posterior(removed.per_pair + change, variance, prior_variance(_period_s(sweep)), odds)


def may_drift(sweep: BeamSweep, fit: PathFit) -> bool:
    """Whether a fit of all paths leaves more of a drift than chance does in most stops."""
    if not _is_shown(sweep, fit):
        return False
    change, variance = _drift_left(sweep, fit)
    return change**2 > DOUBTED**2 * variance


def settled_drift(sweep: BeamSweep, fitted: Callable[[BeamSweep], PathFit], start_s: float) -> ClockDrift:
    """The drift of a clock, in seconds from one beam pair to the next, where it is near `start_s`.

    `fitted` gives some paths of a sweep. They are fitted without the drift that is found, until it stays.
    """
    found_s, variance = start_s, np.inf
    for _ in range(MOST_TURNS):
        steady = without_drift(sweep, found_s)
        fit = fitted(steady)
        if not _is_shown(steady, fit):
            return ClockDrift(start_s)
        change, variance = _drift_left(steady, fit)
        found_s += change
        if change**2 <= variance:
            break
    return posterior(found_s, variance, prior_variance(_period_s(sweep)), DRIFTING)


def with_drift_errors(sweep: BeamSweep, fit: PathFit, drift: ClockDrift) -> PathFit:
    """The fit of a sweep free of a drift; what is not known of the drift is part of the covariances of delays."""
    tx, rx = nominal_manifold(sweep.tx_codebook), nominal_manifold(sweep.rx_codebook)
    seen = mean_pairs(LinkBeams(tx, rx, sweep.noise_power_mw), paths_towards(fit.aod_rad, fit.aoa_rad))
    covariance = fit.covariance.copy()
    covariance[:, 0, 0] += drift.variance * np.square(seen)
    return replace(fit, covariance=covariance)


def _is_shown(sweep: BeamSweep, fit: PathFit) -> bool:
    """Whether there are paths, and beams enough to tell a drift."""
    return len(fit) > 0 and sweep.samples.shape[0] >= LEAST_BEAMS


def _period_s(sweep: BeamSweep) -> float:
    return float((sweep.samples.shape[2] - 1) / np.ptp(sweep.frequency_offset_hz))


def _drift_left(sweep: BeamSweep, fit: PathFit) -> tuple[float, float]:
    """The drift that the paths of a fit leave, in seconds from one beam pair to the next, and its variance."""
    model = SweepModel.of(sweep, fit)
    tx, rx, gain, wave = model.tx, model.rx, model.gain, model.wave
    best = np.sort(np.argsort(-fit.snr_db, kind="stable")[:MOST_PATHS])
    slope = -2j * np.pi * sweep.frequency_offset_hz * wave[best]
    both = np.concatenate([wave[best], slope.astype(np.complex64)]).conj().T
    n_tx, n_rx = sweep.samples.shape[:2]
    matched = np.empty((n_tx, n_rx, 2, len(best)), complex)
    for beam, (expected, samples) in enumerate(model.blocks(sweep)):
        turn = np.exp(1j * np.angle((expected.conj() * samples).sum(axis=1))).astype(np.complex64)
        left = samples * turn.conj()[:, None] - expected
        share = ((gain * tx[:, beam])[:, None] * rx)[best].conj().T / sweep.noise_power_mw[:, None]
        matched[beam] = (left @ both).reshape(n_rx, 2, -1) * share[:, None]
    place = np.arange(n_tx * n_rx).reshape(n_tx, n_rx) / (n_tx * n_rx) - 0.5
    weighted = [_pair_products(gain[best], tx[best], rx[best], sweep.noise_power_mw, place, k) for k in range(3)]
    value, variance = _least_squares(matched, weighted, both, place)
    return value / place.size, variance / place.size**2


def _pair_products(
    gain: ComplexArray, tx: ComplexArray, rx: ComplexArray, noise_mw: FloatArray, place: FloatArray, power: int
) -> ComplexArray:
    """Sums (path, path) over pairs of the products of two paths' amplitudes, times a power of the place."""
    flat = pair_products(gain[:, None] * tx, rx / np.sqrt(noise_mw))
    return np.asarray(flat.conj() * place.ravel() ** power @ flat.T)


def _least_squares(
    matched: ComplexArray, weighted: list[ComplexArray], both: ComplexArray, place: FloatArray
) -> tuple[float, float]:
    """Delay from one end of the sweep to the other and its variance, with amplitudes and delays of paths free.

    `matched` (tx_beam, rx_beam, wave or slope, path) is the residual against the paths.
    """
    n = weighted[0].shape[0]
    gram = both.conj().T @ both
    waves, mixed, slopes = gram[:n, :n].conj(), gram[:n, n:].conj(), gram[n:, n:].conj()
    amplitudes, cross, delays = weighted[0] * waves, weighted[0] * mixed, weighted[0] * slopes
    matrix = np.block(
        [
            [amplitudes.real, -amplitudes.imag, cross.real],
            [amplitudes.imag, amplitudes.real, cross.imag],
            [cross.real.T, cross.imag.T, delays.real],
        ]
    )
    late = np.sum(weighted[1] * mixed, axis=1), np.sum(weighted[1] * slopes, axis=1)
    beside = np.concatenate([late[0].real, late[0].imag, late[1].real])
    own = float(np.sum(weighted[2] * slopes).real)
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    share = np.linalg.lstsq(matrix / np.outer(scale, scale), beside / scale, rcond=1e-10)[0] / scale
    per_pair = place[:, :, None] * matched[:, :, 1].real
    parts = np.concatenate([matched[:, :, 0].real, matched[:, :, 0].imag, matched[:, :, 1].real], axis=2)
    score = (per_pair.sum(axis=2) - parts @ share).sum(axis=1)
    information = own - float(beside @ share)
    scattered = float(np.square(score - score.mean()).sum()) * len(score) / (len(score) - 1)
    return float(score.sum()) / information, max(scattered / information**2, 0.5 / information)
