"""Impairments: what each does to the samples in closed form, its off switch and its own random numbers."""

import dataclasses

import numpy as np
import pytest

from isac_arena.validation.signal.generation import ImpairmentBench
from sim.signal.arrays.codebook import Codebook
from sim.signal.hardware.apply_impairments import impaired_codebooks, true_tx_pose
from sim.signal.hardware.config import IMPAIRMENTS, ImpairmentsConfig
from sim.signal.hardware.impairments import (
    clipped_iq,
    coupling_matrix,
    fft_bins,
    quantised_iq,
    quantiser_gain,
    to_subcarriers,
    to_time_samples,
    with_iq_imbalance,
)
from sim.simulate import observe

TYPICAL = ImpairmentsConfig(
    clock_bias_std_ns=1.0, clock_drift_ppm=0.1, cfo_hz=500.0, phase_noise_pair_deg=5.0,
    phase_noise_linewidth_hz=500.0, iq_gain_db=0.5, iq_phase_deg=3.0, adc_bits=6, adc_clip_db=3.0,
    element_gain_std_db=0.5, element_phase_std_deg=5.0, coupling_db=-20.0, tx_pointing_offset_deg=1.0,
    rx_placement_std_m=0.05, rx_heading_std_deg=1.0, beam_phase_std_deg=50.0,
)  # fmt: skip


def test_every_setting_belongs_to_one_impairment() -> None:
    settings = [setting for group in IMPAIRMENTS.values() for setting in group]
    assert sorted([*settings, "adc_full_scale_db"]) == sorted(ImpairmentsConfig.model_fields)
    assert TYPICAL.switched_on == list(IMPAIRMENTS) and not ImpairmentsConfig().switched_on
    for name in IMPAIRMENTS:
        assert TYPICAL.only(name).switched_on == [name]
    with pytest.raises(ValueError, match="impairment = 'rust'"):
        TYPICAL.only("rust")


def test_samples_change_with_each_impairment_of_the_signal_and_repeat() -> None:
    bench = ImpairmentBench(3)
    clean = bench.samples(bench.config(), 0)
    assert np.isfinite(clean).all()
    for name in set(IMPAIRMENTS) - {"clock bias", "RX placement", "RX heading"}:
        config = bench.config(**TYPICAL.only(name).model_dump(exclude_defaults=True))
        samples = bench.samples(config, 0)
        assert samples.dtype == np.complex64 and np.isfinite(samples).all()
        assert not np.array_equal(samples, clean), name
    np.testing.assert_array_equal(samples, bench.samples(config, 0))


def test_the_sweep_tells_the_design_whatever_the_hardware() -> None:
    bench = ImpairmentBench(4)
    deviating = TYPICAL.model_copy(update={"element_phase_std_deg": 30.0, "tx_pointing_offset_deg": 5.0})
    config = bench.config(**deviating.model_dump(exclude_defaults=True))
    built = impaired_codebooks(config, bench.link)
    sweep = observe(config, bench.link, bench.scene, bench.truth(0))
    for told, radiated, designed in zip(
        (sweep.tx_codebook, sweep.rx_codebook),
        built,
        (bench.link.tx_codebook, bench.link.rx_codebook),
        strict=True,
    ):
        assert np.abs(radiated.weights - designed.weights).max() > 0.05
        for field in dataclasses.fields(Codebook):
            np.testing.assert_array_equal(getattr(told, field.name), getattr(designed, field.name))
    assert true_tx_pose(config, bench.scene.tx).heading_rad != bench.scene.tx.heading_rad
    assert sweep.tx_pose.heading_rad == bench.scene.tx.heading_rad
    for name in ("prs_symbol", "frequency_offset_hz", "noise_power_mw", "carrier_hz"):
        np.testing.assert_array_equal(getattr(sweep, name), getattr(bench.link, name))


def test_time_and_frequency_are_a_unitary_pair() -> None:
    rng = np.random.default_rng(1)
    samples = (rng.standard_normal((3, 24, 2)) @ [1, 1j]).astype(np.complex64)
    bins, n_fft = fft_bins((np.arange(24) * 2 - 24) * 120e3, 120e3)
    time = to_time_samples(samples, bins, n_fft)
    np.testing.assert_allclose(np.linalg.norm(time, axis=1), np.linalg.norm(samples, axis=1), rtol=1e-5)
    np.testing.assert_allclose(to_subcarriers(time, bins), samples, atol=1e-5)


def test_converter_and_mixer_in_closed_form() -> None:
    x = np.array([0.3 - 0.9j, 1.5 + 0.1j], np.complex64)
    np.testing.assert_allclose(clipped_iq(x, 1.0), [0.3 - 0.9j, 1.0 + 0.1j])
    np.testing.assert_allclose(quantised_iq(x, 2, 1.0), [0.25 - 0.75j, 0.75 + 0.25j])
    np.testing.assert_allclose(with_iq_imbalance(x, 20 * np.log10(2), 0.0), x.real + 2j * x.imag, rtol=1e-6)
    np.testing.assert_allclose(with_iq_imbalance(x, 0.0, np.pi / 6).real, x.real)


def test_coupling_falls_with_distance() -> None:
    matrix = coupling_matrix(np.array([[0, 0, 0], [0, 2.5e-3, 0], [0, 5e-3, 0]]), 59.9584916e9, -20.0)
    np.testing.assert_allclose(np.abs(matrix[0]), [1, 0.1, 0.05], rtol=1e-6)
    np.testing.assert_allclose(matrix, matrix.T)


@pytest.mark.parametrize("ratio", [0.05, 0.3, 1.0, 8.0])
def test_the_gain_of_a_quantiser_is_that_of_a_gaussian_input(ratio: float) -> None:
    x = np.random.default_rng(1).standard_normal(400_000).astype(np.float32)
    bits, step = 8, 1 / ratio
    output = quantised_iq((x + 0j).astype(np.complex64), bits, step * 2 ** (bits - 1)).real
    slope = float((x * output).mean() / (x * x).mean())
    assert float(quantiser_gain(np.array(ratio), bits)) == pytest.approx(slope, rel=0.01)
