"""Starting points for the joint fit: likelihood ratios of candidates on the search grid."""

import numpy as np

from estimation.channel.incoherent.grid_kernels import candidate_ratios
from estimation.channel.incoherent.likelihood import LinkBeams
from estimation.channel.incoherent.screen import Candidates, Screen
from scenes.record import ComplexArray, FloatArray

_AMPLITUDES = np.geomspace(0.5, 1.5, 6)  # trial amplitudes of a candidate, relative to its mean over the pairs
_PHASE_KNOWN = 0.5  # |mu^H y| above which a pair's phase is known: I1(2x) / I0(2x) is near x / (x + 1/2)
_WEAKEST = 1e-3  # share of the strongest pair's SNR below which pairs are left out


def starting_points(
    screen: Screen,
    ends: LinkBeams,
    candidates: Candidates,
    matched: ComplexArray,
    phasor: ComplexArray,
    n_bins: int,
) -> tuple[FloatArray, FloatArray]:
    """Parameters (candidate, parameter) and log-likelihood ratios (candidate,) of candidates.

    Parameters
    ----------
    matched
        (pair, candidate) samples matched to the candidate's delay, of unit noise power, known paths removed.
    phasor
        (pair,) phase of every pair if known paths determine it, else 0. If known paths or earlier candidates
        determine it, a candidate is matched in phase as well, and the larger ratio counts.
    """
    tx_angles, rx_angles = (screen.tx_angles[candidates.tx_direction], screen.rx_angles[candidates.rx_direction])
    tx, rx = ends.tx.response(tx_angles), ends.rx.response(rx_angles) / np.sqrt(ends.noise_mw)
    tx_norm, rx_norm = (np.linalg.norm(part, axis=1, keepdims=True) for part in (tx, rx))
    amplitude, phase, ratio = candidate_ratios(
        tx / tx_norm, rx / rx_norm, matched, phasor.copy(), _AMPLITUDES, _WEAKEST, _PHASE_KNOWN
    )
    log_amplitude = np.log(amplitude / ((tx_norm * rx_norm)[:, 0] * np.sqrt(n_bins)))
    return np.column_stack([candidates.delay_bins, tx_angles, rx_angles, log_amplitude, phase]), ratio
