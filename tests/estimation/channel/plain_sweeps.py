"""Sweeps of a small link, equation (1) written out path by path."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray
from sim.codebook import Codebook, beam_response
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.link import Link, make_link
from sim.sweep import BeamSweep


@dataclass(frozen=True)
class PlainPaths:
    """Delay in s, angles (path, 1 or 2) in rad, amplitude xi in sqrt(mW)."""

    delay_s: FloatArray
    aod_rad: FloatArray
    aoa_rad: FloatArray
    amplitude: ComplexArray


def plain_link(
    tx: ArrayConfig | None = None, rx: ArrayConfig | None = None, n_rb: int = 24, **waveform: Any
) -> Link:
    """By default 10 beams of 4 x 8 arrays over 288 subcarriers."""
    array = ArrayConfig(columns=8, beams_per_panel=10, sector_deg=120.0)
    return make_link(
        SimulationConfig(
            scene="-",
            waveform=WaveformConfig(**{"combine_symbols": True, **waveform}, n_rb=n_rb),
            tx_array=tx or array,
            rx_array=rx or array,
        )
    )


def plain_paths(
    link: Link,
    delay_ns: Any,
    aod_deg: Any,
    aoa_deg: Any,
    snr_db: Any,
    noise_mw: float = 1.0,
    phase: Any = 0.0,
) -> PlainPaths:
    """Paths at zero elevation unless angles are (path, 2), with amplitudes from the SNR in the best beam pair."""
    delay_s = 1e-9 * np.atleast_1d(np.asarray(delay_ns, float))
    aod, aoa = (
        np.deg2rad(np.asarray(angle, float).reshape(len(delay_s), 2 if np.ndim(angle) > 1 else 1))
        for angle in (aod_deg, aoa_deg)
    )
    best = np.abs(_gain(link.tx_codebook, aod)).max(axis=1) * np.abs(_gain(link.rx_codebook, aoa)).max(axis=1)
    per_sample = 10 ** (np.asarray(snr_db, float) / 10) * noise_mw / len(link.frequency_offset_hz)
    return PlainPaths(delay_s, aod, aoa, np.sqrt(per_sample) / best * np.exp(1j * np.asarray(phase)))


def no_plain_paths(link: Link) -> PlainPaths:
    """Nothing."""
    return plain_paths(link, np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))


def plain_sweep(
    link: Link, paths: PlainPaths, rng: np.random.Generator | None = None, noise_mw: Any = 1.0
) -> BeamSweep:
    """The samples of paths, with white noise of `noise_mw` (or (rx_beam,)) where there is a generator."""
    noise = np.broadcast_to(np.asarray(noise_mw, float), len(link.rx_codebook)).copy()
    shape = (len(link.tx_codebook), len(link.rx_codebook), len(link.frequency_offset_hz))
    samples = np.zeros(shape, complex)
    tx, rx = _gain(link.tx_codebook, paths.aod_rad), _gain(link.rx_codebook, paths.aoa_rad)
    for path, xi in enumerate(paths.amplitude):
        wave = np.exp(-2j * np.pi * link.frequency_offset_hz * paths.delay_s[path])
        samples += xi * tx[path, :, None, None] * rx[path, :, None] * wave
    samples *= link.prs_symbol[:, None]
    if rng is not None:
        white = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
        samples += white * np.sqrt(noise / 2)[:, None]
    return BeamSweep(
        tx_codebook=link.tx_codebook,
        rx_codebook=link.rx_codebook,
        tx_pose=Pose(np.zeros(3), 0.0),
        stop=3,
        samples=samples,
        prs_symbol=link.prs_symbol,
        frequency_offset_hz=link.frequency_offset_hz,
        carrier_hz=link.carrier_hz,
        noise_power_mw=noise,
    )


def _gain(codebook: Codebook, angles: FloatArray) -> ComplexArray:
    return beam_response(codebook, angles[:, 0], angles[:, 1] if angles.shape[1] == 2 else 0.0).T
