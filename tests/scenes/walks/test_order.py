"""Whether stops follow one another: walks do, random places and walks with leaps do not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.walks.trajectory import follow_one_another


def _line(n: int) -> np.ndarray:
    return np.column_stack([np.arange(n), np.zeros(n), np.ones(n)])


@pytest.mark.parametrize(("n", "walk"), [(1, False), (2, False), (3, True), (4, True), (45, True)])
def test_stops_on_a_line_are_a_walk_from_three_on(n: int, walk: bool) -> None:
    assert follow_one_another(_line(n)) == walk


@given(st.integers(0, 2**32 - 1), st.integers(12, 40))
def test_random_places_are_no_walk(seed: int, n: int) -> None:
    assert not follow_one_another(np.random.default_rng(seed).uniform(0, 20, (n, 3)) * [1, 1, 0])


@given(st.integers(0, 2**32 - 1))
def test_a_walk_of_small_turns_is_one_and_with_a_leap_it_is_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.3, 20))
    position_m = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading), np.zeros(20)]), axis=0)
    assert follow_one_another(position_m)
    position_m[10:] += [8.0, 0.0, 0.0]
    assert not follow_one_another(position_m)
