"""Self-calibration: element and beam errors from paths of unknown directions, against the arrays as built."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.calibration.dominant import dominant_paths
from estimation.channel.calibration.ends import element_matrix, with_responses, without_gauge
from estimation.channel.calibration.rank_one import calibrate_array
from estimation.channel.calibration.record import spread_rows
from estimation.channel.calibration.self_calibration import self_calibrate
from estimation.channel.config import SelfCalibrationConfig
from estimation.channel.model.manifold import Manifold
from isac_arena.validation.scenarios.link_bench import LinkBench, draw_paths, make_bench, observe_paths
from scenes.record import ComplexArray, FloatArray
from sim.observation import BeamSweep
from sim.signal.arrays.array import upa_positions_m
from sim.signal.arrays.beams import sine_spaced_azimuths, steered_beams
from sim.signal.arrays.codebook import Codebook, beam_response, codebook_on_panels
from sim.signal.hardware.apply_impairments import impaired_codebooks

CARRIER_HZ = 60e9


def codebook(panels: list[float], rows: int = 1) -> Codebook:
    position = upa_positions_m(rows, 8, CARRIER_HZ)
    azimuth = sine_spaced_azimuths(14, np.deg2rad(120))
    beams = steered_beams(position, CARRIER_HZ, azimuth, np.zeros(14))
    return codebook_on_panels(beams, position, CARRIER_HZ, panel_azimuth_rad=panels)


def element_errors(rng: np.random.Generator, n: int) -> ComplexArray:
    gain = 10 ** (rng.standard_normal(n) / 20)
    return np.asarray(gain * np.exp(1j * np.deg2rad(10) * rng.standard_normal(n)))


def unit_responses(book: Codebook, azimuth: FloatArray) -> ComplexArray:
    response = beam_response(book, azimuth).T
    return np.asarray(response / np.linalg.norm(response, axis=1, keepdims=True))


def test_elements_add_up_to_the_beams() -> None:
    book = codebook([0.0, 1.5], rows=2)
    azimuth, elevation = np.array([0.3, 1.2]), np.array([0.1, -0.2])
    total = element_matrix(book, azimuth, elevation).sum(axis=2)
    np.testing.assert_allclose(total.T, beam_response(book, azimuth, elevation), atol=1e-12)


@pytest.mark.parametrize("panels", [[0.0], [0.0, 2.0, -2.0]])
def test_exact_responses_give_exact_elements_up_to_the_gauge(panels: list[float]) -> None:
    book, rng = codebook(panels), np.random.default_rng(3)
    errors = element_errors(rng, 8)
    built = with_responses(book, errors, np.ones(len(book)))
    azimuth = rng.uniform(-0.8, 0.8, 40) + rng.choice(panels, 40)
    factor = np.exp(2j * np.pi * rng.random(40))
    vectors = unit_responses(built, azimuth) * factor[:, None]
    config = SelfCalibrationConfig(prior_std=10.0, turns=200)
    found = calibrate_array(book, vectors, np.full(40, 1e8), config)
    np.testing.assert_allclose(found.element, without_gauge(book, errors), atol=2e-3)
    assert found.misfit < 1e-4


def test_magnitudes_alone_give_the_magnitudes_of_all_directions() -> None:
    book, rng = codebook([0.0]), np.random.default_rng(4)
    built = with_responses(book, element_errors(rng, 8), np.ones(len(book)))
    vectors = np.abs(unit_responses(built, rng.uniform(-0.9, 0.9, 60))).astype(complex)
    config = SelfCalibrationConfig(prior_std=10.0, turns=300)
    found = calibrate_array(book, vectors, np.full(60, 1e8), config, is_coherent=False)
    calibrated = with_responses(book, found.element, found.beam)
    directions, fine = np.linspace(-0.9, 0.9, 50), np.linspace(-1.0, 1.0, 4001)
    seen = np.abs(unit_responses(built, directions))
    misfit = [1 - ((seen @ np.abs(unit_responses(b, fine)).T) ** 2).max(axis=1).mean() for b in (book, calibrated)]
    assert misfit[1] < 1e-4 < 0.05 * misfit[0]


def test_beam_factors_are_found_with_true_elements() -> None:
    book, rng = codebook([0.0]), np.random.default_rng(5)
    factors = np.exp(1j * np.deg2rad(30) * rng.standard_normal(len(book)))
    built = with_responses(book, np.ones(8), factors)
    vectors = unit_responses(built, rng.uniform(-0.9, 0.9, 60))
    config = SelfCalibrationConfig(errors="beams", prior_std=10.0, turns=200)
    found = calibrate_array(book, vectors, np.full(60, 1e8), config)
    turn = (found.beam.conj() * factors).sum()
    np.testing.assert_allclose(found.beam * turn / abs(turn), factors, atol=0.03)


def test_the_gauge_removes_a_common_factor_and_a_pointing_offset() -> None:
    book, rng = codebook([0.0], rows=4), np.random.default_rng(6)
    errors = element_errors(rng, 32)
    phase = 0.4 + book.element_position_m[:, 1:] @ np.array([90.0, -60.0])
    both = without_gauge(book, 3.0 * errors * np.exp(1j * phase)), without_gauge(book, errors)
    np.testing.assert_allclose(*both, atol=1e-3)
    np.testing.assert_allclose(without_gauge(book, both[1]), both[1], atol=1e-3)


@pytest.fixture(scope="module")
def bench() -> LinkBench:
    return make_bench(3, element_gain_std_db=1.0, element_phase_std_deg=10.0)


def stop_sweeps(bench: LinkBench, n: int) -> list[BeamSweep]:
    rng = np.random.default_rng(5)
    drawn = (draw_paths(rng, bench.cell, strongest_db=(25.0, 40.0)) for _ in range(n))
    return [observe_paths(bench, paths, stop).sweep for stop, paths in enumerate(drawn)]


def misfit_db(true: Codebook, other: Codebook) -> float:
    """Mean share of the power of true responses that no response of the other codebook explains."""
    azimuth = np.deg2rad(np.linspace(-55, 55, 80))[:, None]
    fine = np.deg2rad(np.linspace(-60, 60, 4001))[:, None]
    responses = [Manifold(true, 1).response(azimuth), Manifold(other, 1).response(fine)]
    seen, model = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in responses)
    return float(10 * np.log10(np.mean(1 - np.square(np.abs(seen.conj() @ model.T)).max(axis=1))))


def test_a_few_stops_calibrate_both_arrays(bench: LinkBench) -> None:
    sweeps = stop_sweeps(bench, 8)
    calibration = self_calibrate(sweeps)
    assert calibration.is_coherent
    assert calibration.n_paths >= 8
    for true, found, nominal in zip(
        impaired_codebooks(bench.config, bench.link),
        (calibration.tx_codebook, calibration.rx_codebook),
        (bench.link.tx_codebook, bench.link.rx_codebook),
        strict=True,
    ):
        assert misfit_db(true, nominal) > -24
        assert misfit_db(true, found) < -33
        assert Manifold(found).n_angles == 1
    applied = calibration.applied(sweeps[0])
    assert applied.tx_codebook is calibration.tx_codebook


def test_calibration_takes_stops_from_the_whole_walk_each_once() -> None:
    settings = SelfCalibrationConfig(stops=4)
    assert spread_rows(10, settings.stops).tolist() == [0, 3, 6, 9]
    assert spread_rows(3, settings.stops).tolist() == [0, 1, 2]
    assert spread_rows(1, settings.stops).tolist() == [0]


def test_incoherent_phases_are_detected() -> None:
    bench = make_bench(3, element_gain_std_db=1.0, element_phase_std_deg=10.0, phase_noise_pair_deg=30.0)
    calibration = self_calibrate(stop_sweeps(bench, 3))
    assert not calibration.is_coherent


def test_paths_that_share_a_delay_cell_are_left_out(bench: LinkBench) -> None:
    paths = dominant_paths(stop_sweeps(bench, 1)[0], 16.0)
    mixed = replace(paths, amplitude=paths.amplitude[:1] + paths.amplitude[1:2][:, ::-1])
    assert paths.pure(True, 0.97).size("path") >= 1
    assert mixed.pure(True, 0.97).size("path") == 0


def test_nothing_to_calibrate_from_is_an_error(bench: LinkBench) -> None:
    with pytest.raises(ValueError, match="no sweeps, at least 2"):
        self_calibrate([])
    sweep = stop_sweeps(bench, 1)[0]
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((*sweep.samples.shape, 2)).astype(np.float32).view(np.complex64)[..., 0]
    quiet = replace(sweep, samples=noise * np.sqrt(sweep.noise_power_mw[0] / 2).astype(np.float32))
    with pytest.raises(ValueError, match="no path stands alone"):
        self_calibrate([quiet])
