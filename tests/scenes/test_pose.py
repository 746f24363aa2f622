"""Angles and directions."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from scenes.pose import direction, within_poles

ANGLE = st.floats(-9.0, 9.0)


@given(st.lists(st.tuples(ANGLE, ANGLE), min_size=1, max_size=4))
def test_directions_over_a_pole_come_down_behind_it(angles) -> None:
    over = np.array(angles)
    folded = within_poles(over)
    assert_allclose(direction(*folded.T), direction(*over.T), atol=1e-9)
    near = np.abs(over[:, 1]) < np.pi / 2
    assert (folded[near] == over[near]).all()
    assert (np.abs(np.sin(folded[:, 1]) - np.sin(over[:, 1])) < 1e-9).all()
    assert (np.cos(folded[:, 1]) > -1e-9).all()


def test_azimuths_alone_stay() -> None:
    azimuth = np.array([[4.0], [-7.0]])
    assert (within_poles(azimuth) == azimuth).all()
