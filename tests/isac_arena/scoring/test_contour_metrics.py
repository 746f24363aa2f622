import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import directed_hausdorff

from isac_arena.scoring.metrics.contours import (
    chamfer_m,
    extent_iou,
    hausdorff_m,
    intersection_over_union,
    interval_iou,
    modified_hausdorff_m,
    outline_distances,
    perpendicular_rmse_m,
    scene_gospa,
)

ANGLE = np.linspace(-np.pi, np.pi, 720, endpoint=False)
UNIT = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=-1)


def circle(x=0.0, radius=1.0):
    return np.array([x, 0.0]) + radius * UNIT


@given(st.floats(0.0, 1.9))
def test_shifted_circles_have_the_closed_form_overlap_and_distance(shift):
    overlap = 2 * np.arccos(shift / 2) - shift / 2 * np.sqrt(4 - shift**2)
    assert intersection_over_union(circle(), circle(shift)) == pytest.approx(
        overlap / (2 * np.pi - overlap), abs=1e-4
    )
    assert hausdorff_m(*outline_distances(circle(), circle(shift))) == pytest.approx(shift, abs=1e-4)


def test_concentric_circles_have_all_distances_equal():
    there, back = outline_distances(circle(), circle(radius=1.3))
    for measure in (hausdorff_m, modified_hausdorff_m, chamfer_m):
        assert measure(there, back) == pytest.approx(0.3, abs=1e-4)


@given(st.integers(0, 1000))
def test_hausdorff_is_that_of_dense_points_and_of_shapely(seed):
    rng = np.random.default_rng(seed)
    a, b = (np.add(circle() * (1 + 0.3 * np.cos(3 * ANGLE + k))[:, None], rng.normal(0, 0.2, 2)) for k in (0, 1))
    found = hausdorff_m(*outline_distances(a, b))
    assert found == pytest.approx(max(directed_hausdorff(a, b)[0], directed_hausdorff(b, a)[0]), abs=5e-3)
    assert found == pytest.approx(
        shapely.hausdorff_distance(shapely.LinearRing(a), shapely.LinearRing(b)), abs=5e-3
    )


def test_hausdorff_looks_both_ways_but_the_means_differ():
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    there, back = outline_distances(circle(radius=0.01), square)
    assert hausdorff_m(there, back) == pytest.approx(np.sqrt(2) - 0.01, abs=1e-3)
    assert chamfer_m(there, back) == pytest.approx((0.99 + np.sqrt(2) - 0.01) / 2, abs=0.01)
    assert modified_hausdorff_m(there, back) == pytest.approx(np.sqrt(2) - 0.01, abs=1e-3)


def test_outlines_that_cross_themselves_or_have_no_area():
    eight = np.cos(2 * ANGLE)[:, None] * UNIT
    assert 0 < intersection_over_union(eight, circle()) < 1
    line = np.array([[0.0, 0], [1, 0], [2, 0]])
    assert intersection_over_union(line, line) == 1
    assert intersection_over_union(line, line + np.array([0, 1])) == 0


@given(st.floats(-3, 3), st.floats(-0.5, 0.5))
def test_points_parallel_to_a_wall_have_its_offset(turn, offset):
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    points = np.outer(np.linspace(-3, 9, 7), along) + offset * across
    assert perpendicular_rmse_m(points, np.zeros(2), 4 * along) == pytest.approx(abs(offset), abs=1e-12)
    with pytest.raises(ValueError, match="two distinct points"):
        perpendicular_rmse_m(points, along, along)


@given(st.floats(-1.5, 1.5), st.floats(0.1, 4), st.floats(-3, 3))
def test_extent_of_segments_matches_intervals(turn, length, start):
    axis = np.array([np.cos(turn), np.sin(turn)])
    lit = np.outer(np.linspace(0, 2, 9), axis) + np.array([3, 1])
    seen = np.outer(np.linspace(start, start + length, 9), axis) + np.array([3, 1])
    overlap = max(0, min(2, start + length) - max(0, start))
    union = max(2, start + length) - min(0, start)
    assert extent_iou(seen, lit) == pytest.approx(overlap / union, abs=1e-9)
    assert interval_iou((start, start + length), (0, 2)) == pytest.approx(overlap / union, abs=1e-12)


def test_extent_needs_two_lit_points():
    assert np.isnan(extent_iou(UNIT, np.array([[0.0, 0.0]])))
    assert np.isnan(extent_iou(UNIT, np.zeros((2, 2))))
    assert np.isnan(extent_iou(np.zeros((0, 2)), UNIT))
    assert interval_iou((1.0, 1.0), (1.0, 1.0)) == 1


def test_a_scene_is_scored_by_overlap_misses_and_ghosts():
    truth = [circle(), circle(5.0)]
    assert scene_gospa(truth, truth).value == 0
    found = scene_gospa([circle(5.2), circle(20.0)], truth)
    iou = intersection_over_union(circle(5.2), circle(5.0))
    assert found.value == pytest.approx(np.sqrt((1 - iou) ** 2 + 0.5 + 0.5))
    assert (found.n_missed, found.n_false, found.true_index.tolist()) == (1, 1, [1, -1])
    assert scene_gospa([], truth).value == pytest.approx(1.0)
