"""Support functions and specular points against geometry, brute force and differences."""

import numpy as np
import pytest

from estimation.laws.contour import EDGE, WALL, predict_reflection
from estimation.laws.support import (
    CIRCLE,
    ELLIPSE,
    HARMONICS,
    ROUNDED_SQUARE,
    contour_points,
    normal_std_m,
    support,
)

CASES = {
    "circle": (CIRCLE, [1.0, -4.0, np.log(0.4)]),
    "ellipse": (ELLIPSE, [1.0, -4.0, np.log(0.4), 0.5, -0.3]),
    "nearly_circle": (ELLIPSE, [1.0, -4.0, np.log(0.4), 1e-5, 2e-5]),
    "rounded_square": (ROUNDED_SQUARE, [1.0, -4.0, np.log(0.4), 0.2, 0.3]),
    "harmonics": (HARMONICS, [1.0, -4.0, np.log(0.4), 0.05, -0.04, 0.02, 0.01]),
    "edge": (EDGE, [1.0, -4.0]),
    "wall": (WALL, [1.2, -4.0]),
}
CLOSED = [name for name in CASES if name not in ("edge", "wall")]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def devices(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    tx = np.tile([2.25, 2.5, -1.6], (n, 1))
    rx = np.column_stack(
        [rng.uniform(-5, 6, n), rng.uniform(-2.5, 0, n), rng.uniform(-3, 3, n), rng.uniform(0, 10, n)]
    )
    return tx, rx


@pytest.mark.parametrize("name", CLOSED)
def test_derivatives_of_the_support_function(name: str) -> None:
    family, parameter = CASES[name][0], np.array(CASES[name][1])
    psi, step = np.linspace(-3, 3, 41), 1e-6
    value, slope = support(family, parameter, psi)
    ahead, behind = support(family, parameter, psi + step)[0], support(family, parameter, psi - step)[0]
    np.testing.assert_allclose((ahead - behind)[:, :2] / (2 * step), value[:, 1:], atol=2e-7)
    for j in range(2, len(parameter)):
        turn = step * np.eye(len(parameter))[j]
        difference = support(family, parameter + turn, psi)[0] - support(family, parameter - turn, psi)[0]
        np.testing.assert_allclose(difference[:, :2] / (2 * step), slope[:, :, j], atol=2e-7)


def test_ellipse_has_the_half_axes_of_its_parameters() -> None:
    a, b, azimuth = 0.7, 0.4, 0.6
    ratio = np.log(a / b)
    parameter = np.array([2, 1, np.log(np.sqrt(a * b)), ratio * np.cos(2 * azimuth), ratio * np.sin(2 * azimuth)])
    x, y = (contour_points(ELLIPSE, parameter, np.linspace(0, 6, 50)) - [2, 1]).T
    along, across = x * np.cos(azimuth) + y * np.sin(azimuth), y * np.cos(azimuth) - x * np.sin(azimuth)
    np.testing.assert_allclose((along / a) ** 2 + (across / b) ** 2, 1.0, atol=1e-12)


def test_rounded_square_is_close_to_the_exact_one() -> None:
    half, share, turn = 0.5, 0.4, 0.3
    parameter = np.array([0.0, 0.0, np.log(half), np.log(share / (1 - share)), turn])
    x, y = contour_points(ROUNDED_SQUARE, parameter, np.linspace(0, 2 * np.pi, 400)).T
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    inner = half * (1 - share)
    outside = np.hypot(np.maximum(np.abs(u) - inner, 0), np.maximum(np.abs(v) - inner, 0))
    # Each bent face adds at most eps = 0.03 of the straight half length to the support.
    assert np.all(np.abs(outside - half * share) <= 0.035 * inner)


@pytest.mark.parametrize("name", CLOSED)
def test_specular_point_gives_the_shortest_path(name: str, rng: np.random.Generator) -> None:
    family, parameter = CASES[name][0], np.array(CASES[name][1])
    tx, rx = devices(rng, 20)
    paths = predict_reflection(family, parameter, tx, rx)
    outline = contour_points(family, parameter, np.linspace(0, 2 * np.pi, 20001))
    to_tx = np.linalg.norm(outline[None] - tx[:, None, :2], axis=-1)
    to_rx = np.linalg.norm(outline[None] - rx[:, None, :2], axis=-1)
    shortest = (to_tx + to_rx).min(axis=1)
    assert paths.is_lit.all()
    np.testing.assert_allclose(paths.measured[:, 0] - rx[:, 3], shortest, atol=1e-6)


def test_wall_is_the_mirror_image_of_the_tx(rng: np.random.Generator) -> None:
    tx, rx = devices(rng, 10)
    paths = predict_reflection(WALL, np.array([np.pi / 2, -6.0]), tx, rx)
    image = np.column_stack([tx[:, 0], -12.0 - tx[:, 1]])
    np.testing.assert_allclose(
        paths.measured[:, 0], np.linalg.norm(image - rx[:, :2], axis=1) + rx[:, 3], atol=1e-12
    )
    arrival = np.arctan2(*(image - rx[:, :2]).T[::-1])
    np.testing.assert_allclose(np.cos(paths.measured[:, 2] + rx[:, 2] - arrival), 1.0, atol=1e-12)
    np.testing.assert_allclose(paths.point_m[:, 1], -6.0, atol=1e-12)


@pytest.mark.parametrize("name", CASES)
def test_jacobians_against_differences(name: str, rng: np.random.Generator) -> None:
    family, parameter = CASES[name][0], np.array(CASES[name][1])
    tx, rx = devices(rng, 12)
    paths = predict_reflection(family, parameter, tx, rx)
    np.testing.assert_allclose(
        difference(lambda v: predict_reflection(family, v, tx, rx).measured, parameter),
        paths.by_parameter,
        atol=1e-7,
    )
    by_rx = difference(lambda v: predict_reflection(family, parameter, tx, rx + v).measured, np.zeros(4))
    np.testing.assert_allclose(by_rx, paths.by_rx, atol=1e-7)


def difference(function, at: np.ndarray) -> np.ndarray:
    """Central differences of fourth order, the last axis over the parameters."""
    step = 2e-4
    columns = []
    for unit in np.eye(len(at)):
        one, two = (function(at + k * step * unit) - function(at - k * step * unit) for k in (1, 2))
        columns.append((8 * one - two) / (12 * step))
    return np.stack(columns, axis=-1)


def test_band_is_the_spread_of_sampled_contours(rng: np.random.Generator) -> None:
    family, parameter = CASES["ellipse"][0], np.array(CASES["ellipse"][1])
    root = 1e-3 * rng.standard_normal((5, 5))
    covariance = root @ root.T
    psi = np.linspace(0, 6, 7)
    draws = rng.multivariate_normal(parameter, covariance, 4000)
    normal = np.stack([np.cos(psi), np.sin(psi)], axis=-1)
    distance = np.array([support(family, draw, psi)[0][:, 0] + normal @ draw[:2] for draw in draws])
    np.testing.assert_allclose(normal_std_m(family, parameter, covariance, psi), distance.std(axis=0), rtol=0.06)
