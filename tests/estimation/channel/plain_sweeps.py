"""Sweeps of a small link, equation (1) written out path by path."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.channel.coherent.plan import nominal_manifold, search_plan
from estimation.channel.fit import PathFit
from estimation.channel.model.compress import CompressedSweep, compress
from estimation.channel.model.crb import PathBounds, crb
from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.observation import BeamSweep
from sim.signal.arrays.codebook import Codebook, beam_response
from sim.signal.link import Link, make_link

PANELS = ArrayConfig(columns=8, beams_per_panel=8, sector_deg=90.0, panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0])
ELEVATION = ArrayConfig(columns=8, beams_per_panel=8, beam_elevation_deg=[-20.0, 0.0, 20.0])
CHI2_95 = 7.815  # of 3 degrees of freedom


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
    link: Link, delay_ns: Any, aod_deg: Any, aoa_deg: Any, snr_db: Any, noise_mw: float = 1.0, phase: Any = 0.0
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


def compressed(sweep: BeamSweep) -> CompressedSweep:
    """A sweep compressed as the coherent method does it, over the whole delay period."""
    noise_mw = tuple(sweep.noise_power_mw.tolist())
    plan = search_plan(nominal_manifold(sweep.tx_codebook), nominal_manifold(sweep.rx_codebook), noise_mw, 2.0)
    cube = compress(sweep, plan.tx, plan.rx)
    return cube.window(np.arange(cube.n_bins))


def scrambled(sweep: BeamSweep, rng: np.random.Generator) -> BeamSweep:
    """The sweep with a random phase on every beam pair."""
    phasor = np.exp(2j * np.pi * rng.random(sweep.samples.shape[:2])).astype(np.complex64)
    return replace(sweep, samples=sweep.samples * phasor[:, :, None])


def places(paths: PathFit | PlainPaths) -> FloatArray:
    """Delay and angles (path, parameter) in the order of a covariance."""
    return np.concatenate([paths.delay_s[:, None], paths.aod_rad, paths.aoa_rad], axis=1)


def plain_bounds(link: Link, paths: PlainPaths, *, coherent: bool = True) -> PathBounds:
    """Bounds of paths in noise of unit power."""
    return crb(
        link.tx_codebook, link.rx_codebook, link.frequency_offset_hz, 1.0, delay_s=paths.delay_s,
        aod_rad=paths.aod_rad, aoa_rad=paths.aoa_rad, amplitude=paths.amplitude, coherent=coherent,
    )  # fmt: skip


def _gain(codebook: Codebook, angles: FloatArray) -> ComplexArray:
    return beam_response(codebook, angles[:, 0], angles[:, 1] if angles.shape[1] == 2 else 0.0).T
