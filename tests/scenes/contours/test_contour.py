"""Contours against closed forms, brute force, finite differences and each other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.contours import (
    Circle,
    ClosedSpline,
    Ellipse,
    LinePiece,
    OpenSpline,
    Polygon,
    Polyline,
    RoundedPolygon,
    SplinePiece,
    rectangle,
)

L_SHAPE = [(0, 0), (4, 0), (4, 3), (2.5, 3), (2.5, 1.5), (0, 1.5)]
RADII = [0.5, 0.0, 0.3, 0.4, 0.2, 0.7]
WAVE = [(0, 0), (1, 0.6), (2, 0.1), (3.5, 1.0), (4, 3)]
CLOSED = {
    "circle": Circle((1.0, -2.0), 0.7),
    "polygon": Polygon(L_SHAPE),
    "rounded": RoundedPolygon(L_SHAPE, RADII),
    "ellipse": Ellipse((0.5, 1.0), (1.6, 0.6), 0.7),
    "closed_spline": ClosedSpline([(0, 0), (2, -0.5), (3, 1), (1.8, 1.2), (1.2, 2.5), (-0.4, 1.6)]),
}
OPEN = {"polyline": Polyline(WAVE), "spline": OpenSpline(WAVE)}
EVERY = CLOSED | OPEN


def contours(group):
    return pytest.mark.parametrize("contour", group.values(), ids=group.keys())


def test_area_closed_forms():
    assert CLOSED["circle"].area_m2() == pytest.approx(np.pi * 0.49, rel=1e-14)
    assert rectangle((1, 3), (0, 1.5)).area_m2() == pytest.approx(3.0)
    square = RoundedPolygon([(0, 0), (2, 0), (2, 2), (0, 2)], [0.5] * 4)
    assert square.area_m2() == pytest.approx(4 - (4 - np.pi) * 0.25, rel=1e-13)
    assert square.length_m == pytest.approx(8 - 8 * 0.5 + np.pi)


@contours(EVERY)
def test_area_by_the_shoelace_formula(contour):
    x, y = contour.vertices(1e-7).T if contour.closed else np.zeros((2, 3))
    assert contour.area_m2() == pytest.approx(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2, abs=1e-5)


@contours(EVERY)
def test_normals_and_curvature_stand_at_the_samples(contour):
    points, normals, curvature = (of(0.2) for of in (contour.sample, contour.outward_normal, contour.curvature))
    assert len(points) == len(normals) == len(curvature)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    if isinstance(contour, Circle):
        np.testing.assert_allclose(normals, (points - contour.center_m) / contour.radius_m, atol=1e-12)
        np.testing.assert_allclose(curvature, 1 / contour.radius_m)


def test_fully_rounded_square_is_a_circle():
    square = RoundedPolygon([(-1, -1), (1, -1), (1, 1), (-1, 1)], [1.0] * 4)
    assert all(piece.is_curved for piece in square.pieces)
    np.testing.assert_allclose(np.linalg.norm(square.sample(0.1), axis=1), 1.0, rtol=1e-12)


@contours(EVERY)
def test_pieces_join_and_closed_ones_run_counter_clockwise(contour):
    pieces = contour.pieces
    follow = pieces[1:] + pieces[:1] if contour.closed else pieces[1:]
    for piece, after in zip(pieces, follow, strict=False):
        np.testing.assert_allclose(piece.point(1.0), after.point(0.0), atol=1e-12)
    if contour.closed:
        x, y = contour.vertices(0.01).T
        assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0
        for piece in pieces:
            foot, normal = piece.point(0.37), piece.outward_normal(0.37)
            np.testing.assert_allclose(contour.signed_distance(foot + 0.05 * normal), 0.05, atol=2e-6)
            np.testing.assert_allclose(contour.signed_distance(foot - 0.05 * normal), -0.05, atol=2e-6)


def test_fillets_are_tangent_to_both_sides_and_clockwise_input_is_turned():
    forward = RoundedPolygon(L_SHAPE, RADII)
    for piece, after in zip(forward.pieces, forward.pieces[1:] + forward.pieces[:1], strict=True):
        if piece.is_curved or after.is_curved:
            cosine = float(piece.outward_normal(1.0) @ after.outward_normal(0.0))
            assert cosine == pytest.approx(1.0, abs=1e-12)
    assert sorted(abs(p.curvature(0.5)) for p in forward.pieces if p.is_curved) == pytest.approx(
        sorted(1 / r for r in RADII if r)
    )
    assert [p.curvature(0.5) < 0 for p in forward.pieces if p.is_curved].count(True) == 1  # the re-entrant corner
    backward = RoundedPolygon(L_SHAPE[::-1], RADII[::-1])
    assert backward.area_m2() == pytest.approx(forward.area_m2())


def test_too_large_fillet_names_the_side():
    with pytest.raises(ValueError, match=r"corner_radius_m = .*corners 0 and 1 take 9\.000 m.*4\.000 m long"):
        RoundedPolygon([(0, 0), (4, 0), (4, 3)], [3.0, 0.0, 0.0])


def test_spline_of_points_on_a_line_is_straight_and_on_a_parabola_exact():
    line = SplinePiece([(0, 0), (1, 0.5), (4, 2)])
    np.testing.assert_allclose(line.curvature(np.linspace(0, 1, 9)), 0, atol=1e-12)
    assert line.length == pytest.approx(np.hypot(4, 2))
    np.testing.assert_allclose(line.outward_normal(0.3), np.array([1, -2]) / np.sqrt(5))


def test_spline_of_a_dense_circle_has_its_length_curvature_and_normal():
    angle = np.linspace(0, 1.5 * np.pi, 60)
    spline = SplinePiece(2 * np.column_stack([np.cos(angle), np.sin(angle)]))
    assert spline.length == pytest.approx(3 * np.pi, rel=1e-6)
    t = np.linspace(0.05, 0.95, 40)
    np.testing.assert_allclose(spline.curvature(t), 0.5, rtol=2e-3)
    np.testing.assert_allclose(spline.outward_normal(t), spline.point(t) / 2, atol=1e-3)


@contours(EVERY)
def test_derivatives_against_finite_differences(contour):
    t, h = np.linspace(0.02, 0.98, 23), 1e-5
    for piece in contour.pieces:
        first = (piece.point(t + h) - piece.point(t - h)) / (2 * h)
        second = (piece.derivative(t + h) - piece.derivative(t - h)) / (2 * h)
        np.testing.assert_allclose(piece.derivative(t), first, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(piece.second_derivative(t), second, rtol=1e-4, atol=1e-4)


@contours(EVERY)
def test_curvature_is_the_turn_of_the_normal_per_length(contour):
    h = 1e-5
    for piece in contour.pieces:
        t = np.linspace(0.02, 0.98, 23)
        before, after = piece.outward_normal(t - h), piece.outward_normal(t + h)
        turn = np.arcsin(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
        step = np.linalg.norm(piece.point(t + h) - piece.point(t - h), axis=1)
        np.testing.assert_allclose(piece.curvature(t), turn / step, rtol=1e-4, atol=1e-5)


@contours(EVERY)
@pytest.mark.parametrize("sagitta_m", [0.05, 0.002])
def test_polygonisation_keeps_the_sagitta(contour, sagitta_m):
    vertices = contour.vertices(sagitta_m)
    np.testing.assert_allclose(np.abs(contour.signed_distance(vertices)), 0, atol=2e-6)
    chords = Polyline(vertices if not contour.closed else np.vstack([vertices, vertices[:1]]))
    assert chords.signed_distance(contour.sample(0.01)).max() <= sagitta_m * 1.02


@contours(EVERY)
def test_sample_spacing(contour):
    points = contour.sample(0.05)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert step.max() <= 0.05 + 1e-9
    for piece in contour.pieces:
        inside = piece.point(piece.equidistant(200))
        step = np.linalg.norm(np.diff(inside, axis=0), axis=1)
        assert step.max() / step.min() < 1.01


@contours(EVERY)
def test_signed_distance_by_brute_force(contour):
    x_min, y_min, x_max, y_max = contour.bounds_m
    rng = np.random.default_rng(3)
    points = rng.uniform([x_min - 1, y_min - 1], [x_max + 1, y_max + 1], (200, 2))
    dense = np.concatenate([piece.point(np.linspace(0, 1, 4001)) for piece in contour.pieces])
    brute = np.linalg.norm(points[:, None] - dense, axis=2).min(axis=1)
    np.testing.assert_allclose(np.abs(contour.signed_distance(points)), brute, atol=1e-3, rtol=1e-4)
    if not contour.closed:
        assert not contour.contains(points).any()
        assert contour.area_m2() == 0.0
        return
    winding = np.unwrap(np.arctan2(*(np.vstack([dense, dense[:1]]) - points[:, None]).T[::-1]), axis=0)
    inside = np.abs(winding[-1] - winding[0]) > np.pi
    np.testing.assert_array_equal(contour.contains(points), inside)


@contours(CLOSED)
@given(x=st.floats(-3, 6), y=st.floats(-4, 5))
@settings(max_examples=40, deadline=None)
def test_contains_is_negative_distance(contour, x, y):
    assert bool(contour.contains((x, y))) == bool(contour.signed_distance((x, y)) < 0)


@contours(CLOSED)
@given(angle=st.floats(-10, 10), along=st.floats(0, 1), off=st.floats(0, 0.2))
@settings(max_examples=40, deadline=None)
def test_radial_function_ends_on_the_boundary(contour, angle, along, off):
    center = contour.pieces[0].point(along) - (off + 1e-3) * contour.pieces[0].outward_normal(along)
    if not contour.contains(center):
        return
    radius = contour.radius(center, angle)
    tip = center + radius * np.array([np.cos(angle), np.sin(angle)])
    assert abs(contour.signed_distance(tip)) < 1e-5
    beyond = center + (radius + np.linspace(1e-4, 6, 50))[:, None] * np.array([np.cos(angle), np.sin(angle)])
    assert not contour.contains(beyond).any()


def test_radial_function_of_circle_matches_the_outline_and_misses_are_nan():
    circle = Circle((0.5, 0.2), 1.3)
    angle = np.linspace(-np.pi, np.pi, 50).reshape(5, 10)
    exact, numeric = circle.radius((0, 0), angle), super(Circle, circle).radius((0, 0), angle)
    np.testing.assert_allclose(exact, numeric, atol=5e-6)
    np.testing.assert_allclose(circle.radius((3.5, 0.2), [np.pi, np.pi / 2]), [4.3, np.nan])
    assert np.isnan(Polygon(L_SHAPE).radius((6, 1), 0.0))
    assert Polygon(L_SHAPE).radius((-1, 1), 0.0) == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Circle((0, 0), 0.0), r"radius_m = 0\.0: must be > 0"),
        (lambda: Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), r"vertices_m = .*must not cross"),
        (lambda: Polygon([(0, 0), (1, 1)]), r"vertices_m has 2 point\(s\): at least 3"),
        (lambda: Polyline([(0, 0), (0, 0)]), r"points_m\[1\] repeats"),
        (lambda: RoundedPolygon([(0, 0), (4, 0), (4, 3)], [-1, 0, 0]), r"corner_radius_m\[0\] = -1\.0"),
        (lambda: rectangle((1, 0), (0, 1)), r"x_m = \[1, 0\]: the first must be smaller"),
        (lambda: LinePiece((0, 0, 0), (1, 1)), r"LinePiece\.start_m"),
        (lambda: Circle((0, 0), 1.0).vertices(0.0), r"max_sagitta_m = 0\.0: must be > 0"),
        (lambda: Circle((0, np.nan), 1.0), r"center_m = \[0\.0, nan\]: must be finite"),
        (lambda: Polygon([(0, 0), (1, 0), (1, 1), (0, 0)]), r"vertices_m\[3\] repeats the first vertex"),
        (lambda: Polygon([(0, 0), (1, 0), (1, 1e-8)]), r"the outline has no thickness"),
        (lambda: Polygon([(0, 0), (1, np.nan), (1, 1)]), r"at least 3 finite ones"),
        (lambda: Polyline([(0, 0), (2, 0), (2, 1), (1, -1)]), r"points_m: .*crosses itself"),
        (lambda: OpenSpline([(0, 0), (2, 0), (2, 1), (1, -1)]), r"points_m: .*crosses itself"),
        (lambda: Ellipse((0, 0), (1, 0), 0.0), r"semi_axes_m = \[1\.0, 0\.0\]: must be two lengths > 0"),
        (lambda: Ellipse((0, 0), (1, 2), np.inf), r"rotation_rad = inf"),
        (lambda: ClosedSpline([(0, 0), (1, 1), (1, 0), (0, 1)]), r"points_m: .*crosses itself"),
        (lambda: ClosedSpline([(0, 0), (1, 0), (1, 1), (0, 0)]), r"points_m\[3\] repeats the first point"),
        (lambda: Circle((0, 0), 1.0).sample(-1.0), r"spacing_m = -1\.0: must be > 0"),
    ],
)
def test_bad_contours_end_in_one_line(make, message):
    with pytest.raises(ValueError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
