"""Scoring counts what it says, and is unbiased on errors that are drawn from the bounds."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.record import ChannelEstimate
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.validation.channel.matching import (
    MatchedPaths,
    consistency_rows,
    efficiency_rows,
    false_row,
    match_stop,
    rate_row,
)
from isac_arena.validation.monte_carlo import quick_bar
from isac_arena.validation.scenarios.link_bench import ChannelStop, DrawnPaths, TrueBounds, make_bench, nearest


@pytest.fixture(scope="module")
def bench():
    return make_bench(1)


def made_stop(bench, places):
    """Paths at places in cells, without samples."""
    places = np.array(places, float) * bench.cell
    n = len(places)
    paths = DrawnPaths(*places.T, snr_db=np.full(n, 30.0), phase_rad=np.zeros(n))
    covariance = np.tile(np.diag([1e-24, 1e-6, 1e-6]), (n, 1, 1))
    return ChannelStop(None, paths, None), TrueBounds(covariance, np.zeros(n), nearest(places / bench.cell))


def estimate_at(bench, places):
    places = np.array(places, float).reshape(-1, 3) * bench.cell
    n = len(places)
    return ChannelEstimate(
        stop=0,
        delay_s=places[:, 0],
        aod_azimuth_rad=np.arcsin(places[:, 1]),
        aoa_azimuth_rad=np.arcsin(places[:, 2]),
        power_dbm=np.zeros(n),
        beam_loss_db=np.zeros(n),
        snr_db=np.full(n, 30.0),
        covariance=np.tile(np.diag([1e-24, 1e-6, 1e-6]), (n, 1, 1)),
        is_los=np.zeros(n, bool),
    )


TRUTH = [[10, 0, 0], [20, 3, -3], [20.8, 3, -3]]


@pytest.mark.parametrize(
    ("estimated", "found", "n_false"),
    [
        (TRUTH, [0, 1, 2], 0),
        (TRUTH[::-1], [2, 1, 0], 0),
        ([], [-1, -1, -1], 0),
        ([[10, 0, 0], [10.5, 0, 0]], [0, -1, -1], 1),  # two for one path
        ([[10, 0, 0], [20.4, 3, -3]], [0, None, None], 0),  # one for two paths is a miss, not false
        ([[10, 1.2, 0]], [-1, -1, -1], 1),  # outside the cell on one axis
        ([[40, 0, 0]], [-1, -1, -1], 1),
        ([*TRUTH, [20.4, 3, -3]], [0, 1, 2], 1),
    ],
)
def test_estimates_are_matched_one_to_one_within_a_cell(bench, estimated, found, n_false):
    stop, bounds = made_stop(bench, TRUTH)
    match, false = match_stop(bench, stop, estimate_at(bench, estimated), bounds)
    assert false == n_false
    for got, wanted in zip(match, found, strict=True):
        assert wanted is None or got == wanted


def test_the_gate_is_wider_for_paths_that_are_badly_known(bench):
    stop, bounds = made_stop(bench, [[10, 0, 0]])
    wide = replace(bounds, covariance=bounds.covariance * np.array([[(0.5 * bench.cell[0] / 1e-12) ** 2]]))
    estimate = estimate_at(bench, [[12.2, 0, 0]])
    assert match_stop(bench, stop, estimate, bounds)[0][0] == -1
    assert match_stop(bench, stop, estimate, wide)[0][0] == 0


def drawn_table(rng, n, *, scale=1.0):
    """Errors of Gaussian estimates whose covariances are right up to `scale`."""
    root = rng.standard_normal((n, 3, 3)) * np.array([1e-11, 1e-3, 1e-3])[:, None]
    covariance = root @ np.swapaxes(root, 1, 2)
    error = scale * np.einsum("nij,nj->ni", root, rng.standard_normal((n, 3)))
    return MatchedPaths(
        snr_db=np.full(n, 20.0),
        loss_db=np.zeros(n),
        separation=np.full(n, 5.0),
        bound=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        error=error,
        nees=squared_mahalanobis(error, covariance),
        n_false=np.zeros(10, int),
    )


def test_efficient_and_consistent_estimates_meet_their_bars_and_worse_ones_do_not():
    rng = np.random.default_rng(1)
    settings = {"min_snr_db": 10, "quick": False}
    for scale, is_met in ((1.0, True), (1.2, False)):
        table = drawn_table(rng, 20_000, scale=scale)
        rows = efficiency_rows("x", table, bars=(1.1, 1.05), **settings)
        rows += consistency_rows("x", table, **settings)
        assert len(rows) == 6
        assert all(row.met == is_met for row in rows), [(row.key, row.value) for row in rows]
    assert rows[0].value == pytest.approx(1.2, abs=0.03)
    conservative = consistency_rows("x", drawn_table(rng, 20_000, scale=0.8), **settings)
    assert not any(row.met for row in conservative)


def test_nothing_found_meets_no_bar():
    table = replace(drawn_table(np.random.default_rng(2), 10), snr_db=np.zeros(10))
    rows = efficiency_rows("x", table, min_snr_db=10, bars=(1.1, 1.05), quick=True)
    rows += consistency_rows("x", table, min_snr_db=10, quick=True)
    assert not any(row.met for row in rows)
    assert not rate_row("x", np.zeros(0, bool), 0.9, "", True).met


def test_quick_bars_allow_three_standard_errors_and_full_ones_none():
    assert quick_bar(1.0, 0.1, True) == pytest.approx(1.3) and quick_bar(1.0, 0.1, False) == 1.0
    hits = np.arange(100) < 97
    assert rate_row("x", hits, 0.99, "", True).met and not rate_row("x", hits, 0.99, "", False).met
    n_false = np.array([2] + [0] * 19)
    assert not false_row("x", n_false, 1e-3, True).met and not false_row("x", n_false, 1e-3, False).met
