"""Scattering places of a rough wall are parts of the wall, other objects near it are not."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.stats import multivariate_normal

from estimation.laws.plane import bounce, residual
from estimation.shape.reflection import patches
from estimation.shape.reflection.choice import Choice, choose_shape
from estimation.shape.reflection.patches import WallLine, along_wall, wall_patches
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from isac_arena.validation.scenarios.reflections import Errors, TruePaths, edge_paths, observe, wall_paths
from scenes.record import concatenate

SURE = ReflectionConfig(delay_offset_std_ns=0.0, aod_offset_std_deg=0.0, aoa_offset_std_deg=0.0)
WALL_ENDS = np.array([[-8.0, -6.0], [9.0, -6.0]])


def seen(true: TruePaths, seed: int, n: int) -> Reflections:
    data, _ = observe(true, Errors(0.5), np.random.default_rng(seed))
    return data.take("path", np.linspace(0, len(data) - 1, min(n, len(data))).astype(int))


def scattered(places_m: np.ndarray, offset_m: float) -> Reflections:
    """One path by way of each place along the wall, that far in front of it, from places along the walk."""
    rng = np.random.default_rng(9)
    parts = [
        seen(edge_paths(np.array([x, -6.0 + offset_m]), rng), 20 + k, len(places_m))
        for k, x in enumerate(places_m)
    ]
    return concatenate([part.take("path", [min(k, len(part) - 1)]) for k, part in enumerate(parts)], "path")


def wall() -> Choice:
    return choose_shape(seen(wall_paths(WALL_ENDS, np.random.default_rng(2)), 3, 20), SURE)


def test_point_on_the_line_of_a_wall_is_a_patch_and_one_before_it_is_not() -> None:
    parts = [seen(wall_paths(WALL_ENDS, np.random.default_rng(2)), 3, 20)]
    for at in ([6.0, -6.02], [2.0, -5.5]):
        parts.append(seen(edge_paths(np.array(at), np.random.default_rng(4)), 5, 12))
    choices = [choose_shape(part, SURE) for part in parts]
    assert choices[0].best.kind == "wall"
    found = wall_patches(choices, parts, SURE)
    assert list(found) == [1]
    assert found[1].best_class == "wall"
    assert sum(found[1].class_probability.values()) == pytest.approx(1.0)


def test_places_along_a_wall_are_a_patch_and_the_same_before_it_are_not() -> None:
    places = np.linspace(3.0, 3.8, 9)
    for offset, expected in ((0.0, [1]), (0.6, [])):
        parts = [seen(wall_paths(WALL_ENDS, np.random.default_rng(2)), 3, 20), scattered(places, offset)]
        choices = [choose_shape(part, SURE) for part in parts]
        assert list(wall_patches(choices, parts, SURE)) == expected


def test_no_wall_has_no_patches() -> None:
    part = seen(edge_paths(np.array([1.0, -6.0]), np.random.default_rng(4)), 5, 12)
    assert wall_patches([choose_shape(part, SURE)], [part], SURE) == {}


def test_evidence_along_a_wall_is_the_integral_over_the_places(monkeypatch: pytest.MonkeyPatch) -> None:
    data, spread, line = scattered(np.array([2.0, 2.3, 2.7]), 0.01), 0.2, WallLine(wall().best)
    monkeypatch.setattr(patches, "_SPREADS_M", (spread,))
    offset = line.shape.parameter[1]

    def density(place_m: float, path: int) -> float:
        predicted = bounce(data.tx[path], data.rx_state[path], offset * line.normal + place_m * line.tangent)
        across = predicted.by_landmark @ line.normal
        covariance = data.covariance[path] + predicted.by_state @ data.rx_covariance[path] @ predicted.by_state.T
        covariance += line.variance_m2(np.array(place_m), SURE.wall_relief_m) * np.outer(across, across)
        error = residual(data.measured[path], predicted.value)
        return float(multivariate_normal(np.zeros(3), covariance).pdf(error))

    foot = (data.rx_state[:, :2].mean(axis=0)) @ line.tangent
    places = np.linspace(foot - 12, foot + 12, 24_001)
    likely = np.array([[density(place, path) for place in places[::4]] for path in range(3)])

    def integrand(middle: float) -> float:
        normal = np.exp(-0.5 * ((places[::4] - middle) / spread) ** 2) / np.sqrt(2 * np.pi) / spread
        of_paths = (likely * normal).sum(axis=1) * (places[4] - places[0])
        return float(np.exp(line.log_density(np.array(middle))) * of_paths.prod())

    best = float(places[::4][likely.sum(axis=0).argmax()])
    whole, _ = quad_vec(integrand, best - 3, best + 3, epsrel=1e-4)
    expected = np.log(whole) + 3 * SURE.log_path_share
    assert along_wall(line, data, SURE) == pytest.approx(expected, abs=0.1)
