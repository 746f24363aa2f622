"""Closed contours by the reflection law: exact on exact data, consistent on noisy data, robust, and refusing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from estimation.laws.contour import predict_reflection
from estimation.laws.support import CIRCLE, CLOSED_FAMILY, contour_points
from estimation.shape.config import ReflectionConfig
from estimation.shape.kinds.closed import HARMONIC_STD, fit_closed, harmonic_std
from estimation.shape.kinds.fit import fit_kind
from estimation.shape.reflection.posterior import Prior, maximise_posterior
from estimation.shape.reflection.reflections import Reflections
from isac_arena.scoring.metrics.contours import intersection_over_union
from isac_arena.validation.scenarios.reflections import Errors, closed_paths, draw_circle, lit_pillar, observe
from scenes.contours.smooth import Circle

SURE = ReflectionConfig(delay_offset_std_ns=0.0, aod_offset_std_deg=0.0, aoa_offset_std_deg=0.0)
OFFSETS = ReflectionConfig()
PILLAR = Circle(np.array([1.0, -5.0]), 0.4)


def data_of(contour: Circle, errors: Errors, seed: int) -> Reflections:
    rng = np.random.default_rng(seed)
    return observe(closed_paths(contour, rng), errors, rng)[0]


def exact_data(kind: str, parameter: np.ndarray) -> Reflections:
    """Paths that the model itself predicts, with small stated errors: their noise-free fit must return it."""
    data = data_of(PILLAR, Errors(0.01), 0)
    return replace(
        data, measured=predict_reflection(CLOSED_FAMILY[kind], parameter, data.tx, data.rx_state).measured
    )


@pytest.mark.parametrize(
    ("kind", "shape"), [("circle", []), ("ellipse", [0.4, -0.2]), ("rounded_square", [-1.0, 0.5])]
)
def test_noise_free_data_return_the_contour(kind: str, shape: list[float]) -> None:
    true = np.array([1.0, -5.0, np.log(0.45), *shape])
    fit = fit_kind(exact_data(kind, true), kind, SURE)
    psi = np.linspace(0, 2 * np.pi, 300)
    iou = intersection_over_union(fit.contour_m, contour_points(CLOSED_FAMILY[kind], true, psi))
    assert fit.status == "ok"
    assert iou > 0.985


def test_offsets_are_found_beside_the_circle() -> None:
    data = data_of(PILLAR, Errors(0.05), 1)
    moved = replace(data, measured=data.measured + np.array([0.09, np.deg2rad(2), np.deg2rad(-1.5)]))
    found = fit_closed("circle", moved, OFFSETS)
    assert found is not None
    np.testing.assert_allclose(found.offset, [0.09, np.deg2rad(-1.5), np.deg2rad(2)], atol=0.02)
    np.testing.assert_allclose(found.parameter[:2], PILLAR.center_m, atol=0.03)


def test_every_session_has_its_own_departure_offset() -> None:
    data = data_of(PILLAR, Errors(0.05), 2)
    session = (data.stop >= 20).astype(int)
    measured = data.measured.copy()
    measured[:, 1] += np.where(session == 1, np.deg2rad(2.5), 0.0)
    found = fit_closed("circle", replace(data, measured=measured, session=session), OFFSETS)
    assert found is not None
    np.testing.assert_allclose(found.offset[3] - found.offset[2], np.deg2rad(2.5), atol=2e-3)


def test_ghosts_lose_their_weight() -> None:
    rng = np.random.default_rng(5)
    data, is_ghost = observe(closed_paths(PILLAR, rng), Errors(0.2, ghost_share=0.25), rng)
    found = fit_closed("circle", data, SURE)
    assert found is not None
    assert is_ghost.sum() >= 5
    assert np.mean((found.inlier < 0.5) == is_ghost) > 0.95
    np.testing.assert_allclose(found.parameter[:2], PILLAR.center_m, atol=0.05)


def test_normalised_errors_have_the_stated_covariance() -> None:
    """Sum of the normalised squared errors of centre and radius over random pillars, 99.8 % interval."""
    total, n = 0.0, 60
    for k in range(n):
        rng = np.random.default_rng([11, k])
        contour, true = lit_pillar(draw_circle, rng)
        errors = Errors(0.3, position_std_m=0.05, heading_std_deg=0.5)
        fit = fit_kind(observe(true, errors, rng)[0], "circle", SURE)
        error = fit.parameter - [*contour.center_m, np.log(contour.radius_m)]
        total += error @ np.linalg.solve(fit.parameter_covariance, error)
    assert chi2.ppf(0.001, 3 * n) < total < chi2.ppf(0.999, 3 * n)


def test_evidence_is_the_integral_over_the_parameters() -> None:
    """Laplace against a sum over a grid of centres and radii."""
    data = data_of(PILLAR, Errors(0.3), 3).take("path", slice(0, 12))
    sure = ReflectionConfig(**{**SURE.model_dump(), "ghost_share": 0.0})
    found = fit_closed("circle", data, sure)
    assert found is not None
    root = np.linalg.cholesky(found.parameter_covariance)
    axis = np.linspace(-5, 5, 17)
    weight = np.linalg.inv(data.covariance)
    log_norm = -0.5 * np.linalg.slogdet(2 * np.pi * data.covariance)[1].sum()
    density = []
    for u in np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3):
        value = found.parameter + root @ u
        difference = data.measured - predict_reflection(CIRCLE, value, data.tx, data.rx_state).measured
        difference[:, 1:] = (difference[:, 1:] + np.pi) % (2 * np.pi) - np.pi
        square = np.einsum("na,nab,nb->", difference, weight, difference)
        away = (value[2] - np.log(sure.radius_median_m)) / sure.radius_log_std
        prior = -np.log(sure.area_m2) - 0.5 * away**2 - np.log(sure.radius_log_std * np.sqrt(2 * np.pi))
        density.append(log_norm - 0.5 * square + prior)
    cell = np.log((axis[1] - axis[0]) ** 3 * np.linalg.det(root))
    integral = np.logaddexp.reduce(density) + cell
    assert abs(integral - found.log_evidence) < 0.3


def test_wild_radius_keeps_its_prior() -> None:
    """One path is uninformative on the size: the status is `prior`, and the band is as wide as the prior."""
    data = data_of(PILLAR, Errors(0.5), 4).take("path", [10])
    fit = fit_kind(data, "circle", SURE)
    assert fit.status == "prior"
    assert fit.parameter_covariance[2, 2] > 0.8 * SURE.radius_log_std**2


def test_no_paths_is_a_status_and_unknown_kinds_an_error() -> None:
    none = data_of(PILLAR, Errors(0.5), 4).take("path", [])
    assert fit_kind(none, "circle", SURE).status == "failed: no paths"
    with pytest.raises(ValueError, match="kind = 'cube'"):
        fit_kind(none, "cube", SURE)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_and_repeated_paths_give_finite_shapes(n: int) -> None:
    data = data_of(PILLAR, Errors(0.5), 6)
    for rows in (np.arange(n), np.zeros(n + 1, int)):
        for kind in CLOSED_FAMILY:
            fit = fit_kind(data.take("path", rows), kind, OFFSETS)
            assert fit.is_usable
            assert np.all(np.isfinite(fit.contour_m))
            assert np.all(np.isfinite(fit.std_m))


def test_bad_data_are_refused_by_name() -> None:
    data = data_of(PILLAR, Errors(0.5), 6)
    with pytest.raises(ValueError, match=r"Reflections\.measured"):
        replace(data, measured=np.full_like(data.measured, np.nan))
    with pytest.raises(ValueError, match="positive definite"):
        replace(data, covariance=-data.covariance)
    with pytest.raises(ValueError, match="session"):
        replace(data, session=data.session - 1)


def test_harmonics_carry_the_variance_asked_for() -> None:
    assert np.sum(harmonic_std() ** 2) == pytest.approx(HARMONIC_STD**2)


def test_singular_information_is_no_optimum() -> None:
    data = data_of(PILLAR, Errors(0.5), 6)
    broken = Prior(np.full(3, np.nan), np.array([0.0, 0.0, 1.0]), np.ones(3))
    assert maximise_posterior(CIRCLE, np.array([1.0, -5.0, np.nan]), broken, data, SURE) is None
