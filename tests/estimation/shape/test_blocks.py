"""Square columns from points on their faces: the density of points, and what is told from what."""

import numpy as np
import pytest

from estimation.shape.config import ContourConfig, ReflectionConfig
from estimation.shape.fit import FoundContour, ShapeFit
from estimation.shape.reflection.blocks.find import column_shape, with_columns
from estimation.shape.reflection.blocks.fit import block_models, fit_block
from estimation.shape.reflection.blocks.law import SeenPoints, log_block, log_spot
from estimation.shape.reflection.normals import OrientedPoints
from estimation.shape.reflection.reflections import Reflections
from isac_arena.scoring.metrics.contours import intersection_over_union

CONFIG = ReflectionConfig()
CENTER, HALF_M, TURN_RAD = np.array([4.0, 3.0]), 0.4, 0.5
AXES = np.array([[np.cos(TURN_RAD), np.sin(TURN_RAD)], [-np.sin(TURN_RAD), np.cos(TURN_RAD)]])
TX_M, RX_M = CENTER + [9.0, 3.0] @ AXES, CENTER + [4.0, 7.0] @ AXES  # both see the faces along +u and +v


def points_on(places: np.ndarray, std_m: float, seed: int) -> SeenPoints:
    """Points with errors at places (point, uv) in the frame of the column."""
    rng, n = np.random.default_rng(seed), len(places)
    position = CENTER + places @ AXES + std_m * rng.standard_normal((n, 2))
    covariance = np.tile(std_m**2 * np.eye(2), (n, 1, 1))
    return SeenPoints(position, covariance, np.tile(TX_M, (n, 1)), np.tile(RX_M, (n, 1)))


def faces(width: float, depth: float, n: int, seed: int = 1) -> np.ndarray:
    """Places on the two seen faces of a block with these half sides."""
    along = np.random.default_rng(seed).uniform(-1, 1, n)
    front = np.column_stack([np.full(n // 2, width), depth * along[: n // 2]])
    return np.concatenate([front, np.column_stack([width * along[n // 2 :], np.full(n - n // 2, depth)])])


def test_density_of_a_block_is_that_of_its_two_seen_faces() -> None:
    """It integrates to 1, and equals the sum over the places on the faces, added up by hand."""
    block, std_m, step = np.array([[*CENTER, 0.4, 0.7, TURN_RAD]]), 0.05, 0.02
    grid = np.stack(np.meshgrid(np.arange(2.5, 5.5, step), np.arange(1.5, 4.5, step)), axis=-1).reshape(-1, 2)
    n = len(grid)
    covariance = np.array([[std_m**2, 0.6 * std_m**2], [0.6 * std_m**2, 2 * std_m**2]])
    seen = SeenPoints(grid, np.tile(covariance, (n, 1, 1)), np.tile(TX_M, (n, 1)), np.tile(RX_M, (n, 1)))
    density = np.exp(log_block(block, seen, 0.0)[0])
    assert density.sum() * step**2 == pytest.approx(1.0, abs=1e-3)
    along = (np.arange(2000) + 0.5) / 1000 - 1
    on_faces = [
        np.column_stack([np.full(2000, 0.4), 0.7 * along]),
        np.column_stack([0.4 * along, np.full(2000, 0.7)]),
    ]
    chosen = np.argsort(-density)[::97][:40]
    away = grid[chosen, None, None] - (CENTER + np.array(on_faces) @ AXES)
    square = np.einsum("nfka,ab,nfkb->nfk", away, np.linalg.inv(covariance), away)
    by_face = np.exp(-0.5 * square).mean(axis=2) / (2 * np.pi * np.sqrt(np.linalg.det(covariance)))
    np.testing.assert_allclose(density[chosen], (1.4 * by_face[:, 0] + 0.8 * by_face[:, 1]) / 2.2, rtol=2e-3)


def test_no_face_is_seen_from_inside_or_through_the_block() -> None:
    points = points_on(faces(HALF_M, HALF_M, 6), 0.01, 2)
    inside = points._replace(rx_m=np.tile(CENTER, (6, 1)))
    behind = points._replace(rx_m=np.tile(CENTER - [5.0, 5.0] @ AXES, (6, 1)))
    for unseen in (inside, behind):
        assert np.all(np.isneginf(log_block(np.array([[*CENTER, HALF_M, HALF_M, TURN_RAD]]), unseen, 0.03)))


def test_spot_is_a_normal_density() -> None:
    points = points_on(np.array([[0.1, 0.0], [0.0, 0.3]]), 0.1, 3)
    spread = 0.1**2 + 0.2**2
    away = points.position_m - CENTER
    expected = -0.5 * np.sum(away**2, axis=1) / spread - np.log(2 * np.pi * spread)
    np.testing.assert_allclose(log_spot(np.array([[*CENTER, 0.2]]), points)[0], expected)


def evidence(points: SeenPoints) -> dict[str, float]:
    fits = {name: fit_block(model, points, CONFIG) for name, model in block_models(CONFIG).items()}
    return {name: fit.log_evidence for name, fit in fits.items() if fit is not None}


def test_two_faces_tell_a_column_and_its_errors() -> None:
    points = points_on(faces(HALF_M, HALF_M, 40), 0.03, 4)
    fit = fit_block(block_models(CONFIG)["column"], points, CONFIG)
    assert fit is not None
    found = evidence(points)
    assert max(found, key=found.__getitem__) == "column"
    turn = (fit.value[3] - TURN_RAD + np.pi / 4) % (np.pi / 2) - np.pi / 4
    error = np.array([*(fit.value[:2] - CENTER), fit.value[2] - np.log(HALF_M), turn])
    assert error @ np.linalg.solve(fit.covariance, error) < 18.5  # chi-square of 4 at 0.999
    corners = CENTER + HALF_M * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ AXES
    shape = column_shape(fit, CONFIG)
    assert intersection_over_union(shape.contour_m, corners) > 0.9
    assert shape.extent_m == pytest.approx(HALF_M, rel=0.1) and (shape.std_m >= CONFIG.wall_relief_m).all()


@pytest.mark.parametrize(
    ("places", "name"),
    [
        (faces(0.35, 0.9, 40), "box"),
        (np.column_stack([np.full(40, HALF_M), np.random.default_rng(5).uniform(-1.5, 1.5, 40)]), "plate"),
        (0.02 * np.random.default_rng(6).standard_normal((40, 2)), "spot"),
    ],
)
def test_what_is_no_column_is_told_from_it(places: np.ndarray, name: str) -> None:
    found = evidence(points_on(places, 0.03, 7))
    assert found[name] > found.get("column", -np.inf)


def edge_at(place_m: np.ndarray) -> ShapeFit:
    at, none = np.tile(place_m, (5, 1)), np.zeros(0)
    own = {"parameter": none, "parameter_covariance": np.zeros((0, 0)), "parameter_name": none.astype(str)}
    return ShapeFit("edge", "ok", False, at, np.full(5, 0.01), 0.0, **own, extent_m=0.0, extent_std_m=0.0)


def test_a_column_takes_the_place_of_its_edges_alone() -> None:
    own, far = points_on(faces(HALF_M, HALF_M, 40), 0.03, 8), np.array([[8.0, -3.0]] * 6)
    position = np.concatenate([own.position_m, far + 0.01 * np.random.default_rng(9).standard_normal((6, 2))])
    n = len(position)
    points = OrientedPoints(position, np.tile(0.03**2 * np.eye(2), (n, 1, 1)), np.zeros(n), np.zeros((n, 2)))
    data = Reflections(
        measured=np.ones((n, 3)),
        covariance=np.tile(np.eye(3), (n, 1, 1)),
        tx=np.tile([*TX_M, 0.0], (n, 1)),
        rx_state=np.tile([*RX_M, 0.0, 0.0], (n, 1)),
        rx_covariance=np.zeros((n, 4, 4)),
        session=np.zeros(n, int),
        stop=np.arange(n),
    )
    corner, other = (
        FoundContour(edge_at(own.position_m[0]), np.arange(4), [0, 1, 0]),
        FoundContour(edge_at(far[0]), np.arange(40, 46), [0, 1, 0]),
    )
    found = with_columns([corner, other], points, data, ContourConfig())
    assert [shape.kind for shape, _, _ in found] == ["edge", "square"]
    _, rows, (wall, edge, pillar) = found[1]
    assert found[0].rows[0] == 40 and len(rows) > 30 and rows.max() < 40
    assert pillar > 0.75 and wall + edge + pillar == pytest.approx(1.0)
