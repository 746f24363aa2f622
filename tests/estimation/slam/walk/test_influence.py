"""The influence of a path, against fits without it."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.plane import predict_los
from estimation.laws.wall import predict_walls
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.influence import shifts_without, widened
from estimation.slam.record import SolveStatus
from estimation.slam.stops import locate_and_map
from estimation.slam.walk.motion import course_of
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from estimation.slam.walk.smoother import minimise_robust_cost
from isac_arena.validation.scenarios.halls import ScenarioConfig, draw_walk
from isac_arena.validation.scenarios.stops import observe_stop
from isac_arena.validation.slam.trials import NOISE
from scenes.pose import Pose

TX = Pose(np.array([0.0, 0.0, 1.5]), 0.2)
WALLS = np.array([[0.0, 12.0], [1.4, 9.0]])
STD = np.array([3e-3, 3e-4, 3e-4])
GAUSSIAN = TrajectoryConfig(degrees_of_freedom=10**6, wall_roughness_m=0.0)


def seen_walk(kinds: list[PathClass]) -> tuple[Observations, Association, TrajectoryState]:
    """A walk of six stops with the same kinds of paths at each, bounces off walls, and its solution."""
    rng = np.random.default_rng(7)
    n = 6
    state = np.column_stack([np.linspace(3, 8, n), np.linspace(1, 0, n), np.full(n, 0.4), np.full(n, 5.0)])
    marks = [-1 if kind == PathClass.LOS else k % 2 for k, kind in enumerate(kinds)]
    measured = []
    for one in state:
        for kind, mark in zip(kinds, marks, strict=True):
            path = predict_los(TX, one) if kind == PathClass.LOS else predict_walls(TX, one, WALLS[[mark]]).value
            measured.append(path + STD * rng.normal(size=3))
    row = np.repeat(np.arange(n), len(kinds))
    covariance = np.tile(np.diag(STD**2), (len(row), 1, 1))
    seen = Observations(TX, n, row, np.array(measured), covariance, np.zeros((3, 3)))
    landmark = np.column_stack(
        [np.where(np.tile(kinds, n) == PathClass.WALL, np.tile(marks, n), -1), np.full(len(row), -1)]
    )
    link = Association(np.tile(kinds, n).astype(np.int64), landmark)
    none = np.empty((0, 3))
    start = TrajectoryState(state, np.zeros(1), WALLS, none, np.zeros(n, np.int64), 0, course_of(state))
    return seen, link, minimise_robust_cost(seen, link, start, GAUSSIAN, 60)


@pytest.mark.parametrize(
    "kinds",
    [
        [PathClass.LOS, PathClass.WALL, PathClass.WALL],
        [PathClass.LOS, PathClass.WALL, PathClass.WALL, PathClass.BOUNCE, PathClass.UNUSED],
    ],
)
def test_the_closed_form_is_a_fit_without_the_path(kinds):
    seen, link, now = seen_walk(kinds)
    shift = shifts_without(seen, link, now, GAUSSIAN)
    for path, kind in enumerate(link.kind):
        if kind == PathClass.UNUSED:
            assert np.isnan(shift[path]).all()
            continue
        without = link.kind.copy()
        without[path] = PathClass.UNUSED
        other = minimise_robust_cost(seen, replace(link, kind=without), now, GAUSSIAN, 60)
        moved = (other.state - now.state)[seen.row[path]]
        np.testing.assert_allclose(shift[path], moved, rtol=0.03, atol=5e-5)


def test_covariances_are_at_least_those_of_the_jackknife():
    rng = np.random.default_rng(2)
    factor = rng.normal(size=(3, 4, 4))
    covariance = factor @ np.swapaxes(factor, 1, 2)
    shift, row = rng.normal(size=(8, 4)) * [3.0, 0.1, 1.0, 1.0], np.array([0, 0, 0, 1, 1, 1, 1, 1])
    shift[7] = np.nan
    wide = widened(covariance, shift, row)
    for stop in range(3):
        own = shift[:7][row[:7] == stop]
        assert np.linalg.eigvalsh(wide[stop] - covariance[stop]).min() > -1e-9
        assert np.linalg.eigvalsh(wide[stop] - own.T @ own).min() > -1e-9
    np.testing.assert_array_equal(wide[2], covariance[2])


def estimates_of_walk(n_stops: int = 8):
    rng = np.random.default_rng(3)
    config = ScenarioConfig(n_paths=8, n_pillars=4, delay_std_ns=0.1, angle_std_deg=0.1)
    walk = draw_walk(rng, config, n_stops)
    return [
        observe_stop(rng, config, walk.hall, state, k).estimate for k, state in enumerate(walk.state)
    ], walk.hall.tx


@pytest.mark.parametrize("trajectory", [None, TrajectoryConfig()])
def test_every_stop_names_its_most_influential_path(trajectory):
    estimates, tx = estimates_of_walk()
    poses, points = locate_and_map(estimates, tx, SnapshotConfig(noise=NOISE), trajectory, MappingConfig())
    for k, estimate in enumerate(estimates):
        if poses.status[k] == SolveStatus.FAILED:
            continue
        assert 0 <= poses.most_influential_path[k] < len(estimate)
        own = points.stop == poses.stop[k]
        assert np.nanmax(points.influence_m[own]) <= poses.path_influence_m[k]
        named = points.influence_m[own & (points.path == poses.most_influential_path[k])]
        assert (named == poses.path_influence_m[k]).all()  # empty where it is the line of sight
    assert (poses.status != SolveStatus.FAILED).sum() >= 6


def test_the_published_algorithm_tells_no_influence():
    estimates, tx = estimates_of_walk(2)
    poses, points = locate_and_map(estimates, tx, SnapshotConfig(method="reference"), None, MappingConfig())
    assert (poses.most_influential_path == -1).all()
    assert np.isnan(points.influence_m).all()
