"""Occlusion in 2.5 D against closed forms and dense marching along the leg."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.contours import Circle, Polygon, Polyline, rectangle
from scenes.objects.material import Material
from scenes.pose import Pose
from scenes.scene import HorizontalPlane, Scene, SceneObject
from scenes.walks.trajectory import Walk
from sim.propagation import occlusion
from sim.propagation.occlusion import is_blocked, occluders, surface_names

STONE = Material("stone", 5.0, 0.5)


def scene_of(*items, floor=None):
    walk = Walk(np.array([[9.0, 9.0]]), 1.0, 0.0)
    objects = tuple(
        SceneObject(f"object_{index}", "wall", contour, z_min, z_max, STONE)
        for index, (contour, z_min, z_max) in enumerate(items)
    )
    return Scene("test", objects, Pose(np.array([-9.0, -9.0, 1.0]), 0.0), walk, (-10, -10, 10, 10), floor)


BOX = rectangle((-1, 1), (-1, 1))
SOLIDS = scene_of(
    (BOX, 0.5, 2.0),
    (Circle(np.array([3.0, 1.0]), 0.7), 0.0, 3.0),
    (Polygon(np.array([(-4, -3), (-2, -4), (-2.5, -2), (-3.2, -3.0)])), 0.0, 1.2),
)
FACES = occluders(SOLIDS)


def one_is_blocked(faces, start, end):
    return bool(is_blocked(faces, np.array([start], float), np.array([end], float))[0])


@pytest.mark.parametrize(
    ("z_start", "z_end", "expected"),
    [(1.0, 1.0, True), (2.1, 2.1, False), (0.4, 0.4, False), (2.9, 0.3, True), (3.3, 2.4, False)],
)
def test_height_at_the_crossing_decides(z_start, z_end, expected):
    faces = occluders(scene_of((Polyline(np.array([(0.0, -1.0), (0.0, 1.0)])), 0.5, 2.0)))
    assert one_is_blocked(faces, (-2, 0.2, z_start), (2, -0.3, z_end)) == expected


def test_crossing_height_is_where_the_leg_meets_the_wall():
    faces = occluders(scene_of((Polyline(np.array([(1.0, -1.0), (1.0, 1.0)])), 0.0, 1.5)))
    assert one_is_blocked(faces, (0, 0, 0.0), (4, 0, 5.9))  # 1.475 m high there
    assert not one_is_blocked(faces, (0, 0, 0.0), (4, 0, 6.1))  # 1.525 m


def test_lids_stop_steep_legs_that_no_face_meets():
    faces = occluders(scene_of((BOX, 2.0, 2.2)))
    assert one_is_blocked(faces, (0.1, 0.0, 0.0), (-0.2, 0.1, 4.0))
    assert not one_is_blocked(faces, (1.1, 0.0, 0.0), (1.2, 0.1, 4.0))


def test_wall_end_is_open_beyond():
    faces = occluders(scene_of((Polyline(np.array([(0.0, 0.0), (0.0, 1.0)])), 0.0, 2.0)))
    assert one_is_blocked(faces, (-1, 0.99, 1), (1, 0.99, 1))
    assert not one_is_blocked(faces, (-1, 1.01, 1), (1, 1.01, 1))


def test_parallel_and_empty():
    faces = occluders(scene_of((Polyline(np.array([(0.0, 0.0), (0.0, 1.0)])), 0.0, 2.0)))
    assert not one_is_blocked(faces, (0.1, -1, 1), (0.1, 2, 1))
    assert not one_is_blocked(occluders(scene_of()), (0, 0, 1), (5, 5, 1))
    assert is_blocked(faces, np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


positions = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.05, 2.9))


@settings(max_examples=60, deadline=None)
@given(positions, positions)
def test_against_marching_through_the_solids(start, end):
    ends = np.array([start, end])
    if np.any(SOLIDS.object_index_at(ends) >= 0):
        return
    points = ends[0] + np.linspace(0, 1, 2001)[:, None] * (ends[1] - ends[0])
    depth = np.full(len(points), -np.inf)
    for item in SOLIDS.objects:
        inside = -item.contour.signed_distance(points[:, :2])
        inside = np.minimum(inside, np.minimum(points[:, 2] - item.z_min_m, item.z_max_m - points[:, 2]))
        depth = np.maximum(depth, inside)
    if depth.max() > 1e-3:
        assert one_is_blocked(FACES, start, end)
    elif depth.max() < -5e-3:
        assert not one_is_blocked(FACES, start, end)


def test_parts_give_the_same_as_the_whole(monkeypatch):
    rng = np.random.default_rng(0)
    start, end = rng.uniform([-5, -5, 0], [5, 5, 3], (2, 300, 3))
    whole = is_blocked(FACES, start, end)
    monkeypatch.setattr(occlusion, "MAX_TABLE_ENTRIES", 1)
    np.testing.assert_array_equal(is_blocked(FACES, start, end), whole)
    assert 0 < whole.sum() < len(whole)


def test_surface_names_end_with_the_planes():
    assert surface_names(scene_of((BOX, 0.0, 1.0))) == ["object_0"]
    assert surface_names(scene_of((BOX, 0.0, 1.0), floor=HorizontalPlane(0.0, STONE))) == ["object_0", "floor"]
