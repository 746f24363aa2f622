"""Points with normals, mirror walls, edges, and the choice among them."""

import numpy as np
import pytest
from scipy.stats import chi2

from estimation.laws.plane import lit_normals
from estimation.laws.wall import wall_places
from estimation.shape.config import ReflectionConfig
from estimation.shape.kinds.fit import fit_kind
from estimation.shape.reflection.choice import choose_shape
from estimation.shape.reflection.normals import fit_normals, oriented_points
from isac_arena.validation.scenarios.reflections import (
    TX,
    Errors,
    closed_paths,
    edge_paths,
    lit_wall,
    observe,
    wall_paths,
)
from isac_arena.validation.shape.law import check_reflection_information
from scenes.contours.smooth import Circle
from scenes.record import concatenate

SURE = ReflectionConfig(delay_offset_std_ns=0.0, aod_offset_std_deg=0.0, aoa_offset_std_deg=0.0)
PILLAR = Circle(np.array([1.0, -5.0]), 0.4)
WALL_ENDS = np.array([[-8.0, -8.0], [9.0, -7.0]])
EDGE = np.array([1.5, -7.0])


def test_normals_turn_as_their_slope_says() -> None:
    rng = np.random.default_rng(3)
    point, rx, step = rng.uniform(-8, -6, (9, 2)), rng.uniform(-3, 3, (9, 2)), 1e-6
    tx = np.tile(TX[:2], (9, 1))
    _, slope = lit_normals(point, tx, rx)
    for axis, unit in enumerate(np.eye(2)):
        turn = lit_normals(point + step * unit, tx, rx)[0] - lit_normals(point - step * unit, tx, rx)[0]
        np.testing.assert_allclose(turn / (2 * step), slope[:, axis], atol=1e-8)


def test_points_with_normals_lie_on_the_pillar() -> None:
    rng = np.random.default_rng(1)
    true = closed_paths(PILLAR, rng)
    data, _ = observe(true, Errors(0.001), rng)
    points = oriented_points(data)
    outward = np.column_stack([np.cos(points.normal_rad), np.sin(points.normal_rad)])
    np.testing.assert_allclose(points.position_m, true.point_m, atol=2e-3)
    np.testing.assert_allclose(PILLAR.center_m + 0.4 * outward, true.point_m, atol=3e-3)


def test_normals_find_the_circle_and_know_their_error() -> None:
    total, n = 0.0, 40
    for k in range(n):
        rng = np.random.default_rng([2, k])
        fit = fit_normals(observe(closed_paths(PILLAR, rng), Errors(0.2), rng)[0], SURE)
        error = fit.parameter - [*PILLAR.center_m, PILLAR.radius_m]
        total += error @ np.linalg.solve(fit.parameter_covariance, error)
    # Student weights cost a little of the information they claim.
    assert chi2.ppf(0.001, 3 * n) < total < 1.35 * chi2.ppf(0.999, 3 * n)


def test_direct_and_oriented_points_carry_the_same_information() -> None:
    assert all(row.met for row in check_reflection_information(3, quick=True))


def test_places_along_a_wall_move_as_their_slopes_say() -> None:
    rng = np.random.default_rng(3)
    rx, wall, step = rng.uniform(-3, 3, (9, 2)), np.array([1.4, -7.0]), 1e-6
    tx = np.tile(TX[:2], (9, 1))
    _, slope, by_rx = wall_places(wall, tx, rx)
    for axis, unit in enumerate(np.eye(2)):
        by_wall = wall_places(wall + step * unit, tx, rx)[0] - wall_places(wall - step * unit, tx, rx)[0]
        by_place = wall_places(wall, tx, rx + step * unit)[0] - wall_places(wall, tx, rx - step * unit)[0]
        np.testing.assert_allclose(by_wall / (2 * step), slope[:, axis], atol=1e-7)
        np.testing.assert_allclose(by_place / (2 * step), by_rx[:, axis], atol=1e-7)


def test_wall_line_and_ends_know_their_errors() -> None:
    line, ends, n = 0.0, 0.0, 60
    for k in range(n):
        rng = np.random.default_rng([4, k])
        corners, true = lit_wall(rng)
        fit = fit_kind(observe(true, Errors(0.5), rng)[0], "wall", SURE)
        along = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
        normal = np.array([-along[1], along[0]])
        normal *= np.sign(normal @ [np.cos(fit.parameter[0]), np.sin(fit.parameter[0])])
        turn = np.arctan2(normal[1], normal[0]) - fit.parameter[0]
        error = np.array([(turn + np.pi) % (2 * np.pi) - np.pi, normal @ corners[0] - fit.parameter[1]])
        line += error @ np.linalg.solve(fit.parameter_covariance[:2, :2], error)
        place = true.point_m @ np.array([-normal[1], normal[0]])
        ends += (place.min() - fit.parameter[2]) ** 2 / fit.parameter_covariance[2, 2]
    assert chi2.ppf(0.001, 2 * n) < line < chi2.ppf(0.999, 2 * n)
    assert chi2.ppf(0.001, n) < ends < chi2.ppf(0.999, n)


def test_wall_is_not_the_mean_of_two_objects() -> None:
    """A third of the paths comes from a jamb: the wall keeps its own direction."""
    rng = np.random.default_rng(6)
    wall, _ = observe(wall_paths(WALL_ENDS, rng), Errors(0.3), rng)
    jamb, _ = observe(edge_paths(EDGE, rng), Errors(0.3), rng)
    joined = concatenate([wall, jamb.take("path", slice(0, 12))], "path")
    fit = fit_kind(joined, "wall", SURE)
    slope = np.arctan2(*(WALL_ENDS[1] - WALL_ENDS[0])[::-1]) + np.pi / 2
    assert abs(np.rad2deg(fit.parameter[0] - slope)) < 0.3


@pytest.mark.parametrize(("name", "kind"), [("pillar", "circle"), ("wall", "wall"), ("edge", "edge")])
def test_evidence_names_the_class(name: str, kind: str) -> None:
    rng = np.random.default_rng(8)
    true = {
        "pillar": lambda: closed_paths(PILLAR, rng),
        "wall": lambda: wall_paths(WALL_ENDS, rng),
        "edge": lambda: edge_paths(EDGE, rng),
    }[name]()
    choice = choose_shape(observe(true, Errors(0.5), rng)[0], SURE)
    assert choice.best_class == name
    assert choice.best.kind == kind
    assert choice.class_probability[name] > 0.95
    assert sum(choice.probability.values()) == pytest.approx(1.0)


def test_edge_point_is_found_with_its_error() -> None:
    total, n = 0.0, 40
    for k in range(n):
        rng = np.random.default_rng([9, k])
        fit = fit_kind(observe(edge_paths(EDGE, rng), Errors(0.5), rng)[0], "edge", SURE)
        error = fit.parameter - EDGE
        total += error @ np.linalg.solve(fit.parameter_covariance, error)
    assert chi2.ppf(0.001, 2 * n) < total < chi2.ppf(0.999, 2 * n)


def test_no_paths_are_a_status_or_a_clear_error() -> None:
    rng = np.random.default_rng(8)
    none = observe(closed_paths(PILLAR, rng), Errors(0.5), rng)[0].take("path", [])
    assert fit_kind(none, "wall", SURE).status == "failed: no paths"
    assert fit_kind(none, "edge", SURE).status == "failed: no paths"
    assert fit_normals(none, SURE).status == "failed: no paths"
    with pytest.raises(ValueError, match="0 paths"):
        choose_shape(none, SURE)
