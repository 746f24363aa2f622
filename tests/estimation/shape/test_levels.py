"""Floor and ceiling are told by heights that agree, apart from those of the devices."""

import numpy as np

from estimation.shape.reflection.levels import is_level
from estimation.slam.record import IncidencePoints

DEVICES_M = (1.2, 2.0)


def points_at(height_m: np.ndarray, std_m: float = 0.05) -> IncidencePoints:
    n = len(height_m)
    covariance = np.zeros((n, 3))
    covariance[:, 2] = np.where(np.isfinite(height_m), std_m**2, np.nan)
    return IncidencePoints(
        stop=np.zeros(n, int),
        path=np.arange(n),
        position_m=np.zeros((n, 2)),
        covariance_m2=np.tile(np.eye(2), (n, 1, 1)),
        cost=np.zeros(n),
        is_inlier=np.ones(n, bool),
        height_m=height_m,
        height_covariance_m2=covariance,
    )


def test_floor_and_ceiling_are_the_heights_of_many_points() -> None:
    rng = np.random.default_rng(0)
    walls = rng.uniform(0.3, 3.7, 40)
    floor, ceiling = 0.05 * rng.standard_normal(20), 4.0 + 0.05 * rng.standard_normal(15)
    level = is_level(points_at(np.concatenate([walls, floor, ceiling])), DEVICES_M)
    assert level[40:].mean() > 0.95
    assert level[:40].mean() < 0.1


def test_walls_alone_have_no_level() -> None:
    assert not is_level(points_at(np.random.default_rng(1).uniform(-0.2, 4.2, 40)), DEVICES_M).any()


def test_mirrors_at_the_heights_of_the_devices_are_upright() -> None:
    height = np.random.default_rng(2).uniform(1.1, 2.1, 50)
    assert not is_level(points_at(height, 0.02), DEVICES_M).any()
    assert not is_level(points_at(np.full(30, 2.05), 0.02), DEVICES_M).any()


def test_points_of_the_plane_are_upright() -> None:
    assert not is_level(points_at(np.full(10, np.nan)), DEVICES_M).any()
    assert len(is_level(points_at(np.zeros(0)), DEVICES_M)) == 0
