"""Beams, tapers, panels and polarisation against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.pose import direction, wrap_angle
from sim.config import ArrayConfig
from sim.signal.arrays.array import (
    from_panel,
    panel_axes,
    steering_vector,
    to_panel,
    upa_positions_m,
    upa_taper,
    vertical_polarisation,
)
from sim.signal.arrays.beams import (
    PanelBeams,
    beams_from_weights,
    campus_azimuths,
    dft_beams,
    hierarchical_beams,
    quantised_phase,
    shaped_beams,
    sine_spaced_azimuths,
    steered_beams,
)
from sim.signal.arrays.codebook import beam_response, codebook_on_panels
from sim.signal.link import make_codebook

CARRIER_HZ = 60e9
UPA = upa_positions_m(4, 16, CARRIER_HZ)
angles = st.floats(-1.4, 1.4)


def broadside(columns: int) -> PanelBeams:
    return steered_beams(upa_positions_m(1, columns, CARRIER_HZ), CARRIER_HZ, np.zeros(1), np.zeros(1))


def test_dft_beams_are_orthonormal_and_peak_on_their_grid() -> None:
    beams = dft_beams(UPA, CARRIER_HZ, 4, 16)
    np.testing.assert_allclose(beams.weights @ beams.weights.conj().T, np.eye(len(beams)), atol=1e-12)
    response = beams.weights @ steering_vector(UPA, CARRIER_HZ, beams.azimuth_rad, beams.elevation_rad).T
    np.testing.assert_allclose(np.abs(response), 8 * np.eye(len(beams)), atol=1e-11)
    assert ((np.abs(beams.azimuth_rad) < 1e-12) & (beams.elevation_rad == 0)).sum() == 1
    assert len(beams) == 15 + 2 * 13 and set(np.round(np.rad2deg(beams.elevation_rad), 3)) == {-30, 0, 30}


def test_dft_beams_of_a_half_wavelength_row_share_all_power() -> None:
    row = upa_positions_m(1, 7, CARRIER_HZ)
    beams = dft_beams(row, CARRIER_HZ, 1, 7)
    total = (np.abs(beams.weights @ steering_vector(row, CARRIER_HZ, np.linspace(-1.5, 1.5, 50), 0).T) ** 2).sum(0)
    np.testing.assert_allclose(total, 7)


def test_campus_beams() -> None:
    azimuth = np.rad2deg(campus_azimuths())
    assert len(azimuth) == 63 and azimuth[31] == 0
    np.testing.assert_allclose(azimuth[[0, -1]], [-45, 45])
    np.testing.assert_allclose(np.diff(azimuth), 1.45, atol=0.002)
    assert len(campus_azimuths(np.deg2rad(30))) == 21


def test_turned_campus_beams_cover_the_circle_in_steps_of_about_1_45_deg() -> None:
    config = ArrayConfig(
        codebook="campus_63", sector_deg=30.0, panel_azimuth_deg=[30.0 * turn for turn in range(12)]
    )
    azimuth = np.sort(np.rad2deg(make_codebook(config, CARRIER_HZ).azimuth_rad))
    gaps = np.diff(azimuth, append=azimuth[0] + 360)
    assert len(azimuth) == 252 and gaps.max() < 1.46 and gaps.min() > 0.9


def test_every_level_of_the_hierarchy_covers_the_sector() -> None:
    sector = np.deg2rad(120)
    beams = hierarchical_beams(UPA, CARRIER_HZ, 16, 4, sector)
    assert len(beams) == 1 + 2 + 4 + 8
    np.testing.assert_allclose(np.linalg.norm(beams.weights, axis=1), 1)
    inside = np.linspace(-sector / 2, sector / 2, 181)
    response = np.abs(beams.weights @ steering_vector(UPA, CARRIER_HZ, inside, 0.0).T)
    start, weakest = 0, []
    for level in range(4):
        rows = slice(start, start + 2**level)
        start += 2**level
        weakest.append(response[rows].max(axis=0).min() / response[rows].max())
        winner = response[rows].argmax(axis=0)
        assert (np.diff(winner) >= 0).all() and set(winner) == set(range(2**level))
    assert min(weakest) > 0.5
    peak = [response[2**level - 1 : 2 ** (level + 1) - 1].max() for level in range(4)]
    assert (np.diff(peak) > 0).all()


def test_given_weights_point_to_where_they_are_strongest() -> None:
    made = steered_beams(UPA, CARRIER_HZ, np.deg2rad([-40, 0, 25]), np.deg2rad([0, 10, -5]))
    back = beams_from_weights(UPA, CARRIER_HZ, 3.0 * made.weights, "isotropic")
    np.testing.assert_allclose(back.weights, made.weights, atol=1e-15)
    np.testing.assert_allclose(back.azimuth_rad, made.azimuth_rad, atol=np.deg2rad(1))
    np.testing.assert_allclose(back.elevation_rad, made.elevation_rad, atol=np.deg2rad(2))


def test_bad_weights_name_the_rule() -> None:
    with pytest.raises(ValueError, match="16 per beam, the array has 64 elements"):
        beams_from_weights(UPA, CARRIER_HZ, np.ones((3, 16), complex), "tr38901")
    with pytest.raises(ValueError, match="at least 1 beam"):
        beams_from_weights(UPA, CARRIER_HZ, np.ones((0, 64), complex), "tr38901")
    for bad in (0.0, np.nan):
        weights = np.ones((3, 64), complex)
        weights[1] = bad
        with pytest.raises(ValueError, match="beam 1 has none"):
            beams_from_weights(UPA, CARRIER_HZ, weights, "tr38901")
    with pytest.raises(ValueError, match="hierarchy_levels = 6"):
        hierarchical_beams(UPA, CARRIER_HZ, 16, 6, np.pi)
    with pytest.raises(ValueError, match="phase_bits = 0"):
        quantised_phase(np.ones((1, 1), complex), 0)


def test_a_codebook_without_weights_is_refused() -> None:
    beams = steered_beams(UPA, CARRIER_HZ, np.zeros(2), np.zeros(2))
    empty = PanelBeams(beams.weights * [[1], [0]], beams.azimuth_rad, beams.elevation_rad)
    with pytest.raises(ValueError, match=r"Codebook.weights: beam 1 has none"):
        codebook_on_panels(empty, UPA, CARRIER_HZ, panel_azimuth_rad=[0.0])
    with pytest.raises(ValueError, match="axis 'element' has length 64, expected 4"):
        codebook_on_panels(beams, UPA[:4], CARRIER_HZ, panel_azimuth_rad=[0.0])


@given(st.integers(1, 6), st.floats(-np.pi, np.pi))
def test_quantised_phases_are_the_nearest_multiples(bits: int, phase: float) -> None:
    rounded = quantised_phase(np.array([[0.3 * np.exp(1j * phase)]]), bits)[0, 0]
    steps = np.angle(rounded) / (2 * np.pi / 2**bits)
    assert abs(rounded) == pytest.approx(0.3)
    assert abs(steps - round(steps)) < 1e-9
    assert abs(wrap_angle(np.angle(rounded) - phase)) <= np.pi / 2**bits + 1e-9


def test_few_bits_cost_the_textbook_gain() -> None:
    """Loss of b-bit phase shifters, uniform errors: sinc^2(1 / 2^b) of the ideal gain on average."""
    row = upa_positions_m(1, 64, CARRIER_HZ)
    azimuth = sine_spaced_azimuths(200, 2.5)
    ideal = steered_beams(row, CARRIER_HZ, azimuth, np.zeros(200))
    coarse = shaped_beams(ideal, phase_bits=2)
    steering = steering_vector(row, CARRIER_HZ, azimuth, 0.0)
    gain = np.abs((coarse.weights * steering).sum(axis=1)) ** 2 / 64
    assert gain.mean() == pytest.approx(np.sinc(0.25) ** 2, abs=0.02)


@pytest.mark.parametrize(("taper", "tolerance_db"), [("chebyshev", 0.1), ("taylor", 1.0)])
def test_tapers_reach_their_side_lobes(taper: str, tolerance_db: float) -> None:
    beams = shaped_beams(broadside(16), upa_taper(1, 16, taper, 30.0))  # type: ignore[arg-type]
    sine = np.linspace(0, 1, 4001)
    row = upa_positions_m(1, 16, CARRIER_HZ)
    level = 20 * np.log10(np.abs(beams.weights @ steering_vector(row, CARRIER_HZ, np.arcsin(sine), 0).T)[0])
    first_null = int(np.argmax(np.diff(level) > 0))
    assert level[first_null:].max() - level[0] == pytest.approx(-30, abs=tolerance_db)
    np.testing.assert_allclose(np.linalg.norm(beams.weights), 1)


def test_bad_tapers() -> None:
    with pytest.raises(ValueError, match="taper_side_lobe_db = 5"):
        upa_taper(1, 16, "taylor", 5.0)
    with pytest.raises(ValueError, match="taper = 'hann'"):
        upa_taper(1, 16, "hann")  # type: ignore[arg-type]
    assert (upa_taper(2, 3, "uniform") == 1).all()


@given(angles, angles, st.floats(-3, 3), angles)
def test_panel_frames_turn_back_and_forth(azimuth: float, elevation: float, panel: float, tilt: float) -> None:
    axes = panel_axes(panel, tilt)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    device = from_panel(azimuth, elevation, panel, tilt)
    local = to_panel(*device, panel, tilt)
    np.testing.assert_allclose(direction(*local), direction(azimuth, elevation), atol=1e-9)


def test_a_vanishing_tilt_is_no_tilt() -> None:
    beams = steered_beams(UPA, CARRIER_HZ, np.array([0.2]), np.array([0.1]))
    flat, tilted = (
        codebook_on_panels(beams, UPA, CARRIER_HZ, panel_azimuth_rad=[0.5], panel_tilt_rad=[tilt])
        for tilt in (0.0, 1e-9)
    )
    azimuth, elevation = np.linspace(-3, 3, 40), np.linspace(-1, 1, 40)
    np.testing.assert_allclose(
        beam_response(tilted, azimuth, elevation), beam_response(flat, azimuth, elevation), atol=1e-6
    )


def test_tilted_panels_keep_their_gain_along_the_boresight() -> None:
    beams = steered_beams(UPA, CARRIER_HZ, np.zeros(1), np.zeros(1))
    codebook = codebook_on_panels(beams, UPA, CARRIER_HZ, panel_azimuth_rad=[0.0, 2.0], panel_tilt_rad=[-0.3, 0.4])
    np.testing.assert_allclose(codebook.elevation_rad, [-0.3, 0.4])
    response = beam_response(codebook, codebook.azimuth_rad, codebook.elevation_rad)
    np.testing.assert_allclose(np.abs(np.diag(response)), 8 * 10**0.4, rtol=1e-12)


def test_slanted_elements_lose_the_cosine() -> None:
    assert vertical_polarisation(0.3, 0.2, 0.0, 0.0, np.pi / 4) == pytest.approx(np.sqrt(0.5))
    slanted, upright = (
        make_codebook(ArrayConfig(polarisation_slant_deg=slant), CARRIER_HZ) for slant in (60.0, 0.0)
    )
    np.testing.assert_allclose(beam_response(slanted, 0.4, 0.1), 0.5 * beam_response(upright, 0.4, 0.1))


@given(angles, st.floats(-1.2, 1.2), angles, st.floats(-1.5, 1.5))
def test_vertical_share_is_the_projection_of_the_element_field(
    azimuth: float, elevation: float, tilt: float, slant: float
) -> None:
    """The field of a slanted element, built from its own spherical unit vectors, projected on the vertical one."""
    local_azimuth, local_elevation = to_panel(azimuth, elevation, 0.0, tilt)
    theta_local = -direction(local_azimuth, local_elevation + np.pi / 2)
    phi_local = np.array([-np.sin(local_azimuth), np.cos(local_azimuth), 0.0])
    axes = panel_axes(0.0, tilt)
    field = (np.cos(slant) * theta_local + np.sin(slant) * phi_local) @ axes
    theta = -direction(azimuth, elevation + np.pi / 2)
    assert vertical_polarisation(azimuth, elevation, 0.0, tilt, slant) == pytest.approx(field @ theta, abs=1e-6)


def test_panels_and_files_have_to_agree() -> None:
    with pytest.raises(ValueError, match="must have 1 value or one for each of 1 panels"):
        ArrayConfig(panel_tilt_deg=[0.0, 10.0])
    with pytest.raises(ValueError, match="weights_file = None: must be given with codebook = 'file'"):
        ArrayConfig(codebook="file")
    with pytest.raises(ValueError, match=r"weights_file = w.npz: must be given with"):
        ArrayConfig(weights_file="w.npz")
