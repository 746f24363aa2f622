from itertools import pairwise

import numpy as np
import pytest

from isac_arena.insight.budget.attribution import attribute, signed_root
from isac_arena.insight.budget.stages import STAGE_GROUPS, Stage, coalitions, label, orders

FREE = (("a", "b", "c"),)


def additive(groups, rng, n_units=40):
    """Squared errors that are sums of one independent term per part, and the terms' means."""
    term = {part: rng.chisquare(2, n_units) for group in groups for part in group}
    table = {
        met: sum((term[part] for part in term if part not in met), np.zeros(n_units)) for met in coalitions(groups)
    }
    return table, np.array([term[part].mean() for part in term])


def test_sums_of_independent_errors_are_told_apart_exactly():
    table, expected = additive(STAGE_GROUPS, np.random.default_rng(1))
    found = attribute(table, STAGE_GROUPS, np.random.default_rng(2), 200)
    np.testing.assert_allclose(found.contribution, expected, rtol=1e-12)
    np.testing.assert_allclose(found.alone, expected, rtol=1e-12)
    np.testing.assert_allclose(found.first, found.last, rtol=1e-12)
    assert found.total == pytest.approx(expected.sum())
    assert found.rest == pytest.approx(0, abs=1e-12)


def test_contributions_and_rest_add_up_whatever_the_errors():
    rng = np.random.default_rng(3)
    table = {met: rng.chisquare(1, 17) for met in coalitions(FREE)}
    found = attribute(table, FREE, rng, 100)
    assert found.contribution.sum() + found.rest == pytest.approx(found.total, abs=1e-12)


def test_one_group_gives_the_shapley_value():
    """Against its definition with factorial weights, on a game of three players."""
    rng = np.random.default_rng(4)
    table = {met: rng.chisquare(1, 5) for met in coalitions(FREE)}
    value = {met: rows.mean() for met, rows in table.items()}
    found = attribute(table, FREE, rng, 50)
    for index, part in enumerate(found.part):
        others = [name for name in found.part if name != part]
        weights = {0: 1 / 3, 1: 1 / 6, 2: 1 / 3}
        expected = sum(
            weights[len(met)] * (value[met] - value[met | {part}])
            for met in value
            if part not in met and met <= set(others)
        )
        assert found.contribution[index] == pytest.approx(expected)


def test_swapping_two_parts_keeps_every_share_in_its_interval():
    rng = np.random.default_rng(5)
    common = rng.normal(0, 1, 60)
    table = {
        met: (sum(part not in met for part in "abc") * common) ** 2 + rng.chisquare(1, 60) * (len(met) < 3)
        for met in coalitions(FREE)
    }
    found = attribute(table, FREE, rng, 500)
    for order in orders(FREE):
        path = [frozenset(order[:length]) for length in range(4)]
        for part, (before, after) in zip(order, pairwise(path), strict=True):
            share = (table[before].mean() - table[after].mean()) / found.total
            index = found.part.index(part)
            assert found.low[index] <= share <= found.high[index]


def test_intervals_cover_the_truth_as_often_as_they_say():
    """Shares of two independent errors of known variances: about 95 % of intervals hold the true share."""
    hits, runs = 0, 120
    groups = (("a", "b"),)
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        a, b = 4 * rng.chisquare(4, 60), rng.chisquare(4, 60)
        table = {frozenset(): a + b, frozenset("a"): b, frozenset("b"): a, frozenset("ab"): np.zeros(60)}
        found = attribute(table, groups, rng, 400)
        hits += found.low[0] <= 0.8 <= found.high[0]
    assert hits >= 0.88 * runs  # 4.5 standard deviations below what 95 % give less the small-sample loss


def test_intervals_narrow_with_the_number_of_units():
    widths = []
    for n_units in (20, 2000):
        table, _ = additive(FREE, np.random.default_rng(6), n_units)
        found = attribute(table, FREE, np.random.default_rng(7), 300)
        widths.append(found.high - found.low)
    assert (widths[1] < widths[0] / 5).all()


def test_one_unit_has_no_interval_and_no_error_no_share():
    table = {met: np.array([2.0 - len(met) / 2]) for met in coalitions(FREE)}
    found = attribute(table, FREE, np.random.default_rng(8))
    assert np.isnan([found.total_low, found.rest_high]).all()
    none = attribute({met: np.zeros(4) for met in table}, FREE, np.random.default_rng(9), 20)
    assert none.total == 0 and np.isnan(none.low).all()


def test_shares_are_refused_where_they_would_mean_nothing():
    rng = np.random.default_rng(10)
    clear, _ = additive(FREE, rng, 200)
    found = attribute(clear, FREE, rng, 200)
    assert set(found.effect) == {"falls"} and found.objection == ""
    few = attribute({met: rows[:5] for met, rows in clear.items()}, FREE, rng, 50)
    assert few.objection == "5 stops or objects, an interval needs 6"
    noise = {met: rng.chisquare(1, 8) for met in clear} | {frozenset("abc"): np.zeros(8)}
    assert attribute(noise, FREE, rng, 200).objection == "no interval excludes zero"
    cancel = {met: np.ones(40) for met in clear} | {frozenset("a"): np.full(40, 90.0)}
    assert attribute(cancel, FREE, rng, 50).objection.startswith("parts cancel")
    assert attribute({met: np.zeros(9) for met in clear}, FREE, rng, 20).objection == "there is no error"


def test_a_part_is_told_where_its_interval_leaves_out_zero():
    rng = np.random.default_rng(12)
    groups, n = (("a", "b"),), 60
    a, b = 4 * rng.chisquare(4, n), rng.normal(0, 1, n)
    table = {frozenset(): a + b, frozenset("a"): b, frozenset("b"): a, frozenset("ab"): np.zeros(n)}
    found = attribute(table, groups, rng, 400)
    assert found.effect.tolist() == ["falls", "undecided"] and found.objection == ""
    only_chance = {parts: b + 10 * (len(parts) < 2) for parts in table}
    unclear = attribute({**only_chance, frozenset("ab"): 10 + rng.normal(0, 1, n)}, groups, rng, 400)
    assert unclear.objection == "" and set(unclear.effect) == {"undecided"}  # all of it is the rest


def test_a_part_downstream_has_no_effect():
    rng = np.random.default_rng(13)
    error = rng.chisquare(2, 30)
    table = {met: error * (1.0 if "a" not in met else 1e-14) for met in coalitions(FREE)}
    found = attribute(table, FREE, rng, 100)
    assert found.effect.tolist() == ["falls", "none", "none"]


def test_units_must_agree():
    table = {met: np.zeros(3) for met in coalitions(FREE)}
    with pytest.raises(ValueError, match=r"\[2, 3\] units"):
        attribute(table | {frozenset("a"): np.zeros(2)}, FREE, np.random.default_rng(1))
    with pytest.raises(ValueError, match=r"\[0\] units"):
        attribute({met: np.zeros(0) for met in table}, FREE, np.random.default_rng(1))


def test_roots_keep_the_sign():
    np.testing.assert_allclose(signed_root(np.array([4.0, -9.0, 0.0])), [2, -3, 0])


def test_orders_keep_causes_before_effects():
    found = list(orders(STAGE_GROUPS))
    assert len(found) == len(set(found)) == 6
    assert {order[3:] for order in found} == {(Stage.POSE, Stage.CLUSTERS, Stage.FIT)}
    sets = coalitions(STAGE_GROUPS)
    assert sets[0] == frozenset()
    assert len(sets) == len(set(sets)) == 14
    assert len(coalitions(FREE)) == 8
    assert label(frozenset({Stage.FIT, Stage.GEOMETRY}), STAGE_GROUPS) == "path_geometry+contour_fit"
    assert label(frozenset(), STAGE_GROUPS) == "none"
