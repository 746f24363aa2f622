"""Paired differences: closed forms, coverage of the intervals, and what cannot be paired."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimation import compare
from estimation.compare import MIN_GROUPS, Pairs, compare_runs, paired_difference
from estimation.report.compare_figure import compare_figure
from estimation.report.style import png_bytes
from estimation.scoring.config import Significance
from estimation.scoring.score import score_campaign

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


def pairs(first, second, group=None, direction="lower"):
    group = np.arange(len(first)) if group is None else group
    return Pairs("a.key", "m", direction, group, np.asarray(first, float), np.asarray(second, float))


@pytest.fixture(scope="module")
def score(campaign, true_power):
    def run(scene=campaign.scene, truths=campaign.truths, results=campaign.results):
        return score_campaign(
            scene, iter(truths), results, true_power_dbm=true_power, significance=LIMITS
        ).tables

    return run


def moved(results, by_m, rng):
    """SLAM positions off by `by_m` and some, channel delays off by 0.1 ns and some."""
    poses = results.slam.poses
    offset = np.column_stack([by_m * rng.uniform(0.8, 1.2, len(poses.stop)), np.zeros(len(poses.stop))])
    slam = replace(results.slam, poses=replace(poses, position_m=poses.position_m + offset))
    channel = tuple(
        replace(one, delay_s=one.delay_s + 1e-10 * rng.uniform(0.8, 1.2, len(one))) for one in results.channel
    )
    return replace(results, slam=slam, channel=channel)


def by_key(compared):
    return {one.key: one for one in compared.differences}


def test_a_constant_shift_is_told_exactly():
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
    monkeypatch.setattr(compare, "RESAMPLES", 499)
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


def test_a_run_is_the_same_as_itself(score):
    compared = compare_runs(score(), score())
    assert compared.n_stops == 12 and not compared.notes
    assert {one.verdict for one in compared.differences if one.n_pairs} == {"same"}
    assert png_bytes(compare_figure(compared.differences, "a", "b")).startswith(b"\x89PNG")


def test_a_worse_run_is_told_by_what_is_worse(score, campaign):
    worse = score(results=moved(campaign.results, 0.05, np.random.default_rng(4)))
    found = by_key(compare_runs(score(), worse))
    position = found["slam.position_error"]
    assert position.verdict == "worse" and position.low > 0.04 and position.high < 0.06
    assert found["channel.delay_error"].verdict == "worse"
    assert found["channel.delay_error"].n_groups == 12
    assert found["channel.delay_error"].difference == pytest.approx(0.1, abs=0.01)
    assert found["slam.heading_error"].verdict == "same"
    assert found["contours.mapping.seen_rmse"].verdict in ("same", "too few")
    better = by_key(compare_runs(worse, score()))
    assert better["slam.position_error"].verdict == "better"


def test_stops_are_paired_by_number_and_place(score):
    whole = score()
    part = replace(
        whole,
        paths=whole.paths.take("estimate", whole.paths.stop >= 2),
        significant=whole.significant.take("true_path", whole.significant.stop >= 2),
        stops=whole.stops.take("stop", slice(2, None)),
        poses=whole.poses.take("stop", slice(2, None)),
    )
    compared = compare_runs(whole, part)
    assert compared.n_stops == 10
    assert compared.notes == ("10 stops are the same in both, of 12 and 10",)
    assert by_key(compared)["channel.delay_error"].n_groups == 10


def test_other_places_cannot_be_paired(score):
    tables = score()
    far = replace(tables, poses=replace(tables.poses, true_position_m=tables.poses.true_position_m + 0.01))
    with pytest.raises(ValueError, match="no receiver stop is the same in both"):
        compare_runs(tables, far)


def test_other_true_paths_are_not_paired(score):
    tables = score()
    turned = replace(tables.significant, aod_azimuth_rad=tables.significant.aod_azimuth_rad + 1e-3)
    compared = compare_runs(tables, replace(tables, significant=turned))
    assert compared.notes == ("the true paths differ: paths are not paired",)
    assert "channel.delay_error" not in by_key(compared)
