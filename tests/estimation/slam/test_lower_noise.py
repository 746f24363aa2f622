"""Floors of the noise fall where paths are better than they say, and stay where covariances are too small."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import PathNoise, TrajectoryConfig
from estimation.slam.stops import locate_and_map
from estimation.slam.walk import alternation
from estimation.slam.walk.alternation import Noise, smooth_walk
from estimation.slam.walk.linearise import linearise
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import Scenario, draw_trajectory
from isac_arena.validation.slam.trials import MAPPING, OURS
from tests.estimation.slam.test_linearise import CONFIG, campaign

WALK = TrajectoryConfig()
FLOORS = OURS.model_copy(update={"noise": PathNoise()})  # 0.1 ns and 0.2 deg
STD = np.array([1e-9, np.deg2rad(0.6), np.deg2rad(0.6)])


def _walk(seed: int, sharp: float, said: float) -> list[Scenario]:
    """A walk with half of the paths `sharp` times the errors of the others, and all covariances times `said`^2."""
    rng = np.random.default_rng([seed, 9])
    stops = draw_trajectory(rng, ScenarioConfig(n_paths=12, is_noisy=False), 12)
    return [replace(stop, estimate=_noisy(rng, stop.estimate, sharp, said)) for stop in stops]


def _noisy(rng: np.random.Generator, estimate: ChannelEstimate, sharp: float, said: float) -> ChannelEstimate:
    std = np.where(rng.random(len(estimate)) < 0.5, sharp, 1.0)[:, None] * STD
    error = std * rng.standard_normal(std.shape)
    return replace(
        estimate,
        delay_s=estimate.delay_s + error[:, 0],
        aod_azimuth_rad=estimate.aod_azimuth_rad + error[:, 1],
        aoa_azimuth_rad=estimate.aoa_azimuth_rad + error[:, 2],
        covariance=np.square(said * std)[:, :, None] * np.eye(3),
    )


def _rms_m(walk: list[Scenario]) -> float:
    poses, _ = locate_and_map([s.estimate for s in walk], walk[0].tx, FLOORS, WALK, MAPPING)
    error = poses.position_m - np.array([s.state[:2] for s in walk])
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def test_sharp_paths_give_far_better_positions_than_the_floors_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    walks = [_walk(seed, sharp=0.01, said=1.0) for seed in range(3)]
    lower = np.array([_rms_m(walk) for walk in walks])
    monkeypatch.setattr(alternation, "WALK_SHARES", ())
    wide = np.array([_rms_m(walk) for walk in walks])
    assert np.median(lower / wide) < 0.5
    assert (lower < 1.1 * wide).all()


def test_covariances_that_are_too_small_do_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    walks = [_walk(seed, sharp=1.0, said=0.05) for seed in range(3)]
    lower = np.array([_rms_m(walk) for walk in walks])
    monkeypatch.setattr(alternation, "WALK_SHARES", ())
    wide = np.array([_rms_m(walk) for walk in walks])
    assert (lower < 1.15 * wide).all()


def test_noise_without_a_floor_is_left() -> None:
    seen, link, now = campaign(np.random.default_rng(1))
    assert not seen.floor.any()
    walk = smooth_walk(seen, link.kind == 1, now, CONFIG)
    assert walk.noise.seen is seen and walk.noise.config is CONFIG


def test_all_noise_falls_together_and_objects_get_theirs_back() -> None:
    seen, _, _ = campaign(np.random.default_rng(2))
    wide = Noise(replace(seen, floor=np.diag([0.03, 0.004, 0.004]) ** 2), WALK)
    low = wide.lower(0.25)
    np.testing.assert_allclose(low.seen.floor, wide.seen.floor / 16)
    assert low.config.wall_roughness_m == pytest.approx(WALK.wall_roughness_m / 2)
    assert low.config.object_roughness_m == pytest.approx(WALK.object_roughness_m / 2)
    back = low.with_objects_of(wide)
    assert back.config.object_roughness_m == WALK.object_roughness_m
    assert back.config.wall_roughness_m == low.config.wall_roughness_m


def test_a_share_of_the_floor_is_in_every_covariance() -> None:
    seen, _, _ = campaign(np.random.default_rng(2))
    own, floor = seen.covariance, np.diag([0.03, 0.004, 0.004]) ** 2
    wide = replace(seen, covariance=own + floor, floor=floor)
    np.testing.assert_allclose(wide.with_floor(0.1).covariance, own + 0.01 * floor, rtol=1e-12)
    np.testing.assert_allclose(wide.with_floor(0.5).with_floor(0.2).floor, 0.01 * floor)


def test_log_densities_are_those_of_the_student_law() -> None:
    """Its covariance without roughness is that of the paths."""
    from scipy.stats import multivariate_t  # noqa: PLC0415  (slow to import)

    seen, link, now = campaign(np.random.default_rng(3))
    flat = CONFIG.model_copy(update={"wall_roughness_m": 0.0, "object_roughness_m": 0.0})
    residuals = linearise(seen, link, now, flat)
    density = residuals.log_density(4.0)
    whole = np.flatnonzero(residuals.size == 3)
    assert np.isneginf(np.delete(density, whole)).all()
    for path in whole:
        root = np.linalg.cholesky(seen.covariance[path])
        expected = multivariate_t(np.zeros(3), seen.covariance[path], 4).logpdf(root @ residuals.value[path])
        assert density[path] == pytest.approx(expected, rel=1e-9, abs=1e-6)
