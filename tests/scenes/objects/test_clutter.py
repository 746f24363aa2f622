"""Clutter: inside test and occlusion against closed forms, and meshes that are refused."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.contours import Circle, Polyline
from scenes.objects.clutter import Clutter, mesh_crossings, placed_vertices
from scenes.objects.material import Material
from scenes.objects.scene_object import SceneObject

WOOD = Material("wood", 2.0, 0.4)
BOX = trimesh.creation.box((2.0, 1.0, 3.0))
BALL = trimesh.creation.icosphere(subdivisions=3, radius=1.0)


def clutter(mesh=BOX, *, move=(0, 0, 0), scale=1.0, rotation=(0, 0, 0), name="thing"):
    vertices = placed_vertices(np.asarray(mesh.vertices), move, scale, rotation)
    return Clutter(name, "clutter", WOOD, vertices, np.asarray(mesh.faces))


def blocked(item, start, end):
    """Whether each leg meets the mesh."""
    return np.isin(np.arange(len(np.atleast_2d(start))), mesh_crossings(item, start, end).leg)


def test_inside_of_a_box_and_a_ball():
    rng = np.random.default_rng(1)
    points = rng.uniform(-2, 2, (400, 3))
    turn = 0.7
    box = clutter(rotation=(0, 0, turn), move=(0.2, 0.1, 0.0))
    c, s = np.cos(turn), np.sin(turn)
    local = (points - [0.2, 0.1, 0.0]) @ np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)])
    np.testing.assert_array_equal(box.contains(points), np.all(np.abs(local) < [1, 0.5, 1.5], axis=1))
    radius = np.linalg.norm(points, axis=1)
    off = np.abs(radius - 1) > 0.02
    np.testing.assert_array_equal(clutter(BALL).contains(points)[off], (radius < 1)[off])
    assert not clutter(trimesh.Trimesh([(-1, -1, 0), (1, -1, 0), (0, 2, 0)], [(0, 1, 2)])).contains(points).any()


@given(start=st.tuples(*[st.floats(-4, 4)] * 3), end=st.tuples(*[st.floats(-4, 4)] * 3), scale=st.floats(0.3, 2))
@settings(max_examples=100, deadline=None)
def test_a_ball_blocks_the_legs_that_pass_its_centre_closer_than_its_radius(start, end, scale):
    start, end = np.array(start), np.array(end)
    along = end - start
    if np.linalg.norm(along) < 1e-3:
        return
    share = np.clip(-start @ along / (along @ along), 0, 1)
    distance = np.linalg.norm(start + share * along) / scale
    is_inside = max(np.linalg.norm(start), np.linalg.norm(end)) < 0.97 * scale
    near_surface = [distance, np.linalg.norm(start) / scale, np.linalg.norm(end) / scale]
    if any(0.97 < radius < 1.01 for radius in near_surface):
        return
    hit = blocked(clutter(BALL, scale=scale), start, end)[0]
    assert hit == (distance < 1 and not is_inside)


PILLAR = SceneObject("pillar", "pillar", Circle(np.zeros(2), 0.4), 0.0, 3.0, WOOD)
SHEET = SceneObject("sheet", "wall", Polyline(np.array([(0.0, -3.0), (0.0, 3.0)])), 0.0, 3.0, WOOD)


@pytest.mark.parametrize(
    ("move", "size_m", "in_pillar", "in_sheet"),
    [
        ((0.0, 0.0, 1.0), (2.0, 1.0, 1.0), True, True),  # the pillar goes through a box
        ((0.0, 0.0, 1.5), (9.0, 9.0, 0.05), True, True),  # and through a plate whose edges are far
        ((0.0, 0.0, 1.5), (0.1, 0.1, 0.1), True, True),  # a box inside the pillar
        ((0.0, 0.0, 1.5), (2.0, 1.0, 5.0), True, True),  # the pillar inside a box
        ((1.4, 0.0, 1.5), (2.0, 1.0, 1.0), False, False),  # side by side
        ((1.39, 0.0, 1.5), (2.0, 1.0, 1.0), True, False),
        ((1.0, 2.0, 1.5), (2.0, 1.0, 1.0), False, False),  # beside the sheet
        ((0.99, 2.0, 1.5), (2.0, 1.0, 1.0), False, True),
        ((0.0, 0.0, 3.5), (2.0, 1.0, 1.0), False, False),  # on top
        ((0.0, 0.0, 3.49), (2.0, 1.0, 1.0), True, True),
    ],
)
def test_overlaps_with_objects(move, size_m, in_pillar, in_sheet):
    item = clutter(trimesh.creation.box(size_m), move=move)
    assert (item.overlaps(PILLAR), item.overlaps(SHEET)) == (in_pillar, in_sheet)


@given(height=st.floats(-1.0, 4.0), reach=st.floats(-2.0, 2.0))
@settings(max_examples=40, deadline=None)
def test_a_ball_overlaps_a_pillar_where_its_slice_does(height, reach):
    below_m = max(0.0, -height, height - 3.0)  # of the middle of the ball from the pillar
    wanted_m = np.sqrt(max(0.0, 1.0 - below_m**2)) + 0.4 - abs(reach) if below_m < 1.0 else -1.0
    if abs(wanted_m) > 0.03 and abs(below_m - 1.0) > 0.03:  # the facets lie inside of the ball
        assert clutter(BALL, move=(reach, 0.0, height)).overlaps(PILLAR) == (wanted_m > 0)


def test_legs_in_chunks_and_turned_round(monkeypatch):
    item = clutter(BALL, move=(1, 0, 0))
    rng = np.random.default_rng(2)
    start, end = rng.uniform(-3, 3, (2, 300, 3))
    whole = mesh_crossings(item, start, end)
    assert 30 < len(whole.leg) < 400
    monkeypatch.setattr("scenes.objects.clutter.MAX_TABLE_ENTRIES", 50)
    for part, other in zip(whole, mesh_crossings(item, start, end), strict=True):
        np.testing.assert_array_equal(part, other)
    back = mesh_crossings(item, end, start)
    np.testing.assert_array_equal(np.bincount(back.leg), np.bincount(whole.leg))


def test_crossings_of_a_box_and_on_an_edge_that_two_triangles_share():
    leg, share, normal = mesh_crossings(clutter(), (-2.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    assert leg.tolist() == [0, 0]
    np.testing.assert_allclose(share, [0.25, 0.75], atol=1e-12)
    np.testing.assert_allclose(np.abs(normal), [(1, 0, 0)] * 2, atol=1e-12)


def test_a_leg_that_starts_on_a_face_is_not_blocked_by_it():
    assert not blocked(clutter(), (1.0, 0.1, 0.2), (5, 0, 0))[0]
    assert blocked(clutter(), (1.0, 0.1, 0.2), (-5, 0, 0))[0]


def test_placed_turns_about_x_then_y_then_z():
    np.testing.assert_allclose(
        placed_vertices([(0, 1, 0)], (1, 2, 3), 2.0, (np.pi / 2, 0, 0)), [(1, 2, 5)], atol=1e-12
    )
    np.testing.assert_allclose(
        placed_vertices([(1, 0, 0)], (0, 0, 0), 1.0, (0, np.pi / 2, 0)), [(0, 0, -1)], atol=1e-12
    )
    np.testing.assert_allclose(
        placed_vertices([(1, 0, 0)], (0, 0, 0), 1.0, (0, 0, np.pi / 2)), [(0, 1, 0)], atol=1e-12
    )
    np.testing.assert_allclose(
        placed_vertices([(0, 1, 0)], (0, 0, 0), 1.0, (np.pi / 2, np.pi / 2, 0)), [(1, 0, 0)], atol=1e-12
    )


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        ([(0, 0, 0)] * 3, np.zeros((0, 3)), "mesh 'thing' has no triangles"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, np.nan)], [(0, 1, 2)], r"mesh 'thing': vertex 2 = .*nan.* finite"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 3)], "mesh 'thing': a face names a vertex"),
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)], "mesh 'thing': its faces have no area"),
        (
            [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, -1, 0)],
            [(0, 1, 2), (0, 1, 3), (0, 1, 4)],
            r"mesh 'thing' is not manifold: 1 edge\(s\) belong to more than two faces",
        ),
    ],
)
def test_bad_meshes(vertices, faces, message):
    with pytest.raises(ValueError, match=message) as caught:
        Clutter("thing", "clutter", WOOD, vertices, faces)
    assert "\n" not in str(caught.value)


def test_closed_and_open_meshes():
    assert clutter().is_closed and clutter(BALL).is_closed
    pair = trimesh.util.concatenate([BOX, BOX.copy().apply_translation((2.0, 0.0, 0.0))])
    pair.merge_vertices()
    points = [(0.9, 0, 0), (1.1, 0, 0), (3.1, 0, 0)]
    assert clutter(pair).is_closed and clutter(pair).contains(points).tolist() == [True, True, False]
    assert not Clutter("open", "clutter", WOOD, BOX.vertices, BOX.faces[:-1]).is_closed
    assert clutter().area_m2() == pytest.approx(22.0)


def test_distance_in_the_plan_is_that_to_the_outline_and_to_upright_faces():
    points = np.array([[1.5, 0.0], [0.0, 0.0], [2.0, 1.5], [0.9, 0.1]])
    np.testing.assert_allclose(clutter().plan_distance_m(points), [0.5, 0.5, np.sqrt(2), 0.1], atol=1e-9)
    sheet = trimesh.Trimesh([(-1, 0, 0), (1, 0, 0), (1, 0, 2), (-1, 0, 2)], [(0, 1, 2), (0, 2, 3)])
    assert not clutter(sheet).plan_outlines_m
    np.testing.assert_allclose(
        clutter(sheet).plan_distance_m(points), [0.5, 0.0, np.hypot(1, 1.5), 0.1], atol=1e-9
    )
