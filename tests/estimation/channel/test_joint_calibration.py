"""Joint calibration of both arrays by all paths: against finite differences, drawn arrays and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from estimation.channel.calibration.ends import (
    End,
    as_built,
    coupled_pairs,
    coupling_levels,
    designed_factors,
    with_responses,
    without_gauge,
)
from estimation.channel.calibration.joint import independent_errors, joint_factors
from estimation.channel.calibration.normal import StopModel, StopSamples, normal_equations
from estimation.channel.calibration.record import Calibration, as_designed
from estimation.channel.calibration.remaining import (
    error_power,
    likelihood_settings,
    sine_variance,
    with_pointing_errors,
)
from estimation.channel.calibration.self_calibration import self_calibrate
from estimation.channel.config import ChannelConfig, SelfCalibrationConfig
from estimation.channel.record import ChannelEstimate
from isac_arena.validation.scenarios.link_bench import draw_paths, make_bench, observe_paths
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray
from sim.observation import BeamSweep
from sim.signal.arrays.array import upa_positions_m
from sim.signal.arrays.beams import steered_beams
from sim.signal.arrays.codebook import Codebook, codebook_on_panels
from sim.signal.hardware.impairments import coupling_matrix

CARRIER_HZ = 60e9
N_PATHS = 6


def drawn(rng: np.random.Generator, *shape: int) -> ComplexArray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def book(rows: int, columns: int, elevations: tuple[float, ...] = (-0.4, 0.0, 0.4)) -> Codebook:
    position = upa_positions_m(rows, columns, CARRIER_HZ)
    azimuth, elevation = map(np.ravel, np.meshgrid(np.linspace(-0.9, 0.9, 9), elevations))
    return codebook_on_panels(
        steered_beams(position, CARRIER_HZ, azimuth, elevation), position, CARRIER_HZ, panel_azimuth_rad=[0.0]
    )


def drawn_model(rng: np.random.Generator, books: tuple[Codebook, Codebook], n_angles: int = 2) -> StopModel:
    angles = rng.uniform(-0.7, 0.7, (2, N_PATHS, n_angles)) * ([1.0, 0.5][:n_angles])
    return StopModel(
        gain=10 * drawn(rng, N_PATHS),
        delay_change=np.zeros(N_PATHS),
        aod_rad=angles[0],
        aoa_rad=angles[1],
        phase_rad=np.zeros((len(books[0]), len(books[1]))),
    )


def seen(rng: np.random.Generator, model: StopModel, ends: tuple[End, End], phase_std: float = 0.0) -> StopSamples:
    """Samples of the paths, in the space of waves of six well apart delays, with noise of power one."""
    shape, rank = model.phase_rad.shape, 2 * N_PATHS
    wave = np.linalg.qr(drawn(rng, rank, rank))[0]
    stop = StopSamples(
        sample=drawn(rng, *shape, rank) / np.sqrt(2),
        wave=wave[:N_PATHS],
        slope=wave[N_PATHS:],
        weight=np.ones(shape),
        phase_variance=np.full(shape, phase_std**2),
    )
    explained = model.residual(stop, *ends)[1]
    turn = np.exp(1j * phase_std * rng.standard_normal(shape))
    return replace(stop, sample=stop.sample + explained * turn[..., None])


def towards(books: tuple[Codebook, Codebook], factors: list[ComplexArray], model: StopModel) -> tuple[End, End]:
    return End.towards(books[0], factors[0], model.aod_rad), End.towards(books[1], factors[1], model.aoa_rad)


def test_normal_equations_are_those_of_finite_differences() -> None:
    rng, step = np.random.default_rng(2), 1e-6
    books = (book(2, 3), book(1, 3, (0.0,)))
    model = drawn_model(rng, books)
    model = replace(model, aoa_rad=model.aoa_rad[:, :1], delay_change=0.1 * rng.standard_normal(N_PATHS))
    model = replace(model, phase_rad=0.1 * rng.standard_normal(model.phase_rad.shape))
    factors = [designed_factors(one) + 0.1 * drawn(rng, len(designed_factors(one))) for one in books]
    stop = seen(rng, model, towards(books, factors, model), phase_std=0.2)
    found = normal_equations(stop, model, *towards(books, factors, model))
    n, n_rows, n_pairs = found.n_elements, len(found.gradient), model.phase_rad.size

    def left(row: FloatArray) -> FloatArray:
        own = row[:n] + 1j * row[n : 2 * n]
        moved = model.moved(row[2 * n : n_rows].reshape(N_PATHS, -1), row[n_rows:].reshape(model.phase_rad.shape))
        changed = [one + part for one, part in zip(factors, np.split(own, [len(factors[0])]), strict=True)]
        rest = moved.residual(stop, *towards(books, changed, moved))[0] * np.exp(1j * moved.phase_rad)[..., None]
        prior = np.sqrt(stop.phase_information) * moved.phase_rad
        return np.concatenate([rest.real.ravel(), rest.imag.ravel(), prior.ravel()])

    moves = step * np.eye(n_rows + n_pairs)
    jacobian = np.stack([(left(move) - left(-move)) / (2 * step) for move in moves], axis=1)
    whole, slope = jacobian.T @ jacobian, -jacobian.T @ left(np.zeros(n_rows + n_pairs))
    across = np.linalg.solve(whole[n_rows:, n_rows:], np.column_stack([whole[n_rows:, :n_rows], slope[n_rows:]]))
    matrix = whole[:n_rows, :n_rows] - whole[:n_rows, n_rows:] @ across[:, :-1]
    gradient = slope[:n_rows] - whole[:n_rows, n_rows:] @ across[:, -1]
    np.testing.assert_allclose(found.matrix, matrix, atol=1e-7 * np.abs(matrix).max())
    np.testing.assert_allclose(found.gradient, gradient, atol=1e-7 * np.abs(gradient).max())
    assert model.cost(stop, *towards(books, factors, model)) == pytest.approx(np.square(left(0 * moves[0])).sum())


@pytest.mark.parametrize("phase_std", [0.0, 0.3])
def test_drawn_elements_and_coupling_are_found_without_known_directions(phase_std: float) -> None:
    """The responses of both arrays are right to -40 dB, up to gains and a shift of directions."""
    rng = np.random.default_rng(3)
    books = (book(2, 4), book(2, 4))
    factors = [designed_factors(one) + 0.1 * drawn(rng, len(designed_factors(one))) for one in books]
    models = [drawn_model(rng, books) for _ in range(6)]
    stops = [seen(rng, model, towards(books, factors, model), phase_std) for model in models]
    found = joint_factors(stops, models, books, prior_std=0.3, turns=30)
    assert found.gain > chi2.isf(1e-3, found.n_parameters) / 2
    for one, true, own in zip(books, factors, (found.tx, found.rx), strict=True):
        angles = rng.uniform(-0.7, 0.7, (40, 2)) * [1.0, 0.5]
        misfits = []
        for learned in (own, designed_factors(one)):
            built, model = End.towards(one, true, angles), End.towards(one, learned, angles)
            for path in range(len(angles)):
                base = np.column_stack([model.response[path], *model.slopes[:, path]])
                rest = built.response[path] - base @ np.linalg.lstsq(base, built.response[path])[0]
                misfits.append(np.square(np.abs(rest)).sum() / np.square(np.abs(built.response[path])).sum())
        learned_misfit, designed_misfit = np.median(np.reshape(misfits, (2, -1)), axis=1)
        assert learned_misfit < 1e-4 < 0.05 * designed_misfit


def test_arrays_as_designed_gain_no_more_than_chance() -> None:
    gains = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        books = (book(1, 4, (0.0,)), book(1, 4, (0.0,)))
        models = [drawn_model(rng, books, n_angles=1) for _ in range(3)]
        factors = [designed_factors(one) for one in books]
        stops = [seen(rng, model, towards(books, factors, model)) for model in models]
        found = joint_factors(stops, models, books, 0.3, 30)
        gains.append(2 * found.gain)
    freedom = found.n_parameters + 3 * 5 * N_PATHS  # the true paths gain as well: they are at no maximum
    assert min(gains) > 0 and max(gains) < chi2.isf(1e-3, freedom)
    assert 0.6 * freedom < np.mean(gains) < 1.1 * freedom  # factors that no path tells apart gain nothing


def test_a_few_other_paths_are_as_many_independent_errors_as_they_light_beams() -> None:
    rng = np.random.default_rng(6)
    assert independent_errors(drawn(rng, 20, 30, 40)) == pytest.approx(20 * 30 * 40, rel=0.2)
    lit = drawn(rng, 20, 2) @ drawn(rng, 2, 30)  # of 30 RX beams, two independent ones
    few = lit[..., None] * drawn(rng, 40)
    assert independent_errors(few) == pytest.approx(4, rel=0.5)


def test_coupling_is_told_by_displacement_at_all_distances() -> None:
    grid = coupled_pairs(book(3, 4))
    assert len(grid) == 3 * 4 - 1
    np.testing.assert_array_equal(grid, grid.swapaxes(1, 2))
    np.testing.assert_array_equal(grid.sum(axis=0), 1 - np.eye(12))
    assert len(coupled_pairs(book(3, 4, (0.0,)))) == 3  # horizontal beams see sums of columns
    one = book(1, 5, (-0.4, 0.0, 0.4))
    true = coupling_matrix(one.element_position_m, CARRIER_HZ, -20.0)
    factors = np.concatenate([np.ones(5), true[0, 1:]])
    np.testing.assert_allclose(as_built(one, factors).weights, one.weights @ true, atol=1e-9)


def test_coupling_falls_with_distance_and_adds_up_over_columns() -> None:
    true = np.abs(coupling_matrix(book(4, 6).element_position_m, CARRIER_HZ, -20.0))
    kinds = coupled_pairs(book(4, 6))
    expected = [10 * (true * kind).sum() / kind.sum() for kind in kinds]
    np.testing.assert_allclose(coupling_levels(book(4, 6)), expected, rtol=0.03)
    level = coupling_levels(book(4, 6, (0.0,)))
    columns = 10 * true.reshape(4, 6, 4, 6).sum(axis=(0, 2)) / 4  # (column, column)
    np.testing.assert_allclose(level, columns[0, 1:], rtol=0.03)


def sweeps(gain_std_db: float, phase_std_deg: float) -> list[BeamSweep]:
    bench = make_bench(3, element_gain_std_db=gain_std_db, element_phase_std_deg=phase_std_deg)
    rng = np.random.default_rng(5)
    some = (draw_paths(rng, bench.cell, strongest_db=(25.0, 40.0)) for _ in range(4))
    return [observe_paths(bench, paths, stop).sweep for stop, paths in enumerate(some)]


def test_only_arrays_that_show_errors_are_calibrated() -> None:
    settings = SelfCalibrationConfig(stops=4)
    right = sweeps(0.0, 0.0)
    kept = self_calibrate(right, settings)
    assert kept.n_paths == 0
    applied = kept.applied(right[0])
    assert applied.tx_codebook is right[0].tx_codebook and applied.rx_codebook is right[0].rx_codebook
    wrong = self_calibrate(sweeps(1.0, 10.0), settings)
    assert wrong.n_paths > 0 and wrong.is_coherent
    true_power = np.deg2rad(10) ** 2 + (1.0 * np.log(10) / 20) ** 2
    for codebook, element in ((wrong.tx_codebook, wrong.tx_element), (wrong.rx_codebook, wrong.rx_element)):
        assert error_power(codebook, element) == pytest.approx(true_power, rel=0.6)


def calibrated(codebook: Codebook, element: ComplexArray) -> Calibration:
    none = as_designed(codebook, codebook)
    return replace(none, tx_element=element, rx_element=element, n_paths=10)


@pytest.mark.parametrize("elevations", [(-0.4, 0.0, 0.4), (0.0,)])
def test_the_pointing_offset_has_the_variance_of_drawn_arrays(elevations: tuple[float, ...]) -> None:
    """Directions by arrays without their gauge err by the linear phase that was taken from them."""
    rng, one, std = np.random.default_rng(4), book(4, 8, elevations), 0.1
    position = one.element_position_m[:, 1:]
    offsets, powers = [], []
    for _ in range(400):
        element = 1 + std / np.sqrt(2) * drawn(rng, 32)
        kept = without_gauge(one, element)
        turned = np.angle(element / kept)
        turned -= turned.mean()
        offsets.append(np.linalg.lstsq(position, turned)[0] * SPEED_OF_LIGHT_M_S / (2 * np.pi * CARRIER_HZ))
        if len(elevations) == 1:  # the beams show the mean of every column
            kept = np.tile(kept.reshape(4, 8).mean(axis=0), 4)
        powers.append(error_power(one, kept))
    n_seen = 32 if len(elevations) > 1 else 8
    n_gauge = 4 if len(elevations) > 1 else 3  # a complex factor, and slopes
    assert np.mean(powers) == pytest.approx(std**2 * (1 - n_gauge / (2 * n_seen)), rel=0.05)
    expected = sine_variance(one, np.full(32, 1 + std, complex))
    if len(elevations) == 1:
        expected = expected / 4
    np.testing.assert_allclose(np.square(offsets).mean(axis=0), expected, rtol=0.25)


def test_pointing_errors_widen_all_directions_of_calibrated_arrays_alone() -> None:
    one = book(4, 8)
    element = 1 + 0.1 * np.exp(2j * np.pi * np.random.default_rng(1).random(32))
    azimuth, elevation = np.array([0.3, -0.6]), np.array([0.2, -0.1])
    before = ChannelEstimate(
        stop=0,
        delay_s=np.array([1e-8, 2e-8]),
        aod_azimuth_rad=azimuth,
        aoa_azimuth_rad=np.zeros(2),
        power_dbm=np.zeros(2),
        beam_loss_db=np.zeros(2),
        snr_db=np.zeros(2),
        covariance=np.tile(1e-4 * np.eye(5), (2, 1, 1)),
        is_los=np.zeros(2, bool),
        aod_elevation_rad=elevation,
        aoa_elevation_rad=np.zeros(2),
    )
    assert with_pointing_errors(before, as_designed(one, one)) is before
    added = with_pointing_errors(before, calibrated(one, element)).covariance - before.covariance
    variance = sine_variance(one, element)
    step = 1e-6
    for path in range(2):
        level = np.array([np.sin(azimuth[path]) * np.cos(elevation[path]), np.sin(elevation[path])])

        def direction(sines: FloatArray) -> FloatArray:
            up = np.arcsin(sines[1])
            return np.array([np.arcsin(sines[0] / np.cos(up)), up])

        slopes = [(direction(level + s) - direction(level - s)) / (2 * step) for s in step * np.eye(2)]
        expected = (np.array(slopes).T * variance) @ np.array(slopes)
        np.testing.assert_allclose(added[path][np.ix_([1, 3], [1, 3])], expected, rtol=1e-5)
    assert not added[:, 0].any()


def test_errors_that_are_left_are_no_larger_than_those_found() -> None:
    one, config = book(4, 8), ChannelConfig()
    assert likelihood_settings(config, as_designed(one, one)) is config
    element = np.full(32, 1.1, complex)
    built = with_responses(one, element, np.ones(len(one), complex))
    settings = likelihood_settings(config, calibrated(built, element))
    assert settings.maximum_likelihood.max_element_error == pytest.approx(0.01)
