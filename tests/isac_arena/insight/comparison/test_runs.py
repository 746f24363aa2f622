"""Two runs: what is paired with what, what only one of them has, and the figure of it."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.reflection.rows import no_contours
from isac_arena.insight.comparison.names import group_of, name_of
from isac_arena.insight.comparison.runs import compare_runs, pair_values
from isac_arena.report.figures.comparison import _changes, compare_figure
from isac_arena.report.style import png_bytes
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance
from isac_arena.validation.scenarios.perfect_campaign import make_moving_campaign

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


@pytest.fixture(scope="module")
def score(campaign, true_power):
    def run(scene=campaign.scene, truths=campaign.truths, results=campaign.results):
        return score_campaign(scene, iter(truths), results, true_power_dbm=true_power, significance=LIMITS).tables

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


def test_a_run_is_the_same_as_itself(score):
    compared = compare_runs(score(), score())
    assert compared.n_stops == 12 and not compared.notes
    assert {one.verdict for one in compared.differences if one.n_pairs} == {"same"}
    assert png_bytes(compare_figure(compared.differences, "a", "b")).startswith(b"\x89PNG")


def test_cone_angles_beside_azimuths_are_noted(score):
    run = score()
    is_cone = np.ones(len(run.paths.stop), bool)
    cones = replace(run, paths=replace(run.paths, aod_is_cone=is_cone))
    assert not compare_runs(cones, cones).notes
    (note,) = compare_runs(cones, run).notes
    assert note.startswith("AoD errors are those of cone angles in A and of azimuths in B")


def test_only_the_worse_quantities_of_a_run_are_worse(score, campaign):
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
    assert compared.notes == ("10 stops are the same in both, of 12 in A and 10 in B",)
    assert by_key(compared)["channel.delay_error"].n_groups == 10


def test_other_places_cannot_be_paired(score):
    tables = score()
    far = replace(tables, poses=replace(tables.poses, true_position_m=tables.poses.true_position_m + 0.01))
    with pytest.raises(ValueError, match="no receiver stop is the same in both"):
        compare_runs(tables, far)


def test_other_true_paths_are_not_paired(score):
    tables = score()
    turned = replace(tables.significant, aod_azimuth_rad=tables.significant.aod_azimuth_rad + 1e-3)
    compared, n = compare_runs(tables, replace(tables, significant=turned)), len(tables.significant.stop)
    assert compared.notes == (f"the true paths differ ({n} in A, {n} in B): paths are not paired",)
    assert "channel.delay_error" not in by_key(compared)


def test_items_are_paired_by_what_they_are():
    found = pair_values("key", "m", "lower", {(0, 1): 1.0, (0, 2): 2.0, (3, 1): 3.0}, {(3, 1): 30.0, (0, 4): 40.0})
    np.testing.assert_array_equal(found.first, [1, 2, 3, np.nan])
    np.testing.assert_array_equal(found.second, [np.nan, np.nan, 30, 40])
    assert found.group.tolist() == [0, 0, 1, 0]


def test_nothing_that_one_run_has_is_dropped_without_a_word(score, campaign):
    mapping = campaign.results.mapping
    none = replace(mapping, contours=no_contours(len(mapping.ips), len(campaign.truths)))
    fewer = tuple(one.take("path", slice(0, 5)) for one in campaign.results.channel)
    found = by_key(compare_runs(score(), score(results=replace(campaign.results, mapping=none, channel=fewer))))
    contour = found["contours.mapping.iou"]
    assert contour.verdict == "only in A" and contour.first == pytest.approx(1, abs=1e-3)
    assert by_key(compare_runs(score(), score()))["contours.mapping.iou"].verdict != "only in A"
    delay = found["channel.delay_error"]
    assert (delay.n_first, delay.n_second, delay.n_pairs) == (12 * 6, 12 * 5, 12 * 5)
    assert found["channel.detected"].n_pairs == 12 * 6 and found["channel.detected"].verdict == "worse"


def test_tracks_are_paired_by_mover_and_stop(true_power):
    moving = make_moving_campaign(np.array([0.4, -0.2, 0.0]))
    tables = []
    for by_m in (0.0, 0.1):
        slam, tracks = moving.results.slam, moving.results.slam.tracks
        off = replace(slam, tracks=replace(tracks, position_m=tracks.position_m + np.array([by_m, 0.0])))
        results = replace(moving.results, slam=off)
        scored = score_campaign(
            moving.scene, iter(moving.truths), results, true_power_dbm=true_power, significance=LIMITS
        )
        tables.append(scored.tables)
    found = by_key(compare_runs(*tables))
    position, velocity = found["tracks.position_error"], found["tracks.velocity_error"]
    assert position.n_pairs == len(moving.truths) and position.second - position.first == pytest.approx(0.1)
    assert velocity.second == velocity.first and found["tracks.gospa"].second > found["tracks.gospa"].first
    assert not [key for key in by_key(compare_runs(tables[0], replace(tables[1], tracks=None))) if "tracks" in key]


def test_the_figure_shows_every_quantity_and_where_it_ends(score, campaign):
    worse = score(results=moved(campaign.results, 0.05, np.random.default_rng(4)))
    start = score(results=moved(campaign.results, 0.001, np.random.default_rng(5)))
    compared = compare_runs(start, worse).differences
    assert next(one for one in compared if one.key == "slam.position_error").verdict == "worse"
    figure = compare_figure(compared, "a", "b")
    ax = figure.axes[0]
    assert [label.get_text().split(" (")[0] for label in ax.get_yticklabels()] == [
        f"{group_of(one.key)}: {name_of(one.key)}".split(" (")[0] for one in reversed(compared)
    ]
    texts = [text.get_text() for text in ax.texts]
    row = next(text for text in texts if text.endswith("times"))
    assert "n = 12; +4" in row  # 49 times as much: beyond the axis, written out
    arrows = [line for line in ax.get_lines() if line.get_marker() in "<>" and line.get_marker()]
    assert len(arrows) == 1 and arrows[0].get_xdata()[0] == ax.get_xlim()[1]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"worse", "same", "exceeds the axis"} <= set(labels)


def test_both_ends_of_an_interval_have_one_unit():
    assert _changes([841.0, 1500.0]) == "+841 % to +1,500 %"
    assert _changes([1200.0, 1500.0]) == "+12 times to +15 times"
    assert _changes([-20.0]) == "-20 %"
