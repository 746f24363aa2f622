"""The bundle against a dense least-squares oracle, its consistency, and what it gains."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from estimation.laws.contour import predict_reflection
from estimation.laws.support import CIRCLE
from estimation.shape.config import ReflectionConfig
from estimation.shape.kinds.fit import fit_kind
from estimation.shape.reflection.bundle import BundleObject, fit_bundle
from estimation.shape.reflection.fit_all import survey_scale
from isac_arena.validation.scenarios.reflections import (
    TX,
    Errors,
    closed_paths,
    draw_circle,
    edge_paths,
    lit_pillar,
    observe_together,
    wall_paths,
)
from scenes.contours.smooth import Circle
from scenes.pose import SPEED_OF_LIGHT_M_S

CENTERS = np.array([[1.0, -5.0], [-3.0, -6.0], [4.0, -4.0]])
ERRORS = Errors(0.5, position_std_m=0.1, heading_std_deg=1.0, delay_offset_ns=0.3, angle_offset_deg=2.0)
CONFIG = ReflectionConfig()


def campaign(seed: int, errors: Errors = ERRORS):
    rng = np.random.default_rng(seed)
    truths = [closed_paths(Circle(center, 0.4), rng) for center in CENTERS]
    data, los = observe_together(truths, errors, rng)
    return [BundleObject("circle", each) for each in data], los


def test_bundle_equals_dense_least_squares() -> None:
    """Without ghosts the problem is a plain least-squares one: scipy on all unknowns at once is the oracle."""
    config = ReflectionConfig(ghost_share=0.0)
    objects, los = campaign(1)
    found = fit_bundle(objects, los, config)
    n_stops = len(found.stop)
    prior_std = np.array([1e-9 * SPEED_OF_LIGHT_M_S, np.deg2rad(3.0), np.deg2rad(3.0)])
    given = los.rx_state
    state_std = np.sqrt(np.diagonal(los.rx_covariance[0]) + 1e-12)

    def residuals(unknown: np.ndarray) -> np.ndarray:
        offset, circles = unknown[:3], unknown[3:12].reshape(3, 3)
        state = given + (state_std * unknown[12:].reshape(n_stops, 4))
        turned = offset[[0, 2, 1]]
        parts = [offset / prior_std, unknown[12:]]
        parts.append((circles[:, 2] - np.log(config.radius_median_m)) / config.radius_log_std)
        for each, circle in zip(objects, circles, strict=True):
            data = each.paths
            paths = predict_reflection(CIRCLE, circle, data.tx, state[data.stop]).measured + turned
            parts.append(whitened(data.measured - paths, data.covariance))
        away = state[:, :2] - TX[:2]
        azimuth = np.arctan2(away[:, 1], away[:, 0])
        straight = np.column_stack(
            [np.linalg.norm(away, axis=1) + state[:, 3], azimuth - TX[2], azimuth + np.pi - state[:, 2]]
        )
        parts.append(whitened(los.measured - straight - turned, los.covariance))
        return np.concatenate([part.ravel() for part in parts])

    start = np.concatenate([np.zeros(3), *[[*center, np.log(0.4)] for center in CENTERS], np.zeros(4 * n_stops)])
    oracle = least_squares(residuals, start, x_scale="jac", ftol=1e-14, xtol=1e-14, gtol=1e-12)
    np.testing.assert_allclose(found.offset, oracle.x[:3], atol=2e-4)
    for shape, circle in zip(found.shapes, oracle.x[3:12].reshape(3, 3), strict=True):
        np.testing.assert_allclose(shape.parameter, circle, atol=2e-3)
    covariance = np.linalg.inv(oracle.jac.T @ oracle.jac)
    np.testing.assert_allclose(found.shapes[0].parameter_covariance, covariance[3:6, 3:6], rtol=0.05, atol=1e-6)


def whitened(difference: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    difference = difference.copy()
    difference[:, 1:] = (difference[:, 1:] + np.pi) % (2 * np.pi) - np.pi
    return difference / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


def test_bundle_knows_its_errors_and_beats_single_fits() -> None:
    total, alone, together, n = 0.0, 0.0, 0.0, 12
    for k in range(n):
        objects, los = campaign(100 + k)
        found = fit_bundle(objects, los, CONFIG)
        for shape, center, each in zip(found.shapes, CENTERS, objects, strict=True):
            error = shape.parameter - [*center, np.log(0.4)]
            total += error @ np.linalg.solve(shape.parameter_covariance, error)
            together += np.sum(error[:2] ** 2)
            single = fit_kind(each.paths, "circle", CONFIG)
            alone += np.sum((single.parameter[:2] - center) ** 2)
    assert chi2.ppf(0.001, 9 * n) < total < chi2.ppf(0.999, 9 * n)
    assert together < 0.8 * alone


def test_walls_and_edges_join_and_empty_objects_stay_out() -> None:
    rng = np.random.default_rng(3)
    ends = np.array([[-8.0, -8.0], [9.0, -7.0]])
    truths = [
        closed_paths(Circle(CENTERS[0], 0.4), rng),
        wall_paths(ends, rng),
        edge_paths(np.array([1.5, -7.5]), rng),
    ]
    data, los = observe_together(truths, replace(ERRORS, level=0.2), rng)
    kinds = ("circle", "wall", "edge")
    objects = [BundleObject(kind, each) for kind, each in zip(kinds, data, strict=True)]
    objects.append(BundleObject("circle", data[0].take("path", [])))
    found = fit_bundle(objects, los, CONFIG)
    assert [shape.kind for shape in found.shapes] == ["circle", "wall", "edge", "circle"]
    assert found.shapes[3].status.startswith("failed")
    np.testing.assert_allclose(found.shapes[2].parameter, [1.5, -7.5], atol=0.15)
    slope = np.arctan2(1.0, 17.0) + np.pi / 2
    assert abs(np.rad2deg(found.shapes[1].parameter[0] - slope)) < 0.8


def test_unknown_kinds_are_refused() -> None:
    objects, los = campaign(1)
    with pytest.raises(ValueError, match="kind = 'cube'"):
        fit_bundle([BundleObject("cube", objects[0].paths)], los, CONFIG)


@pytest.mark.parametrize("seed", [0, 6, 12])
def test_paths_far_more_accurate_than_poses_are_no_ghosts(seed: int) -> None:
    """At the given states and the offsets of each fit alone all paths are far off; none may stay so."""
    rng = np.random.default_rng(seed)
    errors = Errors(level=0.02, position_std_m=0.1, heading_std_deg=1.0, delay_offset_ns=0.3, angle_offset_deg=2.0)
    truths = [lit_pillar(draw_circle, rng) for _ in range(3)]
    objects, los = observe_together([true for _, true in truths], errors, rng)
    found = fit_bundle([BundleObject("circle", each) for each in objects], los, CONFIG)
    for shape, inlier, (pillar, _) in zip(found.shapes, found.inlier, truths, strict=True):
        assert np.mean(inlier > 0.5) > 0.95
        assert np.hypot(*(shape.parameter[:2] - pillar.center_m)) < 0.15


@pytest.mark.parametrize("stated", [1.0, 0.5, 10.0])
def test_lines_of_sight_show_how_exact_the_survey_is(stated: float) -> None:
    """Positions that are stated too well or too badly; headings and clocks are lost among the common offsets."""
    _, los = campaign(3)
    los = replace(los, rx_covariance=los.rx_covariance * stated**2)
    assert survey_scale(los, CONFIG)[0] * stated == pytest.approx(1.0, abs=0.5)
    few = los.take("path", np.arange(1))
    np.testing.assert_array_equal(survey_scale(few, CONFIG), 1.0)
    np.testing.assert_array_equal(survey_scale(los.take("path", np.arange(0)), CONFIG), 1.0)
