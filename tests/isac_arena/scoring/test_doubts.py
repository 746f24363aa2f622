"""Poses that are far off are said, with what to do."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.slam.record import SolveStatus
from isac_arena.scoring.doubts import (
    FAR,
    FEW_STOPS,
    case_doubts,
    estimate_doubts,
    few_stops,
    in_short,
    pose_doubts,
    score_doubts,
)
from isac_arena.scoring.metrics.metric import Metric

FINE = {
    "slam.stops": 12.0,
    "slam.solved_share": 1.0,
    "slam.position.rmse_m": 0.002,
    "slam.position.over_bound": 1.1,
    "slam.heading.rmse_deg": 0.01,
    "slam.heading.over_bound": 1.0,
    "slam.clock.rmse_ns": 0.01,
    "slam.clock.over_bound": 1.0,
    "slam.nees": 1.0,
    "published.solved_share": 1.0,
    "published.position.rmse_m": 0.015,
}


def sentence(**changes: float) -> str:
    values = FINE | {key.replace("__", "."): value for key, value in changes.items()}
    return "".join(score_doubts([Metric(key, value, "1", "info") for key, value in values.items()]))


def test_nothing_is_said_of_good_poses_and_of_unknown_scores() -> None:
    assert not pose_doubts(FINE)
    assert not pose_doubts({})
    assert not pose_doubts(dict.fromkeys(FINE, np.nan))
    assert not pose_doubts({**FINE, "slam.position.over_bound": FAR})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"slam__position__over_bound": 163.0}, "position 0.002 m, 163 times its bound"),
        ({"slam__heading__over_bound": 10.0}, "heading 0.01 deg, 10 times its bound"),
        ({"slam__clock__over_bound": 30.0}, "clock bias 0.01 ns, 30 times its bound"),
        (
            {"slam__position__over_bound__median": 29.0},
            "half of the stops err 29 times (position) their bound or more",
        ),
        ({"published__position__rmse_m": 0.001}, "position 2 times that of the published method"),
        ({"slam__nees": 16.0}, "errors 4 times their stated deviations"),
    ],
)
def test_every_kind_of_doubt_is_said_with_what_to_do(changes: dict[str, float], told: str) -> None:
    assert told in sentence(**changes)
    assert "arena budget" in sentence(**changes) and "Explore" in sentence(**changes)
    assert "To do: more stops" in sentence(slam__stops=2.0, **changes)


def test_a_published_method_that_solves_fewer_stops_is_no_comparison() -> None:
    assert not sentence(published__position__rmse_m=0.001, published__solved_share=0.5)


def test_the_error_that_slam_states_itself_is_told_beside_the_true_one() -> None:
    stated = sentence(slam__position__over_bound=30.0, slam__position__stated_m=0.001)
    assert "position 0.002 m, 30 times its bound (SLAM itself states 0.001 m)" in stated
    assert "states" not in sentence(slam__position__over_bound=30.0)
    whole = {"slam__position__over_bound": 20.0, "slam__position__bound_m": 0.0001}
    assert "20 times its bound;" in sentence(**whole, slam__nees=16.0)
    some = sentence(slam__position__over_bound=30.0, slam__position__bound_m=0.0001)
    assert "30 times its bound at the stops that have one" in some


def test_covariances_of_paths_that_are_too_small_are_said() -> None:
    assert not sentence(channel__coverage95=0.93, channel__nees=1.2)
    assert "hold 80 % of paths (NEES 1.2)" in sentence(channel__coverage95=0.8, channel__nees=1.2)
    both = sentence(channel__coverage95=0.8, mapping__ip_height__coverage95=0.93, mapping__ip_height__nees=25.0)
    assert "hold 80 % of paths, 93 % of heights of points of mapping (NEES 25)" in both


def test_covariances_that_are_too_large_are_said_where_the_stops_are_enough() -> None:
    assert not sentence(mapping__ip_position__nees=0.8, mapping__ip_position__coverage95=0.97)
    told = sentence(slam__ip_position__nees=0.18, slam__ip_position__coverage95=1.0)
    assert "stated errors are too large: points of SLAM (NEES 0.18, 100 % inside" in told
    assert "states of SLAM" in sentence(slam__nees=0.2, slam__coverage95=1.0)
    few = sentence(slam__ip_position__nees=0.18, slam__ip_position__coverage95=1.0, slam__stops=2.0)
    assert "too large" not in few  # two stops of two coordinates: chance gives a NEES of .18 there
    assert not sentence(slam__ip_position__nees=0.18, slam__solved_share=np.nan)


def test_points_are_called_too_certain_or_not_with_how_many_are_judged() -> None:
    """Errors of detected paths, a tenth of the points, say nothing of the others."""
    wide = {"mapping__ip_position__nees": 0.04, "mapping__ip_position__coverage95": 1.0, "mapping__ips": 340.0}
    assert "too large" not in sentence(**wide, mapping__ip_position__nees__count=35.0)
    told = sentence(**wide, mapping__ip_position__nees__count=170.0)
    assert "points of mapping (NEES 0.04, 100 % inside their 95 % regions, judged at 170 of 340)" in told
    narrow = {"mapping__ip_to_surface__nees": 3.2, "mapping__ip_to_surface__coverage95": 0.86}
    told = sentence(**narrow, mapping__ip_to_surface__nees__count=245.0, mapping__ips=340.0)
    assert "86 % of points of mapping across their surface (NEES 3.2, judged at 245 of 340)" in told
    assert "states of SLAM" in sentence(
        slam__nees=0.2, slam__coverage95=1.0, slam__nees__count=8.0, slam__ips=99.0
    )


@pytest.mark.parametrize(("variance", "share"), [(1.0, (0.0, 0.01)), (1.6, (0.0, 0.2)), (4.0, (0.95, 1.0))])
def test_right_covariances_are_called_too_large_by_chance_alone(
    variance: float, share: tuple[float, float]
) -> None:
    rng = np.random.default_rng(1)
    nees = (rng.standard_normal((400, 12, 4)) ** 2 / variance).mean(axis=(1, 2))
    called = np.mean(["too large" in sentence(slam__nees=float(one), slam__coverage95=1.0) for one in nees])
    assert share[0] <= called <= share[1]


def test_paths_count_one_by_one_and_need_no_slam_where_their_errors_are_too_large() -> None:
    mine = {"channel__nees": 0.38, "channel__coverage95": 1.0}
    assert "too large: paths (NEES 0.38" in sentence(**mine, channel__detected=14.0, slam__stops=np.nan)
    assert not sentence(**mine, channel__detected=2.0)
    assert not sentence(**mine | {"channel__nees": 0.6}, channel__detected=100.0)


def test_paths_far_over_their_bounds_are_said_by_median_and_rms() -> None:
    box_room = {"channel__aoa__over_bound__median": 4.5, "channel__aoa__over_bound__rms": 21.0}
    assert not sentence(**box_room)
    told = sentence(**box_room | {"channel__aoa__over_bound__rms": 226.0})
    assert "times their bounds: AoA 4.5 times in the median, 226 times in RMS." in told
    assert "delay 5.1 times in the median" in sentence(channel__delay__over_bound__median=5.1)


def test_powers_that_are_far_off_are_said_with_how_many() -> None:
    scores = {"power__median_db": 0.1, "power__max_db": 32.0, "power__off_10db": 6.0, "detected": 114.0}
    channel = {f"channel__{key}": value for key, value in scores.items()}
    assert not sentence(**channel, channel__power__rmse_db=2.9)
    told = sentence(**channel, channel__power__rmse_db=7.3)
    assert "powers: 6 of 114 detected paths err by 10 dB or more, up to 32 dB (RMSE 7.3 dB, median 0.1 dB)" in told


def test_doubts_in_short_have_the_first_in_words_and_name_the_others() -> None:
    assert in_short(()) == ""
    assert in_short(("SLAM: far off. To do: more stops",)) == "SLAM: far off"
    assert in_short(("SLAM: far. To do: x", "powers: many", "contours: 2")) == "SLAM: far; also: powers, contours"


def test_contours_of_no_object_are_said() -> None:
    assert not sentence(contours__mapping__false=0.0, contours__mapping__accepted=5.0)
    told = sentence(contours__mapping__false=2.0, contours__mapping__accepted=5.0)
    assert "contours: 2 of 5 of mapping are false" in told and "more stops" in told
    near = sentence(contours__slam__false=2.0, contours__slam__accepted=5.0, contours__slam__false_on_surface=1.0)
    assert "2 of 5 of SLAM (1 on a true surface, by wrong paths) are false" in near


def test_bands_of_contours_that_are_too_narrow_are_said() -> None:
    assert not sentence(contours__mapping__wall__seen_coverage95__mean=0.9)
    told = sentence(
        contours__mapping__wall__seen_coverage95__mean=0.68, contours__slam__pillar__seen_coverage95__mean=0.5
    )
    assert "bands of contours" in told and "68 % (walls, mapping), 50 % (pillars, SLAM)" in told


def test_paths_missed_by_the_limit_are_said() -> None:
    assert not sentence(channel__missed__path_limit=0.0)
    assert "3 significant paths missed where max_paths was" in sentence(channel__missed__path_limit=3.0)


def test_estimates_alone_tell_that_no_stop_or_another_state_was_found(campaign) -> None:
    poses = campaign.results.slam.poses
    assert not estimate_doubts(poses)
    none = replace(poses, status=np.full(len(poses.stop), SolveStatus.FAILED))
    assert "located no stop" in "".join(estimate_doubts(none))
    some = replace(poses, status=np.where(poses.stop == 1, SolveStatus.FAILED, poses.status))
    assert f"did not locate 1 of {len(poses.stop)} stops, stop 1;" in "".join(estimate_doubts(some))
    given = replace(poses, status=np.full(len(poses.stop), SolveStatus.GIVEN))
    assert not estimate_doubts(given)
    two = replace(poses, is_ambiguous=np.arange(len(poses.stop)) < 2)
    assert "at stop 0, 1" in "".join(estimate_doubts(two))
    hangs = replace(poses, path_influence_m=np.where(poses.stop == 1, 0.42, 0.01))
    assert "hangs on one path at stop 1: without it the position moves, by 0.42 m" in "".join(
        estimate_doubts(hangs)
    )


def test_few_stops_are_told_before_a_run() -> None:
    assert "4 stops of a walk" in "".join(few_stops(4)) and "1 stop of" in "".join(few_stops(1))
    assert not few_stops(FEW_STOPS)


def test_cases_of_few_stops_are_doubtful_unless_each_stop_is_alone() -> None:
    told = case_doubts({"slam.stops": 4.0})
    assert in_short(told).startswith("4 stops of a walk hardly check one another")
    assert "to do" not in in_short(told)
    assert not case_doubts({"slam.stops": 4.0}, stops_alone=True) and not case_doubts({"slam.stops": FEW_STOPS})
    assert not case_doubts({})


def test_wrong_decisions_on_the_line_of_sight_are_said() -> None:
    assert not sentence(channel__los__decision_accuracy=0.9)
    assert "told right at 75 %" in sentence(channel__los__decision_accuracy=0.75)
    assert "told right at 11 % of the stops" in sentence(channel__los__decision_accuracy=0.11)
