"""The compiled restatement of the published snapshot SLAM gives the results of the one written with NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimation.slam.snapshot.problem import snapshot_problem
from estimation.slam.snapshot.reference import solve_reference
from estimation.slam.snapshot.solve import ranked_modes
from isac_arena.validation.benches.compiled_reference import los_state, nlos_state, published_state
from isac_arena.validation.benches.slam import NOISE, REFERENCE, STOPS
from isac_arena.validation.scenarios.stops import draw_stop


def drawn(seed, count, **changed):
    rng = np.random.default_rng(seed)
    stops = [draw_stop(rng, replace(STOPS, **changed)) for _ in range(count)]
    return [snapshot_problem(stop.estimate, stop.tx, NOISE) for stop in stops]


def close(state, wanted):
    assert_allclose(state, wanted, rtol=1e-7, atol=1e-7)


def test_without_line_of_sight_it_is_the_reference():
    for problem in drawn(1, 8, has_los=False, n_paths=8):
        close(nlos_state(problem, REFERENCE), solve_reference(problem, REFERENCE, False).state)


@pytest.mark.parametrize("gate_m2", [0.1, 0.02])
def test_with_a_line_of_sight_state_and_inliers_are_those_of_the_reference(gate_m2):
    config = REFERENCE.model_copy(update={"gate_m2": gate_m2})
    solved = 0
    for problem in drawn(2, 20):
        fit = solve_reference(problem, config, True)
        state, n_inliers = los_state(problem, config)
        if fit is None:
            assert np.isnan(state).all()
            continue
        solved += 1
        close(state, fit.state)
        assert n_inliers == fit.is_inlier.sum()
    assert solved > 10


def test_the_order_of_the_modes_is_the_published_one():
    is_los = []
    for problem in drawn(3, 4, n_paths=6) + drawn(4, 4, has_los=False, n_paths=6):
        fits = ranked_modes(problem, REFERENCE)
        if fits:
            close(published_state(problem, REFERENCE), fits[0].state)
            is_los.append(fits[0].is_los.any())
    assert 2 < sum(is_los) < len(is_los) - 2


def test_too_few_paths_give_no_state():
    problem = drawn(5, 1, has_los=False)[0]
    assert np.isnan(nlos_state(problem.take(np.arange(3)), REFERENCE)).all()
    assert np.isnan(los_state(problem.take(np.arange(1)), REFERENCE)[0]).all()
