"""Curved walls as arcs of large circles, and priors of pillars from the other pillars of a scene."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.config import ReflectionConfig
from estimation.shape.kinds.fit import fit_kind
from estimation.shape.reflection.bundle import BundleObject, fit_bundle
from estimation.shape.reflection.choice import choose_shape
from estimation.shape.reflection.pillar_prior import prior_from_others, radius_prior
from isac_arena.validation.scenarios.reflections import Errors, closed_paths, lit_pillar, observe, observe_together
from scenes.contours.smooth import Circle

CONFIG = ReflectionConfig()
RING = Circle(np.array([0.0, -13.0]), 5.0)


def bent_wall(errors, seed=0):
    rng = np.random.default_rng(seed)
    true = closed_paths(RING, rng)
    return true, observe(true, errors, rng)[0]


def test_a_bent_wall_without_noise_is_found_exactly():
    true, data = bent_wall(Errors(level=1e-3))
    shape = fit_kind(data, "arc", CONFIG)
    np.testing.assert_allclose(shape.parameter, [0.0, -13.0, np.log(5.0)], atol=2e-3)
    assert np.abs(RING.signed_distance(shape.contour_m)).max() < 2e-3
    turn = np.unwrap(np.arctan2(*(true.point_m - RING.center_m).T[::-1]))
    assert shape.extent_m == pytest.approx(5.0 * np.ptp(turn), rel=1e-2)
    assert not shape.is_closed


def test_a_bent_wall_is_a_wall_by_evidence():
    for seed in range(3):
        choice = choose_shape(bent_wall(Errors(level=0.5), seed)[1], CONFIG)
        assert choice.best_class == "wall"
        assert choice.best.kind == "arc"


def test_the_band_of_a_bent_wall_holds():
    covered = []
    for seed in range(40):
        shape = fit_kind(bent_wall(Errors(level=0.5), seed)[1], "arc", CONFIG)
        covered.append(np.mean(np.abs(RING.signed_distance(shape.contour_m)) <= 1.96 * shape.std_m))
    assert 0.85 < np.mean(covered) < 0.995


def test_a_bent_wall_joins_the_bundle():
    rng = np.random.default_rng(1)
    objects, los = observe_together([closed_paths(RING, rng)], Errors(level=0.3, position_std_m=0.05), rng)
    found = fit_bundle([BundleObject("arc", objects[0])], los, CONFIG)
    assert found.shapes[0].kind == "arc"
    assert np.abs(RING.signed_distance(found.shapes[0].contour_m)).max() < 0.1
    assert fit_kind(objects[0].take("path", []), "arc", CONFIG).status == "failed: no paths"


def test_the_bundle_sees_how_large_the_noise_is():
    rng = np.random.default_rng(2)
    truths = [lit_pillar(lambda r: Circle(r.uniform(-5, -4, 2), 0.4), rng)[1] for _ in range(3)]
    objects, los = observe_together(truths, Errors(level=0.5, position_std_m=0.1), rng)
    scale = np.array([0.5, 1.0, 2.0])
    scaled = [replace(each, covariance=each.covariance / np.outer(scale, scale)) for each in (*objects, los)]
    found = fit_bundle([BundleObject("circle", each) for each in scaled[:-1]], scaled[-1], CONFIG)
    np.testing.assert_allclose(found.noise_scale, scale, rtol=0.25)


def test_without_other_pillars_the_prior_stays():
    none = np.zeros(0)
    alone = (np.log(CONFIG.radius_median_m), CONFIG.radius_log_std)
    assert radius_prior(none, none, CONFIG) == alone
    assert radius_prior(np.array([1.0]), np.zeros(1), CONFIG) == alone
    assert radius_prior(np.array([1.0]), np.full(1, 1e-9), CONFIG) == pytest.approx(alone)


def test_many_equal_pillars_fix_the_next_and_unequal_ones_widen_it():
    same = np.full(200, np.log(0.2))
    mean, std = radius_prior(same, np.ones(200), CONFIG)
    assert mean == pytest.approx(np.log(0.2), abs=1e-3)
    assert std < 0.05
    mixed = np.log(np.tile([0.15, 0.6], 100))
    mean, std = radius_prior(mixed, np.ones(200), CONFIG)
    assert mean == pytest.approx(mixed.mean(), abs=1e-2)
    assert std == pytest.approx(mixed.std(), rel=0.02)


def test_pillars_tell_kind_and_radius_and_walls_tell_nothing():
    rng = np.random.default_rng(4)
    round_one = lit_pillar(lambda r: Circle(np.array([1.7, -6.5]), 0.25), rng)[1]
    pillar = choose_shape(observe(round_one, Errors(level=0.1), rng)[0], CONFIG)
    wall = choose_shape(bent_wall(Errors(level=0.3))[1], CONFIG)
    config, shares = prior_from_others([pillar, wall, pillar], 1, CONFIG)
    assert config.radius_log_std < CONFIG.radius_log_std
    assert abs(np.log(config.radius_median_m / 0.25)) < abs(np.log(CONFIG.radius_median_m / 0.25)) / 2
    assert shares["circle"] > 0.7
    assert sum(shares.values()) == pytest.approx(1)
    unchanged, _ = prior_from_others([wall, wall], 0, CONFIG)
    assert unchanged.radius_log_std == pytest.approx(CONFIG.radius_log_std, rel=1e-2)
