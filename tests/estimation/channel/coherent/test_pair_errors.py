"""Errors of beam pairs against sums over pairs and against dense Fisher information."""

from dataclasses import replace

import numpy as np

from estimation.channel.calibration.ends import element_matrix
from estimation.channel.coherent.pair_errors import LitPairs, PairErrors
from estimation.channel.coherent.plan import nominal_manifold, search_plan
from estimation.channel.model.compress import CompressedSweep, compress
from estimation.channel.model.path_model import PathParameters
from scenes.record import ComplexArray, FloatArray
from sim.signal.arrays.codebook import Codebook
from tests.estimation.channel.plain_sweeps import no_plain_paths, plain_link, plain_sweep

LINK = plain_link()
RNG = np.random.default_rng(1)
SWEEP = plain_sweep(LINK, no_plain_paths(LINK), RNG)
TX, RX = nominal_manifold(LINK.tx_codebook), nominal_manifold(LINK.rx_codebook)
SHAPE = SWEEP.samples.shape[:2]
PAIRS = LitPairs(TX, RX, SWEEP.noise_power_mw, PairErrors(RNG.uniform(0, 5, SHAPE), RNG.uniform(0.01, 0.5, SHAPE)))
PATHS = PathParameters(
    np.array([3.2, 3.9]), np.array([[0.1], [0.3]]), np.array([[-0.2], [-0.1]]), np.array([0.4 + 0.2j, -0.3j])
)


def window() -> CompressedSweep:
    plan = search_plan(TX, RX, tuple(SWEEP.noise_power_mw.tolist()), 2.0)
    cube = compress(SWEEP, plan.tx, plan.rx)
    return cube.window(np.arange(cube.n_bins))


def test_the_noise_of_a_path_is_that_of_its_pairs_by_its_energy() -> None:
    tx, rx = np.abs(TX.response(PATHS.aod_rad)) ** 2, np.abs(RX.response(PATHS.aoa_rad)) ** 2
    rx = rx / SWEEP.noise_power_mw
    for path, factor in enumerate(PAIRS.noise_factor(PATHS)):
        energy = np.outer(tx[path], rx[path])
        noise = 1 + PAIRS.errors.excess
        assert np.isclose(factor, (energy * noise).sum() / energy.sum())


def test_the_floors_are_what_drawn_errors_of_elements_and_of_phases_leave_of_a_stronger_path() -> None:
    paths = PathParameters(
        np.array([3.2, 3.9]), np.array([[0.1], [0.5]]), np.array([[-0.2], [0.4]]), np.array([1.0 + 0j, 1e-3j])
    )
    variance = RNG.uniform(0.01, 0.03, SHAPE)
    errors = PairErrors(np.zeros(SHAPE), variance, element_level=0.02)
    pairs, n_bins = LitPairs(TX, RX, SWEEP.noise_power_mw, errors), SWEEP.samples.shape[2]
    power, by_elements, by_phases = pairs.power_and_floors(paths, n_bins)
    assert by_elements[0] == by_phases[0] == 0
    ends = ((LINK.tx_codebook, paths.aod_rad[0, 0]), (LINK.rx_codebook, paths.aoa_rad[0, 0]))
    tx, rx = TX.response(paths.aod_rad), RX.response(paths.aoa_rad) / np.sqrt(SWEEP.noise_power_mw)
    unit = [one[1] / np.linalg.norm(one[1]) for one in (tx, rx)]
    late = float(np.sinc(paths.delay_bins[1] - paths.delay_bins[0])) ** 2
    found: list[list[float]] = [[], []]
    for _ in range(4000):
        shape = (2, LINK.tx_codebook.size("element"))
        error = np.sqrt(0.02 / 2) * (RNG.standard_normal(shape) + 1j * RNG.standard_normal(shape))
        changed = [
            nominal_response(replace(book, weights=book.weights * (1 + one)), azimuth)
            for (book, azimuth), one in zip(ends, error, strict=True)
        ]
        right = np.outer(tx[0], rx[0])
        turned = right * np.exp(1j * np.sqrt(variance) * RNG.standard_normal(SHAPE))
        for number, wrong in enumerate((np.outer(changed[0], changed[1] / np.sqrt(SWEEP.noise_power_mw)), turned)):
            found[number].append(float(np.square(np.abs(unit[0].conj() @ (wrong - right) @ unit[1].conj()))))
    np.testing.assert_allclose([by_elements[1], by_phases[1]], late * np.mean(found, axis=1), rtol=0.1)
    assert np.isclose(power[1], 1e-6 * np.square(np.abs(np.outer(tx[1], rx[1]))).sum())


def nominal_response(codebook: Codebook, azimuth_rad: float) -> ComplexArray:
    """Response (beam,) of a codebook in one direction at the horizon."""
    angles = np.array([azimuth_rad]), np.zeros(1)
    return np.asarray(element_matrix(codebook, *angles)[0].sum(axis=1))


def test_only_weak_paths_at_the_delay_of_a_strong_one_may_be_its_floor() -> None:
    delay = np.array([3.0, 3.0, 3.0, 30.0])
    angle = np.array([[0.1], [0.5], [0.5], [0.5]])
    amplitude = np.array([1.0, 1e-3, 0.3, 1e-3]) + 0j
    paths = PathParameters(delay, angle, np.full((4, 1), -0.2), amplitude)
    errors = PairErrors(np.zeros(SHAPE), np.zeros(SHAPE), element_level=0.02)
    pairs = LitPairs(TX, RX, SWEEP.noise_power_mw, errors)
    assert pairs.may_be_floor(paths, SWEEP.samples.shape[2]).tolist() == [False, True, False, False]
    none = replace(pairs, errors=replace(errors, element_level=0.0))
    assert not none.may_be_floor(paths, SWEEP.samples.shape[2]).any()


def signal(values: FloatArray, sweep: CompressedSweep) -> ComplexArray:
    """Signal (pair, bin) of paths with parameters (path, column): real and imaginary part, delay, angles."""
    paths = values.reshape(len(PATHS), -1)
    wave = sweep.delay_response(paths[:, 2])[:, 0]
    tx, rx = TX.response(paths[:, 3:4]), RX.response(paths[:, 4:5]) / np.sqrt(SWEEP.noise_power_mw)
    gain = paths[:, 0] + 1j * paths[:, 1]
    return np.einsum("p,pm,pn,pb->mnb", gain, tx, rx, wave).reshape(-1, wave.shape[1])


def test_unknown_phases_take_the_schur_complement_of_the_dense_information() -> None:
    sweep = window()
    amplitude = PATHS.amplitude
    values = np.column_stack(
        [amplitude.real, amplitude.imag, PATHS.delay_bins, PATHS.aod_rad, PATHS.aoa_rad]
    ).ravel()
    mean, step = signal(values, sweep), 1e-6
    slopes = np.array(
        [(signal(values + d, sweep) - signal(values - d, sweep)) / (2 * step) for d in step * np.eye(len(values))]
    )
    cross = 2 * np.einsum("apb,pb->ap", slopes.conj(), 1j * mean).real
    own = 2 * np.square(np.abs(mean)).sum(axis=1) + 1 / PAIRS.errors.phase_variance.ravel()
    lost = (cross / own) @ cross.T / 2
    found = PAIRS.lost_information(sweep, PATHS).reshape(lost.shape)
    np.testing.assert_allclose(found, lost, rtol=1e-4, atol=1e-6 * np.abs(lost).max())
