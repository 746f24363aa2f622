"""Bounds against brute force: finite differences of the mean, Monte Carlo of the score, closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import i0e, ive

from estimation.channel.model.crb import crb, path_covariance, path_information
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.phase_information import exact_pair_information, pair_information
from sim.signal.arrays.array import upa_positions_m
from sim.signal.arrays.beams import direction_grid, sine_spaced_azimuths, steered_beams
from sim.signal.arrays.codebook import codebook_on_panels, steered_codebook

CARRIER_HZ = 60e9
FREQUENCY_HZ = np.linspace(-150e6, 170e6, 24)


def flat_codebook(beams, panels=(0.0,), columns=8):
    return steered_codebook(
        upa_positions_m(2, columns, CARRIER_HZ),
        CARRIER_HZ,
        panel_azimuth_rad=panels,
        beams_per_panel=beams,
        sector_rad=np.deg2rad(90),
    )


def elevation_codebook():
    position = upa_positions_m(4, 6, CARRIER_HZ)
    beams = steered_beams(position, CARRIER_HZ, *direction_grid(sine_spaced_azimuths(5, 1.5), [-0.3, 0.0, 0.3]))
    return codebook_on_panels(beams, position, CARRIER_HZ, panel_azimuth_rad=[0.2])


CASES = {
    "flat": (flat_codebook(6), flat_codebook(7), 1, 1),
    "panels": (flat_codebook(5), flat_codebook(4, (-np.pi / 2, 0.0, np.pi / 2)), 1, 1),
    "elevation": (flat_codebook(5), elevation_codebook(), 1, 2),
}


class Model:
    """The mean of a stop as a plain function of its real parameters (path, parameter)."""

    def __init__(self, name, n_paths, seed):
        tx, rx, self.n_tx, self.n_rx = CASES[name]
        self.tx, self.rx = Manifold(tx), Manifold(rx)
        assert (self.tx.n_angles, self.rx.n_angles) == (self.n_tx, self.n_rx)
        rng = np.random.default_rng(seed)
        self.noise = rng.uniform(0.5, 2.0, self.rx.n_beams)
        self.at = np.column_stack(
            [
                rng.uniform(0, 30e-9, n_paths),
                rng.uniform(-0.6, 0.6, (n_paths, self.n_tx)),
                rng.uniform(-0.4, 0.4, (n_paths, self.n_rx)),
                np.log(rng.uniform(0.01, 0.03, n_paths)),
                rng.uniform(-3, 3, n_paths),
            ]
        )

    def split(self, at):
        aod, aoa = at[:, 1 : 1 + self.n_tx], at[:, 1 + self.n_tx : -2]
        return at[:, 0], aod, aoa, np.exp(at[:, -2] + 1j * at[:, -1])

    def mean(self, at):
        """(tx_beam, rx_beam, subcarrier) over the noise amplitude."""
        delay, aod, aoa, gain = self.split(at)
        wave = np.exp(-2j * np.pi * delay[:, None] * FREQUENCY_HZ)
        tx, rx = self.tx.response(aod), self.rx.response(aoa) / np.sqrt(self.noise)
        return np.einsum("i,im,in,ik->mnk", gain, tx, rx, wave)

    def slopes(self):
        """Central differences (parameter, tx_beam, rx_beam, subcarrier) of the mean."""
        rows = []
        for index in np.ndindex(self.at.shape):
            step = np.zeros_like(self.at)
            step[index] = 1e-15 if index[1] == 0 else 1e-6
            difference = self.mean(self.at + step) - self.mean(self.at - step)
            rows.append(difference / (2 * step[index]))
        return np.array(rows)

    def information(self, coherent):
        return path_information(
            self.tx, self.rx, FREQUENCY_HZ, self.noise, *self.split(self.at), coherent=coherent
        )


def relative(information):
    """Information scaled to a unit diagonal."""
    flat = information.reshape(int(np.sqrt(information.size)), -1)
    scale = np.sqrt(np.diagonal(flat))
    return flat / np.outer(scale, scale)


@pytest.mark.parametrize("name", CASES)
def test_coherent_information_is_that_of_the_differentiated_mean(name):
    model = Model(name, 3, 1)
    slopes = model.slopes().reshape(model.at.size, -1)
    brute = 2 * np.real(slopes.conj() @ slopes.T)
    ours = model.information(True).reshape(brute.shape)
    scale = np.sqrt(np.outer(np.diagonal(brute), np.diagonal(brute)))
    assert_allclose(ours / scale, brute / scale, atol=1e-6)


@pytest.mark.parametrize(("name", "level"), [("flat", 1.0), ("flat", 6.0), ("panels", 2.0), ("elevation", 2.0)])
def test_incoherent_information_is_the_covariance_of_the_score(name, level):
    """Monte Carlo over pair phases and noise; pairs from far below the noise to far above it."""
    model = Model(name, 2, 2)
    model.at[:, -2] += np.log(level)
    mean, slopes = model.mean(model.at), model.slopes()
    rng = np.random.default_rng(3)
    total, n = np.zeros((model.at.size,) * 2), 2000
    first = np.zeros(model.at.size)
    for _ in range(n):
        noise = rng.standard_normal(mean.shape) + 1j * rng.standard_normal(mean.shape)
        phase = np.exp(2j * np.pi * rng.random(mean.shape[:2]))[..., None]
        data = phase * mean + noise / np.sqrt(2)
        z = np.sum(mean.conj() * data, axis=-1)
        ratio = ive(1, 2 * np.abs(z)) / i0e(2 * np.abs(z))
        turned = data * np.exp(-1j * np.angle(z))[..., None]
        score = 2 * np.real(slopes.conj() * (ratio[..., None] * turned - mean)).sum(axis=(1, 2, 3))
        first += score / n
        total += np.outer(score, score) / n
    ours = model.information(False).reshape(total.shape)
    scale = np.sqrt(np.diagonal(ours))
    assert_allclose(total / np.outer(scale, scale), ours / np.outer(scale, scale), atol=0.12)
    assert_allclose(np.diagonal(total) / scale**2, 1, atol=4 * np.sqrt(2 / n))
    assert_allclose(first / scale, 0, atol=4 / np.sqrt(n))


def test_incoherent_information_is_the_curvature_of_the_expected_log_likelihood():
    """The marginal likelihood itself, differenced: no score formula shared with the code."""
    model = Model("flat", 2, 4)
    model.at[:, -2] += np.log(3.0)
    rng = np.random.default_rng(5)
    shape = model.mean(model.at).shape
    steps = 0.02 / np.sqrt(np.diagonal(model.information(False).reshape(model.at.size, -1)))

    def log_likelihood(at, data):
        mean = model.mean(at)
        argument = 2 * np.abs(np.sum(mean.conj() * data, axis=-1))
        return float(np.sum(np.log(i0e(argument)) + argument - np.sum(np.abs(mean) ** 2, axis=-1)))

    scores = []
    for _ in range(500):
        noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
        data = model.mean(model.at) + noise / np.sqrt(2)
        row = []
        for index, step in zip(np.ndindex(model.at.shape), steps, strict=True):
            change = np.zeros_like(model.at)
            change[index] = step
            row.append(log_likelihood(model.at + change, data) - log_likelihood(model.at - change, data))
        scores.append(np.array(row) / 0.04)
    ours = relative(model.information(False))
    assert_allclose(np.cov(np.array(scores).T), ours, atol=0.25)


@pytest.mark.parametrize("coherent", [True, False])
def test_a_place_without_paths_has_no_information(coherent):
    tx, rx = (Manifold(book) for book in CASES["flat"][:2])
    none = np.zeros(0)
    noise = np.ones(rx.n_beams)
    found = path_information(
        tx, rx, FREQUENCY_HZ, noise, none, np.zeros((0, 1)), np.zeros((0, 1)), none + 0j, coherent=coherent
    )
    assert found.shape[0] == found.shape[2] == 0


def test_strong_pairs_lose_only_their_phase_and_weak_pairs_all():
    snr = np.array([1e-9, 1e-4, 1e7])
    a, b = pair_information(snr)
    assert_allclose(a[-1] / snr[-1], 0.5, rtol=1e-6)
    assert_allclose(b[-1], 1, rtol=1e-6)
    assert_allclose(a[:2], snr[:2] ** 2, rtol=1e-3)
    assert_allclose(b[:2], snr[:2], rtol=1e-3)
    inside = np.geomspace(2e-6, 5e5, 777)
    for table, exact in zip(pair_information(inside), exact_pair_information(inside), strict=True):
        assert_allclose(table, exact, rtol=1e-4)


def test_a_lone_path_has_the_textbook_delay_bound():
    """var >= 1 / (8 pi^2 SNR beta^2) with beta the rms bandwidth and SNR that of all samples together."""
    book = flat_codebook(6)
    bounds = crb(book, book, FREQUENCY_HZ, 2e-3, delay_s=[9e-9], aod_rad=[0.1], aoa_rad=[-0.2], amplitude=[3e-2j])
    tx, rx = Manifold(book).response(np.array([[0.1]])), Manifold(book).response(np.array([[-0.2]]))
    snr = 9e-4 * np.sum(np.abs(tx) ** 2) * np.sum(np.abs(rx) ** 2) * len(FREQUENCY_HZ) / 2e-3
    variance = 1 / (8 * np.pi**2 * snr * np.var(FREQUENCY_HZ))
    assert_allclose(bounds.delay_std_s[0] ** 2, variance, rtol=1e-9)
    known_angles = 20 / np.log(10) / np.sqrt(2 * snr)
    assert known_angles <= bounds.gain_std_db[0] <= 1.01 * known_angles
    best = 9e-4 * np.max(np.abs(tx) ** 2) * np.max(np.abs(rx) ** 2) * len(FREQUENCY_HZ) / 2e-3
    assert_allclose(bounds.snr_db[0], 10 * np.log10(best))


def test_losing_phases_never_helps_and_real_responses_lose_little():
    book = flat_codebook(12)
    paths = {
        "delay_s": [9e-9, 40e-9], "aod_rad": [0.1, 0.15], "aoa_rad": [-0.2, 0.3], "amplitude": [3e-2j, 2e-2],
    }  # fmt: skip
    kept = crb(book, book, FREQUENCY_HZ, 1e-5, **paths)
    lost = crb(book, book, FREQUENCY_HZ, 1e-5, **paths, coherent=False)
    assert np.all(lost.std >= kept.std)
    assert np.all(lost.std <= 1.2 * kept.std)
    assert np.all(np.isnan(lost.phase_std_rad)) and np.all(np.isfinite(kept.phase_std_rad))
    noisy = crb(book, book, FREQUENCY_HZ, 1e3, **paths, coherent=False)
    assert np.all(noisy.std > 3 * crb(book, book, FREQUENCY_HZ, 1e3, **paths).std)


def test_unobservable_parameters_have_infinite_bounds():
    book = flat_codebook(6)
    single = replace(flat_codebook(1))
    here = {"delay_s": [9e-9], "aod_rad": [0.1], "aoa_rad": [-0.2], "amplitude": [1.0]}
    bounds = crb(single, book, FREQUENCY_HZ, 1.0, **here)
    assert np.isinf(bounds.aod_std_rad).all() and np.isfinite(bounds.delay_std_s).all()
    assert np.isfinite(bounds.aoa_std_rad).all() and np.isinf(bounds.gain_std_db).all()
    twice = {name: value * 2 for name, value in here.items()}
    assert np.isinf(crb(book, book, FREQUENCY_HZ, 1.0, **twice).std).all()
    none = {name: [] for name in here}
    assert crb(book, book, FREQUENCY_HZ, 1.0, **none).covariance.shape == (0, 3, 3)


def test_joint_covariance_includes_the_other_paths():
    model = Model("flat", 2, 6)
    model.at[1, :-2] = model.at[0, :-2] + np.array([1e-9, 0.05, 0.05])
    information = model.information(True)
    joint, alone = path_covariance(information), path_covariance(information[:1, :, :1])
    assert np.all(np.diagonal(joint[0, :, 0]) >= np.diagonal(alone[0, :, 0]) * (1 - 1e-9))
    size = information.shape[1]
    product = joint.reshape(2 * size, -1) @ information.reshape(2 * size, -1)
    assert_allclose(product, np.eye(2 * size), atol=1e-4 * np.abs(product).max())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"delay_s": [1e-9, 2e-9]}, "delay_s: shape"),
        ({"aod_rad": [np.nan]}, "aod_rad: must be finite"),
        ({"noise_power_mw": 0.0}, "noise_power_mw = 0: must be positive"),
        ({"amplitude": [np.inf]}, "amplitude: must be finite"),
    ],
)
def test_bad_input_is_named(change, message):
    book = flat_codebook(4)
    given = {
        "tx_codebook": book, "rx_codebook": book, "frequency_offset_hz": FREQUENCY_HZ, "noise_power_mw": 1.0,
        "delay_s": [1e-9], "aod_rad": [0.0], "aoa_rad": [0.0], "amplitude": [1.0],
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        crb(**{**given, **change})
