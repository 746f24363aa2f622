"""The conducting wedge against eigenfunction series and integrals, and its own symmetries."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import hankel2

from isac_arena.validation.propagation import exact_fields
from sim.propagation.diffraction.wedge import transition_function, wedge_gain

K = 2 * np.pi * 60e9 / 299_792_458.0


@pytest.mark.parametrize("x", [1e-6, 0.03, 0.5, 2.0, 9.0])
def test_transition_function_is_its_integral(x):
    # along t = sqrt(x) + (1 - j) u the integrand e^{-j t^2} falls off
    def integrand(u, part):
        t = np.sqrt(x) + (1 - 1j) * u
        return getattr((1 - 1j) * np.exp(-1j * t**2), part)

    integral = sum(unit * quad(integrand, 0, 8, part)[0] for unit, part in ((1, "real"), (1j, "imag")))
    assert transition_function(x) == pytest.approx(2j * np.sqrt(x) * np.exp(1j * x) * integral, rel=1e-8)


def test_transition_function_limits():
    assert transition_function(0.0) == 0
    assert transition_function(1e6) == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(transition_function(40.0), 1 + 1j / 80, atol=1e-3)


def test_exact_fields_meet_their_boundary_conditions():
    soft = exact_fields.wedge_series(K / 20, 1.5, (0.4, 0.7), 1.0, [0.0, 1.0, 1.5 * np.pi], -1)
    assert np.abs(soft[[0, 2]]).max() < 1e-12 * np.abs(soft[1])
    turn = np.array([1e-3, 2e-3])
    hard = exact_fields.wedge_series(K / 20, 1.5, (0.4, 0.7), 1.0, turn, 1)
    assert abs(hard[1] - hard[0]) < 1e-2 * abs(hard[0])
    free = exact_fields.wedge_series(K / 20, 1.0, (0.4, 0.7), 1.0, 1.1, -1)
    direct, image = (np.sqrt(1.16 - 0.8 * np.cos(angle)) for angle in (0.4, 1.8))
    assert free == pytest.approx(hankel2(0, K / 20 * direct) - hankel2(0, K / 20 * image), rel=1e-9)


@given(
    n=st.floats(1.05, 2.0),
    ends=st.tuples(st.floats(0.01, 0.99), st.floats(0.01, 0.99)),
    legs=st.tuples(st.floats(0.1, 30), st.floats(0.1, 30)),
)
@settings(max_examples=60, deadline=None)
def test_swapping_the_ends_or_the_faces_changes_nothing(n, ends, legs):
    phi_in, phi_out = (share * n * np.pi for share in ends)
    gain = wedge_gain(K, n, phi_in, phi_out, *legs)
    assert wedge_gain(K, n, phi_out, phi_in, *legs[::-1]) == pytest.approx(gain, rel=1e-6, abs=1e-12)
    mirrored = wedge_gain(K, n, n * np.pi - phi_in, n * np.pi - phi_out, *legs)
    assert mirrored == pytest.approx(gain, rel=1e-5, abs=1e-10)


@pytest.mark.parametrize("n", [1.25, 1.5, 2.0])
def test_gain_is_finite_and_jumps_by_one_at_the_shadow_boundary(n):
    boundary = 0.2 + np.pi
    below, on, above = wedge_gain(K, n, 0.2, boundary + np.array([-1e-8, 0.0, 1e-8]), 2.0, 3.0)
    assert np.isfinite(on)
    assert above - below == pytest.approx(1.0, abs=1e-3)
    assert abs(on) == pytest.approx(0.5, abs=0.05)


def test_soft_field_vanishes_on_both_faces():
    gain = wedge_gain(K, 1.5, 0.4, np.array([0.0, 1.5 * np.pi]), 2.0, 3.0)
    assert np.abs(gain).max() < 1e-12
