"""Lossless compression of a beam sweep: whitened, projected on the span of the beams, transformed to delay bins.

All beams of a codebook are sums of the same few elements, so the samples of a path of any direction lie in the
span of the weights, and the samples outside are noise that no path model can use. The projections are orthonormal
after whitening, so the noise of the compressed samples is white. The delay transform is unitary; a window of its
bins is kept, in which the model of a path is exact: the side lobes that the window cuts off (0.4 % of the energy
for a path 24 bins inside an edge) are lost to the estimate, but never bias it.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy.fft

from estimation.channel.model.kernels import dirichlet
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.turns import SweepTurns
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray
from sim.observation import BeamSweep

RANK_TOLERANCE = 1e-6  # of the largest singular value: weaker sums of beams are rounding errors
REAL_TOLERANCE = 1e-9  # relative imaginary part that is a rounding error
LEAST_NOISE = 0.5  # of the nominal noise power: lower bound of the measured one
NOISE_CELLS = 25_000  # approximate number of cells that the noise is measured in; with less than
LEAST_NOISE_CELLS = 2_000  # the nominal one is taken
EVEN_SPACING = 1e-6  # relative deviation of subcarrier spacings that is a rounding error


@dataclass(frozen=True)
class CompressedSweep:
    """White samples of unit noise power, and the models of a path along every axis.

    A path of amplitude c adds c t(phi) r(theta) d(tau), with t and r the responses of `tx` and `rx` and d the
    `delay_response`. Its gain at zero offset from the carrier is xi = c exp(+j 2 pi f tau), f the `centre_hz`.

    Attributes
    ----------
    parts : float32 (part, tx_rank, rx_rank, bin), the real and the imaginary parts of the samples
    tx, rx : manifolds of the compressed beams
    position : (bin,) delay bins kept, counted from zero delay, possibly negative or beyond the period
    weight : (bin,) factor of whitening for every bin
    n_subcarriers, bin_s, centre_hz : of the delay transform, whose period is n_subcarriers * bin_s
    noise_scale : noise power that the samples were divided by, relative to the nominal one
    turns : times of the beams where paths may have Doppler shifts, with one cell per beam; else None
    """

    parts: FloatArray
    tx: Manifold
    rx: Manifold
    position: IntArray
    weight: FloatArray
    n_subcarriers: int
    bin_s: float
    centre_hz: float
    noise_scale: float
    turns: SweepTurns | None = None

    @property
    def samples(self) -> ComplexArray:
        """The samples (tx_rank, rx_rank, bin), complex64."""
        return np.asarray(self.parts[0] + 1j * self.parts[1])

    def delay_response(self, delay_bins: FloatArray) -> FloatArray:
        """Responses d to delays in bins and their derivatives per bin, (delay, 2, bin); real by choice of phase.

        Over a whole period without weights |d|^2 is the number of subcarriers.
        """
        kernel = dirichlet(self.position, np.asarray(delay_bins, float), self.n_subcarriers)
        scale = np.sqrt(self.n_subcarriers) * self.weight
        return np.asarray(kernel * (np.array([[1.0], [-1.0]]) * scale))

    def bins(self, kept: BoolArray) -> Self:
        """The delay bins marked in `kept` (bin,)."""
        return replace(self, parts=self.parts[..., kept], position=self.position[kept], weight=self.weight[kept])

    def over_background(self, background: FloatArray) -> Self:
        """The sweep whitened by the noise power (bin,) of every delay bin."""
        std = np.sqrt(background)
        return replace(self, parts=np.asarray(self.parts / std, np.float32), weight=self.weight / std)

    def with_hidden_elevation(self) -> Self:
        """The sweep with the elevations that several panels observe (`Manifold.with_hidden_elevation`)."""
        return replace(self, tx=self.tx.with_hidden_elevation(), rx=self.rx.with_hidden_elevation())


@dataclass(frozen=True)
class DelayCube:
    """Compressed samples over the whole delay period, from which windows are taken.

    Attributes
    ----------
    spectrum : complex64 (tx_rank, rx_rank, bin), white noise; phases of a plain inverse FFT
    noise_scale : noise power per cell, 1 if the nominal noise powers are right
    turns : as in `CompressedSweep`
    """

    spectrum: ComplexArray
    tx: Manifold
    rx: Manifold
    bin_s: float
    centre_hz: float
    noise_scale: float
    turns: SweepTurns | None = None

    @property
    def n_bins(self) -> int:
        """Delay bins in the period."""
        return int(self.spectrum.shape[2])

    def window(self, position: IntArray) -> CompressedSweep:
        """The delay bins at `position` (bin,), periodic, with phases relative to the centre of the band."""
        n = self.n_bins
        turn = np.exp(-1j * np.pi / n * ((n - 1) * position % (2 * n))) / np.sqrt(self.noise_scale)
        samples = np.take(self.spectrum, position % n, axis=2) * turn.astype(np.complex64)
        return CompressedSweep(
            parts=np.stack([samples.real, samples.imag]),
            tx=self.tx,
            rx=self.rx,
            position=position,
            weight=np.ones(len(position)),
            n_subcarriers=n,
            bin_s=self.bin_s,
            centre_hz=self.centre_hz,
            noise_scale=self.noise_scale,
            turns=self.turns,
        )


@dataclass(frozen=True)
class BeamSpan:
    """An orthonormal basis of the span of a device's whitened beams.

    Attributes
    ----------
    basis : (rank, beam), complex64, or float32 if the responses are real; whitens and projects samples of beams
    manifold : responses of the compressed beams, noise of unit power
    """

    basis: ComplexArray | FloatArray
    manifold: Manifold


def beam_span(manifold: Manifold, noise_power_mw: FloatArray | None = None) -> BeamSpan:
    """Basis of the span of all responses, whitened by the noise power (beam,) of the beams if it is given.

    The basis is rotated so that its vectors are as near as possible to the responses of as many evenly spaced
    directions: a compressed cell is approximately a matched filter to its direction.
    """
    whitener = np.ones(manifold.n_beams) if noise_power_mw is None else 1 / np.sqrt(noise_power_mw)
    white = manifold.combined(np.diag(whitener))
    weights = white.weights()
    gram = weights @ weights.conj().T
    is_real = np.abs(gram.imag).max() < REAL_TOLERANCE * np.abs(gram).max()
    power, vectors = np.linalg.eigh(gram.real if is_real else gram)
    basis = _towards_directions(white, vectors[:, power > RANK_TOLERANCE**2 * power[-1]].conj().T)
    precision: type[np.generic] = np.float32 if is_real else np.complex64
    return BeamSpan(np.asarray(basis * whitener, precision), white.combined(basis))


def every_beam(manifold: Manifold, noise_power_mw: FloatArray | None = None) -> BeamSpan:
    """As `beam_span`, with one cell per beam."""
    whitener = np.diag(np.ones(manifold.n_beams) if noise_power_mw is None else 1 / np.sqrt(noise_power_mw))
    precision: type[np.generic] = np.float32
    return BeamSpan(np.asarray(whitener, precision), manifold.combined(whitener))


def _towards_directions(manifold: Manifold, basis: ComplexArray | FloatArray) -> ComplexArray | FloatArray:
    """The basis (rank, beam) rotated by the unitary matrix nearest to responses of evenly spaced directions."""
    directions = manifold.grid(2.0)
    wanted = directions[np.linspace(0, len(directions) - 1, min(len(basis), len(directions))).astype(int)]
    seen = (manifold.response(wanted) @ basis.T).conj()
    left, _, right = np.linalg.svd(seen if np.iscomplexobj(basis) else seen.real, full_matrices=True)
    turned = left @ right[: len(left)]
    return np.asarray(np.concatenate([turned, right[len(left) :]]) @ basis)


def compress(sweep: BeamSweep, tx: BeamSpan, rx: BeamSpan, turns: SweepTurns | None = None) -> DelayCube:
    """All delay bins of a sweep, on the bases of its beams (`beam_span`; that of the RX with the noise powers).

    With `turns`, the bases are those of `every_beam`: a Doppler shift leaves the span of the beams.
    The noise level is measured at the delays farthest from the strongest path (see `noise_scale_of`).

    Raises `ValueError` For samples that are not finite; the message names the stop.
    """
    n_tx, _, n_bins = sweep.samples.shape
    projected = np.empty((n_tx, len(rx.basis), n_bins), np.complex64)
    for beam in range(n_tx):
        _project(rx.basis, sweep.samples[beam], out=projected[beam])
        projected[beam] *= sweep.prs_symbol[beam].conj()
    cube = np.empty((len(tx.basis), len(rx.basis), n_bins), np.complex64)
    _project(tx.basis, projected.reshape(n_tx, -1), out=cube.reshape(len(tx.basis), -1))
    del projected
    if not np.isfinite(np.vdot(cube, cube)):
        raise ValueError(f"BeamSweep.samples at stop {sweep.stop}: NaN or infinite, samples must be finite")
    spectrum = scipy.fft.ifft(cube, axis=2, norm="ortho", overwrite_x=True)
    step_hz = (sweep.frequency_offset_hz[-1] - sweep.frequency_offset_hz[0]) / (n_bins - 1)
    return DelayCube(
        spectrum=spectrum,
        tx=tx.manifold,
        rx=rx.manifold,
        bin_s=float(1 / (n_bins * step_hz)),
        centre_hz=float(sweep.frequency_offset_hz.mean()),
        noise_scale=noise_scale_of(spectrum),
        turns=turns,
    )


def check_sweep(sweep: BeamSweep) -> None:
    """Refuse a sweep that allows no delay estimate.

    Raises `ValueError` For a sweep of no beams, less than 2 subcarriers, subcarriers that are not evenly spaced
    and ascending, and noise powers that are not positive; the message names field, value and what is allowed.
    """
    shape, step_hz = sweep.samples.shape, np.diff(sweep.frequency_offset_hz)
    where = f"at stop {sweep.stop}"
    if min(shape) < 1 or shape[2] < 2:
        raise ValueError(
            f"BeamSweep.samples {where}: shape {shape}, at least 1 beam each and 2 subcarriers are needed"
        )
    if not (step_hz > 0).all() or np.ptp(step_hz) > EVEN_SPACING * step_hz.mean():
        raise ValueError(
            f"BeamSweep.frequency_offset_hz {where}: steps of {step_hz.min():g} to {step_hz.max():g} Hz,"
            " subcarriers must ascend evenly"
        )
    noise = sweep.noise_power_mw
    if not (np.isfinite(noise) & (noise > 0)).all():
        raise ValueError(f"BeamSweep.noise_power_mw {where} = {noise.min():g}: must be positive and finite")


def _project(basis: ComplexArray | FloatArray, samples: ComplexArray, out: ComplexArray) -> None:
    """Basis @ samples in single precision; a real basis takes half the work."""
    if np.iscomplexobj(basis):
        np.matmul(basis, samples, out=out)
    else:
        np.matmul(basis, samples.view(np.float32), out=out.view(np.float32))


def noise_scale_of(spectrum: ComplexArray) -> float:
    """Noise power of compressed samples (tx_rank, rx_rank, bin), at the delays farthest from the strongest path.

    For white noise the median power is ln 2 times its mean. 1 if there are too few samples.
    """
    n_tx, n_rx, n = spectrum.shape
    every = max(1, n // 400)
    power = spectrum[..., ::every]
    strongest = every * int(np.argmax((power.real**2 + power.imag**2).max(axis=(0, 1))))
    n_bins = min(n // 4, max(1, NOISE_CELLS // (n_tx * n_rx)))
    if n_tx * n_rx * n_bins < LEAST_NOISE_CELLS:
        return 1.0
    far = spectrum[..., (strongest + n // 2 - n_bins // 2 + np.arange(n_bins)) % n]
    return max(LEAST_NOISE, float(np.median(far.real**2 + far.imag**2) / np.log(2)))
