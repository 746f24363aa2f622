from itertools import permutations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from isac_arena.scoring.association import assign, inside_gate, parameter_errors
from isac_arena.scoring.config import Gate

GATE = Gate()


def total_cost(match, estimate, truth):
    """Sum of d over the matches, and sqrt(3) for every pair that could not be made."""
    matched = [(i, j) for i, j in enumerate(match) if j >= 0]
    d = sum(np.linalg.norm(parameter_errors(estimate[i], truth[j]) / GATE.half_width) for i, j in matched)
    return d + np.sqrt(3) * (min(len(estimate), len(truth)) - len(matched))


def brute_force_cost(estimate, truth):
    best = np.inf
    slots = [*range(len(truth)), *[-1] * len(estimate)]
    for choice in set(permutations(slots, len(estimate))):
        allowed = all(
            j < 0 or inside_gate(parameter_errors(estimate[i], truth[j]), GATE.half_width)
            for i, j in enumerate(choice)
        )
        if allowed:
            best = min(best, total_cost(choice, estimate, truth))
    return best


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.integers(0, 4))
def test_assignment_is_the_best_of_all(seed, n_estimates, n_truths):
    rng = np.random.default_rng(seed)
    estimate = rng.uniform(-1.2, 1.2, (n_estimates, 3)) * GATE.half_width
    truth = rng.uniform(-1.2, 1.2, (n_truths, 3)) * GATE.half_width
    match = assign(estimate, truth, GATE.half_width)
    used = match[match >= 0]
    assert len(set(used.tolist())) == len(used)
    for i, j in enumerate(match):
        assert j < 0 or inside_gate(parameter_errors(estimate[i], truth[j]), GATE.half_width)
    np.testing.assert_allclose(total_cost(match, estimate, truth), brute_force_cost(estimate, truth))


def test_angles_wrap_and_delays_do_not():
    estimate = np.array([[10e-9, np.pi - 0.01, -np.pi + 0.01]])
    truth = np.array([[10e-9, -np.pi + 0.01, np.pi - 0.01]])
    np.testing.assert_allclose(parameter_errors(estimate, truth)[0], [0, -0.02, 0.02], atol=1e-12)
    assert assign(estimate, truth, GATE.half_width).tolist() == [0]
    assert assign(estimate + np.array([4e-9, 0, 0]), truth, GATE.half_width).tolist() == [-1]


def test_a_good_match_is_not_given_up_for_two_poor_ones():
    step = np.array([0.9, 0.9, 0.9]) * GATE.half_width
    truth = np.array([0 * step, step])
    estimate = np.array([0 * step, -step])
    assert assign(estimate, truth, GATE.half_width).tolist() == [0, -1]


def test_a_chain_of_poor_matches_does_not_replace_good_ones():
    step = np.array([0.5, 0.5, 0.5]) * GATE.half_width
    truth = np.arange(3)[:, None] * step
    estimate = np.arange(1, 4)[:, None] * step  # two on true paths, and one more
    assert assign(estimate, truth, GATE.half_width).tolist() == [1, 2, -1]


def test_a_pair_that_is_not_possible_is_not_assigned():
    both = np.zeros((2, 3))
    possible = np.array([[False, True], [False, False]])
    assert assign(both, both, GATE.half_width, possible).tolist() == [1, -1]
