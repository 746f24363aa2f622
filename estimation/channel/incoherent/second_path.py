"""Hidden second paths: Rao's score test for a path close to a known one.

Two paths within a resolution cell look like one path that fits both on average, with a small residual. The test is
the score of a further amplitude at zero, weighted by the information that no change of the known paths' parameters
could explain (Rao 1948). It predicts the gain in likelihood to second order without a fit.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from estimation.channel.incoherent.likelihood import LinkBeams, LocalSamples, Score, log_likelihood_gradient
from estimation.channel.incoherent.spectrum import delay_waves
from estimation.channel.model.phase_information import pair_information
from scenes.record import ComplexArray, FloatArray, IntArray

_OFFSET = 0.5  # of a resolution cell, from a path to its probes along one axis
_CORNER = 0.4  # and along every axis to the probes between the axes
_DARK = 1e-6  # of the best probe's information: below it no beam covers a probe
_MOST_TRIALS = 4
_BRIGHT = 0.1  # least SNR of a path in a pair that is informative about a second path
_HIDING = 8.0  # of the least gain: least energy of a path that can hide another one
_KEPT_PROMISE = 0.5
_LEAST_OWN_SHARE = 0.03  # of a probe's information, always taken as independent of the known paths
_FLOOR = 1e-6  # of the equilibrated information of the known paths: phases may be unobservable


def second_path_start(
    local: LocalSamples, ends: LinkBeams, paths: FloatArray, at: Score, least_gain: float
) -> FloatArray | None:
    """The likeliest further path (1, parameter) next to a known one; None if no predicted gain reaches
    `least_gain`.

    The prediction is of second order, for signals of a pair well above or well below its noise. If it fails, with
    the known paths fixed, the next best probe is tried.
    """
    hiding = ends.energies(paths) * local.n_bins > _HIDING * least_gain
    if not hiding.any():
        return None
    known = _known(local, ends, paths)
    scores = []
    for path in paths[hiding]:
        probes = _probes(ends, path[None])
        bright = np.abs(ends.amplitudes(path[None])[local.pair, 0]) ** 2 * local.n_bins > _BRIGHT
        scores.append((probes, *_score(local, ends, known, at, probes, np.flatnonzero(bright))))
    probes, pull, own, cross = (np.concatenate(part) for part in zip(*scores, strict=True))
    energy = np.einsum("qaa->q", own)
    seen = energy > _DARK * energy.max()
    probes, pull, own, cross, energy = (part[seen] for part in (probes, pull, own, cross, energy))
    scale = 1 / np.sqrt(np.maximum(np.diagonal(at.information), 1e-9))
    equilibrated = at.information * np.outer(scale, scale) + _FLOOR * np.eye(len(scale))
    taken = (cross * scale) @ np.linalg.inv(equilibrated) @ (cross * scale).swapaxes(1, 2)
    own_share = own - taken + _LEAST_OWN_SHARE * energy[:, None, None] * np.eye(2)
    own = own + _FLOOR * energy[:, None, None] * np.eye(2)
    amplitude, alone = (np.linalg.solve(matrix, pull[..., None])[..., 0] for matrix in (own_share, own))
    gain, gain_alone = ((value * pull).sum(axis=1) / 2 for value in (amplitude, alone))
    for probe in np.argsort(-gain)[:_MOST_TRIALS]:
        if gain[probe] < least_gain:
            break
        start = _with_amplitude(probes[[probe]], alone[probe])
        rise = log_likelihood_gradient(local, ends, np.concatenate([paths, start])).value - at.value
        if rise > _KEPT_PROMISE * gain_alone[probe]:
            return start
    return None


def _with_amplitude(probe: FloatArray, amplitude: FloatArray) -> FloatArray:
    """A probe (1, parameter) with a real and imaginary amplitude (2,)."""
    path = probe.copy()
    path[0, -2] = np.log(max(float(np.hypot(*amplitude)), 1e-300))
    path[0, -1] = np.arctan2(amplitude[1], amplitude[0])
    return path


def _probes(ends: LinkBeams, paths: FloatArray) -> FloatArray:
    """Paths (probe, parameter) of unit gain around every path, along its delay and angles and between them."""
    step = ends.cells(paths)
    n = step.shape[1]
    corners = np.array(list(product((-1.0, 1.0), repeat=n)))
    moves = np.concatenate([_OFFSET * np.eye(n), -_OFFSET * np.eye(n), _CORNER * corners])
    probes = np.repeat(paths, len(moves), axis=0)
    probes[:, :-2] += (step[:, None] * moves).reshape(len(probes), -1)
    probes[:, -2:] = 0.0
    return probes


@dataclass(frozen=True)
class _Derivatives:
    """The pairs' signals and their derivatives, factor x wave for every column, and products of the two."""

    signal: ComplexArray  # (rank, pair)
    factor: ComplexArray  # (pair, column)
    wave: FloatArray  # (rank, column)
    along: ComplexArray  # (pair, column), mu^H d


def _known(local: LocalSamples, ends: LinkBeams, paths: FloatArray) -> _Derivatives:
    """Signals and derivatives over all parameters of the known paths."""
    tx, rx = ends.responses(paths)
    tx, rx = tx[:, :, local.tx_beam], rx[:, :, local.rx_beam]
    amplitude = tx[:, 0] * rx[:, 0]
    factors = [amplitude]
    factors += [tx[:, 1 + k] * rx[:, 0] for k in range(ends.tx.n_angles)]
    factors += [tx[:, 0] * rx[:, 1 + k] for k in range(ends.rx.n_angles)]
    factors += [amplitude, 1j * amplitude]
    factor = np.stack(factors, axis=1)
    wave, slope = (local.basis.T @ part for part in delay_waves(local.bins, paths[:, 0], local.n_bins))
    signal = wave @ amplitude
    waves = np.repeat(wave[:, :, None], len(factors), axis=2)
    waves[:, :, 0] = slope
    factor, waves = factor.reshape(-1, len(local.tx_beam)).T, waves.reshape(len(wave), -1)
    return _Derivatives(signal, factor, waves, factor * (signal.conj().T @ waves))


def _score(
    local: LocalSamples, ends: LinkBeams, known: _Derivatives, at: Score, probes: FloatArray, pair: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scores (probe, 2) of the real and imaginary amplitude of probes, and their information.

    The information is that of the probes (probe, 2, 2), and that shared with the parameters of the known paths
    (probe, 2, path * parameter); of some pairs.
    """
    factor = ends.amplitudes(probes)[local.pair[pair]]
    wave = local.basis.T @ delay_waves(local.bins, probes[:, 0], local.n_bins)[0]
    along = factor * (known.signal[:, pair].conj().T @ wave)
    matched = (local.samples[:, pair].T @ wave) * at.pair_phasor[pair].conj()[:, None]
    pull = 2 * ((factor.conj() * matched).sum(axis=0) - along.conj().sum(axis=0))
    snr = np.maximum(at.pair_snr[pair], 1e-12)
    a, b = pair_information(snr)
    across, beside, kept = 2 * b, 2 * b / snr, 4 * a / snr**2
    power = (np.abs(factor) ** 2 * across[:, None]).sum(axis=0) * (wave**2).sum(axis=0)
    power -= (np.abs(along) ** 2 * beside[:, None]).sum(axis=0)
    parts = np.stack([along.real, -along.imag], axis=2)
    own = np.einsum("pqa,p,pqb->qab", parts, kept, parts) + power[:, None, None] * np.eye(2)
    shared = (factor.conj() * across[:, None]).T @ known.factor[pair] * (wave.T @ known.wave)
    shared -= (along.conj() * beside[:, None]).T @ known.along[pair]
    cross = np.stack([shared.real, shared.imag], axis=1)
    cross += np.einsum("pqa,pc->qac", parts * kept[:, None, None], known.along[pair].real, optimize=True)
    return np.stack([pull.real, pull.imag], axis=1), own, cross
