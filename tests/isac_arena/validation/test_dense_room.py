"""The dense stop of `arena bench channel` holds what it says, and its rows are the worst of all fits."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from isac_arena.campaign.campaign import load_campaign
from isac_arena.validation.benches import dense_room
from isac_arena.validation.benches.dense_room import FitCost, bench_dense_room, dense_rows, dense_stop, drawn_paths
from isac_arena.validation.channel.arena import seen_paths
from isac_arena.validation.scenarios.paths import made_paths
from sim.truth import Truth


@pytest.fixture(scope="module")
def run():
    return load_campaign("campus_arena", seed=1, **{"waveform.n_rb": 24}).chain()


@pytest.fixture(scope="module")
def truth(run):
    """A stop with one path, 40 ns long, straight ahead of the TX."""
    level = np.zeros(1)
    ahead = (level + run.scene.tx.heading_rad, level)
    return Truth(made_paths([1e-4 + 0j], [40e-9], ahead, (level, level)), run.scene.stops[0], 0, 0.0)


def test_drawn_paths_have_their_snr_and_follow_the_first(run, truth):
    paths = drawn_paths(run, truth, np.random.default_rng(1))
    seen = seen_paths(run.link, Truth(paths, truth.rx_pose, 0, 0.0), run.scene.tx.heading_rad)
    low, high = dense_room.DRAWN_SNR_DB
    assert len(paths) == dense_room.N_DRAWN
    assert (seen.snr_db > low - 1e-6).all() and (seen.snr_db < high + 1e-6).all()
    assert np.ptp(seen.snr_db) > 0.9 * (high - low)
    assert (paths.delay_s >= 40e-9).all() and (paths.delay_s <= 40e-9 + dense_room.SPREAD_S).all()


def test_the_dense_stop_has_its_own_path_too(run, truth):
    """Without the drawn paths, what is left of the samples is the sweep of the stop itself, but for the noise."""
    dense = dense_stop(run, truth, np.random.default_rng(1)).samples
    drawn = drawn_paths(run, truth, np.random.default_rng(1))
    alone = run.observer(run.config, run.link, run.scene, Truth(drawn, truth.rx_pose, 0, 0.0)).samples
    silent = Truth(made_paths(*_no_paths()), truth.rx_pose, 0, 0.0)
    noise = run.observer(run.config, run.link, run.scene, silent).samples
    own = run.observer(run.config, run.link, run.scene, truth).samples
    assert np.abs(own - noise).max() > 100 * np.abs(noise).std()
    assert_allclose(dense - alone, own - noise, atol=1e-4 * np.abs(own).max())


def _no_paths():
    none = np.zeros(0)
    return none + 0j, none, (none, none), (none, none)


def cost(stop, limit, passes):
    return FitCost(stop, limit, limit, np.atleast_1d(passes).astype(float), 1.0, 1.0)


def values(costs):
    return {row.key.removeprefix("channel.dense."): row.value for row in dense_rows(costs)}


def test_a_linear_fit_does_not_grow():
    found = values([cost("a", limit, limit / 10) for limit in dense_room.LIMITS])
    assert_allclose([found[key] for key in ("passes_per_path", "growth_over_linear")], [0.1, 1.0])
    assert_allclose([found[key] for key in ("passes_120", "120_over_30")], [12.0, 4.0])


def test_rows_are_the_worst_of_all_stops_and_limits():
    quadratic = [cost("b", limit, limit**2 / 3000) for limit in dense_room.LIMITS]
    found = values([cost("a", limit, limit / 10) for limit in dense_room.TRACED_LIMITS] + quadratic)
    assert_allclose([found["passes_per_path"], found["growth_over_linear"]], [0.1, 8.0])
    assert_allclose([found["passes_120"], found["120_over_30"]], [12.0, 16.0])


def test_the_median_of_pairs_counts_and_a_quick_run_has_no_row_of_120_paths():
    found = values([cost("a", 30, [3.0, 3.0, 90.0]), cost("a", 60, 6.0)])
    assert found == {"passes_per_path": pytest.approx(0.1), "growth_over_linear": pytest.approx(1.0)}


@pytest.mark.whole
def test_the_quick_bench_fits_as_many_paths_as_it_may():
    found = bench_dense_room(1, True)
    (table,) = found.tables
    assert [row[1:3] for row in table.rows] == [(30, 30), (60, 60)]
    assert {row.key for row in found.rows} == {"channel.dense.passes_per_path", "channel.dense.growth_over_linear"}
    assert all(row.value > 0 for row in found.rows)
