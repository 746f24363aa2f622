"""One paired difference: closed forms, coverage of the intervals, and values without a partner."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from isac_arena.insight.comparison import difference
from isac_arena.insight.comparison.difference import MIN_GROUPS, PairedValues, paired_difference


def pairs(first, second, group=None, direction="lower"):
    group = np.arange(len(first)) if group is None else group
    return PairedValues("a.key", "m", direction, group, np.asarray(first, float), np.asarray(second, float))


def test_a_constant_shift_is_found_exactly():
    first = np.linspace(1, 2, 12)
    for direction, verdict in (("lower", "worse"), ("higher", "better"), ("info", "different")):
        found = paired_difference(pairs(first, first + 0.25, direction=direction))
        assert (found.n_pairs, found.n_groups, found.verdict) == (12, 12, verdict)
        assert_allclose([found.difference, found.low, found.high], 0.25)
        assert found.second - found.first == pytest.approx(found.difference)


def test_the_mean_difference_is_between_the_ends_and_changes_sign_with_the_order():
    rng = np.random.default_rng(1)
    first, second = rng.exponential(size=(2, 15))
    there, back = paired_difference(pairs(first, second)), paired_difference(pairs(second, first))
    assert there.difference == pytest.approx((second - first).mean()) == pytest.approx(-back.difference)
    assert there.low < there.difference < there.high
    assert there.p_value == pytest.approx(back.p_value)


def test_intervals_cover_what_is_true(monkeypatch):
    monkeypatch.setattr(difference, "RESAMPLES", 499)
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(150):
        first = rng.standard_normal(25)
        found = paired_difference(pairs(first, first + 0.3 + rng.standard_normal(25)))
        held += found.low <= 0.3 <= found.high
    assert 0.88 <= held / 150 <= 0.99


def test_paths_of_one_stop_count_together():
    rng = np.random.default_rng(3)
    first, second = rng.standard_normal((2, 10))
    once = paired_difference(pairs(first, second))
    often = paired_difference(pairs(*np.repeat([first, second], 20, axis=1), np.repeat(np.arange(10), 20)))
    assert often.n_pairs == 200 and often.n_groups == 10
    assert_allclose([often.low, often.high, often.p_value], [once.low, once.high, once.p_value])


def test_few_groups_tell_nothing_and_missing_values_are_left_out():
    values = np.arange(MIN_GROUPS - 1.0)
    few = paired_difference(pairs(values, values + 1 + 0.1 * values))
    assert few.verdict == "too few" and np.isnan(few.low) and np.isnan(few.p_value)
    holes = np.append(values, np.nan)
    assert paired_difference(pairs(holes, holes[::-1])).n_pairs == len(holes) - 2
    assert paired_difference(pairs([], [])).n_pairs == 0


def test_a_difference_without_the_test_is_undecided():
    first = np.zeros(7)
    second = np.array([-1e-3, 1e-3, -2e-3, 2e-3, 0.9, 1.0, 1.1])
    found = paired_difference(pairs(first, second))
    assert found.low > 0 and found.p_value > 0.05 and found.verdict == "undecided"


def test_what_one_run_alone_has_is_counted_and_named():
    nothing = np.full(4, np.nan)
    alone = paired_difference(pairs([1.0, 3.0, np.nan, np.nan], nothing))
    assert (alone.verdict, alone.n_first, alone.n_second, alone.n_pairs) == ("only in A", 2, 0, 0)
    assert alone.first == 2.0 and np.isnan(alone.second) and np.isnan(alone.difference)
    assert paired_difference(pairs(nothing, [1.0, 3.0, np.nan, np.nan])).verdict == "only in B"
    crossed = paired_difference(pairs([1.0, np.nan], [np.nan, 1.0]))
    assert (crossed.verdict, crossed.n_first, crossed.n_second) == ("no pair", 1, 1)
    assert paired_difference(pairs(nothing, nothing)).verdict == ""
    some = paired_difference(pairs([1.0, 2.0, np.nan], [1.0, 9.0, 5.0]))
    assert (some.n_pairs, some.n_first, some.n_second) == (2, 2, 3)
    assert (some.first, some.second) == (1.5, 5.0)  # of the pairs, not of all
