"""The noise of mapping is learned: floors fall where covariances are right, and stay where they are too small."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from estimation.slam.config import MappingConfig, PathNoise
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.mapping.noise import with_learned_noise
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.space.mapping import map_stops_spatial
from isac_arena.validation.scenarios.estimates import made_poses
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import Scenario, draw_trajectory
from scenes.pose import SPEED_OF_LIGHT_M_S

CONFIG = MappingConfig()  # floors of 0.1 ns and 0.2 deg
SHARP = ScenarioConfig(n_paths=16, outlier_share=0.5, delay_std_ns=0.002, angle_std_deg=0.004)
BLUNT = replace(SHARP, delay_std_ns=0.3, angle_std_deg=0.6)


def _walk(seed: int, config: ScenarioConfig, said: float = 1.0) -> list[Scenario]:
    """A walk whose covariances say that errors are `said` times what they are."""
    walk = draw_trajectory(np.random.default_rng([seed, 3]), config, 15)
    said_covariance = [said**2 * s.estimate.covariance for s in walk]
    return [
        replace(s, estimate=replace(s.estimate, covariance=covariance, method="coherent"))
        for s, covariance in zip(walk, said_covariance, strict=True)
    ]


def _poses(walk: Sequence[Scenario]) -> PoseEstimates:
    state = np.array([(*s.state[:2], s.state[-2], s.state[-1] / SPEED_OF_LIGHT_M_S) for s in walk])
    poses = made_poses(state)
    return replace(poses, height_m=np.array([s.state[2] for s in walk])) if len(walk[0].state) == 5 else poses


def _inliers(walk: Sequence[Scenario], points: IncidencePoints) -> tuple[float, float]:
    """Shares of single bounces and of other paths that pass as single bounces."""
    single = np.array([walk[stop].is_single[path] for stop, path in zip(points.stop, points.path, strict=True)])
    return float(points.is_inlier[single].mean()), float(points.is_inlier[~single].mean())


@pytest.mark.parametrize("in_space", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_sharp_paths_lower_the_floors_and_tell_single_bounces_from_others(seed: int, in_space: bool) -> None:
    walk = _walk(seed, replace(SHARP, in_space=in_space))
    estimates, poses, tx = [s.estimate for s in walk], _poses(walk), walk[0].tx
    learned = with_learned_noise(estimates, poses, tx, CONFIG, spatial=in_space)
    assert learned.noise == CONFIG.noise.with_floors(0.03)
    points_of = map_stops_spatial if in_space else map_stops
    wide = _inliers(walk, points_of(estimates, poses, tx, CONFIG))
    sharp = _inliers(walk, points_of(estimates, poses, tx, learned))
    assert sharp[0] > 0.95 * wide[0] and sharp[1] <= 0.5 * wide[1]


@pytest.mark.parametrize("seed", range(3))
def test_covariances_that_are_too_small_keep_the_floors(seed: int) -> None:
    walk = _walk(seed, BLUNT, said=0.02)
    learned = with_learned_noise([s.estimate for s in walk], _poses(walk), walk[0].tx, CONFIG, spatial=False)
    assert learned == CONFIG


def test_floors_stay_at_estimated_states_and_for_covariances_of_no_likelihood() -> None:
    walk = _walk(0, SHARP)
    estimates, poses, tx = [s.estimate for s in walk], _poses(walk), walk[0].tx
    by_power = [replace(estimate, method="power") for estimate in estimates]
    assert with_learned_noise(by_power, poses, tx, CONFIG, spatial=False) is CONFIG
    estimated = replace(poses, status=np.full(len(walk), SolveStatus.LOS))
    assert with_learned_noise(estimates, estimated, tx, CONFIG, spatial=False) is CONFIG


def test_fixed_noise_and_no_paths_are_left() -> None:
    walk = _walk(0, SHARP)
    estimates, poses, tx = [s.estimate for s in walk], _poses(walk), walk[0].tx
    fixed = MappingConfig(noise=PathNoise(source="fixed"))
    assert with_learned_noise(estimates, poses, tx, fixed, spatial=False) is fixed
    empty = [estimate.take("path", np.zeros(0, int)) for estimate in estimates]
    assert with_learned_noise(empty, poses, tx, CONFIG, spatial=False) == CONFIG
