"""Convex contours and the waves that creep round them: against circles, geodesics by shapely, and limits."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from isac_arena.validation.scenarios.solids import METAL, scene_of
from scenes.contours import Circle, ClosedSpline, Ellipse, Polygon, RoundedPolygon, rectangle
from scenes.pose import SPEED_OF_LIGHT_M_S
from sim.propagation.diffraction.convex import convex_contour
from sim.propagation.diffraction.creeping import creeping_paths, creeping_rays
from sim.propagation.diffraction.fock import convex_creeping_gain, creeping_gain
from sim.propagation.specular.solver import exact_paths

CARRIER_HZ = 60e9
SQUARE = np.array([(-0.5, -0.4), (0.6, -0.4), (0.6, 0.5), (-0.5, 0.5)])
EGG = ClosedSpline(np.array([(0.6, 0.0), (0.3, 0.42), (-0.2, 0.45), (-0.5, 0.0), (-0.2, -0.45), (0.3, -0.42)]))
SHAPES = [
    Ellipse(np.array([0.1, -0.2]), np.array([0.7, 0.3]), 0.4),
    RoundedPolygon(SQUARE, np.array([0.1, 0.2, 0.3, 0.15])),
    EGG,
]


def ends(seed, n=20):
    rng = np.random.default_rng(seed)
    tx = np.array([-4.0, 0.3, 1.0])
    angle = rng.uniform(-np.pi, np.pi, n)
    return tx, np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), rng.uniform(0.5, 2.0, n)])


def test_an_ellipse_of_equal_axes_is_a_circle():
    tx, rx = ends(1)
    circle = Circle(np.array([0.2, -0.1]), 0.4)
    ring = convex_contour(Ellipse(circle.center_m, np.array([0.4, 0.4]), 0.7))
    for sense in (1, -1):
        expected, found = (creeping_rays(one, tx, rx, sense) for one in (circle, ring))
        found = found.take("ray", np.isin(found.receiver, expected.receiver))
        np.testing.assert_array_equal(found.receiver, expected.receiver)
        assert len(found.receiver) >= 5
        for name in ("attach_m", "middle_m", "shed_m", "normal", "s1_m", "s2_m", "arc_m", "bend", "radius_2_m"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-9, err_msg=name)
    k, turn = 1257.0, np.array([0.01, 0.3])
    np.testing.assert_allclose(
        convex_creeping_gain(k, (0.4, 0.4), 2.0, 3.0, 0.4 * turn, 0.4 ** (1 / 3) * turn, "hard"),
        creeping_gain(k, 0.4, 2.0, 3.0, turn, "hard"),
    )


@pytest.mark.parametrize("contour", SHAPES, ids=["ellipse", "rounded", "spline"])
def test_rays_are_shortest_ways_round_the_contour(contour):
    """The rim of the convex hull of both ends and the contour is made of the two ways, one in each sense."""
    tx = np.array([-4.0, 0.1, 1.0])
    rx = np.array([(3.0, y, 1.0 + y) for y in (-0.3, -0.1, 0.0, 0.2, 0.3)])
    ring = convex_contour(contour)
    outline = contour.vertices(1e-7)
    assert ring.length_m == pytest.approx(contour.length_m, rel=1e-9)
    level = np.full((2, len(rx)), np.nan)
    for row, sense in enumerate((1, -1)):
        rays = creeping_rays(ring, tx, rx, sense)
        level[row, rays.receiver] = rays.s1_m + rays.arc_m + rays.s2_m
    dark = [shapely.LineString([tx[:2], end[:2]]).intersects(shapely.Polygon(outline).buffer(-1e-3)) for end in rx]
    assert sum(dark) >= 3
    for index in np.flatnonzero(dark):
        hull = shapely.MultiPoint(np.vstack([outline, tx[:2], rx[index, :2]])).convex_hull.exterior
        ways = np.diff(np.sort([hull.project(shapely.Point(end[:2])) for end in (tx, rx[index])]))[0]
        np.testing.assert_allclose(np.sort(level[:, index]), np.sort([ways, hull.length - ways]), atol=1e-5)


def test_corners_stop_creeping_waves_and_concave_or_flat_contours_have_none():
    assert convex_contour(rectangle((0, 1), (0, 1))) is None and convex_contour(Polygon(SQUARE)) is None
    bean = ClosedSpline(np.array([(0.6, 0), (0.3, 0.4), (0, 0.1), (-0.3, 0.4), (-0.6, 0), (0, -0.5)], float))
    assert convex_contour(bean) is None
    one_round = RoundedPolygon(SQUARE, np.array([0.0, 0.0, 0.3, 0.3]))
    ring = convex_contour(one_round)
    assert ring.corner_m.size == 2
    tx, low, high = np.array([-4.0, 0.0, 1.0]), np.array([[4.0, -0.3, 1.0]]), np.array([[4.0, 0.3, 1.0]])
    assert len(creeping_rays(ring, tx, low, 1).receiver) == 0  # below, over two corners
    assert len(creeping_rays(ring, tx, high, -1).receiver) == 1  # above, over two round ones


@pytest.mark.parametrize("contour", SHAPES, ids=["ellipse", "rounded", "spline"])
@pytest.mark.parametrize("rise", [0.0, 1.2])
def test_total_field_goes_on_into_the_shadow(contour, rise):
    """Just inside the light the reflection at grazing joins the line of sight; just outside the creeping wave."""
    tx = np.array([-4.0, 0.1, 1.0])
    ring = convex_contour(contour)
    touch = ring.tangents(tx[None, :2], ends_light=False)
    onward = touch.point_m[0] - tx[:2]
    beyond = touch.point_m[0] + 3.0 * onward / np.linalg.norm(onward)
    fields = []
    for off in (1e-4, -1e-4):
        rx = np.append(beyond + off * touch.normal[0], 1.0 + rise)
        scene = replace(scene_of(tx, [contour], (METAL,), height_m=5.0))
        parts = [*exact_paths(scene, rx, CARRIER_HZ), *creeping_paths(scene, rx, CARRIER_HZ)]
        free = 1 / (4 * np.pi * CARRIER_HZ * np.linalg.norm(rx - tx) / SPEED_OF_LIGHT_M_S)
        fields.append(abs(sum(paths.gain.sum() for paths in parts)) / free)
    assert fields[1] == pytest.approx(fields[0], rel=3e-3)
    assert 0.2 < fields[0] < 0.8
