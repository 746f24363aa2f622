"""Random walks keep their distance, their step and their seed."""

import numpy as np
import pytest

from scenes.contours import Circle, OpenSpline, rectangle
from scenes.walks.random_walk import random_walk

OBSTACLES = [
    Circle((3, 3), 0.8),
    rectangle((5.0, 6.0), (1.0, 5.0)),
    OpenSpline([(1, 6), (2, 6.5), (4, 6.2), (5, 7)]),
]
SETTINGS = {"area_m": (0.0, 0.0, 8.0, 8.0), "n_stops": 60, "step_m": 0.5, "height_m": 1.4}


@pytest.mark.parametrize("seed", range(12))
def test_all_of_the_walk_is_clear(seed):
    walk = random_walk(np.random.default_rng(seed), OBSTACLES, clearance_m=0.35, **SETTINGS)
    points = walk.waypoints_m
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 0.5)
    assert len(walk.poses()) == 60 and (walk.positions_m()[:, 2] == 1.4).all()
    share = np.linspace(0, 1, 26)[:, None, None]
    dense = (points[:-1] + share * np.diff(points, axis=0)).reshape(-1, 2)
    assert dense.min() >= 0.35 and dense.max() <= 7.65
    for contour in OBSTACLES:
        assert contour.signed_distance(dense).min() >= 0.35


def test_seed_and_start():
    walks = [
        random_walk(np.random.default_rng(5), OBSTACLES, clearance_m=0.3, start_m=(1.0, 1.0), **SETTINGS)
        for _ in range(2)
    ]
    assert walks[0].waypoints_m.tobytes() == walks[1].waypoints_m.tobytes()
    np.testing.assert_array_equal(walks[0].waypoints_m[0], (1, 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start_m": (3, 3)}, r"start_m = \[3\.0, 3\.0\]: must lie clearance_m = 0\.3 away"),
        ({"clearance_m": 5.0}, r"clearance_m = 5\.0: no place of the area"),
        ({"step_m": 20.0}, r"step_m = 20\.0: there is no clear step"),
    ],
)
def test_impossible_walks(change, message):
    with pytest.raises(ValueError, match=message):
        random_walk(np.random.default_rng(0), OBSTACLES, **({"clearance_m": 0.3} | SETTINGS | change))
