"""The likelihood of paths when every beam pair has an unknown phase, and its maximum over all their parameters.

A pair receives y = exp(j psi) mu + w, mu = sum_i a_i v(x_i) over its delay bins. For uniform, marginalised psi

    log p(y) / p_noise(y) = sum over pairs of  log I0(2 |mu^H y|) - |mu|^2.

All paths of a pair share psi, so their relative phases count within it. Score and exact information are those of
`estimation.channel.model.phase_information`; Fisher scoring with Levenberg's damping finds the maximum.

Only the delay axis is compressed: to the span of the waves near the searched delays, which holds the signal of
every path found there and keeps white noise white.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1

from estimation.channel.incoherent.kernels import fill_lower_blocks, likelihoods_without, pair_scores
from estimation.channel.incoherent.spectrum import DelaySpectrum, delay_waves
from estimation.channel.model.factors import pair_products
from estimation.channel.model.manifold import CELL, Manifold
from estimation.channel.model.phase_information import pair_information
from estimation.inference.least_squares import Attempt, Schedule, minimise
from scenes.pose import wrap_angle
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray

_OUTSIDE_RAD = np.deg2rad(3.0)  # outside the directions that the beams cover: paths there are rejected
REACH_BINS = 1.0  # around the delay of every path, in which its wave is in the compressed span
_NODES = 6  # waves that span all waves of a reach to 1e-6
_NARROW_NODES = 10  # to 1e-10: likelihoods with fixed paths are compared with those of all paths
_RANK_TOLERANCE = 1e-10  # of the power of the strongest combination of waves
_TABLE_POINTS = 4000
MOST_STEPS = 30
FAINT = 0.03  # SNR of a path in a pair below which the pair is uninformative
_SCHEDULE = Schedule(MOST_STEPS, least=1e-5, largest=1e4 / 8, factor=8.0, good=0.7, poor=0.2)
_ENOUGH = 2e-3  # expected gain in log-likelihood at which the steps end: 0.06 standard deviations
HOPE = 10.0  # times the gain that a step expects: more is not gained by the steps that follow
_LARGEST_CELLS, _LARGEST_LOG_AMPLITUDE, _LARGEST_PHASE = 0.4, 0.7, 0.7  # of one step


def paths_towards(aod_rad: FloatArray, aoa_rad: FloatArray) -> FloatArray:
    """Paths (path, parameter) of unit amplitude and no delay in the given directions (path, angle)."""
    none = np.zeros((len(aod_rad), 1))
    return np.concatenate([none, aod_rad, aoa_rad, none, none], axis=1)


@dataclass(frozen=True)
class LinkBeams:
    """The beams of both ends, those of the receiver with their noise."""

    tx: Manifold
    rx: Manifold
    noise_mw: FloatArray  # (rx_beam,)

    @property
    def n_parameters(self) -> int:
        """Parameters of a path: delay, AoD angles, AoA angles, log amplitude, phase."""
        return 3 + self.tx.n_angles + self.rx.n_angles

    def responses(self, paths: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """TX factors with the gain and RX factors over the noise amplitude, each (path, 1 + angle, beam)."""
        n = self.tx.n_angles
        gain = np.exp(paths[:, -2] + 1j * paths[:, -1])
        tx = self.tx.tangents(paths[:, 1 : 1 + n]) * gain[:, None, None]
        rx = self.rx.tangents(paths[:, 1 + n : -2]) / np.sqrt(self.noise_mw)
        return tx, rx

    def amplitudes(self, paths: FloatArray) -> ComplexArray:
        """Amplitude (pair, path) of every path in every pair over the noise, for the wave of one delay bin."""
        return pair_products(*self._beams(paths)).T

    def energies(self, paths: FloatArray) -> FloatArray:
        """Energy (path,) of every path over all beam pairs and the noise, for the wave of one delay bin."""
        tx, rx = self._beams(paths)
        return np.asarray((np.abs(tx) ** 2).sum(axis=1) * (np.abs(rx) ** 2).sum(axis=1))

    def energy_shares(self, paths: FloatArray) -> FloatArray:
        """Share (pair, path) of every path's energy that each beam pair receives."""
        energy = np.square(np.abs(self.amplitudes(paths)))
        return np.asarray(energy / np.maximum(energy.sum(axis=0), 1e-300))

    def bright_pairs(self, paths: FloatArray, least: float) -> BoolArray:
        """Mask (pair,) of the brightest beam pairs that hold at least this share of the energy of every path."""
        share = self.energy_shares(paths)
        order = np.argsort(-share, axis=0, kind="stable")
        ranked = np.take_along_axis(share, order, axis=0)
        bright: BoolArray = np.zeros(len(share), bool)
        bright[order[np.cumsum(ranked, axis=0) - ranked < least]] = True
        return bright

    def known_phase_shares(self, paths: FloatArray, n_bins: int) -> FloatArray:
        """Share (path,) of every path's energy in beam pairs whose phases the other paths determine.

        A path of SNR g in a pair determines its phase by about g / (g + 1/2), the mean of the cosine of its error.
        """
        tx, rx = (np.square(np.abs(part)) for part in self._beams(paths))
        power = n_bins * tx[:, :, None] * rx[:, None]
        others = power.sum(axis=0) - power
        known = others / (others + 0.5)
        return np.asarray((power * known).sum(axis=(1, 2)) / np.maximum(power.sum(axis=(1, 2)), 1e-300))

    def _beams(self, paths: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        n = self.tx.n_angles
        gain = np.exp(paths[:, -2] + 1j * paths[:, -1])
        tx = self.tx.response(paths[:, 1 : 1 + n]) * gain[:, None]
        return tx, self.rx.response(paths[:, 1 + n : -2]) / np.sqrt(self.noise_mw)

    def cells(self, paths: FloatArray) -> FloatArray:
        """Width (path, 1 + angles) of a resolution cell along the delay in bins and the angles in rad."""
        n = self.tx.n_angles
        widths = [np.ones((len(paths), 1))]
        for manifold, angles in ((self.tx, paths[:, 1 : 1 + n]), (self.rx, paths[:, 1 + n : -2])):
            rate = manifold.rates(angles)
            widths.append(CELL / np.maximum(rate, CELL / np.pi))
        return np.concatenate(widths, axis=1)

    def distance_cells(self, paths: FloatArray, place: FloatArray) -> FloatArray:
        """Largest distance (path,) along any axis to a delay and angles (1 + angles,), in resolution cells."""
        offset = paths[:, :-2] - place
        offset[:, 1:] = wrap_angle(offset[:, 1:])
        return np.asarray((np.abs(offset) / self.cells(paths)).max(axis=1, initial=0.0))

    def in_sight(self, paths: FloatArray) -> BoolArray:
        """Mask (path,) of the paths in directions that the beams of both ends cover."""
        n = self.tx.n_angles
        return _sees(self.tx, paths[:, 1 : 1 + n]) & _sees(self.rx, paths[:, 1 + n : -2])


@dataclass(frozen=True)
class FixedPaths:
    """The signal of fixed paths in the basis of others, its inner product with the samples, and its energy."""

    signal: ComplexArray  # (rank, pair)
    inner: ComplexArray  # (pair,)
    energy: FloatArray  # (pair,)


@dataclass(frozen=True)
class LocalSamples:
    """Samples near the delays of some paths in a basis of their span, and the beam pairs of these samples."""

    samples: ComplexArray  # (rank, pair)
    pair: IntArray  # (pair,) among all, by TX beam
    tx_beam: IntArray  # (pair,)
    rx_beam: IntArray  # (pair,)
    basis: FloatArray  # (bin, rank), orthonormal
    bins: IntArray  # (bin,)
    n_bins: int
    fixed: FixedPaths | None = None

    def of_pairs(self, chosen: BoolArray) -> LocalSamples:
        """The samples of the pairs in a mask (pair,) of all pairs."""
        kept = chosen[self.pair]
        samples, pair = np.ascontiguousarray(self.samples[:, kept]), self.pair[kept]
        return replace(self, samples=samples, pair=pair, tx_beam=self.tx_beam[kept], rx_beam=self.rx_beam[kept])

    def with_fixed(self, ends: LinkBeams, paths: FloatArray, delay_bins: FloatArray) -> LocalSamples:
        """The samples with these paths (path, parameter) fixed, for others near `delay_bins` (path,).

        The basis spans only the waves of the others: products of the fixed paths with the samples are made once.
        """
        signal = self.signal(ends, paths)
        waves, _ = delay_waves(self.bins, _nodes(delay_bins, _NARROW_NODES), self.n_bins)
        turn = np.linalg.qr(self.basis.T @ waves)[0]
        narrow, samples = ((turn.T @ part.view(float)).view(complex) for part in (signal, self.samples))
        inner = np.einsum("rp,rp->p", signal.conj(), self.samples)
        fixed = FixedPaths(narrow, inner, np.square(np.abs(signal)).sum(axis=0))
        return replace(self, samples=samples, basis=self.basis @ turn, fixed=fixed)

    def signal(self, ends: LinkBeams, paths: FloatArray) -> ComplexArray:
        """Signal (rank, pair) of paths (path, parameter), without the pairs' phases."""
        wave, _ = delay_waves(self.bins, paths[:, 0], self.n_bins)
        return np.asarray((self.basis.T @ wave) @ ends.amplitudes(paths)[self.pair].T)


@dataclass(frozen=True)
class Score:
    """Log-likelihood ratio to noise alone of a set of paths, with its score and information."""

    value: float
    gradient: FloatArray  # (path * parameter,)
    information: FloatArray  # (path * parameter, path * parameter)
    pair_value: FloatArray  # (pair,)
    pair_snr: FloatArray  # (pair,) energy of all paths over the noise
    pair_phasor: ComplexArray  # (pair,) expectation of exp(j psi) given the samples


def local_samples(
    spectrum: DelaySpectrum, window: ComplexArray, bins: IntArray, pairs: IntArray, delay_bins: FloatArray
) -> LocalSamples:
    """Samples of some pairs, compressed to the waves within `REACH_BINS` of `delay_bins` (path,).

    `window` (pair, bin) are the samples of all pairs at the delay `bins`.
    """
    waves, _ = delay_waves(bins, _nodes(delay_bins, _NODES), spectrum.n_bins)
    power, turn = np.linalg.eigh(waves.T @ waves)
    kept = power > _RANK_TOLERANCE * power[-1]
    basis = waves @ (turn[:, kept] / np.sqrt(power[kept]))
    samples = (window[pairs] @ basis.astype(np.complex64)).T.astype(complex, order="C")
    tx_beam, rx_beam = np.divmod(pairs, len(spectrum.noise_mw))
    return LocalSamples(samples, pairs, tx_beam, rx_beam, basis, bins, spectrum.n_bins)


def _nodes(delay_bins: FloatArray, n: int) -> FloatArray:
    """Delays whose waves, `n` for each, span all within `REACH_BINS` of delays in bins."""
    return np.asarray((delay_bins[:, None] + REACH_BINS * chebpts1(n)).ravel())


def log_likelihood_gradient(
    local: LocalSamples, ends: LinkBeams, paths: FloatArray, faint: float = FAINT
) -> Score:
    """Marginal log-likelihood of `paths` (path, parameter) with its derivatives.

    Parameters are the delay in bins, AoD angles, AoA angles in rad, log amplitude and phase. Pairs in which the
    SNR of a path is below `faint` are left out of its information, not of the score.
    """
    at = _products(local, ends, paths)
    n_pairs, size = len(local.pair), paths.size
    gradient, information = np.zeros(size), np.zeros((size, size))
    value, phasor = np.empty(n_pairs), np.empty(n_pairs, complex)
    pair_scores(
        at.inner, at.snr, at.matched, at.sent, at.gram, at.tx, at.rx, local.tx_beam, local.rx_beam,
        information_table(), faint, gradient, information, value, phasor,
    )  # fmt: skip
    fill_lower_blocks(information, paths.shape[1])
    return Score(float(value.sum()), gradient, information, value, at.snr, phasor)


def likelihood_without(local: LocalSamples, ends: LinkBeams, paths: FloatArray, chosen: IntArray) -> FloatArray:
    """Marginal log-likelihood (chosen,) of all paths except the chosen one, the others fixed."""
    at, n = _products(local, ends, paths), len(paths)
    energy = np.diagonal(at.gram)[:n].copy()
    return np.asarray(
        likelihoods_without(at.inner, at.snr, at.matched[:n], at.sent[:n], at.amplitude, energy, chosen)
    )


@dataclass(frozen=True)
class _Products:
    """Responses of paths, amplitudes over the pairs, and inner products with their waves and slopes."""

    tx: ComplexArray  # (path, 1 + angle, tx_beam)
    rx: ComplexArray  # (path, 1 + angle, rx_beam)
    amplitude: ComplexArray  # (path, pair)
    gram: FloatArray  # (2 path, 2 path) of waves and slopes
    matched: ComplexArray  # (2 path, pair) with the samples
    sent: ComplexArray  # (2 path, pair) with the signal
    inner: ComplexArray  # (pair,) of the signal with the samples
    snr: FloatArray  # (pair,) of the signal with itself


def _products(local: LocalSamples, ends: LinkBeams, paths: FloatArray) -> _Products:
    n = len(paths)
    wave, slope = delay_waves(local.bins, paths[:, 0], local.n_bins)
    waves = local.basis.T @ np.concatenate([wave, slope], axis=1)
    tx, rx = ends.responses(paths)
    amplitude = np.multiply(tx[:, 0][:, local.tx_beam], rx[:, 0][:, local.rx_beam], order="C")
    gram = waves.T @ waves
    matched = (waves.T @ local.samples.view(float)).view(complex)
    sent = (gram[:, :n] @ amplitude.view(float)).view(complex)
    inner = np.einsum("ip,ip->p", amplitude.conj(), matched[:n])
    snr = np.einsum("ip,ip->p", amplitude.conj(), sent[:n]).real
    if local.fixed is not None:
        cross = (waves.T @ local.fixed.signal.view(float)).view(complex)
        inner += local.fixed.inner
        snr += local.fixed.energy
        snr += 2 * np.einsum("ip,ip->p", amplitude.conj(), cross[:n]).real
        sent += cross
    return _Products(tx, rx, amplitude, gram, matched, sent, inner, np.maximum(snr, 0.0))


@cache
def information_table() -> FloatArray:
    """Evenly spaced log SNR, A / SNR and B of `pair_information`, (3, n), for the compiled loop."""
    log_snr = np.linspace(np.log(1e-6), np.log(1e7), _TABLE_POINTS)
    a, b = pair_information(np.exp(log_snr))
    return np.stack([log_snr, a / np.exp(log_snr), b])


def maximise_likelihood(
    local: LocalSamples, ends: LinkBeams, paths: FloatArray, most_steps: int = MOST_STEPS, least: float = -np.inf
) -> tuple[FloatArray, Score, bool]:
    """Paths (path, parameter) at the nearest maximum of the likelihood, or after this many steps towards it.

    The last result is whether all delays stayed in reach. Steps end when one leaves it, or cannot reach `least`.
    """
    start = paths[:, 0].copy()
    longest = _longest_steps(ends, paths)
    inside = True

    def attempt(now: tuple[FloatArray, Score], damping: float) -> Attempt[tuple[FloatArray, Score]] | None:
        """One damped Fisher scoring step of all paths; None where it gains too little or a delay leaves reach."""
        nonlocal inside
        paths, at = now
        step = _damped_step(at, damping)
        if (expected := float(step @ at.gradient) / 2) < _ENOUGH or at.value + HOPE * expected < least:
            return None
        move = step.reshape(paths.shape)
        reach = (longest / np.maximum(np.abs(move), 1e-300)).min(axis=1, keepdims=True)
        move = move * np.minimum(1.0, reach)
        inside = not (np.abs(paths[:, 0] + move[:, 0] - start) > REACH_BINS).any()
        if not inside:
            return None
        then = log_likelihood_gradient(local, ends, paths + move)
        gain = float(move.ravel() @ (at.gradient - at.information @ move.ravel() / 2))
        return Attempt((paths + move, then), -at.value, -then.value, max(gain, _ENOUGH / 2))

    paths, at = minimise(
        (paths, log_likelihood_gradient(local, ends, paths)), attempt, replace(_SCHEDULE, max_steps=most_steps)
    )
    return paths, at, inside


def correlated_paths(at: Score, n_paths: int, path: int, least: float) -> BoolArray:
    """Mask (path,) of the paths with a parameter whose correlation with one of `path` exceeds `least`."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(at.information), 1e-9))
    rows = at.information.reshape(n_paths, -1, len(scale))[path] * scale
    own = scale.reshape(n_paths, -1)[path]
    correlation = np.abs(rows * own[:, None]).max(axis=0).reshape(n_paths, -1).max(axis=1)
    return np.asarray((correlation > least) & (np.arange(n_paths) != path))


def _damped_step(at: Score, damping: float) -> FloatArray:
    """Solution of (J + damping diag J) step = score, J scaled to a unit diagonal; unobservable ones stay."""
    diagonal = np.diagonal(at.information)
    scale = 1 / np.sqrt(np.where(diagonal > 1e-9, diagonal, np.inf))
    matrix = at.information * np.outer(scale, scale)
    matrix[np.diag_indices_from(matrix)] = 1 + damping + 1e-9
    return np.asarray(np.linalg.solve(matrix, at.gradient * scale) * scale)


def _longest_steps(ends: LinkBeams, paths: FloatArray) -> FloatArray:
    """Largest step (path, parameter): in parts of a resolution cell, of the amplitude and of the phase."""
    gain = np.broadcast_to([_LARGEST_LOG_AMPLITUDE, _LARGEST_PHASE], (len(paths), 2))
    return np.concatenate([_LARGEST_CELLS * ends.cells(paths), gain], axis=1)


def _sees(manifold: Manifold, angles: FloatArray) -> BoolArray:
    """Mask of the directions (direction, angle) that the beams cover, within a small margin."""
    low, high = manifold.azimuth_range_rad
    offset = np.abs(wrap_angle(angles[:, 0] - (low + high) / 2))
    seen = (offset <= (high - low) / 2 + _OUTSIDE_RAD) | manifold.is_closed
    if manifold.n_angles == 2:
        low, high = manifold.elevation_range_rad
        seen &= (angles[:, 1] >= low - _OUTSIDE_RAD) & (angles[:, 1] <= high + _OUTSIDE_RAD)
    return np.asarray(seen)
