from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isac_arena.scoring.metrics.sets import gospa, ospa

sizes = st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(0, 10_000))


def points(seed, count):
    return np.random.default_rng(seed).uniform(0, 3, (count, 2))


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def every_assignment(n_rows, n_columns):
    """All one-to-one assignments of min(n_rows, n_columns) pairs, as lists of (row, column)."""
    if n_rows > n_columns:
        return [[(row, column) for column, row in pairs] for pairs in every_assignment(n_columns, n_rows)]
    return [list(enumerate(chosen)) for chosen in permutations(range(n_columns), n_rows)]


@given(sizes, st.floats(0.2, 3), st.sampled_from([1.0, 2.0]))
def test_both_are_the_best_of_all_assignments(drawn, cutoff, order):
    n, m, seed = drawn
    distance = distances(points(seed, n), points(seed + 1, m))
    capped = np.minimum(distance, cutoff) ** order
    best = min(sum(capped[pair] for pair in pairs) for pairs in every_assignment(n, m))
    excess = cutoff**order * abs(n - m)
    expected = ((best + excess) / max(n, m)) ** (1 / order) if max(n, m) else 0.0
    assert ospa(distance, cutoff, order) == pytest.approx(expected, abs=1e-12)
    assert gospa(distance, cutoff, order).value == pytest.approx((best + excess / 2) ** (1 / order), abs=1e-12)


@given(sizes, st.floats(0.2, 3))
def test_gospa_parts_add_up_and_name_the_pairs(drawn, cutoff):
    n, m, seed = drawn
    distance = distances(points(seed, n), points(seed + 1, m))
    found = gospa(distance, cutoff)
    assert found.value**2 == pytest.approx(found.localisation**2 + found.missed**2 + found.false**2)
    paired = np.flatnonzero(found.true_index >= 0)
    assert (distance[paired, found.true_index[paired]] < cutoff).all()
    assert found.n_false == n - len(paired)
    assert found.n_missed == m - len(paired)


@given(st.tuples(st.integers(1, 4), st.integers(0, 10_000)), st.floats(0.2, 3))
def test_both_are_metrics(drawn, cutoff):
    count, seed = drawn
    sets = [points(seed + k, n) for k, n in enumerate((count, 2, 3))]
    for measure in (ospa, lambda d, c: gospa(d, c).value):

        def between(i, j, measure=measure):
            return measure(distances(sets[i], sets[j]), cutoff)

        assert between(0, 0) == 0
        assert between(0, 1) == pytest.approx(between(1, 0))
        assert between(0, 1) <= between(0, 2) + between(2, 1) + 1e-9


def test_an_empty_estimate_is_the_worst():
    nothing = np.zeros((0, 3))
    assert ospa(nothing, 0.5) == 0.5
    assert gospa(nothing, 0.5).value == pytest.approx(np.sqrt(3 * 0.125))
    assert gospa(nothing, 0.5).n_missed == 3
    assert ospa(np.zeros((0, 0)), 1.0) == gospa(np.zeros((0, 0)), 1.0).value == 0


@pytest.mark.parametrize(("distance", "cutoff", "order"), [
    (np.zeros((1, 1)), 0.0, 2), (np.zeros((1, 1)), 1.0, 0.5), (np.full((1, 1), -1.0), 1.0, 2),
    (np.full((1, 1), np.nan), 1.0, 2),
])  # fmt: skip
def test_bad_arguments_are_named(distance, cutoff, order):
    with pytest.raises(ValueError, match=r"cutoff|distance"):
        gospa(distance, cutoff, order)
