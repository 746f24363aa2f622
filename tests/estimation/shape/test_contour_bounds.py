"""Bounds of contours from several TX: the covariance of the bundle, derivatives, and what a second TX adds."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.contour import predict_reflection
from estimation.laws.plane import los_path
from estimation.laws.support import CIRCLE
from estimation.shape.config import ContourConfig, ReflectionConfig
from estimation.shape.reflection.bounds import ContourInformation, KnownContour, link_information
from estimation.shape.reflection.bundle import BundleObject, fit_bundle
from estimation.shape.reflection.objects import find_objects
from estimation.shape.reflection.reflections import Reflections
from scenes.record import concatenate

TXS = np.array([[0.0, 0.0, 0.8], [12.0, 0.5, 2.3]])
CIRCLES = [np.array([5.0, 4.0, np.log(0.4)]), np.array([8.0, 6.5, np.log(0.6)])]
STATES = np.column_stack([np.linspace(2.0, 11.0, 9), 2.0 + 0.1 * np.arange(9), np.linspace(-1, 1, 9), np.zeros(9)])
CONFIG = ContourConfig(reflection=ReflectionConfig(ghost_share=0.0, aod_offset_std_deg=1.0))
STD = np.array([0.01, 0.002, 0.003])


def paths_of(tx: int, circle: np.ndarray | None) -> Reflections:
    """Exact paths of a TX to all stops, off a circle or direct, at states with the errors of the survey."""
    n, pose = len(STATES), np.tile(TXS[tx], (len(STATES), 1))
    if circle is not None:
        measured = predict_reflection(CIRCLE, circle, pose, STATES).measured
    else:
        measured = np.empty((n, 3))
        for row in range(n):
            los_path(TXS[tx], STATES[row], measured[row], np.empty((3, 4)))
    return Reflections(
        measured=measured,
        covariance=np.tile(np.diag(STD**2), (n, 1, 1)),
        tx=pose,
        rx_state=STATES,
        rx_covariance=np.tile(np.diag(CONFIG.survey_std**2), (n, 1, 1)),
        session=np.full(n, tx),
        stop=np.arange(n),
        clock=np.full(n, tx),
    )


def information() -> ContourInformation:
    known = [KnownContour(str(k), "circle", circle) for k, circle in enumerate(CIRCLES)]
    links = []
    for tx in range(2):
        alone = [
            replace(paths_of(tx, circle), session=np.zeros(9, int), clock=np.zeros(9, int))
            for circle in (*CIRCLES, None)
        ]
        links.append(link_information(known, alone[:-1], alone[-1], STATES, CONFIG))
    return ContourInformation(known, links, CONFIG)


@pytest.mark.parametrize("chosen", [(0,), (1,), (0, 1)])
def test_bounds_are_the_covariances_of_a_bundle_without_noise(chosen):
    objects = [
        BundleObject("circle", concatenate([paths_of(tx, circle) for tx in chosen], "path")) for circle in CIRCLES
    ]
    settings = CONFIG.reflection.model_copy(
        update={"radius_median_m": 0.5, "delay_offset_std_ns": CONFIG.reflection.delay_offset_std_ns}
    )
    found = fit_bundle(objects, concatenate([paths_of(tx, None) for tx in chosen], "path"), settings)
    bounds = information().bounds(chosen)
    for k, shape in enumerate(found.shapes):
        own = shape.parameter_covariance
        np.testing.assert_allclose(bounds.center_m[k], np.sqrt(own[0, 0] + own[1, 1]), rtol=0.03)
        np.testing.assert_allclose(bounds.radius_m[k], shape.extent_std_m, rtol=0.03)
        np.testing.assert_allclose(bounds.outline_m[k], np.sqrt(np.mean(shape.std_m**2)), rtol=0.03)


def test_the_logarithm_of_the_error_is_convex_and_its_gradient_right():
    problem, at = information(), np.array([0.3, 0.8])
    _, slope = problem.log_error(at)
    for k, step in enumerate(1e-6 * np.eye(2)):
        found = (problem.log_error(at + step)[0] - problem.log_error(at - step)[0]) / 2e-6
        np.testing.assert_allclose(slope[k], found, rtol=1e-4)
    ends = [problem.log_error(np.array(w))[0] for w in ([1.0, 0.0], [0.0, 1.0], [0.5, 0.5])]
    assert ends[2] <= (ends[0] + ends[1]) / 2
    errors = problem.log_error(np.ones(2))[0]
    outline = problem.bounds((0, 1)).outline_m
    np.testing.assert_allclose(errors, np.mean(np.log(outline)))


def test_an_object_keeps_the_paths_of_all_tx_at_a_stop():
    config = ReflectionConfig(aod_offset_std_deg=0.1, aoa_offset_std_deg=0.1)
    data = concatenate([paths_of(tx, CIRCLES[0]) for tx in range(2)], "path")
    data = replace(data, session=np.zeros(len(data), int))
    (found,) = find_objects(data, 1.0, 3, config)
    assert len(found.paths) == len(data)
