"""Motions of objects and devices: places, rates, loops, frozen scenes, and what drives through something."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.config import LIBRARY, SceneConfig, load_scene
from scenes.contours import Circle, ClosedSpline, Ellipse, Polyline, RoundedPolygon
from scenes.motion.collisions import check_motion
from scenes.motion.motion import Motion, recorded_motion, steady_motion, waypoint_motion
from scenes.motion.placed import moved_contour
from scenes.tables import scene_tables
from scenes.toml_config import ConfigError, validate_config
from scenes.walks.trajectory import stop_times_s, velocities_m_s

SQUARE = np.array([(1.0, 0, 0), (0, 1.0, 0), (-1.0, 0, 0)])


def room(**changes: object):
    scene = load_scene("box_room")
    objects = tuple(
        replace(item, motion=changes[item.name]) if item.name in changes else item for item in scene.objects
    )
    return replace(scene, objects=objects)


def test_a_loop_along_way_points_comes_back_and_goes_round_again():
    motion = waypoint_motion(SQUARE, speed_m_s=0.5, start_s=1.0, loops=True)
    assert np.allclose(motion.at(0.5).shift_m, 0) and np.allclose(motion.at(0.5).velocity_m_s, 0)
    assert np.allclose(motion.at(4.0).shift_m, [1.0, 0.5, 0]) and np.allclose(
        motion.at(4.0).velocity_m_s, [0, 0.5, 0]
    )
    assert np.allclose(motion.at(8.0).velocity_m_s, [0, -0.5, 0])
    assert np.allclose(motion.at(12.0).shift_m, motion.at(4.0).shift_m)


def test_a_motion_that_ends_rests_where_it_ends():
    motion = waypoint_motion(SQUARE, speed_m_s=2.0)
    assert np.allclose(motion.at(99.0).shift_m, [0, 1, 0]) and not motion.at(99.0).velocity_m_s.any()
    steady = steady_motion(np.array([1.0, 0, 0]), turn_rate_rad_s=2.0, start_s=1.0, end_s=3.0)
    assert steady.at(9.0).shift_m[0] == 2.0 and steady.at(9.0).turn_rad == 4.0 and steady.top_speed_m_s == 1.0


def test_rates_of_a_recorded_motion_are_its_derivatives():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.2, 0.6, 9))
    motion = recorded_motion(time, rng.normal(size=(9, 3)), rng.uniform(-3, 3, 9))
    step, at = 1e-5, 1.234
    before, now, after = (motion.at(at + k * step) for k in (-1, 0, 1))
    assert np.allclose((after.shift_m - before.shift_m) / (2 * step), now.velocity_m_s, atol=1e-8)
    assert np.allclose((after.velocity_m_s - before.velocity_m_s) / (2 * step), now.acceleration_m_s2, atol=1e-7)
    assert np.isclose((after.turn_rad - before.turn_rad) / (2 * step), now.turn_rate_rad_s)


def test_moved_contours_keep_their_shape():
    rng = np.random.default_rng(5)
    contours = [
        Circle(np.array([1.0, 2.0]), 0.4),
        Ellipse(np.array([1.0, 2.0]), np.array([0.8, 0.3]), 0.2),
        RoundedPolygon(np.array([(0, 0), (2, 0), (1, 1.5)]), np.array([0.1, 0.2, 0.0])),
        ClosedSpline(np.array([(0, 0), (1, 0.1), (1.2, 1), (0, 1)])),
        Polyline(np.array([(0.0, 0), (1, 1), (2, 0)])),
    ]
    state = steady_motion(np.array([0.5, -1.0, 0.0]), 0.7).at(1.3)
    c, s = np.cos(state.turn_rad), np.sin(state.turn_rad)
    pivot = np.array([0.3, 0.4])
    points = rng.uniform(-2, 3, (40, 2))
    carried = (points - pivot) @ np.array([(c, s), (-s, c)]) + pivot + state.shift_m[:2]
    for contour in contours:
        moved = moved_contour(contour, pivot, state)
        assert np.allclose(moved.signed_distance(carried), contour.signed_distance(points), atol=3e-6)


def test_the_frozen_scene_holds_everything_where_it_is_at_that_time():
    scene = room(pillar=steady_motion(np.array([0.5, 0, 0.1])))
    scene = replace(scene, tx_motions={"tx": steady_motion(np.array([0.0, 0.2, 0.0]), 0.5)})
    frozen = scene.at(2.0)
    pillar = frozen.object("pillar")
    assert np.allclose(pillar.contour.center_m, [6.0, 5.5]) and np.isclose(pillar.z_max_m, 3.2)
    assert np.allclose(frozen.tx.position_m, [1.5, 4.4, 1.5]) and np.isclose(frozen.tx.heading_rad, 1.0)
    assert scene.is_moving and not frozen.is_moving and not load_scene("box_room").is_moving
    assert frozen.object("box") is scene.object("box")
    point = np.array([[5.3, 5.5, 1.0]])
    assert np.allclose(scene.carried_points(np.array([4]), point, 0.0, 2.0), [[6.3, 5.5, 1.2]])


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (steady_motion(np.array([1.0, 0, 0])), r"motion: pillar drives through 'box' at 1\.\d\d s"),
        (steady_motion(np.array([0.0, 2.0, 0])), r"motion: pillar drives through 'wall_north' at 1\.\d\d s"),
        (steady_motion(np.array([0.0, 0, 1.0])), r"motion: pillar drives through 'ceiling' at 0\.0\d s"),
        (steady_motion(np.array([-0.9, -0.4, 0]), end_s=4.2), r"motion: TX drives through 'pillar' at 3\.\d\d s"),
        (
            steady_motion(np.array([0.0, -0.77, 0]), end_s=5.0),
            r"motion: the receiver at stop 1 drives through 'pillar'",
        ),
    ],
)
def test_what_drives_through_something_is_named_with_its_time(motion: Motion, message: str):
    scene = room(pillar=motion)
    walk = replace(scene.walk, waypoints_m=np.array([(4.0, 2.0), (5.0, 2.0), (8.5, 2.0)]), n_stops=None)
    walk = replace(walk, stop_interval_s=4.5)
    with pytest.raises(ValueError, match=message) as caught:
        check_motion(replace(scene, walk=walk), 0.1)
    assert "\n" not in str(caught.value)


def test_movers_that_meet_are_refused_and_those_that_pass_are_not():
    at_each_other = {"pillar": steady_motion(np.array([0.5, 0, 0])), "box": steady_motion(np.array([-0.5, 0, 0]))}
    scene = room(**at_each_other)
    scene = replace(scene, walk=replace(scene.walk, stop_interval_s=1.5))
    with pytest.raises(ValueError, match=r"motion: pillar drives through 'box' at 1\.7\d s"):
        check_motion(scene, 0.1)
    check_motion(room(pillar=waypoint_motion(np.array([(0.0, -1.0, 0)]), 1.0, loops=True)), 0.1)


def test_a_thin_wall_is_not_jumped_over():
    scene = room()
    wall = replace(scene.object("box"), name="sheet", contour=Polyline(np.array([(6.0, 5.0), (6.0, 6.0)])))
    fast = steady_motion(np.array([100.0, 0, 0]), end_s=0.04)
    pillar = replace(scene.object("pillar"), motion=fast, contour=Circle(np.array([4.0, 5.5]), 0.01))
    scene = replace(scene, objects=(*scene.objects[:4], pillar, wall))
    with pytest.raises(ValueError, match="pillar drives through 'sheet'"):
        check_motion(scene, 1000.0)


def test_a_walking_receiver_is_at_its_stops_when_it_gets_there():
    walk = replace(load_scene("box_room").walk, speed_m_s=1.5)
    assert np.allclose(velocities_m_s(walk), [[1.5, 0, 0]] * 4)
    assert np.allclose(stop_times_s(walk, 0.2), 0.1 + np.arange(4))
    standing = replace(walk, speed_m_s=0.0, stop_interval_s=0.5)
    assert np.allclose(stop_times_s(standing, 0.2), 0.1 + 0.5 * np.arange(4))
    with pytest.raises(
        ValueError, match=r"walk.speed_m_s = 1.5: stop 0 is 1 s before the next, but a sweep takes 2 s"
    ):
        stop_times_s(walk, 2.0)


def test_motions_in_scene_files_come_back_from_tables(tmp_path):
    text = (
        load_text() + 'motion = { type = "waypoints", waypoints_m = [[7.5, 6.4]], speed_m_s = 0.5, loop = true }\n'
    )
    (tmp_path / "busy.toml").write_text(text, encoding="utf-8")
    scene = load_scene(tmp_path / "busy.toml")
    again = validate_config(scene_tables(scene), SceneConfig, "tables").build(60e9)
    for time in (0.0, 1.1, 3.3, 9.9):
        assert np.allclose(
            scene.object("box").motion.at(time).shift_m, again.object("box").motion.at(time).shift_m
        )


def load_text() -> str:
    return (LIBRARY / "box_room.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ('{ type = "velocity", speed_m_s = 101.0 }', r"objects\[box\]\.motion\.speed_m_s = 101\.0: "),
        (
            '{ type = "waypoints", waypoints_m = [[7.5, 5.4]], speed_m_s = 1.0 }',
            r"objects\[box\]\.motion\.waypoints_m: ",
        ),
        ('{ type = "file", file = "none.tum" }', r"objects\[box\]\.motion\.none\.tum: .*cannot be read"),
        ('{ type = "file", file = "one.tum" }', r"objects\[box\]\.motion\.one\.tum: two or more poses"),
        ('{ type = "fly" }', r"objects\[box\]\.motion\.type = .fly.: must be one of velocity, waypoints, file"),
    ],
)
def test_wrong_motions_are_named(tmp_path, motion: str, message: str):
    (tmp_path / "one.tum").write_text("0 1 2 3 0 0 0 1\n", encoding="utf-8")
    (tmp_path / "busy.toml").write_text(f"{load_text()}motion = {motion}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=message) as caught:
        load_scene(tmp_path / "busy.toml")
    assert "\n" not in str(caught.value)
