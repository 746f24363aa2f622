import numpy as np
import pytest
import scipy.fft

from estimation.channel.model.false_alarms import (
    delay_curvatures,
    detection_level,
    direction_curvatures,
    exceedance_probability,
    region_curvatures,
)
from estimation.channel.model.manifold import Manifold
from sim.signal.arrays.array import upa_positions_m
from sim.signal.arrays.beams import beams_from_weights
from sim.signal.arrays.codebook import Codebook, codebook_on_panels


def test_level_of_one_cell_is_that_of_an_exponential_variable() -> None:
    level = detection_level(0.01, np.array([1.0]))
    assert np.isclose(level, -np.log(-np.log(0.99)))


@pytest.mark.parametrize("probability", [0.1, 1e-2, 1e-4, 1e-8])
def test_level_is_exceeded_with_the_given_probability(probability: float) -> None:
    curvatures = np.array([0.0, 300.0, 1000.0, 2e4])
    assert np.isclose(exceedance_probability(detection_level(probability, curvatures), curvatures), probability)


def test_expected_euler_characteristic_in_three_dimensions() -> None:
    """e^-t [1 + m1 sqrt(t / pi) + m2 (t - 1/2) / pi + m3 sqrt(t) (t - 3/2) / pi^1.5], Worsley (1994)."""
    t, m1, m2, m3 = 15.0, 3.0, 20.0, 70.0
    expected = np.exp(-t) * (
        1 + m1 * np.sqrt(t / np.pi) + m2 * (t - 0.5) / np.pi + m3 * np.sqrt(t) * (t - 1.5) / np.pi**1.5
    )
    assert np.isclose(exceedance_probability(t, np.array([1.0, m1, m2, m3])), expected, rtol=1e-3)


@pytest.mark.parametrize("probability", [0.0, 1.0, -1.0])
def test_probabilities_outside_the_open_interval_are_refused(probability: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        detection_level(probability, np.array([1.0]))


def test_curvatures_of_a_product_multiply() -> None:
    box = region_curvatures(np.array([1.0, 2.0]), np.array([1.0, 3.0]), np.array([1.0, 5.0]))
    assert np.allclose(box, [1, 10, 31, 30])  # of a box: sums of edges, faces, and its volume


def _bare_array(rows: int, columns: int) -> Codebook:
    """Isotropic elements, each a beam of its own."""
    position_m = upa_positions_m(rows, columns, 60e9)
    beams = beams_from_weights(position_m, 60e9, np.eye(len(position_m), dtype=complex), "isotropic")
    return codebook_on_panels(beams, position_m, 60e9, panel_azimuth_rad=[0.0], element_pattern="isotropic")


def test_length_of_single_elements_is_that_of_the_array() -> None:
    manifold = Manifold(_bare_array(rows=1, columns=8))
    low, high = np.sin(manifold.azimuth_range_rad)
    expected = np.pi * np.sqrt((8**2 - 1) / 12) * (high - low)
    assert np.allclose(direction_curvatures(manifold), [1.0, expected], rtol=1e-3)


def test_area_of_single_elements_is_that_of_the_array() -> None:
    """Metric pi^2 / 12 (N^2 - 1) in either direction cosine: the area is that of their range."""
    manifold = Manifold(_bare_array(rows=4, columns=6))
    azimuth, elevation = np.meshgrid(manifold.azimuths(), np.linspace(*manifold.elevation_range_rad, 200))
    density = np.abs(np.cos(azimuth)) * np.cos(elevation) ** 2
    cosines = np.trapezoid(np.trapezoid(density, azimuth[0], axis=1), elevation[:, 0])
    expected = np.pi**2 / 12 * np.sqrt((4**2 - 1) * (6**2 - 1)) * cosines
    assert np.isclose(direction_curvatures(manifold)[2], expected, rtol=0.02)


@pytest.mark.parametrize(("n_bins", "n_subcarriers"), [(64, 64), (20, 64)])
def test_rate_of_exceedance_over_delay(n_bins: int, n_subcarriers: int) -> None:
    """Noise through the matched filter at 16 delays per bin: as many maxima above the level as predicted."""
    rng = np.random.default_rng(5)
    n_trials, probability = 4000, 0.1
    level = detection_level(probability, delay_curvatures(n_bins, n_subcarriers))
    shape = (n_trials, n_subcarriers)
    noise = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    field = np.abs(scipy.fft.ifft(noise, 16 * n_subcarriers, norm="forward")) ** 2 / n_subcarriers
    rate = (field[:, : 16 * n_bins].max(axis=1) > level).mean()
    assert abs(rate - probability) < 4 * np.sqrt(probability / n_trials)
