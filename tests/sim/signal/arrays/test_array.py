"""Arrays and codebooks against closed forms."""

import numpy as np
import pytest

from scenes.pose import SPEED_OF_LIGHT_M_S, direction, wrap_angle
from sim.signal.arrays.array import element_amplitude, steering_vector, upa_positions_m
from sim.signal.arrays.codebook import beam_response, steered_codebook

CARRIER_HZ = 60e9
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / CARRIER_HZ


def test_positions_are_centred_half_wavelength_grid() -> None:
    positions = upa_positions_m(4, 16, CARRIER_HZ)
    assert positions.shape == (64, 3)
    np.testing.assert_allclose(positions.mean(axis=0), 0, atol=1e-15)
    np.testing.assert_allclose(np.ptp(positions, axis=0), [0, 7.5 * WAVELENGTH_M, 1.5 * WAVELENGTH_M])


def test_steering_phase_is_the_path_length_difference() -> None:
    rng = np.random.default_rng(0)
    positions = upa_positions_m(2, 3, CARRIER_HZ)
    azimuth, elevation = rng.uniform(-1, 1, 2)
    far = 1e4 * direction(azimuth, elevation)
    difference = np.linalg.norm(far) - np.linalg.norm(far - positions, axis=1)
    expected = np.exp(2j * np.pi * difference / WAVELENGTH_M)
    np.testing.assert_allclose(steering_vector(positions, CARRIER_HZ, azimuth, elevation), expected, atol=1e-4)


def test_element_pattern_of_tr38901() -> None:
    assert element_amplitude("tr38901", 0, 0) ** 2 == pytest.approx(10**0.8)
    half_power = np.deg2rad(32.5)
    assert 10 * np.log10(element_amplitude("tr38901", half_power, 0) ** 2) == pytest.approx(8 - 3)
    assert 10 * np.log10(element_amplitude("tr38901", np.pi, 0) ** 2) == pytest.approx(8 - 30)
    with pytest.raises(ValueError, match="element_pattern = 'dipole'"):
        element_amplitude("dipole", 0, 0)


def test_steered_beam_reaches_full_array_gain() -> None:
    codebook = steered_codebook(
        upa_positions_m(4, 16, CARRIER_HZ), CARRIER_HZ,
        panel_azimuth_rad=[0.3, -2.0], beams_per_panel=9, sector_rad=2.0, element_pattern="isotropic",
    )  # fmt: skip
    response = beam_response(codebook, codebook.azimuth_rad, codebook.elevation_rad)
    np.testing.assert_allclose(np.diag(response), 8.0, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(codebook.weights, axis=1), 1)


def test_broadside_beam_is_the_dirichlet_kernel() -> None:
    codebook = steered_codebook(
        upa_positions_m(1, 16, CARRIER_HZ), CARRIER_HZ,
        panel_azimuth_rad=[0.0], beams_per_panel=1, sector_rad=1.0, element_pattern="isotropic",
    )  # fmt: skip
    azimuth = np.linspace(-1.5, 1.5, 301)
    x = np.pi * np.sin(azimuth) / 2
    expected = 16 * np.sinc(16 * x / np.pi) / np.sinc(x / np.pi) / 4
    np.testing.assert_allclose(beam_response(codebook, azimuth)[0], expected, atol=1e-9)


def test_horizontal_beams_see_the_cone_angle() -> None:
    """sin(azimuth) cos(elevation) is all that one row of elements measures."""
    codebook = steered_codebook(
        upa_positions_m(1, 16, CARRIER_HZ), CARRIER_HZ,
        panel_azimuth_rad=[0.0], beams_per_panel=8, sector_rad=2.0, element_pattern="isotropic",
    )  # fmt: skip
    azimuth, elevation = 0.6, 0.3
    cone = np.arcsin(np.sin(azimuth) * np.cos(elevation))
    np.testing.assert_allclose(
        beam_response(codebook, azimuth, elevation), beam_response(codebook, cone, 0.0), atol=1e-9
    )


def test_four_panels_cover_the_circle_evenly() -> None:
    codebook = steered_codebook(
        upa_positions_m(4, 16, CARRIER_HZ), CARRIER_HZ,
        panel_azimuth_rad=np.deg2rad([-180, -90, 0, 90]).tolist(), beams_per_panel=24, sector_rad=np.pi / 2,
    )  # fmt: skip
    gaps = np.diff(np.sort(codebook.azimuth_rad), append=np.sort(codebook.azimuth_rad)[0] + 2 * np.pi)
    assert np.rad2deg(gaps).max() < 5
    assert (np.abs(wrap_angle(codebook.azimuth_rad - codebook.panel_azimuth_rad)) < np.pi / 4).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"beams_per_panel": 0}, "beams_per_panel = 0"),
        ({"panel_azimuth_rad": []}, "panel_azimuth_rad is empty"),
        ({"sector_rad": 4.0}, "sector = 229.183 deg"),
    ],
)
def test_bad_codebooks(changes: dict[str, object], message: str) -> None:
    settings = {"panel_azimuth_rad": [0.0], "beams_per_panel": 4, "sector_rad": 1.0} | changes
    with pytest.raises(ValueError, match=message):
        steered_codebook(upa_positions_m(1, 4, CARRIER_HZ), CARRIER_HZ, **settings)  # type: ignore[arg-type]


def test_array_needs_an_element() -> None:
    with pytest.raises(ValueError, match="rows, columns = 0, 4"):
        upa_positions_m(0, 4, CARRIER_HZ)


def test_steering_is_the_plane_wave_of_any_arrangement() -> None:
    rng = np.random.default_rng(8)
    irregular = rng.uniform(-0.02, 0.02, (9, 3))
    column = np.stack([np.zeros(5), np.full(5, 1e-3), np.arange(5) * 2e-3], axis=1)
    for position_m in (irregular, column, upa_positions_m(4, 16, 60e9), np.array([[1e-3, 0.0, 0.0]])):
        azimuth, elevation = rng.uniform(-3, 3, 20), rng.uniform(-1.5, 1.5, 20)
        path_m = direction(azimuth, elevation) @ position_m.T
        expected = np.exp(2j * np.pi * 60e9 / SPEED_OF_LIGHT_M_S * path_m)
        np.testing.assert_allclose(steering_vector(position_m, 60e9, azimuth, elevation), expected, atol=1e-12)
