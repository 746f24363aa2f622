"""Stops along the walk."""

import numpy as np
import pytest

from scenes.walks.trajectory import Walk

CORNERS = [(0, 0), (3, 0), (3, 4)]


def test_stops_are_equally_spaced_by_arc_length():
    walk = Walk(CORNERS, 1.8, 0.25, 15)
    position = walk.positions_m()
    assert walk.length_m == pytest.approx(7)
    expected = [(s, 0, 1.8) if s <= 3 else (3, s - 3, 1.8) for s in np.linspace(0, 7, 15)]
    np.testing.assert_allclose(position, expected, atol=1e-12)
    np.testing.assert_array_equal(walk.headings_rad(), 0.25)


def test_heading_along_the_path():
    poses = Walk(CORNERS, 1.0, np.nan, 8).poses()
    assert [round(np.rad2deg(pose.heading_rad)) for pose in poses] == [0, 0, 0, 90, 90, 90, 90, 90]


def test_explicit_points_and_single_stop():
    walk = Walk(CORNERS, 1.0, np.nan)
    np.testing.assert_allclose(walk.positions_m()[:, :2], CORNERS)
    single = Walk([(2, 5)], 1.0, 0.0, 1)
    np.testing.assert_allclose(single.positions_m(), [[2, 5, 1]])
    assert len(Walk([(2, 5)], 1.0, np.nan).poses()) == 1


@pytest.mark.parametrize(
    ("points", "n_stops", "message"),
    [([(0, 0), (1, 0)], 0, "n_stops = 0: must be >= 1"), ([(0, 0)], 3, "3 stops need a path"),
     (np.empty((0, 2)), None, "at least one finite point"), ([(0, np.nan)], None, "at least one finite point")],
)  # fmt: skip
def test_bad_walks(points, n_stops, message):
    with pytest.raises(ValueError, match=message):
        Walk(points, 1.0, 0.0, n_stops)


def test_smooth_walk_follows_the_spline_at_equal_arc_length():
    angle = np.linspace(0, np.pi, 9)
    arc = 2 * np.column_stack([np.cos(angle), np.sin(angle)])
    walk = Walk(arc, 1.5, np.nan, 21, is_smooth=True)
    position, heading = walk.positions_m(), walk.headings_rad()
    assert walk.length_m == pytest.approx(2 * np.pi, rel=1e-4)
    at = np.linspace(0, np.pi, 21)
    np.testing.assert_allclose(position, [(2 * np.cos(a), 2 * np.sin(a), 1.5) for a in at], atol=2e-3)
    np.testing.assert_allclose(np.unwrap(heading), at + np.pi / 2, atol=0.02)
    assert walk.line_m()[0] == pytest.approx(arc[0]) and len(walk.line_m()) > 100
    through = Walk(arc, 1.5, 0.3, is_smooth=True)
    np.testing.assert_allclose(through.positions_m()[:, :2], arc, atol=1e-12)
    np.testing.assert_array_equal(through.headings_rad(), np.full(9, 0.3))
    with pytest.raises(ValueError, match="a smooth walk needs two or more, neighbours distinct"):
        Walk([(0, 0)], 1.0, 0.0, is_smooth=True)
    with pytest.raises(ValueError, match="height_m = nan: must be finite"):
        Walk(CORNERS, np.nan, 0.0)
