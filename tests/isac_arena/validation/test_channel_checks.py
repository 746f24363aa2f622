"""The checks behind `arena validate channel`: seams, helpers, and a user's estimator in place of ours."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimation.channel.model.compress import compress
from estimation.channel.record import ChannelEstimate
from isac_arena.user_functions.room import close_rooms
from isac_arena.validation.channel import arena as channel_arena
from isac_arena.validation.channel import efficiency as channel
from isac_arena.validation.channel import noise as channel_noise
from isac_arena.validation.scenarios.link_bench import make_bench, noise_stop, observe_paths, single_path
from sim.signal.arrays.codebook import beam_response


@pytest.fixture(scope="module")
def bench():
    return make_bench(1)


MY_LAB = """
from estimation.channel.record import EstimateStatus, empty_estimate
from tests.isac_arena.validation.test_channel_checks import estimate_of
import numpy as np

def nothing(sweep):
    return empty_estimate(sweep.stop, "mine", EstimateStatus.NO_PATHS, "")

def always(sweep):
    return estimate_of(np.array([[50e-9, 0.1, 0.2]]), sweep.stop)
"""


@pytest.fixture
def user(tmp_path, monkeypatch):
    """A module of the user's: one estimator that finds nothing, one that finds a path in everything."""
    (tmp_path / "my_lab.py").write_text(MY_LAB)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    close_rooms()


def estimate_of(parameters, stop=0, snr_db=30.0):
    n = len(parameters)
    return ChannelEstimate(
        stop=stop,
        delay_s=parameters[:, 0],
        aod_azimuth_rad=parameters[:, 1],
        aoa_azimuth_rad=parameters[:, 2],
        power_dbm=np.zeros(n),
        beam_loss_db=np.zeros(n),
        snr_db=np.full(n, snr_db),
        covariance=np.tile(np.diag([1e-22, 1e-6, 1e-6]), (n, 1, 1)),
        is_los=np.zeros(n, bool),
    )


def test_compressed_noise_is_the_white_noise_that_is_drawn_in_its_place(bench):
    """Same shape, unit power in every cell, no correlation between cells: circular Gaussian, so the same law."""
    plan, template = channel_noise.noise_template(bench)
    cube = compress(noise_stop(bench, 7), plan.tx, plan.rx).spectrum
    drawn = channel_noise.white_noise(np.random.default_rng(1), template.spectrum.shape)
    for spectrum in (cube, drawn):
        cells = spectrum.reshape(-1, spectrum.shape[2])
        n, n_bins = cells.shape
        gram = cells @ cells.conj().T / n_bins
        off = gram - np.eye(n)
        assert np.abs(off).max() < 5.5 / np.sqrt(n_bins)
        assert np.mean(np.abs(off[~np.eye(n, dtype=bool)]) ** 2) * n_bins == pytest.approx(1, abs=0.02)
        between_bins = np.mean(cells[:, 1:] * cells[:, :-1].conj())
        pseudo = np.mean(cells**2)
        assert max(abs(between_bins), abs(pseudo)) < 4 / np.sqrt(cells.size)
        assert np.mean(np.abs(cells) ** 4) == pytest.approx(2, abs=0.02)


def test_a_path_in_a_noise_trial_would_be_seen(bench):
    """The loop behind the rate counts what the estimator finds: at a probability near one, nearly always."""
    assert channel_noise.compressed_hits(bench, np.random.default_rng(1), 0.999, 3) == 3
    assert channel_noise.compressed_hits(bench, np.random.default_rng(1), 1e-9, 2) == 0


def test_rates_are_judged_from_both_sides():
    def met(hits):
        return channel_noise.false_alarm_row("x", hits, 1000, 0.01, False).met

    assert [met(hits) for hits in (4, 5, 10, 15, 16)] == [False, True, True, True, False]


def test_a_users_estimator_takes_the_place_of_ours(user):
    rows = channel.check_detection(1, True, 5, "my_lab:nothing")
    assert [row.value for row in rows] == [0.0, 0.0] and not any(row.met for row in rows)
    (row,) = channel_noise.check_false_alarms(1, True, 3, "my_lab:always")
    assert row.value == 1.0 and not row.met
    rows = channel.check_coherent_scenes(1, True, 3, "my_lab:always")
    false = next(row for row in rows if row.key == "coherent.false_per_stop")
    assert false.value >= 2 / 3 and not false.met


def test_resolved_means_two_paths_near_their_own(bench):
    stop = observe_paths(bench, single_path(np.random.default_rng(1), 20.0), 0)
    one = stop.paths.parameters
    other = one + np.array([[0.4 * bench.cell[0], 0.0, 0.0]])
    assert not channel.is_resolved(bench, stop, lambda _: estimate_of(one))
    assert not channel.is_resolved(bench, stop, lambda _: estimate_of(np.concatenate([one, other, other])))


@pytest.fixture(scope="module")
def arena_link():
    return channel_arena.make_link(channel_arena.arena_settings(1))


def seen(parameters, snr_db, is_diffuse=False):
    parameters = np.array(parameters, float)
    n = len(parameters)
    return channel_arena.ApparentPaths(
        delay_s=parameters[:, 0] * 1e-9,
        aod_rad=parameters[:, 1:2],
        aoa_rad=parameters[:, 2:],
        amplitude=np.full(n, 1e-3 + 0j),
        snr_db=np.broadcast_to(np.asarray(snr_db, float), n),
        is_diffuse=np.full(n, is_diffuse),
    )


def test_arena_estimates_are_explained_by_true_energy_near_them(arena_link):
    truth = seen([[50, 0.1, 0.2], [51, 0.1, 0.2], [90, 0.3, 3.1]], [20.0, 20.0, 30.0])
    found = estimate_of(np.array([[50.2e-9, 0.1, 0.2], [90e-9, 0.3, -3.14], [70e-9, 0.0, 0.0]]), snr_db=25.0)
    match = channel_arena.matched(arena_link, found, truth)
    assert match.tolist() == [0, -1, 1]  # the wrap of the azimuth is no distance
    every = np.arange(3)
    assert channel_arena.count_unexplained(arena_link, found, every, truth) == 1
    louder = estimate_of(np.array([[50.2e-9, 0.1, 0.2]]), snr_db=32.0)
    assert channel_arena.count_unexplained(arena_link, louder, every[:1], truth) == 1


def test_diffuse_power_counts_where_it_passes_the_matched_filter(arena_link):
    path = seen([[50, 0.1, 0.2]], 30.0)
    here = channel_arena.diffuse_loss_db(arena_link, path, path)
    far = channel_arena.diffuse_loss_db(arena_link, path, seen([[150, 0.9, -2.0]], 30.0, True))
    tx = beam_response(arena_link.tx_codebook, 0.1)
    rx = beam_response(arena_link.rx_codebook, 0.2)[:, 0] / np.sqrt(arena_link.noise_power_mw)
    energy = 1e-6 * np.sum(np.abs(tx) ** 2) * np.sum(np.abs(rx) ** 2) * 1584
    assert_allclose(here, 10 * np.log10(1 + energy), rtol=1e-6)
    assert far[0] < here[0] - 40
