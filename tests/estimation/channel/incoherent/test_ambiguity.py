"""Elevation without phases: ambiguous directions are in the covariance and reported, never a silent bias."""

import numpy as np
import pytest

from estimation.channel.estimate import estimate_channel
from estimation.channel.incoherent.paths import fit_incoherent
from estimation.channel.record import AngleKind, ChannelEstimate
from sim.config import ArrayConfig
from tests.estimation.channel.plain_sweeps import plain_link, plain_paths, plain_sweep

LEVEL = ArrayConfig(columns=8, beams_per_panel=10, sector_deg=120.0)
TWO_LEVELS = ArrayConfig(columns=8, rows=4, beams_per_panel=10, sector_deg=110.0, beam_elevation_deg=[-15.0, 15.0])
FOUR_LEVELS = ArrayConfig(
    columns=8, rows=4, beams_per_panel=6, sector_deg=110.0, beam_elevation_deg=[-35.0, -12.0, 12.0, 35.0]
)
DIRECTIONS = np.array([[-20.0, 17.0], [30.0, -9.0]])
CONES = np.rad2deg(np.arcsin(np.sin(np.deg2rad([10.0, -35.0])) * np.cos(np.deg2rad([14.0, 20.0]))))


def estimated(tx: ArrayConfig, method: str, seed: int = 1) -> ChannelEstimate:
    link = plain_link(tx, LEVEL)
    arrival = np.array([[10.0, -14.0], [-35.0, 20.0]])
    paths = plain_paths(link, [30.0, 90.0], DIRECTIONS, arrival, [35.0, 28.0])
    return estimate_channel(plain_sweep(link, paths, np.random.default_rng(seed)), method)


def departures(estimate: ChannelEstimate) -> tuple[np.ndarray, np.ndarray]:
    """Errors (path, 2) in azimuth and elevation of departure in rad, and their covariances."""
    angles = np.stack([estimate.aod_azimuth_rad, estimate.aod_elevation_rad], axis=1)
    return angles - np.deg2rad(DIRECTIONS), estimate.covariance[:, 1::2, 1::2][:, :2, :2]


@pytest.mark.parametrize("method", ["incoherent", "auto"])
@pytest.mark.parametrize("beams", [TWO_LEVELS, FOUR_LEVELS], ids=["two", "four"])
def test_directions_lie_within_their_covariances_for_all_beams(beams: ArrayConfig, method: str) -> None:
    estimate = estimated(beams, method)
    assert len(estimate) == 2
    assert estimate.aod_angle_kind == AngleKind.AZIMUTH
    error, covariance = departures(estimate)
    assert (np.einsum("pa,pab,pb->p", error, np.linalg.inv(covariance), error) < 16).all()
    wide = np.sqrt(covariance[:, 1, 1]) > np.deg2rad(2)
    if wide.any():
        assert f"{wide.sum()} of 2 paths fit several directions equally" in estimate.reason


def test_beams_at_two_elevations_are_ambiguous_in_elevation_without_phases() -> None:
    assert "fit several directions equally" in estimated(TWO_LEVELS, "incoherent").reason
    sure = estimated(TWO_LEVELS, "coherent")
    error, covariance = departures(sure)
    assert np.sqrt(covariance[:, 1, 1]).max() < np.deg2rad(1)
    assert np.abs(error).max() < np.deg2rad(1)


@pytest.mark.parametrize("method", ["coherent", "incoherent", "auto"])
def test_an_end_of_horizontal_beams_has_cone_angles_if_the_other_has_elevation(method: str) -> None:
    estimate = estimated(FOUR_LEVELS, method)
    assert estimate.aoa_angle_kind == AngleKind.CONE
    assert np.isnan(estimate.aoa_elevation_rad).all()
    std = np.sqrt(estimate.covariance[:, 2, 2])
    assert (np.abs(estimate.aoa_azimuth_rad - np.deg2rad(CONES)) < 5 * std + np.deg2rad(0.3)).all()
    assert np.isnan(estimate.covariance[:, 4]).all()


def test_horizontal_beams_are_not_ambiguous() -> None:
    link = plain_link(LEVEL, LEVEL)
    paths = plain_paths(link, [30.0, 90.0], [-20.0, 30.0], [10.0, -35.0], [35.0, 28.0])
    fit = fit_incoherent(plain_sweep(link, paths, np.random.default_rng(1)))
    assert not fit.is_ambiguous.any()
    assert fit.caveat == ""


@pytest.mark.parametrize("phase_rad", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
def test_a_path_and_its_reflection_off_the_floor_are_not_taken_for_one_far_above(phase_rad: float) -> None:
    """Their sum shows beams at two elevations a ratio that a single path has only near the zenith."""
    beams = TWO_LEVELS.model_copy(update={"beam_elevation_deg": [-12.0, 12.0]})
    link = plain_link(beams, beams)
    paths = plain_paths(
        link, [30.0, 31.0], [[2, 0], [2, -6]], [[-60, 0], [-60, -6]], [50, 44], phase=[0, phase_rad]
    )
    fit = fit_incoherent(plain_sweep(link, paths, np.random.default_rng(1)))
    assert len(fit) == 2
    strongest = np.argmax(fit.snr_db)
    assert abs(fit.delay_s[strongest] - 30e-9) < 0.5e-9
    np.testing.assert_allclose(np.rad2deg(fit.aod_rad[strongest]), [2, 0], atol=2)
    np.testing.assert_allclose(np.rad2deg(fit.aoa_rad[strongest]), [-60, 0], atol=2)


def test_phases_are_tested_where_every_path_fits_several_directions() -> None:
    assert "2 of 2 paths fit several directions" in estimated(TWO_LEVELS, "incoherent").reason
    chosen = estimated(TWO_LEVELS, "auto")
    assert len(chosen) == 2 and chosen.reason.startswith("coherent: ")
