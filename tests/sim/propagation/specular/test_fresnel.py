"""Slab coefficients against closed forms, and the polarisation of a reflected wave against vector algebra."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.pose import SPEED_OF_LIGHT_M_S
from sim.propagation.specular.fresnel import slab_reflection, vertical_polarisation, vertical_reflection

CARRIER_HZ = 60e9
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / CARRIER_HZ
COSINES = np.linspace(0.02, 1, 50)
METAL = 1 - 1j * 1e7 / (2 * np.pi * CARRIER_HZ * 8.8541878128e-12)

unit_components = st.floats(-1, 1)
vectors = st.tuples(unit_components, unit_components, unit_components).filter(
    lambda v: np.hypot(v[0], v[1]) > 0.05
)


def unit(vector):
    return np.asarray(vector) / np.linalg.norm(vector)


def mirrored(incident, normal):
    return incident - 2 * (incident @ normal) * normal


def test_half_wave_slab_is_invisible_at_normal_incidence():
    permittivity = 4.0
    thickness = WAVELENGTH_M / 2 / np.sqrt(permittivity)
    r_s, r_p = slab_reflection(1.0, permittivity, thickness, CARRIER_HZ)
    assert abs(r_s) < 1e-12
    assert abs(r_p) < 1e-12


def test_quarter_wave_slab_at_normal_incidence():
    permittivity = 9.0
    thickness = WAVELENGTH_M / 4 / np.sqrt(permittivity)
    r_s, r_p = slab_reflection(1.0, permittivity, thickness, CARRIER_HZ)
    impedance = 1 / permittivity  # eta_0 times this is what the slab turns the air behind it into
    assert r_s == pytest.approx((impedance - 1) / (impedance + 1))
    assert r_p == pytest.approx(-(impedance - 1) / (impedance + 1))


def test_thick_lossy_slab_is_a_half_space_with_a_brewster_dip():
    permittivity = 5.0 - 0.01j
    tangent = np.sqrt(5.0)
    brewster = 1 / np.sqrt(1 + tangent**2)
    r_s, r_p = slab_reflection(np.array([brewster, 1.0]), permittivity, 5.0, CARRIER_HZ)
    assert abs(r_p[0]) < 1e-3
    assert abs(r_s[0]) > 0.5
    index = np.sqrt(permittivity)
    assert r_s[1] == pytest.approx((1 - index) / (1 + index), abs=1e-9)


def test_lossless_slab_never_amplifies_and_air_reflects_nothing():
    for permittivity in (2.0, 6.31, 15.0):
        for thickness in (0.001, 0.0038, 0.1):
            r_s, r_p = slab_reflection(COSINES, permittivity, thickness, CARRIER_HZ)
            assert np.all(np.abs(r_s) <= 1 + 1e-12)
            assert np.all(np.abs(r_p) <= np.abs(r_s) + 1e-12)
    assert np.all(np.abs(slab_reflection(COSINES, 1.0, 0.1, CARRIER_HZ)) < 1e-12)


def test_metal_tends_to_the_perfect_conductor():
    metal = slab_reflection(COSINES[5:], METAL, 0.002, CARRIER_HZ)
    perfect = slab_reflection(COSINES[5:], complex("inf"), 0.002, CARRIER_HZ)
    np.testing.assert_allclose(metal, perfect, atol=0.02)
    assert perfect[0][0] == -1
    assert perfect[1][0] == 1


@given(vectors)
def test_polarisation_is_a_unit_vector_normal_to_travel_in_its_vertical_plane(vector):
    k = unit(vector)
    field = vertical_polarisation(k)
    assert np.linalg.norm(field) == pytest.approx(1)
    assert field @ k == pytest.approx(0, abs=1e-12)
    assert np.cross(field, k)[2] == pytest.approx(0, abs=1e-12)
    assert field[2] <= 0


@given(vectors, vectors)
def test_perfect_conductor_turns_the_tangential_field(incident, normal):
    k_in, n = unit(incident), unit(normal)
    k_out = mirrored(k_in, n)
    if np.hypot(*k_out[:2]) < 1e-3:
        return
    sent = vertical_polarisation(k_in)
    expected = vertical_polarisation(k_out) @ (2 * (n @ sent) * n - sent)
    gain = vertical_reflection(k_in, k_out, n, -1.0, 1.0)
    assert gain == pytest.approx(expected, abs=1e-9)
    assert vertical_reflection(k_in, k_out, -n, -1.0, 1.0) == pytest.approx(gain, abs=1e-9)


def test_level_wave_on_a_vertical_wall_sees_the_s_coefficient_alone():
    k_in, n = unit([1.0, -2.0, 0.0]), np.array([0.0, 1.0, 0.0])
    assert vertical_reflection(k_in, mirrored(k_in, n), n, 0.3 - 0.4j, 99.0) == pytest.approx(0.3 - 0.4j)


def test_floor_sees_the_p_coefficient_alone():
    k_in, n = unit([1.0, -2.0, -1.5]), np.array([0.0, 0.0, 1.0])
    gain = vertical_reflection(k_in, mirrored(k_in, n), n, 99.0, 0.3 - 0.4j)
    assert abs(gain) == pytest.approx(0.5)


def test_many_reflections_at_once():
    rng = np.random.default_rng(1)
    k_in, n = rng.normal(size=(2, 20, 3))
    k_in /= np.linalg.norm(k_in, axis=1, keepdims=True)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    k_out = k_in - 2 * (k_in * n).sum(axis=1, keepdims=True) * n
    r_s, r_p = slab_reflection(np.abs((k_in * n).sum(axis=1)), 5 - 0.3j, 0.05, CARRIER_HZ)
    together = vertical_reflection(k_in, k_out, n, r_s, r_p)
    singly = [vertical_reflection(*one) for one in zip(k_in, k_out, n, r_s, r_p, strict=True)]
    np.testing.assert_allclose(together, singly)
