from itertools import permutations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from isac_arena.insight.twin.explain import explaining
from isac_arena.insight.twin.record import NARROW_GATE, WIDE_GATE
from isac_arena.scoring.association import parameter_errors


def brute_force(difference, gate):
    """Most pairs within the gate, then least cost, over all one-to-one assignments."""
    n, m = difference.shape[:2]
    inside = (np.abs(difference) <= gate).all(axis=2)
    cost = ((difference / gate) ** 2).sum(axis=2)
    slots = [*range(m), *[-1] * n]
    best = (0, 0.0)
    for choice in set(permutations(slots, n)):
        pairs = [(path, item) for path, item in enumerate(choice) if item >= 0 and inside[path, item]]
        best = min(best, (-len(pairs), sum(cost[pair] for pair in pairs)))
    return best


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 3), m=st.integers(0, 4), seed=st.integers(0, 2**32 - 1))
def test_the_most_paths_are_explained_at_the_least_cost(n, m, seed):
    difference = np.random.default_rng(seed).uniform(-1.6, 1.6, (n, m, 3)) * WIDE_GATE
    found = explaining(difference, WIDE_GATE)
    chosen = found[found >= 0]
    assert len(set(chosen.tolist())) == len(chosen)
    rows = np.flatnonzero(found >= 0)
    assert (np.abs(difference[rows, chosen]) <= WIDE_GATE).all()
    count, cost = brute_force(difference, WIDE_GATE)
    assert len(chosen) == -count
    assert_allclose(((difference[rows, chosen] / WIDE_GATE) ** 2).sum(), cost, atol=1e-9)


def test_a_candidate_explains_one_path_only():
    measured = np.array([[20e-9, 0.1, 0.2], [20.1e-9, 0.1, 0.2]])
    found = explaining(parameter_errors(measured[:, None], measured[None, :1]), NARROW_GATE)
    assert found.tolist() == [0, -1]


def test_angles_are_compared_the_short_way_round():
    difference = parameter_errors(np.array([[0.0, np.pi - 0.01, -3.0]]), np.array([[0.0, -np.pi + 0.01, 3.0]]))
    assert_allclose(difference[0], [0, -0.02, 2 * np.pi - 6])
