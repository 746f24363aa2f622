"""Shared fixtures: a small link and sweeps of made-up paths."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import settings

from scenes.pose import Pose
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.observation import BeamSweep
from sim.propagation.paths import Paths
from sim.signal.generation import beam_channel
from sim.signal.link import Link, make_link
from sim.signal.noise import add_noise

SweepMaker = Callable[..., BeamSweep]

# A test fails on no time, however busy the machine is, and the same examples are drawn every time;
# `scripts/test --hypothesis-profile fresh` draws others.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("fresh", deadline=None, database=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def full_link() -> Link:
    return make_link(SimulationConfig(scene="none"))


@pytest.fixture(scope="session")
def small_link() -> Link:
    """Few beams and subcarriers over the same band, for Monte Carlo runs."""
    return make_link(
        SimulationConfig(
            scene="none",
            waveform=WaveformConfig(comb=12),
            tx_array=ArrayConfig(beams_per_panel=10, sector_deg=60.0),
            rx_array=ArrayConfig(beams_per_panel=12, sector_deg=70.0),
        )
    )


@pytest.fixture(scope="session")
def tx_pose() -> Pose:
    return Pose(np.array([2.25, 2.5, 1.8]), -np.pi / 2)


@pytest.fixture(scope="session")
def rx_pose() -> Pose:
    return Pose(np.array([0.0, -2.0, 1.8]), 0.4)


@pytest.fixture(scope="session")
def make_sweep(full_link: Link, tx_pose: Pose, rx_pose: Pose) -> SweepMaker:
    """Sweep of paths at `rx_pose` with noise of the link scaled by `noise_factor`."""

    def make(
        paths: Paths,
        rng: np.random.Generator,
        *,
        bias_s: float = 0.0,
        noise_factor: float = 1.0,
        over: Link | None = None,
    ) -> BeamSweep:
        link = over or full_link
        samples = beam_channel(
            paths,
            tx_codebook=link.tx_codebook,
            rx_codebook=link.rx_codebook,
            tx_pose=tx_pose,
            rx_pose=rx_pose,
            frequency_offset_hz=link.frequency_offset_hz,
            clock_bias_s=bias_s,
        )
        samples *= np.sqrt(link.tx_power_mw).astype(np.float32) * link.prs_symbol[:, None, :]
        noise_mw = link.noise_power_mw * noise_factor
        return BeamSweep(
            tx_codebook=link.tx_codebook,
            rx_codebook=link.rx_codebook,
            tx_pose=tx_pose,
            stop=3,
            samples=add_noise(samples, noise_mw, rng),
            prs_symbol=link.prs_symbol,
            frequency_offset_hz=link.frequency_offset_hz,
            carrier_hz=link.carrier_hz,
            noise_power_mw=noise_mw,
        )

    return make


@pytest.fixture(scope="session")
def make_paths() -> Callable[..., Paths]:
    """Paths from gains, delays and world-frame azimuths, all at zero elevation."""

    def make(gain: object, delay_s: object, aod_rad: object, aoa_rad: object) -> Paths:
        count = len(np.atleast_1d(gain))
        level = np.zeros(count)
        return Paths(
            gain=np.atleast_1d(gain),
            delay_s=np.atleast_1d(delay_s),
            aod_azimuth_rad=np.atleast_1d(aod_rad),
            aod_elevation_rad=level,
            aoa_azimuth_rad=np.atleast_1d(aoa_rad),
            aoa_elevation_rad=level,
            bounce_kind=np.zeros((count, 1), int),
            bounce_object=np.full((count, 1), -1),
            vertex_m=np.full((count, 1, 3), np.nan),
            object_name=np.array(["wall"]),
        )

    return make
