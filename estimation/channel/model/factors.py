"""The slopes of a sweep over all parameters of its paths, as products of short factors, and their information.

Parameters and equations are those of `crb.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.channel.model.manifold import Manifold
from estimation.channel.model.phase_information import pair_information
from scenes.record import BoolArray, ComplexArray, FloatArray
from sim.observation import BeamClock


def pair_products(tx: ComplexArray, rx: ComplexArray) -> ComplexArray:
    """Products (path, pair) of factors (path, beam) of both ends, all RX beams of a TX beam in turn."""
    return np.asarray((tx[:, :, None] * rx[:, None]).reshape(len(tx), tx.shape[1] * rx.shape[1]))


@dataclass(frozen=True)
class MovingPaths:
    """Doppler shifts (path,) in Hz in a sweep with these times, and which paths are known to be frozen."""

    clock: BeamClock
    doppler_hz: FloatArray
    is_frozen: BoolArray

    def turned(self, tangent: ComplexArray, *, is_tx: bool) -> ComplexArray:
        """Tangents (path, slope, beam) of one end with their turns, and a last one: the slope over the shift."""
        time_s = self.clock.tx_s if is_tx else self.clock.rx_s
        turned = tangent * np.exp(2j * np.pi * self.doppler_hz[:, None] * time_s)[:, None]
        slope = turned[:, :1] * (2j * np.pi * time_s) * ~self.is_frozen[:, None, None]
        return np.concatenate([turned, slope], axis=1)


@dataclass(frozen=True)
class TangentFactors:
    """The factors of every parameter's derivative of the mean, in units of the noise.

    A derivative is coefficient x TX factor (beam,) x RX factor (beam,) x wave (subcarrier,).
    """

    coefficient: ComplexArray  # (parameter,)
    tx: ComplexArray  # (parameter, tx_beam)
    rx: ComplexArray  # (parameter, rx_beam), over the noise amplitude
    wave_gram: ComplexArray  # (parameter, parameter)
    magnitude: Any  # indices (path,) of the parameters log |xi|

    @classmethod
    def make(
        cls,
        tx: Manifold,
        rx: Manifold,
        frequency_hz: FloatArray,
        noise_mw: FloatArray,
        delay_s: FloatArray,
        aod_rad: FloatArray,
        aoa_rad: FloatArray,
        amplitude: ComplexArray,
        moving: MovingPaths | None = None,
    ) -> TangentFactors:
        """The factors of paths with arguments as in `path_information`, parameters in the order of the module.

        With `moving`, each end has one more slope, over the Doppler shift, behind those over its angles.
        """
        noise = np.sqrt(noise_mw)
        tx_tangent, rx_tangent = tx.tangents(aod_rad), rx.tangents(aoa_rad)  # the response, then its slopes
        if moving is not None:
            tx_tangent, rx_tangent = moving.turned(tx_tangent, is_tx=True), moving.turned(rx_tangent, is_tx=False)
        n, n_tx, n_rx = len(delay_s), tx_tangent.shape[1] - 1, rx_tangent.shape[1] - 1
        size = 3 + n_tx + n_rx
        tx_factor = np.repeat(tx_tangent[:, :1], size, axis=1)
        tx_factor[:, 1 : 1 + n_tx] = tx_tangent[:, 1:]
        rx_factor = np.repeat(rx_tangent[:, :1], size, axis=1)
        rx_factor[:, 1 + n_tx : 1 + n_tx + n_rx] = rx_tangent[:, 1:]
        coefficient = np.repeat(amplitude[:, None], size, axis=1).astype(complex)
        coefficient[:, -1] *= 1j
        wave = np.exp(-2j * np.pi * delay_s[:, None] * frequency_hz)
        slope = -2j * np.pi * frequency_hz * wave
        kind = np.zeros((n, size), int)  # of wave: 0 the wave, 1 its slope
        kind[:, 0] = 1
        index = (2 * np.arange(n)[:, None] + kind).ravel()
        waves = np.stack([wave, slope], axis=1).reshape(2 * n, len(frequency_hz))
        gram = waves.conj() @ waves.T
        return cls(
            coefficient=coefficient.ravel(),
            tx=tx_factor.reshape(n * size, tx.n_beams),
            rx=rx_factor.reshape(n * size, rx.n_beams) / noise,
            wave_gram=gram[np.ix_(index, index)],
            magnitude=size * np.arange(n) + size - 2,
        )

    def coherent(self) -> FloatArray:
        """Information (parameter, parameter) with known phases of the beam pairs."""
        c = self.coefficient
        grams = (self.tx.conj() @ self.tx.T) * (self.rx.conj() @ self.rx.T) * self.wave_gram
        return np.asarray(2 * np.real(np.outer(c.conj(), c) * grams))

    def incoherent(self) -> FloatArray:
        """4 A Re(alpha) Re(alpha)' + 2 B Re(d'^H d') summed over beam pairs."""
        weight = self.coefficient[:, None] * pair_products(self.tx, self.rx)  # (parameter, pair)
        gram = self.wave_gram
        # mu is the sum of the derivatives by log |xi|, so mu^H d is a sum over these rows.
        along = weight * (gram[self.magnitude].T @ weight[self.magnitude].conj())
        snr = np.maximum(along[self.magnitude].real.sum(axis=0), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            alpha = np.where(snr > 0, along / snr, 0.0)
        a, b = pair_information(snr)
        whole = gram * ((weight.conj() * b) @ weight.T)
        parallel = (alpha.conj() * (snr * b)) @ alpha.T
        kept = (alpha.real * a) @ alpha.real.T
        return np.asarray(4 * kept + 2 * np.real(whole - parallel))
