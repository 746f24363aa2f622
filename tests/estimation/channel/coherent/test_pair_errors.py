"""Errors of beam pairs against sums over pairs and against dense Fisher information."""

import numpy as np

from estimation.channel.coherent.pair_errors import LitPairs, PairErrors
from estimation.channel.coherent.plan import nominal_manifold, search_plan
from estimation.channel.model.compress import CompressedSweep, compress
from estimation.channel.model.path_model import PathParameters
from scenes.record import ComplexArray, FloatArray
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
