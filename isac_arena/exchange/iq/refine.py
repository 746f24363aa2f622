"""What synchronisation leaves of frequency and sampling offset, from the phases and delays of fitted paths.

The paths of a sweep stand still while it lasts. So the phase of a path grows over its beam pairs with the
frequency that is left, and its delay with the drift. The drift comes first: without it the delay profiles of beam
pairs add up to a sharper one. Then the frequency, from a few incoherent paths, whose phases have no common zero.
Then both, jointly with coherent paths.
"""

from dataclasses import replace

import numpy as np

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.paths import fit_incoherent
from estimation.channel.phases.pairs import LEAST_SNR, phases_of
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.observation import BeamSweep

FEW, MORE = 12, 24  # paths
LARGEST_HZ = 4000.0  # left by synchronisation, whose prefixes are short
SAME = 0.999  # of the largest sum: of such frequencies the smallest is taken
LARGEST_GROWTH_S = 400e-9  # of the delays over a sweep, left by synchronisation
GROUPS, OF_GROUP, LAGS = (
    64,
    8,
    64,
)  # parts of a sweep, pairs of each, and differences of subcarriers that tell a drift
PER_CYCLE = 8  # trial frequencies in a cycle over the sweep
TURNS, INNER_STEPS = 5, 6
SETTLED = 0.1  # of a standard deviation: smaller steps are not followed
LEAST_INFORMATION = 1e-10  # share of the largest: below it is rounding


Steps = tuple[tuple[float, float], tuple[float, float]]  # of frequency and drift, with standard deviations


def left_over(sweep: BeamSweep, time_s: FloatArray) -> tuple[float, float]:
    """The frequency in Hz and the drift that are left in a sweep; `time_s` (tx_beam, rx_beam) are its times.

    Delays stay as they are in the middle of the sweep.
    """
    few, more = (MaximumLikelihoodConfig(max_paths=count) for count in (FEW, MORE))
    time_s = time_s - time_s.mean()
    if np.ptp(time_s) == 0:
        return 0.0, 0.0
    drift = _sharpest(sweep, time_s)
    found = fit_incoherent(_without(sweep, time_s, 0.0, drift), few)
    if not len(found):
        return 0.0, 0.0
    pairs = phases_of(found)
    used = (pairs.snr > LEAST_SNR) & pairs.is_usable
    frequency = _frequency(time_s[used], pairs.phase_rad[used], pairs.snr[used], pairs.path[used])
    for _ in range(TURNS):
        now = _without(sweep, time_s, frequency, drift)
        fit = fit_over_background(now, more)
        if not len(fit):
            break
        steps = _joint(now, fit, time_s)
        frequency, drift = frequency + steps[0][0], drift + steps[1][0]
        if all(abs(step) <= SETTLED * std for step, std in steps):
            break
    return frequency, drift


def _sharpest(sweep: BeamSweep, time_s: FloatArray) -> float:
    """The drift without which the mean delay profile of beam pairs is sharpest, its square largest.

    The transform of a profile is the correlation of the channel over differences of subcarriers; a delay turns it.
    """
    energy = np.square(np.abs(sweep.samples)).mean(axis=2)
    order = np.argsort(time_s.ravel(), kind="stable")
    groups = np.array_split(order, min(GROUPS, len(order)))
    pairs = np.concatenate([one[np.argsort(energy.ravel()[one])[::-1][:OF_GROUP]] for one in groups])
    channel = (sweep.samples * sweep.prs_symbol[:, None, :].conj()).reshape(-1, sweep.samples.shape[2])[pairs]
    n = channel.shape[1]
    lags = np.unique(np.linspace(1, n - 1, min(LAGS, n - 1)).astype(int))
    level = np.square(np.abs(channel)).mean(axis=1)
    noise = np.broadcast_to(sweep.noise_power_mw, energy.shape).ravel()[pairs]
    weight = np.maximum(level - noise, 0.0) / np.maximum(level, np.finfo(float).tiny) ** 2
    correlation = weight * np.stack([(channel[:, lag:] * channel[:, :-lag].conj()).sum(axis=1) for lag in lags])
    step_hz = float(sweep.frequency_offset_hz[1] - sweep.frequency_offset_hz[0])
    growth_s = np.arange(-LARGEST_GROWTH_S, LARGEST_GROWTH_S, 1 / (PER_CYCLE * n * step_hz))
    trials = np.append(0.0, growth_s / np.ptp(time_s))
    turn = 2j * np.pi * step_hz * np.outer(lags, time_s.ravel()[pairs])
    sharpness = [np.square(np.abs((correlation * np.exp(turn * one)).sum(axis=1))).sum() for one in trials]
    return float(trials[np.argmax(sharpness)])


def _without(sweep: BeamSweep, time_s: FloatArray, frequency_hz: float, drift: float) -> BeamSweep:
    """The sweep without a frequency, and without delays that grow with the time."""
    turn = frequency_hz * time_s[..., None] - drift * time_s[..., None] * sweep.frequency_offset_hz
    return replace(sweep, samples=(sweep.samples * np.exp(-2j * np.pi * turn)).astype(np.complex64))


def _frequency(time_s: FloatArray, phase_rad: FloatArray, snr: FloatArray, path: IntArray) -> float:
    """The frequency in Hz at which the phases of all paths add up best, each with a zero of its own."""
    if not len(time_s) or np.ptp(time_s) == 0:
        return 0.0
    step_hz = 1 / (PER_CYCLE * np.ptp(time_s))
    n = np.arange(1, np.floor(LARGEST_HZ / step_hz) + 1)
    trial_hz = step_hz * np.append(0.0, np.column_stack([n, -n]))
    total = np.zeros(len(trial_hz))
    for one in np.unique(path):
        mine = path == one
        phasor = np.sqrt(snr[mine]) * np.exp(1j * phase_rad[mine])
        total += np.abs(np.exp(-2j * np.pi * np.outer(trial_hz, time_s[mine])) @ phasor)
    return float(trial_hz[np.argmax(total >= SAME * total.max())])


def _joint(sweep: BeamSweep, fit: PathFit, time_s: FloatArray) -> Steps:
    """Frequency in Hz and drift of largest likelihood together with the paths of a fit, and their deviations."""
    kept = fit.take("path", ~fit.is_weak) if not fit.is_weak.all() else fit
    gain = kept.amplitude * np.exp(1j * kept.phase_rad)
    total, std = np.zeros(2), np.zeros(2)
    for _ in range(INNER_STEPS):
        now = _without(sweep, time_s, *total)
        step, common, std = _step(now, replace(kept, amplitude=np.abs(gain), phase_rad=np.angle(gain)), time_s)
        total = total + common
        n_aod = kept.aod_rad.shape[1]
        gain = gain * np.exp(np.clip(step[0], -1, 1) + 1j * step[1])
        kept = replace(
            kept,
            aod_rad=kept.aod_rad + step[2 : 2 + n_aod].T,
            aoa_rad=kept.aoa_rad + step[2 + n_aod : -1].T,
            delay_s=kept.delay_s + step[-1],
        )
    return (float(total[0]), float(std[0])), (float(total[1]), float(std[1]))


def _step(sweep: BeamSweep, fit: PathFit, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A Gauss-Newton step: of the paths (kind, path), and of frequency and drift (2,) with their deviations (2,).

    Kinds are log gain, phase, angles and delay. Each derivative of the model is a sum of products of a factor over
    beam pairs and one over subcarriers, so its Gram is small.
    """
    tx = nominal_manifold(sweep.tx_codebook).tangents(fit.aod_rad)  # (path, 1 + angle, beam)
    rx = nominal_manifold(sweep.rx_codebook).tangents(fit.aoa_rad)
    gain, frequency_hz = fit.amplitude * np.exp(1j * fit.phase_rad), sweep.frequency_offset_hz
    wave = np.exp(-2j * np.pi * fit.delay_s[:, None] * frequency_hz)
    slope = -2j * np.pi * frequency_hz * wave
    noise = np.sqrt(sweep.noise_power_mw)

    def pairs(tx_kind: int, rx_kind: int) -> ComplexArray:
        return np.asarray(gain[:, None, None] * tx[:, tx_kind, :, None] * rx[:, rx_kind, None])

    both = pairs(0, 0)  # (path, tx_beam, rx_beam)
    turned = [pairs(kind, 0) for kind in range(1, tx.shape[1])] + [
        pairs(0, kind) for kind in range(1, rx.shape[1])
    ]
    on_wave = np.stack([both, 1j * both, *turned, 2j * np.pi * both * time_s]) / noise  # the last of frequency,
    on_slope = np.stack([both, both * time_s]) / noise  # and of drift
    n_paths, n_wave = len(gain), len(on_wave)
    terms = np.concatenate([on_wave, on_slope]).reshape((n_wave + 2) * n_paths, -1)
    waves = np.concatenate([np.tile(wave, (n_wave, 1)), np.tile(slope, (2, 1))])
    gram = (terms.conj() @ terms.T) * (waves.conj() @ waves.T)
    left = sweep.samples * sweep.prs_symbol[:, None, :].conj() - np.einsum("ptr,pk->trk", both, wave)
    left = (left / noise[:, None]).reshape(terms.shape[1], -1)
    seen = left @ np.concatenate([wave, slope]).conj().T  # (pair, path of either kind)
    path = np.arange(len(terms)) % n_paths + n_paths * (np.arange(len(terms)) >= n_wave * n_paths)
    product = np.einsum("ap,pa->a", terms.conj(), seen[:, path])
    # Frequency and drift are those of all paths: their terms add up
    shared = [np.arange(at * n_paths, (at + 1) * n_paths) for at in (n_wave - 1, n_wave + 1)]
    own = np.delete(np.eye(len(terms)), np.concatenate(shared), axis=1)
    collect = np.column_stack([own, *(np.isin(np.arange(len(terms)), one) for one in shared)])
    information = 2 * (collect.T @ gram @ collect).real
    gradient = 2 * (collect.T @ product).real
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information), np.finfo(float).tiny))
    inverse = np.linalg.pinv(information * np.outer(scale, scale), rcond=LEAST_INFORMATION, hermitian=True)
    step = scale * (inverse @ (scale * gradient))
    std = scale * np.sqrt(np.diagonal(inverse))
    return step[:-2].reshape(-1, n_paths), step[-2:], std[-2:]
