"""Edges of scenes, diffracted and creeping paths: closed forms, continuity, symmetry and bookkeeping."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.config import load_scene
from scenes.contours import Circle, OpenSpline, Polygon, Polyline, RoundedPolygon, rectangle
from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.scene import Scene, SceneObject
from scenes.walks.trajectory import Walk
from sim.propagation.diffraction.creeping import creeping_paths
from sim.propagation.diffraction.edge_paths import diffracted_paths
from sim.propagation.diffraction.edges import find_edges
from sim.propagation.diffraction.fock import grazing_factor
from sim.propagation.occlusion import occluders
from sim.propagation.paths import BounceKind
from sim.propagation.specular.fresnel import slab_reflection

CARRIER_HZ = 60e9
K = 2 * np.pi * CARRIER_HZ / SPEED_OF_LIGHT_M_S
METAL = Material("metal", 1.0, 1e7, 0.002)
STONE = Material("stone", 5.0, 0.5, 0.1)
BOX = rectangle((0.0, 2.0), (-1.0, 0.0))


def scene_of(*items, tx=(-40.0, 40.0, 1.0), material=STONE):
    objects = tuple(
        SceneObject(f"object_{index}", "wall", contour, z_min, z_max, material, may_overlap=True)
        for index, (contour, z_min, z_max) in enumerate(items)
    )
    far = Walk(np.array([[90.0, 90.0]]), 1.0, 0.0)
    return Scene("test", objects, Pose(np.asarray(tx, float), 0.0), far, (-99, -99, 99, 99))


def edge_rows(*items):
    edges = find_edges(scene_of(*items))
    rows = zip(edges.position_m, edges.z_min_m, edges.z_max_m, edges.opening_rad / np.pi, strict=True)
    return sorted((*np.round(p, 6).tolist(), float(lo), float(hi), round(float(n), 6)) for p, lo, hi, n in rows)


def test_convex_corners_of_a_polygon_are_edges():
    notch = Polygon(np.array([(0, 0), (4, 0), (4, 3), (2, 1), (0, 3)], float))
    rows = edge_rows((notch, 0.0, 2.0))
    assert [row[:2] for row in rows] == [(0, 0), (0, 3), (4, 0), (4, 3)]
    assert [row[4] for row in rows] == [1.5, 1.75, 1.5, 1.75]


def test_faces_of_an_edge_enclose_its_free_sector():
    edges = find_edges(scene_of((BOX, 0.0, 2.0)))
    corner = np.flatnonzero((edges.position_m == [0.0, 0.0]).all(axis=1))
    assert edges.face_0_rad[corner] == pytest.approx([0.0])  # its top face, then over to the left one
    assert edges.opening_rad[corner] == pytest.approx([1.5 * np.pi])


def test_thin_walls_end_in_half_planes_and_bend_in_wedges():
    rows = edge_rows((Polyline(np.array([(0, 0), (1, 0), (1, 1)], float)), 0.0, 2.0))
    assert rows == [(0, 0, 0, 2, 2.0), (1, 0, 0, 2, 1.5), (1, 1, 0, 2, 2.0)]


def test_smooth_contours_have_no_edges_and_open_ones_two():
    rounded = RoundedPolygon(np.array([(3, 0), (5, 0), (5, 2), (3, 2)], float), np.array([0.2, 0.0, 0.3, 0.1]))
    spline = OpenSpline(np.array([(0, 5), (1, 6), (2, 5), (3, 6)], float))
    rows = edge_rows((Circle(np.zeros(2), 1.0), 0.0, 1.0), (rounded, 0.0, 1.0), (spline, 0.0, 1.0))
    assert rows == [(0, 5, 0, 1, 2.0), (3, 6, 0, 1, 2.0), (5, 0, 0, 1, 1.5)]
    assert edge_rows((Polyline(np.array([(0, 0), (1, 0), (2, 0)], float)), 0.0, 1.0)) == [
        (0, 0, 0, 1, 2.0),
        (2, 0, 0, 1, 2.0),
    ]


def test_a_thin_wall_that_closes_upon_itself_has_only_its_kink():
    turn = np.linspace(0, 2 * np.pi, 13)
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    ring[-1] = ring[0]
    rows = edge_rows((OpenSpline(ring), 0.0, 1.0))
    assert all(row[4] < 1.1 for row in rows)


def test_flush_faces_have_no_edge_between_them_at_heights_where_both_stand():
    beside = rectangle((2.0, 3.0), (-1.0, 0.0))
    rows = edge_rows((BOX, 0.0, 2.0), (beside, 0.0, 2.0))
    assert [row[:2] for row in rows] == [(0, -1), (0, 0), (3, -1), (3, 0)]
    half = edge_rows((BOX, 0.0, 2.0), (beside, 0.0, 1.0))
    assert [(row[:2], row[2], row[3]) for row in half if row[0] == 2] == [((2, -1), 1, 2), ((2, 0), 1, 2)]


def test_objects_on_a_wall_close_corners_and_corners_that_touch_stay():
    kiosk = rectangle((0.5, 1.0), (0.0, 0.4))
    assert [row[:2] for row in edge_rows((BOX, 0, 2), (kiosk, 0, 2)) if row[1] >= 0] == [
        (0, 0), (0.5, 0.4), (1, 0.4), (2, 0),
    ]  # fmt: skip
    diagonal = rectangle((2.0, 3.0), (0.0, 1.0))
    assert not [row for row in edge_rows((BOX, 0, 2), (diagonal, 0, 2)) if row[:2] == (2, 0)]
    inside = rectangle((-1.0, 1.0), (-0.5, 1.0))
    assert (0.0, 0.0) not in [row[:2] for row in edge_rows((BOX, 0, 2), (inside, 0, 2))]


def test_door_jambs_and_corners_of_the_campus_arena():
    position = find_edges(load_scene("campus_arena")).position_m

    def is_edge(x, y):
        return bool((np.linalg.norm(position - [x, y], axis=1) < 1e-6).any())

    assert all(is_edge(*place) for place in [(0, 0), (0, 0.97), (0, 1.94), (4.52, 0), (4.73, -0.99)])
    assert not any(is_edge(*place) for place in [(0, 0.12), (-0.11, 0.97), (4.73, 0), (4.64, 0.12)])


def test_geometry_of_one_path():
    scene = scene_of((BOX, 0.0, 3.0), tx=(-3.0, -4.0, 1.0), material=METAL)
    rx = np.array([5.0, 0.0 + 12.0, 2.8])
    paths = diffracted_paths(scene, rx[None], CARRIER_HZ)[0]
    [at] = np.flatnonzero((np.abs(paths.vertex_m[:, 0, :2]) < 1e-9).all(axis=1))
    np.testing.assert_allclose(paths.vertex_m[at, 0], [0, 0, 1 + 1.8 * 5 / 18])
    assert paths.delay_s[at] * SPEED_OF_LIGHT_M_S == pytest.approx(np.hypot(18, 1.8))
    assert np.tan(paths.aod_elevation_rad[at]) == pytest.approx(0.1)
    assert paths.aoa_elevation_rad[at] == pytest.approx(-paths.aod_elevation_rad[at])
    assert paths.aod_azimuth_rad[at] == pytest.approx(np.arctan2(4, 3))
    assert paths.aoa_azimuth_rad[at] == pytest.approx(np.arctan2(-12, -5))
    assert paths.bounce_kind[at, 0] == BounceKind.DIFFRACTION
    assert paths.is_single_bounce[at]


def test_edges_behind_obstacles_or_beyond_their_height_give_no_path():
    tx, rx = (-3.0, -4.0, 1.0), np.array([[5.0, 12.0, 1.0]])
    seen = diffracted_paths(scene_of((BOX, 0.0, 3.0), tx=tx), rx, CARRIER_HZ)[0]
    screen = (Polyline(np.array([(-1.0, -1.5), (-1.1, -0.5)])), 0.0, 3.0)
    hidden = diffracted_paths(scene_of((BOX, 0.0, 3.0), screen, tx=tx), rx, CARRIER_HZ)[0]
    at_corner = [(np.abs(p.vertex_m[:, 0, :2]) < 1e-9).all(axis=1).sum() for p in (seen, hidden)]
    assert at_corner == [1, 0]
    assert len(diffracted_paths(scene_of((BOX, 0.0, 0.9), tx=tx), rx, CARRIER_HZ)[0]) == 0
    assert len(diffracted_paths(scene_of(tx=tx), rx, CARRIER_HZ)[0]) == 0


def at_box_corner(scene, rx):
    """Gain of the path over the corner at the origin."""
    result = []
    for paths in diffracted_paths(scene, rx, CARRIER_HZ):
        [at] = np.flatnonzero((np.abs(paths.vertex_m[:, 0, :2]) < 1e-9).all(axis=1))
        result.append(paths.gain[at])
    return np.array(result)


@pytest.mark.parametrize("material", [METAL, STONE])
@pytest.mark.parametrize("rise", [0.0, 1.7])
def test_field_goes_on_over_the_shadow_and_the_reflection_boundary(material, rise):
    tx = np.array([2.0, 3.0, 1.0])  # over the top face; phi' = atan2(3, 2)
    scene = scene_of((rectangle((0.0, 20.0), (-9.0, 0.0)), 0.0, 5.0), tx=tx, material=material)
    phi_in = np.arctan2(3, 2)

    def at(angle):
        return np.column_stack([4 * np.cos(angle), 4 * np.sin(angle), np.full(len(angle), 1.0 + rise)])

    beside = np.array([-1e-7, 1e-7])
    rx = at(np.pi + phi_in + beside)
    free = 1 / (2 * K * np.linalg.norm(rx - tx, axis=1)) * np.exp(-1j * K * np.linalg.norm(rx - tx, axis=1))
    total = at_box_corner(scene, rx) + free * [1, 0]
    assert total[0] == pytest.approx(total[1], rel=1e-4)
    rx = at(np.pi - phi_in + beside)
    image = tx * [1, -1, 1]
    length = np.linalg.norm(rx - image, axis=1)
    cosine = (rx[:, 1] - image[1]) / length
    r_s, r_p = slab_reflection(cosine, material.complex_permittivity(CARRIER_HZ), material.thickness_m, CARRIER_HZ)
    # vertical to vertical off a vertical wall: the s vector is (-sin el, cos el cos t) / sin(3-D incidence)
    up = (rx[:, 2] - tx[2]) / length
    across = 1 - up**2 - cosine**2
    share = up**2 * cosine**2 / ((1 - cosine**2) * (1 - up**2))
    assert np.all(across > 0)
    reflected = (r_s * (1 - share) - r_p * share) / (2 * K * length) * np.exp(-1j * K * length)
    total = at_box_corner(scene, rx) + reflected * [1, 0]
    assert total[0] == pytest.approx(total[1], rel=1e-4)


@given(turn=st.floats(-np.pi, np.pi), shift=st.tuples(st.floats(-20, 20), st.floats(-20, 20)))
@settings(max_examples=15, deadline=None)
def test_rigid_motion_moves_directions_and_nothing_else(turn, shift):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(points):
        xy = np.asarray(points, float)[..., :2] @ rotation.T + shift
        return np.concatenate([xy, np.asarray(points, float)[..., 2:]], axis=-1)

    corners, tx = np.array([(0, -1), (2, -1), (2, 0), (0, 0.3)], float), (-3.0, -4.0, 1.0)
    rx = np.array([[5.0, 12.0, 2.0], [-6.0, 3.0, 1.0]])
    still = diffracted_paths(scene_of((Polygon(corners), 0, 3), tx=tx), rx, CARRIER_HZ)
    gone = diffracted_paths(scene_of((Polygon(moved(corners)), 0, 3), tx=moved(tx)), moved(rx), CARRIER_HZ)
    for before, after in zip(still, gone, strict=True):
        np.testing.assert_allclose(after.delay_s, before.delay_s, rtol=1e-12)
        np.testing.assert_allclose(np.abs(after.gain), np.abs(before.gain), rtol=1e-8)
        offset = (after.aod_azimuth_rad - before.aod_azimuth_rad - turn + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(offset, 0, atol=1e-9)


def test_receivers_do_not_depend_on_one_another():
    scene = scene_of((BOX, 0.0, 3.0), (Circle(np.array([-2.0, 2.0]), 0.3), 0.0, 3.0), tx=(-3.0, -4.0, 1.0))
    rx = np.random.default_rng(5).uniform([-8, 1, 0.5], [8, 9, 2.5], (9, 3))
    faces, edges = occluders(scene), find_edges(scene)
    for solve in (
        lambda ends: diffracted_paths(scene, ends, CARRIER_HZ, faces, edges),
        lambda ends: creeping_paths(scene, ends, CARRIER_HZ, faces),
    ):
        together = solve(rx)
        for one, position in zip(together, rx, strict=True):
            [alone] = solve(position[None])
            np.testing.assert_array_equal(alone.gain, one.gain)
            np.testing.assert_array_equal(alone.vertex_m, one.vertex_m)


@pytest.mark.parametrize("rise", [0.0, 1.5])
def test_creeping_path_takes_over_where_a_pillar_hides_the_line_of_sight(rise):
    radius, tx = 0.3, np.array([-4.0, 0.3, 1.0])
    scene = scene_of((Circle(np.zeros(2), radius), 0.0, 5.0), tx=tx, material=METAL)
    s2 = 3.0  # the line y = 0.3 touches the pillar at the top
    rx = np.array([[s2, radius - 1e-6, 1 + rise], [s2, radius - 0.3, 1 + rise], [s2, radius + 0.5, 1 + rise]])
    just_dark, dark, lit = creeping_paths(scene, rx, CARRIER_HZ)
    free = 1 / (2 * K * SPEED_OF_LIGHT_M_S * just_dark.delay_s)
    level = np.hypot(7.0, rise)
    k_level = K * 7.0 / level
    limit = 1 - np.sqrt(radius * 1e-9 * 7 / 24) * grazing_factor(k_level, radius, 4.0, 3.0, 1e-9, "soft")
    strongest = int(np.argmax(just_dark.power))
    assert just_dark.delay_s[strongest] * SPEED_OF_LIGHT_M_S == pytest.approx(level, abs=1e-7)
    assert abs(just_dark.gain[strongest]) / free[strongest] == pytest.approx(abs(limit), rel=1e-3)
    assert dark.power.max() < 0.2 * just_dark.power.max()
    assert len(lit) == 0 or lit.power.max() < 1e-2 * just_dark.power.max()
    on_circle = np.linalg.norm(dark.vertex_m[:, 0, :2], axis=1)
    np.testing.assert_allclose(on_circle, radius)
