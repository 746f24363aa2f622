"""Ellipses and closed splines against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ellipe

from scenes.contours import Circle, ClosedSpline, Ellipse
from scenes.contours.base import Contour

axes = st.floats(0.1, 5.0)
turns = st.floats(-4.0, 4.0)


@given(a=axes, b=axes, turn=turns, t=st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_ellipse_closed_forms(a, b, turn, t):
    ellipse = Ellipse((1.0, -2.0), (a, b), turn)
    (piece,) = ellipse.pieces
    assert ellipse.area_m2() == pytest.approx(np.pi * a * b)
    assert Contour.area_m2(ellipse) == pytest.approx(np.pi * a * b, rel=1e-12)
    major, minor = max(a, b), min(a, b)
    assert ellipse.length_m == pytest.approx(4 * major * ellipe(1 - (minor / major) ** 2), rel=1e-9)
    phase = 2 * np.pi * t
    expected = a * b / (a**2 * np.sin(phase) ** 2 + b**2 * np.cos(phase) ** 2) ** 1.5
    assert piece.curvature(t) == pytest.approx(expected)
    rotation = np.array([(np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))])
    x, y = (piece.point(t) - ellipse.center_m) @ rotation
    assert (x / a) ** 2 + (y / b) ** 2 == pytest.approx(1)
    gradient = rotation @ np.array([x / a**2, y / b**2])
    np.testing.assert_allclose(piece.outward_normal(t), gradient / np.linalg.norm(gradient), atol=1e-9)


@given(turn=turns, angle=turns, x=st.floats(-3, 3), y=st.floats(-3, 3))
@settings(max_examples=60, deadline=None)
def test_ellipse_radial_function_matches_the_outline(turn, angle, x, y):
    ellipse = Ellipse((0.2, 0.1), (1.5, 0.6), turn)
    if abs(ellipse.signed_distance((x, y))) < 0.02:
        return
    exact, numeric = ellipse.radius((x, y), angle), Contour.radius(ellipse, (x, y), angle)
    if np.isnan(exact) == np.isnan(numeric):  # rays that graze may differ by the sagitta of the outline
        np.testing.assert_allclose(exact, numeric, atol=5e-3)
    if not np.isnan(exact):
        tip = np.array([x, y]) + exact * np.array([np.cos(angle), np.sin(angle)])
        assert abs(ellipse.signed_distance(tip)) < 2e-6


def test_an_ellipse_with_equal_axes_is_a_circle():
    ellipse, circle = Ellipse((1, 2), (0.7, 0.7), 0.4), Circle((1, 2), 0.7)
    points = np.random.default_rng(0).uniform(-1, 4, (100, 2))
    np.testing.assert_allclose(ellipse.signed_distance(points), circle.signed_distance(points), atol=2e-6)
    angle = np.linspace(0, 6, 30)
    np.testing.assert_allclose(ellipse.radius((0.8, 2.1), angle), circle.radius((0.8, 2.1), angle))


def test_closed_spline_through_points_of_a_circle_becomes_one():
    for n, tolerance in ((8, 4e-3), (32, 1.3e-5)):
        angle = np.arange(n) * 2 * np.pi / n
        spline = ClosedSpline(2 * np.column_stack([np.cos(angle), np.sin(angle)]))
        np.testing.assert_allclose(np.linalg.norm(spline.sample(0.05), axis=1), 2, rtol=tolerance)
        assert spline.area_m2() == pytest.approx(4 * np.pi, rel=2 * tolerance)
        assert spline.length_m == pytest.approx(4 * np.pi, rel=tolerance)
        np.testing.assert_allclose(spline.radius((0, 0), [0.1, 3.0]), 2, rtol=tolerance)


POINTS = [(0, 0), (2, -0.5), (3, 1), (1.8, 1.2), (1.2, 2.5), (-0.4, 1.6)]


@pytest.mark.parametrize("first", range(6))
def test_closed_spline_passes_its_points_and_has_no_seam(first):
    spline, whole = ClosedSpline(np.roll(POINTS, first, axis=0)), ClosedSpline(POINTS)
    (piece,) = spline.pieces
    np.testing.assert_allclose(piece.derivative(0.0), piece.derivative(1.0), atol=1e-12)
    np.testing.assert_allclose(piece.second_derivative(0.0), piece.second_derivative(1.0), atol=1e-10)
    np.testing.assert_allclose(whole.signed_distance(POINTS), 0, atol=1e-6)
    np.testing.assert_allclose(piece.point(piece.breaks[:-1]), spline.points_m, atol=1e-12)
    assert spline.area_m2() == pytest.approx(whole.area_m2(), rel=1e-12)


def test_a_closed_spline_given_clockwise_is_turned_round():
    turned = ClosedSpline(POINTS[::-1])
    assert turned.area_m2() == pytest.approx(ClosedSpline(POINTS).area_m2(), rel=1e-12) and turned.closed
    foot, normal = turned.sample(0.2), turned.outward_normal(0.2)
    np.testing.assert_allclose(turned.signed_distance(foot + 0.02 * normal), 0.02, atol=1e-5)
