"""Jumps of the TX heading that SLAM stop by stop hides: turns about the TX, and sessions by objects."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.plane import predict_bounce, predict_los
from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection import tx_sessions
from estimation.shape.reflection.tx_sessions import (
    Sessions,
    object_sessions,
    one_session,
    rotated_about_tx,
    stop_rows,
    with_heading_error,
)
from estimation.slam.config import SnapshotConfig
from isac_arena.campaign.chain.maps import make_map
from isac_arena.campaign.config import CampaignConfig
from isac_arena.validation.scenarios.reflections import TX, Errors, closed_paths, observe
from isac_arena.validation.shape.campaign import JUMP_STOP, make_arena, score
from scenes.contours.smooth import Circle
from scenes.pose import Pose

TX_POSE = Pose(np.array([*TX[:2], 0.0]), float(TX[2]))


def some_paths(position_std_m=0.1):
    rng = np.random.default_rng(3)
    true = closed_paths(Circle(np.array([1.0, -5.0]), 0.4), rng)
    return observe(true, Errors(0.3, position_std_m=position_std_m), rng)[0]


def test_a_turn_about_the_tx_leaves_lines_of_sight_and_moves_points_with_it():
    data, turn = some_paths(), 0.3
    turned = rotated_about_tx(data, np.full(len(data), turn))
    before, after = predict_los(TX_POSE, data.rx_state), predict_los(TX_POSE, turned.rx_state)
    shift = np.array([0.0, -turn, 0.0])
    np.testing.assert_allclose(after, before + shift, atol=1e-12)
    np.testing.assert_allclose(turned.measured, data.measured + shift, atol=1e-12)
    point = np.tile([2.0, -6.0], (len(data), 1))
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    moved = TX[:2] + (point - TX[:2]) @ rotation.T
    np.testing.assert_allclose(
        predict_bounce(TX_POSE, turned.rx_state, moved),
        predict_bounce(TX_POSE, data.rx_state, point) + shift,
        atol=1e-12,
    )
    for row in range(len(data)):
        same = np.linalg.eigvalsh(turned.rx_covariance[row])
        np.testing.assert_allclose(same, np.linalg.eigvalsh(data.rx_covariance[row]), atol=1e-15)


def test_loosened_covariances_hold_what_a_turn_does_at_a_fixed_point():
    data, config, step = some_paths(), ReflectionConfig(aod_offset_std_deg=2.0), 1e-5
    point = np.tile([1.0, -4.6], (len(data), 1))
    exact = replace(data, measured=predict_bounce(TX_POSE, data.rx_state, point))
    added = with_heading_error(exact, config).covariance - exact.covariance
    moved = []
    for turn in (step, -step):
        turned = rotated_about_tx(exact, np.full(len(exact), turn))
        moved.append(turned.measured - predict_bounce(TX_POSE, turned.rx_state, point))
    slope = (moved[0] - moved[1]) / (2 * step)
    expected = np.deg2rad(2.0) ** 2 * slope[:, :, None] * slope[:, None, :]
    np.testing.assert_allclose(added, expected, atol=1e-9)


def test_sessions_give_their_offsets_to_paths():
    data = some_paths()
    stop = np.unique(data.stop)
    later = (stop >= stop[len(stop) // 2]).astype(int)
    sessions = Sessions(later, np.array([0.1, 0.0]), np.zeros(2))
    np.testing.assert_array_equal(stop[stop_rows(data, stop)], data.stop)
    np.testing.assert_array_equal(sessions.of_paths(data, stop) == 0.1, data.stop < stop[len(stop) // 2])
    np.testing.assert_array_equal(one_session(stop).of_paths(data, stop), 0.0)


@pytest.mark.parametrize("jump_deg", [0.0, -2.0])
def test_objects_show_a_jump_that_no_stop_can_tell(jump_deg):
    made = make_arena(np.random.default_rng([7, 1]), offset=False, jump_deg=jump_deg)
    config = CampaignConfig(name="made", scene="-", seed=0, slam=SnapshotConfig(method="statistical"))
    result = make_map(config, made.channel, TX_POSE)
    contours, found = result.contours, score(made, result)
    early = (result.poses.stop < JUMP_STOP).astype(int) * int(jump_deg != 0)
    np.testing.assert_array_equal(contours.session != contours.session[-1], early)
    if jump_deg:
        step = np.rad2deg(contours.aod_offset_rad[0] - contours.aod_offset_rad[1])
        assert abs(step - jump_deg) < 4 * np.rad2deg(contours.aod_offset_std_rad.max()) + 0.1
    assert found.iou > 0.7
    assert found.class_right > 0.8


def test_long_campaigns_show_a_jump_to_within_a_few_stops(monkeypatch):
    monkeypatch.setattr(tx_sessions, "_MAX_GROUPS", 15)  # of three stops each
    made = make_arena(np.random.default_rng([7, 2]), offset=False, jump_deg=2.0)
    config = CampaignConfig(name="made", scene="-", seed=0, slam=SnapshotConfig(method="statistical"))
    session = make_map(config, made.channel, TX_POSE).contours.session
    assert session[-1] == 1
    assert abs(np.count_nonzero(session == 0) - JUMP_STOP) <= 3


def test_without_objects_there_is_one_session():
    data = some_paths()
    stop = np.unique(data.stop)
    none = data.take("path", slice(0, 0))
    assert len(object_sessions([], data, none, stop, ReflectionConfig()).offset_rad) == 1
    assert len(object_sessions([], none, none, stop, ReflectionConfig()).offset_rad) == 1
