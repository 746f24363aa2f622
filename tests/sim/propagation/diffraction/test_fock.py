"""Reflection near grazing and creeping waves on conducting cylinders against the eigenfunction series."""

import numpy as np
import pytest
from scipy.special import hankel2

from isac_arena.validation.propagation import exact_fields
from sim.propagation.diffraction.fock import (
    REFLECTION_SERIES_BELOW,
    RESIDUE_SERIES_ABOVE,
    creeping_gain,
    grazing_factor,
    pekeris_function,
)

K = 2 * np.pi * 60e9 / 299_792_458.0
POLARISATIONS = ("soft", "hard")


def test_pekeris_functions_at_the_shadow_boundary():
    # Logan's tables: p*(0) = 0.3066 e^{j pi/6} / cos(pi/6), q*(0) = -0.2660 e^{j pi/6} / cos(pi/6)
    np.testing.assert_allclose(pekeris_function(0.0, "soft"), 0.3541 * np.exp(1j * np.pi / 6), atol=2e-4)
    np.testing.assert_allclose(pekeris_function(0.0, "hard"), -0.3072 * np.exp(1j * np.pi / 6), atol=2e-4)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
@pytest.mark.parametrize("joint", [REFLECTION_SERIES_BELOW, RESIDUE_SERIES_ABOVE])
def test_pekeris_representations_meet(polarisation, joint):
    below, above = pekeris_function(joint + np.array([-1e-9, 1e-9]), polarisation)
    assert abs(above - below) < 5e-5 * abs(below)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_phase_and_amplitude_of_the_reflected_field(polarisation):
    radius, s1, s2 = 1.0, 5.0, 3.0
    sign = -1 if polarisation == "soft" else 1
    for incidence in np.deg2rad([20, 60, 75, 82]):
        cosine, sine = np.cos(incidence), np.sin(incidence)
        tx = np.array([radius + s1 * cosine, s1 * sine])
        rx = np.array([radius + s2 * cosine, -s2 * sine])
        exact = exact_fields.cylinder_series(K, radius, tx, rx, sign)[0] / hankel2(0, K * (s1 + s2))
        optics = sign / np.sqrt(1 + 2 * s1 * s2 / ((s1 + s2) * radius * cosine))
        error = optics * grazing_factor(K, radius, s1, s2, cosine, polarisation) / exact
        assert abs(error - 1) < 0.01


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_factor_tends_to_one_away_from_grazing_and_for_large_radii(polarisation):
    assert grazing_factor(K, 0.2, 3.0, 4.0, 1.0, polarisation) == pytest.approx(1, abs=3e-3)
    radius = np.geomspace(1, 1e6, 7)
    deviation = np.abs(grazing_factor(K, radius, 3.0, 4.0, np.cos(np.deg2rad(80)), polarisation) - 1)
    assert np.all(np.diff(deviation) < 0)
    assert deviation[-1] < 1e-6


def test_concave_and_flat_contours_are_left_alone():
    factor = grazing_factor(K, np.array([-2.0, np.inf, 0.0, np.nan]), 1.0, 1.0, 0.1, "soft")
    np.testing.assert_array_equal(factor, 1)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_lit_and_shadow_side_meet_at_half_the_field_and_less(polarisation):
    radius, s1, s2 = 0.3, 4.0, 2.0
    sign = -1 if polarisation == "soft" else 1
    lit = 1 + sign * np.sqrt(radius * 1e-10 * (s1 + s2) / (2 * s1 * s2)) * grazing_factor(
        K, radius, s1, s2, 1e-10, polarisation
    )
    dark = creeping_gain(K, radius, s1, s2, 1e-12, polarisation)
    assert lit == pytest.approx(dark, rel=1e-4)
    assert creeping_gain(K, radius, s1, s2, 0.05, polarisation) != pytest.approx(dark, rel=0.05)


def test_soft_waves_creep_less_far_than_hard_ones_and_decay_as_the_first_mode():
    turn = np.array([0.5, 0.6])
    soft, hard = (np.abs(creeping_gain(K, 0.2, 30.0, 30.0, turn, p)) for p in POLARISATIONS)
    assert np.all(soft < hard)
    m = np.cbrt(K * 0.2 / 2)
    assert np.log(hard[0] / hard[1]) == pytest.approx(m * 0.1 * 1.01879 * np.cos(np.pi / 6), rel=0.05)
