"""Beam pairs as time-domain samples, and SigMF recordings of them."""

import json
from pathlib import Path

import numpy as np
import pytest

from isac_arena.exchange.sigmf_recording import read_sigmf, write_sigmf
from isac_arena.validation.scenarios.paths import free_space
from scenes.pose import Pose
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.observation import BeamSweep
from sim.signal.generation import beam_channel
from sim.signal.link import make_link
from sim.signal.waveform.ofdm import cp_lengths, demodulate
from sim.signal.waveform.prs import prs_slot
from sim.signal.waveform.time_domain import received_grid, received_samples

TX, RX = Pose(np.array([0.0, 0.0, 1.5]), 0.0), Pose(np.array([5.0, 0.0, 1.5]), -np.pi)
FEW = ArrayConfig(beams_per_panel=3)


def clean_sweep(wave: WaveformConfig) -> BeamSweep:
    link = make_link(SimulationConfig(scene="none", waveform=wave, tx_array=FEW, rx_array=FEW))
    samples = beam_channel(
        free_space(TX, RX), tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook, tx_pose=TX, rx_pose=RX,
        frequency_offset_hz=link.frequency_offset_hz, clock_bias_s=20e-9,
    )  # fmt: skip
    return BeamSweep(
        tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook, tx_pose=TX, stop=0,
        samples=samples * link.prs_symbol[:, None], prs_symbol=link.prs_symbol,
        frequency_offset_hz=link.frequency_offset_hz, carrier_hz=60e9, noise_power_mw=link.noise_power_mw,
    )  # fmt: skip


@pytest.mark.parametrize("combine", [False, True])
def test_samples_demodulate_to_the_channel_times_the_slot(combine: bool) -> None:
    """Divided by the PRS of the slot, every symbol of the burst is the same channel on its own comb."""
    wave = WaveformConfig(n_rb=24, comb=6, rb_offset=8, carrier_rb=40, first_symbol=2, combine_symbols=combine)
    sweep = clean_sweep(wave)
    samples = received_samples(sweep, wave.prs, slot=1, tx_beam=1, rx_beam=2)
    n_symbols = 6 if combine else 1
    assert samples.dtype == np.complex64 and len(samples) == n_symbols * (4096 + 288)
    grid = demodulate(samples, 480, cp_lengths(3, 1)[2 : 2 + n_symbols])
    pilots = prs_slot(wave.prs, 1, 1)[2 : 2 + n_symbols]
    symbol, subcarrier = np.nonzero(pilots)
    np.testing.assert_allclose(grid[pilots == 0], 0, atol=1e-5 * np.abs(grid).max())
    frequency = (subcarrier - 240) * 120e3
    delay_s = 5 / 299_792_458 + 20e-9
    channel = grid[symbol, subcarrier] / pilots[symbol, subcarrier] * np.exp(2j * np.pi * frequency * delay_s)
    np.testing.assert_allclose(channel, channel[0], rtol=1e-4)
    assert (np.abs(grid[0]) ** 2).sum() == pytest.approx((np.abs(sweep.samples[1, 2]) ** 2).mean(), rel=1e-4)


def test_extended_prefixes_reach_the_samples() -> None:
    wave = WaveformConfig(n_rb=24, numerology=2, cyclic_prefix="extended", combine_symbols=True)
    assert len(received_samples(clean_sweep(wave), wave.prs, 1, 1, 2)) == 2 * (4096 + 1024)


def test_beams_and_waveform_are_checked() -> None:
    wave = WaveformConfig(n_rb=24)
    sweep = clean_sweep(wave)
    with pytest.raises(ValueError, match="tx_beam = 3: allowed is 0 to 2"):
        received_grid(sweep, wave.prs, 0, 3, 0)
    with pytest.raises(ValueError, match="rx_beam = -1: allowed is 0 to 2"):
        received_grid(sweep, wave.prs, 0, 0, -1)
    with pytest.raises(ValueError, match="144 subcarriers, this PRS has 1584 or 3168"):
        received_grid(sweep, WaveformConfig().prs, 0, 0, 0)
    with pytest.raises(ValueError, match="beam 1 did not send this PRS in slot 5"):
        received_grid(sweep, wave.prs, 5, 1, 0)


def test_recordings_come_back_bit_by_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    bursts = [rng.standard_normal((n, 2), np.float32).view(np.complex64)[:, 0] for n in (5, 3)]
    meta = write_sigmf(
        tmp_path / "a.b", bursts, ["one", "two"], sample_rate_hz=1e6, carrier_hz=60e9, description="test"
    )
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.b.sigmf-data", "a.b.sigmf-meta"]
    samples, metadata = read_sigmf(tmp_path / "a.b")
    np.testing.assert_array_equal(samples, np.concatenate(bursts))
    assert metadata == json.loads(meta.read_text())
    assert metadata["global"]["core:datatype"] == "cf32_le"
    assert [c["core:sample_start"] for c in metadata["captures"]] == [0, 5]
    assert metadata["annotations"][1] == {"core:sample_start": 5, "core:sample_count": 3, "core:label": "two"}


def test_damaged_recordings_are_named(tmp_path: Path) -> None:
    burst = np.ones(4, np.complex64)
    meta = write_sigmf(tmp_path / "r", [burst], ["x"], sample_rate_hz=1.0, carrier_hz=1.0, description="")
    (tmp_path / "r.sigmf-data").write_bytes(b"short")
    with pytest.raises(ValueError, match=r"r.sigmf-data: differs from the core:sha512"):
        read_sigmf(tmp_path / "r")
    meta.write_text(meta.read_text().replace("cf32_le", "rf32_le"))
    with pytest.raises(ValueError, match="core:datatype = rf32_le: must be cf32_le"):
        read_sigmf(tmp_path / "r")
    meta.write_text("[]")
    with pytest.raises(ValueError, match="not readable SigMF metadata"):
        read_sigmf(tmp_path / "r")
    with pytest.raises(FileNotFoundError):
        read_sigmf(tmp_path / "none")
