"""Starting points for the joint fit: likelihood ratios of candidates on the search grid."""

from __future__ import annotations

import numpy as np
from scipy.special import i0e

from estimation.channel.incoherent_likelihood import Ends
from estimation.channel.incoherent_screen import Candidates, Screen
from scenes.record import ComplexArray, FloatArray

_AMPLITUDES = np.geomspace(0.5, 1.5, 6)  # tried for a candidate, relative to its mean over the pairs
_PHASE_KNOWN = 0.5  # |mu^H y| above which a pair's phase is known: I1(2x) / I0(2x) is near x / (x + 1/2)
_WEAKEST = 1e-3  # share of the strongest pair's SNR below which pairs are left out


def starting_points(
    screen: Screen,
    ends: Ends,
    candidates: Candidates,
    matched: ComplexArray,
    phasor: ComplexArray,
    n_bins: int,
) -> tuple[FloatArray, FloatArray]:
    """Parameters (candidate, parameter) and log-likelihood ratios (candidate,) of candidates.

    Parameters ---------- matched : (pair, candidate) samples matched to the candidate's delay, of unit noise
    power, known paths removed phasor : (pair,) phase of every pair as far as the known paths tell, 0 where
    they do not; where they or earlier
        candidates do, a candidate is matched in phase as well, and the larger ratio counts
    """
    tx_angles, rx_angles = (
        screen.tx_angles[candidates.tx_direction],
        screen.rx_angles[candidates.rx_direction],
    )
    tx, rx = ends.tx.response(tx_angles), ends.rx.response(rx_angles) / np.sqrt(ends.noise_mw)
    norm = np.linalg.norm(tx, axis=1) * np.linalg.norm(rx, axis=1)
    log_amplitude, phase, ratio = (np.zeros(len(candidates)) for _ in range(3))
    phasor = phasor.copy()
    for i in range(len(candidates)):
        share = np.outer(np.abs(tx[i]), np.abs(rx[i])).ravel() / norm[i]
        used = np.flatnonzero(share**2 > _WEAKEST * share.max() ** 2)
        m, n = np.divmod(used, rx.shape[1])
        shape, received, known = tx[i, m] * rx[i, n] / norm[i], matched[used, i], phasor[used]
        in_phase = np.vdot(shape * known, received)
        amplitude, ratio[i] = _best_amplitude(share[used], np.abs(received))
        if abs(in_phase) ** 2 > ratio[i]:
            amplitude, ratio[i] = abs(in_phase), abs(in_phase) ** 2
        log_amplitude[i] = np.log(amplitude / (norm[i] * np.sqrt(n_bins)))
        phase[i] = np.angle(in_phase)
        strength = amplitude * (shape * np.exp(1j * phase[i])).conj() * received
        told = strength / (np.abs(strength) + _PHASE_KNOWN)
        phasor[used] = np.where(np.abs(told) > np.abs(known), told, known)
    return np.column_stack([candidates.delay_bins, tx_angles, rx_angles, log_amplitude, phase]), ratio


def _best_amplitude(share: FloatArray, amplitude: FloatArray) -> tuple[float, float]:
    """Amplitude over all pairs and the log-likelihood ratio of a path with these shares (pair,) of amplitude."""
    trial = (share @ amplitude) / (share @ share) * _AMPLITUDES
    signal = trial[:, None] * share
    argument = 2 * signal * amplitude
    ratio = (np.log(i0e(argument)) + argument - signal**2).sum(axis=1)
    best = int(np.argmax(ratio))
    return float(trial[best]), float(ratio[best])
