from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.record import Shapes
from isac_arena.scoring.stages.shapes import seen_samples, shape_errors
from scenes.contours import Circle, Polyline

ANGLE = np.linspace(-np.pi, np.pi, 720, endpoint=False)
UNIT = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=-1)


def circle(radius, shift=0.0):
    return Circle(np.array([1.0 + shift, 2.0]), radius)


def shapes_of(radius_m, std_m, center=(1.0, 2.0)):
    one = np.ones(1)
    radius = np.broadcast_to(np.asarray(radius_m, float), ANGLE.shape)[None]
    std = np.broadcast_to(np.asarray(std_m, float), ANGLE.shape)[None]
    return Shapes(np.zeros(0, int), np.array([center]), ANGLE, radius, std, one, one, one, one, one)


def test_exact_contour_has_no_error_and_full_coverage():
    members = np.array([1.0, 2.0]) + UNIT[::60]
    errors = shape_errors(shapes_of(1.0, 0.01), 0, members, circle(1.0), members)
    assert errors.iou == pytest.approx(1, abs=1e-4)
    assert errors.full_rmse_m == pytest.approx(0, abs=1e-12)
    assert errors.chamfer_m == pytest.approx(0, abs=1e-4)
    assert errors.coverage95 == errors.seen_coverage95 == 1
    too_narrow = shape_errors(shapes_of(1.1, 0.049), 0, members, circle(1.0), members)
    assert too_narrow.coverage95 == 0
    assert too_narrow.full_rmse_m == pytest.approx(0.1)
    wide_enough = shape_errors(shapes_of(1.1, 0.051), 0, members, circle(1.0), members)
    assert wide_enough.coverage95 == 1


def test_coverage_of_gaussian_radii_is_that_of_two_sigma():
    rng = np.random.default_rng(5)
    errors = shape_errors(shapes_of(2 + 0.05 * rng.standard_normal(720), 0.05), 0, UNIT, circle(2.0), UNIT)
    assert errors.coverage95 == pytest.approx(0.9545, abs=0.025)


def test_seen_part_is_judged_alone():
    right = np.abs(ANGLE) <= np.deg2rad(45)
    radius = np.where(right, 1.0, 1.5)
    members = np.array([1.0, 2.0]) + UNIT[np.abs(ANGLE) <= np.deg2rad(35)]
    errors = shape_errors(shapes_of(radius, 0.1), 0, members, circle(1.0), members)
    assert errors.seen_rmse_m == pytest.approx(0, abs=1e-9)
    assert errors.full_rmse_m == pytest.approx(0.5 * np.sqrt(0.75), rel=0.01)
    assert errors.seen_coverage95 == 1
    assert errors.coverage95 == pytest.approx(0.25, abs=0.01)


def test_seen_samples_wrap_round():
    seen = seen_samples(ANGLE, np.array([np.pi - 0.01]), 0.1)
    np.testing.assert_array_equal(seen, np.cos(ANGLE - np.pi + 0.01) >= np.cos(0.1))
    assert not seen_samples(ANGLE, np.zeros(0), 0.1).any()


def test_band_is_tested_only_where_the_true_radius_exists():
    wall = Polyline(np.array([[-10.0, 3.0], [10.0, 3.0]]))
    radius = np.where(np.sin(ANGLE) > 0.5, 1 / np.maximum(np.sin(ANGLE), 1e-9), 1.0)
    shapes = replace(shapes_of(radius, 1e-6), center_m=np.array([[0.0, 2.0]]))
    errors = shape_errors(shapes, 0, np.array([[0.0, 3.0]]), wall, np.zeros((0, 2)))
    hit = np.sin(ANGLE) > 1 / np.hypot(1, 10)
    assert errors.coverage95 == pytest.approx((np.sin(ANGLE) > 0.5).sum() / hit.sum(), abs=0.01)
    assert errors.seen_coverage95 == 1
    assert np.isnan(errors.iou)
