"""The plain numpy terms beside which fits are timed are those of the compiled reflection law."""

import numpy as np
import pytest

from estimation.laws.contour import WALL, predict_reflection
from estimation.laws.plane import los_jacobian_rx, predict_los, residual
from estimation.laws.support import CIRCLE
from isac_arena.validation.benches.plain_reflections import circle_terms, los_terms, wall_terms
from isac_arena.validation.scenarios.reflections import Errors
from isac_arena.validation.shape.reflection import made_campaign, made_wall

SEED = 100


@pytest.mark.parametrize(
    ("terms", "family", "parameter"), [(circle_terms, CIRCLE, [1.3, -4.2, -0.8]), (wall_terms, WALL, [0.4, 6.0])]
)
def test_terms_of_contours_are_those_of_the_law(terms, family, parameter):
    data, parameter = made_wall(np.random.default_rng(SEED), Errors()), np.array(parameter)
    paths = predict_reflection(family, parameter, data.tx, data.rx_state)
    expected = residual(data.measured, paths.measured), paths.by_parameter, paths.by_rx
    for found, law in zip(terms(data, parameter), expected, strict=True):
        np.testing.assert_allclose(found, law, rtol=1e-9, atol=1e-10)


def test_terms_of_lines_of_sight_are_those_of_the_law():
    _, los = made_campaign(np.random.default_rng(SEED))
    difference, _, by_rx = los_terms(los, np.empty(0))
    np.testing.assert_allclose(difference, residual(los.measured, predict_los(los.tx, los.rx_state)), atol=1e-10)
    np.testing.assert_allclose(by_rx, los_jacobian_rx(los.tx, los.rx_state), atol=1e-10)
