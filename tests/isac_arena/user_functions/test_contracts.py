"""What a function of a user may return: everything else ends in one line with stop, field and value."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.shape.outline import ObjectOutline, contours_of
from estimation.slam.record import SolveStatus
from estimation.tracks.record import EchoSurvey, Tracks
from isac_arena.user_functions.contracts import CONTRACTS, check_mapping, check_shapes, check_slam, check_tracker
from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, make_campaign, make_moving_campaign
from scenes.record import empty_record


@pytest.fixture(scope="module")
def made() -> MadeCampaign:
    return make_campaign()


def with_row(record: Any, name: str, row: Any, value: Any) -> Any:
    """The record with another value in a row of a field."""
    changed = np.array(getattr(record, name))
    changed[row] = value
    return replace(record, **{name: changed})


POINTS: list[tuple[str, Any, Any, str]] = [
    ("position_m", (5, 0), np.nan, "stop 1: point of path 2: position_m = nan: must be finite"),
    ("position_m", (5, 0), 1e9, "stop 1: point of path 2: position_m = 1000000000.0: must be finite, in m"),
    ("covariance_m2", (5, 0, 0), -1.0, "stop 1: point of path 2: covariance_m2 = "),
    ("covariance_m2", (5, 0, 1), 0.005, "symmetric and positive definite"),
    ("path", 5, 77, "stop 1: point of path 77: path = 77: there is no such path"),
    ("stop", 5, 99, "stop 99: point of path 2: path = 2: there is no such path"),
    ("path", 5, 0, "must be sorted by stop, then by path"),
    ("path", 5, 1, "stop 1: point of path 1: path = 1: is there twice"),
]


@pytest.mark.parametrize(("name", "row", "value", "words"), POINTS)
def test_points_name_stop_path_and_field(made: MadeCampaign, name: str, row: Any, value: Any, words: str) -> None:
    slam, channel = made.results.slam, list(made.results.channel)
    given = channel, made.scene.tx, made.results.mapping.poses
    assert check_mapping(slam.ips, *given).position_m.tolist() == slam.ips.position_m.tolist()
    bad = with_row(slam.ips, name, row, value)
    with pytest.raises(ValueError, match=r"^[^\n]+$") as told:
        check_mapping(bad, *given)
    assert words in str(told.value)
    with pytest.raises(ValueError, match=r"stop|sorted"):
        check_slam((slam.poses, bad), channel, made.scene.tx, None)


def test_a_point_that_is_no_inlier_may_be_nowhere(made: MadeCampaign) -> None:
    ips = with_row(made.results.slam.ips, "position_m", 3, np.nan)
    ips = with_row(with_row(ips, "covariance_m2", 3, np.nan), "is_inlier", 3, False)
    assert not check_mapping(ips, made.results.channel, made.scene.tx, made.results.slam.poses).is_inlier[3]


POSES: list[tuple[str, Any, Any, str]] = [
    ("stop", 3, 4, "must be the 12 stops of the channel estimates, in their order"),
    ("position_m", (3, 1), np.inf, "stop 3: position_m = "),
    ("heading_rad", 3, 90.0, "stop 3: heading_rad = 90.0: must be within -6.28 and 6.28 rad"),
    ("clock_bias_s", 3, 20.0, "stop 3: clock_bias_s = 20.0: must be within -0.001 and 0.001 s"),
    ("status", 3, 9, "stop 3: status = 9: must be a SolveStatus"),
    ("status", 3, SolveStatus.FAILED, "must be NaN where the status is FAILED"),
    ("covariance", 3, -np.eye(4), "stop 3: covariance = "),
    ("n_inliers", 3, -1, "stop 3: n_inliers = -1: must not be negative"),
    ("los_probability", 3, 2.0, "stop 3: los_probability = 2.0: must be within 0 to 1"),
]


@pytest.mark.parametrize(("name", "row", "value", "words"), POSES)
def test_poses_name_stop_and_field(made: MadeCampaign, name: str, row: Any, value: Any, words: str) -> None:
    slam, channel = made.results.slam, list(made.results.channel)
    poses, _ = check_slam((slam.poses, slam.ips), channel, made.scene.tx, None)
    assert poses.position_m.tolist() == slam.poses.position_m.tolist()
    with pytest.raises(ValueError, match=r"^[^\n]+$") as told:
        check_slam((with_row(slam.poses, name, row, value), slam.ips), channel, made.scene.tx, None)
    assert words in str(told.value)


CONTOURS: list[tuple[str, Any, Any, str]] = [
    ("contour_m", (2, 7, 1), np.nan, "contour 2: contour_m = nan: must be finite"),
    ("std_m", (2, 7), -0.1, "contour 2: std_m = -0.1: must be finite and not negative"),
    ("extent_m", 2, np.nan, "contour 2: extent_m = nan"),
    ("status", 2, "xy", "contour 2: status = xy: must be ok or prior"),
    ("class_name", 0, "tree", "class_name = "),
    ("class_probability", (2, 0), 1.5, "contour 2: class_probability = 1.5"),
    ("object", 9, 4, "point 9: object = 4: must be -1, or a contour below 4"),
]


@pytest.mark.parametrize(("name", "row", "value", "words"), CONTOURS)
def test_contours_name_row_and_field(made: MadeCampaign, name: str, row: Any, value: Any, words: str) -> None:
    slam = made.results.slam
    given = list(made.results.channel), made.scene.tx, slam.poses, slam.ips
    assert len(check_shapes(slam.contours, *given)) == len(slam.contours)
    with pytest.raises(ValueError, match=r"^[^\n]+$") as told:
        check_shapes(with_row(slam.contours, name, row, value), *given)
    assert words in str(told.value)
    fewer = slam.ips.take("ip", slice(0, 3))
    with pytest.raises(ValueError, match="object has 48 rows: one for each of 3 is needed"):
        check_shapes(slam.contours, *given[:3], fewer)


TRACKS: list[tuple[str, Any, Any, str]] = [
    ("stop", 3, 40, "track 0: stop 40: stop = 40: there is no such stop"),
    ("stop", 3, 2, "track 0: stop 2: stop = 2: is there twice"),
    ("stop", 3, 1, "track, stop: states must be sorted by track, then by stop"),
    ("track", -1, 2, "track: tracks must be numbered from 0 on, without gaps"),
    ("track", 0, -1, "track: tracks must be numbered"),
    ("position_m", (3, 0), np.nan, "track 0: stop 3: position_m = nan: must be finite, in m"),
    ("velocity_m_s", (3, 1), np.inf, "track 0: stop 3: velocity_m_s = inf: must be finite, in m/s"),
    ("height_m", 3, np.inf, "height_m = inf: must be finite, or NaN"),
    ("covariance", 3, -np.eye(5), "track 0: stop 3: covariance = "),
    ("covariance", (3, 0, 1), np.nan, "symmetric and positive definite, or NaN"),
    ("existence", 3, 1.5, "existence = 1.5: must be within 0 to 1"),
    ("existence", 3, np.nan, "existence = nan: must be within 0 to 1"),
    ("extent_m", 3, -0.1, "extent_m = -0.1: must be finite and not negative"),
    ("echo_path", 3, 77, "stop 3: echo of path 77: path = 77: there is no such path"),
    ("echo_track", 3, 1, "stop 3: echo of path 1: echo_track = 1: must be -1, or a track below 1"),
]


@pytest.mark.parametrize(("name", "row", "value", "words"), TRACKS)
def test_tracks_name_track_stop_and_field(name: str, row: Any, value: Any, words: str) -> None:
    moving = make_moving_campaign(np.array([0.4, -0.2, 0.0]))
    tracks, poses = moving.results.slam.tracks, moving.results.slam.poses
    assert tracks is not None
    given = list(moving.results.channel), poses, tracks.survey
    assert check_tracker(tracks, *given).position_m.tolist() == tracks.position_m.tolist()
    with pytest.raises(ValueError, match=r"^[^\n]+$") as told:
        check_tracker(with_row(tracks, name, row, value), *given)
    assert words in str(told.value)


def test_tracks_need_places_and_velocities_alone() -> None:
    moving = make_moving_campaign(np.array([0.4, -0.2, 0.0]))
    full, poses = moving.results.slam.tracks, moving.results.slam.poses
    assert full is not None
    other = replace(full.survey, time_s=full.survey.time_s + 1.0)
    tracks = check_tracker(
        Tracks(other, full.track, full.stop, full.position_m, full.velocity_m_s),
        *(moving.results.channel, poses, full.survey),
    )
    assert tracks.survey is full.survey and np.isnan(tracks.covariance).all() and (tracks.existence == 1).all()
    none = check_tracker(tracks.take("state", slice(0, 0)), moving.results.channel, poses, full.survey)
    assert none.n_tracks == 0


def test_results_of_another_kind_are_named(made: MadeCampaign) -> None:
    slam, channel = made.results.slam, list(made.results.channel)
    given = {
        "channel": (channel[0],),
        "mapping": (channel, made.scene.tx, slam.poses),
        "slam": (channel, made.scene.tx, None),
        "shapes": (channel, made.scene.tx, slam.poses, slam.ips),
        "tracker": (channel, slam.poses, empty_record(EchoSurvey)),
    }
    for stage, contract in CONTRACTS.items():
        assert len(given[stage]) == len(contract.arguments)
        for found, kind in ((None, "nothing"), (3.0, "a float"), ([slam.poses], "a list")):
            with pytest.raises(ValueError, match=rf"returned {kind}, .* is needed"):
                contract.check(found, *given[stage])


def test_outlines_become_contours_that_pass_the_check(made: MadeCampaign) -> None:
    slam = made.results.slam
    turn = np.linspace(0.0, 2 * np.pi, 30, endpoint=False)
    ring = np.array([3.0, -4.0]) + 0.5 * np.column_stack([np.cos(turn), np.sin(turn)])
    line = np.column_stack([np.linspace(0.0, 3.0, 7), np.full(7, 2.0)])
    outlines = [
        ObjectOutline(ring, np.full(30, 0.02), is_closed=True, rows=np.array([0, 4])),
        ObjectOutline(line, np.full(7, 0.1), is_closed=False, rows=np.array([2])),
    ]
    contours = contours_of(outlines, slam.poses, slam.ips)
    check_shapes(contours, made.results.channel, made.scene.tx, slam.poses, slam.ips)
    assert contours.extent_m == pytest.approx([0.5, 3.0]) and contours.object[:5].tolist() == [0, -1, 1, -1, 0]
    assert np.linalg.norm(contours.contour_m[0] - [3.0, -4.0], axis=1) == pytest.approx(0.5, abs=0.01)
    assert np.ptp(contours.contour_m[1], axis=0) == pytest.approx([3.0, 0.0])
    none = contours_of([], slam.poses, slam.ips)
    assert len(check_shapes(none, made.results.channel, made.scene.tx, slam.poses, slam.ips)) == 0
