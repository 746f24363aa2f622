"""Phases of beam pairs against the paths of a fit."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.paths import IncoherentFit
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray
from sim.observation import BeamSweep

LEAST_SNR = 6.0  # of a pair whose phase is used: its phase noise has a standard deviation of at most 17 deg
ABOUT_BINS = 2  # about a path, that hold most of its energy
ADDED_NOISE = 0.2  # in the pairs of strong paths, over the nominal one: their deviations grow by 10 %


@dataclass(frozen=True)
class PairPhases:
    """Phases of beam pairs (tx_beam, rx_beam) against a reference path, with their SNR.

    Attributes
    ----------
    path : (tx_beam, rx_beam) reference of each pair; phases of different ones have no common zero
    residual : (tx_beam, rx_beam) energy that the reference does not explain, over the noise
    is_usable : (tx_beam, rx_beam) the reference is not one of several ambiguous directions
    log_magnitude : (tx_beam, rx_beam) logarithm of the amplitude over the reference's, None where that is fitted
    excess : (tx_beam, rx_beam) noise power beyond the nominal one, over it; None where it is not known
    hidden : (tx_beam, rx_beam) residual energy at the delays of paths beyond that noise, over the nominal one
    """

    phase_rad: FloatArray
    snr: FloatArray
    residual: FloatArray
    path: IntArray
    is_usable: BoolArray
    log_magnitude: FloatArray | None = None
    excess: FloatArray | None = None
    hidden: FloatArray | None = None

    @property
    def noise_excess(self) -> FloatArray:
        """`excess`, zero where it is not known."""
        return np.zeros(self.snr.shape) if self.excess is None else self.excess

    @property
    def adds_noise(self) -> bool:
        """Whether pairs have noise in proportion to their signal, as of converters and mixers."""
        return float((self.snr * self.noise_excess).sum()) > ADDED_NOISE * float(self.snr.sum())


@dataclass(frozen=True)
class SweepModel:
    """The sum of the paths of a fit, as the pairs of a sweep show it.

    Attributes
    ----------
    tx, rx : (path, beam) responses in the directions of the paths
    gain : (path,) complex amplitude
    wave : (path, subcarrier) phases of the delays
    """

    tx: ComplexArray
    rx: ComplexArray
    gain: ComplexArray
    wave: ComplexArray

    @classmethod
    def of(cls, sweep: BeamSweep, fit: PathFit) -> "SweepModel":
        """The model of a fit; paths with Doppler shifts turn during a sweep with a clock."""
        tx = nominal_manifold(sweep.tx_codebook).response(fit.aod_rad)
        rx = nominal_manifold(sweep.rx_codebook).response(fit.aoa_rad)
        if sweep.clock is not None and fit.size("doppler"):
            tx = tx * np.exp(2j * np.pi * fit.doppler_hz * sweep.clock.tx_s)
            rx = rx * np.exp(2j * np.pi * fit.doppler_hz * sweep.clock.rx_s)
        wave = np.exp(-2j * np.pi * fit.delay_s[:, None] * sweep.frequency_offset_hz).astype(np.complex64)
        return cls(tx, rx, fit.amplitude * np.exp(1j * fit.phase_rad), wave)

    def blocks(self, sweep: BeamSweep) -> Iterator[tuple[ComplexArray, ComplexArray]]:
        """Expected and received samples (rx_beam, subcarrier) of one TX beam after the other, without the PRS."""
        for beam in range(self.tx.shape[1]):
            expected = ((self.gain * self.tx[:, beam])[:, None] * self.rx).T.astype(np.complex64) @ self.wave
            yield expected, sweep.samples[beam] * sweep.prs_symbol[beam].conj()


def phases_of(fit: IncoherentFit, *, all_usable: bool = False) -> PairPhases:
    """The phases of an incoherent fit; `all_usable` takes those of ambiguous directions too."""
    is_clear = ~fit.is_ambiguous | all_usable
    usable = is_clear[fit.pair_path] if len(fit) else np.zeros(fit.pair_path.shape, bool)
    return PairPhases(fit.pair_phase_rad, fit.pair_snr, fit.pair_residual, fit.pair_path, usable)


def phases_against(sweep: BeamSweep, fit: PathFit) -> PairPhases:
    """The phases of a sweep against the sum of all paths of a coherent fit."""
    shape, noise = sweep.samples.shape[:2], sweep.noise_power_mw
    product, model, energy = np.zeros(shape, complex), np.zeros(shape), np.zeros(shape)
    white, hidden = np.zeros(shape), np.zeros(shape)
    occupied = _occupied_bins(sweep, fit.delay_s)
    tiny = np.finfo(float).tiny
    for beam, (expected, samples) in enumerate(SweepModel.of(sweep, fit).blocks(sweep)):
        product[beam] = (expected.conj() * samples).sum(axis=1) / noise
        model[beam] = np.square(np.abs(expected)).sum(axis=1) / noise
        energy[beam] = np.square(np.abs(samples)).sum(axis=1) / noise
        turn = np.exp(1j * np.angle(product[beam])).astype(np.complex64)
        profile = scipy.fft.ifft(samples - expected * turn[:, None], axis=1, norm="ortho", overwrite_x=True)
        power = (np.square(profile.real) + np.square(profile.imag)) / noise[:, None]
        white[beam] = np.median(power, axis=1) / np.log(2)  # of white noise the median is ln 2 of the mean
        hidden[beam] = power[:, occupied].sum(axis=1) - occupied.sum() * white[beam]
    unexplained = energy - np.square(np.abs(product)) / np.maximum(model, tiny)
    residual = np.maximum(unexplained - sweep.samples.shape[2], 0.0)
    return PairPhases(
        phase_rad=np.angle(product),
        snr=model,
        residual=residual,
        path=np.zeros(shape, int),
        is_usable=np.ones(shape, bool),
        log_magnitude=np.log(np.maximum(np.abs(product), tiny) / np.maximum(model, tiny)),
        excess=np.maximum(white - 1, 0.0),
        hidden=np.maximum(hidden, 0.0),
    )


def without_phases(sweep: BeamSweep, phase_rad: FloatArray) -> BeamSweep:
    """The sweep with phases (tx_beam, rx_beam) of its beam pairs removed."""
    return replace(sweep, samples=sweep.samples * np.exp(-1j * phase_rad).astype(np.complex64)[:, :, None])


def _occupied_bins(sweep: BeamSweep, delay_s: FloatArray) -> BoolArray:
    """Mask (bin,) of the delay bins about the paths."""
    n = sweep.samples.shape[2]
    bin_s = 1 / (n * np.diff(sweep.frequency_offset_hz[:2])[0])
    occupied = np.zeros(n, bool)
    around = np.arange(-ABOUT_BINS, ABOUT_BINS + 1)
    occupied[(np.round(delay_s / bin_s).astype(int)[:, None] + around) % n] = True
    return occupied


def phase_variance(snr: FloatArray) -> FloatArray:
    """Variance of the phase of a pair of SNR g, to second order: 1 / (2 g) + 1 / (4 g^2)."""
    return np.asarray(0.5 / snr + 0.25 / snr**2)
