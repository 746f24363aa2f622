"""Relief of walls: a pane before a wall mirrors, the wall beside it scatters from two centimetres behind."""

import numpy as np
import pytest

from estimation.shape.kinds.mirror_wall import scattering_wall
from estimation.shape.reflection.faces import relief
from estimation.shape.reflection.faces.bends import fit_bend, known_parts
from estimation.shape.reflection.faces.relief import with_relief
from estimation.shape.reflection.faces.scattering import FaceLine

LINE = FaceLine(np.array([0.0, 2.0]), np.diag([1e-8, 1e-6]), np.array([0.0, 8.0]))  # x = 2, seen along y
MIRRORED = np.linspace(5.0, 7.0, 9)


def wall(first_m: float = 0.0, last_m: float = 8.0):
    places = np.array([first_m, last_m])
    return scattering_wall(LINE.parameter, LINE.covariance, places, np.full(2, 1e-4))


def scattered(seed: int, step_m: float, n: int = 120, std_m: float = 0.03):
    """Places over the whole wall and depths: the wall is `step_m` behind the line outside of 4.5 to 7.5 m."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0.0, 8.0, n)
    return place, true_depth(place, step_m) + std_m * rng.standard_normal(n), np.full(n, std_m**2)


def true_depth(place_m: np.ndarray, step_m: float) -> np.ndarray:
    return np.where((place_m > 4.5) & (place_m < 7.5), 0.0, -step_m)


def off_and_covered(step_m: float, seeds: range) -> tuple[float, float, float]:
    """RMS errors of depths with relief and of the line alone, and the share of the band that holds the wall."""
    errors, plain, covered = [], [], []
    for seed in seeds:
        found = with_relief(wall(), LINE, MIRRORED, *scattered(seed, step_m))
        true = 2.0 + true_depth(found.contour_m[:, 1], step_m)
        errors.append(found.contour_m[:, 0] - true)
        plain.append(2.0 - true)
        covered.append(np.abs(errors[-1]) <= 1.96 * found.std_m)
    return float(np.std(errors)), float(np.sqrt(np.mean(np.square(plain)))), float(np.mean(covered))


def test_a_wall_behind_a_pane_is_found_where_it_scatters() -> None:
    off, plain, covered = off_and_covered(0.06, range(12))
    assert off < 0.6 * plain and covered > 0.9


def test_a_flat_wall_stays_where_it_mirrors() -> None:
    for seed in range(6):
        found = with_relief(wall(), LINE, MIRRORED, *scattered(seed, 0.0))
        np.testing.assert_allclose(found.contour_m, wall().contour_m, atol=0.004)
        assert (found.std_m >= wall().std_m - 1e-12).all()
    assert off_and_covered(0.0, range(6))[2] == 1.0


def test_one_point_far_off_makes_no_relief() -> None:
    place, depth, variance = scattered(0, 0.0)
    depth[7] = -1.0
    found = with_relief(wall(), LINE, MIRRORED, place, depth, variance)
    np.testing.assert_allclose(found.contour_m, wall().contour_m, atol=0.01)


def test_without_mirrored_or_scattered_paths_nothing_changes() -> None:
    none, shape = np.zeros(0), wall()
    assert with_relief(shape, LINE, none, *scattered(0, 0.1)) is shape
    assert with_relief(shape, LINE, MIRRORED, none, none, none) is shape


def test_thinned_points_keep_their_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many points as a few means: the same wall, and as sure."""
    many = scattered(3, 0.06, n=600)
    found = with_relief(wall(), LINE, MIRRORED, *many)
    monkeypatch.setattr(relief, "_MOST_POINTS", 600)
    whole = with_relief(wall(), LINE, MIRRORED, *many)
    np.testing.assert_allclose(found.contour_m, whole.contour_m, atol=0.008)
    np.testing.assert_allclose(found.std_m, whole.std_m, rtol=0.4)


def test_other_walls_lie_in_their_own_direction() -> None:
    """A wall turned by 90 deg has the same relief along its own normal."""
    turned = LINE._replace(parameter=np.array([np.pi / 2, LINE.parameter[1]]))
    shape = scattering_wall(turned.parameter, turned.covariance, np.array([0.0, 8.0]), np.full(2, 1e-4))
    seen = scattered(1, 0.06)
    found = with_relief(shape, turned, MIRRORED, *seen)
    first = with_relief(wall(), LINE, MIRRORED, *seen)
    np.testing.assert_allclose(found.contour_m @ turned.normal, first.contour_m @ LINE.normal, atol=1e-9)


def test_a_curve_between_two_groups_of_points_is_no_face() -> None:
    """Six points on either side of a gap of 3 m: the curve is known beside them, and not between."""
    rng = np.random.default_rng(5)
    place = np.concatenate([np.linspace(0.0, 1.0, 6), np.linspace(4.0, 5.0, 6)])
    depth = 0.3 * np.sin(place) + 0.01 * rng.standard_normal(12)
    bend = fit_bend(place, depth, np.full(12, 1e-4), 0.2)
    parts = known_parts(bend, np.array([[0.0, 5.0]]))
    assert len(parts) == 2
    assert parts[0, 0] == 0.0 and 1.0 <= parts[0, 1] < 2.5 < parts[1, 0] <= 4.0 and parts[1, 1] == 5.0
    np.testing.assert_array_equal(known_parts(bend, np.array([[0.2, 0.8]])), [[0.2, 0.8]])
    unknown = bend._replace(variance_m2=np.ones_like(bend.variance_m2))
    np.testing.assert_array_equal(known_parts(unknown, np.array([[0.0, 5.0]])), [[0.0, 5.0]])
