import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.channel.model.manifold import CELL, Manifold
from sim.config import ArrayConfig
from sim.signal.arrays.codebook import Codebook, beam_response
from sim.signal.hardware.impairments import with_element_errors
from sim.signal.link import make_codebook
from tests.estimation.channel.plain_sweeps import PANELS, plain_link

ARRAYS = {
    "steered": ArrayConfig(sector_deg=120.0),
    "four_panels": ArrayConfig(panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0], beams_per_panel=12, sector_deg=90.0),
    "tilted": ArrayConfig(
        panel_azimuth_deg=[-60.0, 60.0], panel_tilt_deg=[10.0, -10.0], polarisation_slant_deg=30.0
    ),
    "elevation": ArrayConfig(beam_elevation_deg=[-20.0, 0.0, 20.0], beams_per_panel=8),
    "dft": ArrayConfig(codebook="dft", columns=8),
    "campus": ArrayConfig(codebook="campus_63"),
    "two_bits": ArrayConfig(phase_bits=2),
    "isotropic": ArrayConfig(element_pattern="isotropic"),
}


def _book(name: str) -> Codebook:
    return make_codebook(ARRAYS[name], 60e9)


@pytest.mark.parametrize("name", ARRAYS)
def test_responses_are_those_of_the_beams(name: str) -> None:
    book = _book(name)
    manifold = Manifold(book)
    angles = np.random.default_rng(1).uniform(-1.2, 1.2, (40, manifold.n_angles))
    elevation = angles[:, 1] if manifold.n_angles == 2 else 0.0
    expected = beam_response(book, angles[:, 0], elevation).T
    assert np.allclose(manifold.response(angles), expected, atol=1e-9)
    assert np.allclose(manifold.tangents(angles)[:, 0], expected, atol=1e-9)


@pytest.mark.parametrize("name", ARRAYS)
def test_derivatives_are_the_limit_of_differences(name: str) -> None:
    manifold = Manifold(_book(name))
    angles = np.random.default_rng(2).uniform(-1.0, 1.0, (30, manifold.n_angles))
    step = 1e-5
    for axis in range(manifold.n_angles):
        offset = step * np.eye(manifold.n_angles)[axis]
        difference = (manifold.response(angles + offset) - manifold.response(angles - offset)) / (2 * step)
        jacobian = manifold.tangents(angles)[:, 1 + axis]
        assert np.abs(jacobian - difference).max() < 1e-7 * np.abs(jacobian).max()


@pytest.mark.parametrize(
    ("array", "n_angles"),
    [
        (ArrayConfig(), 1),
        (ArrayConfig(panel_azimuth_deg=[-90.0, 0.0, 90.0]), 1),
        (ArrayConfig(rows=1, codebook="dft"), 1),
        (ArrayConfig(rows=1, columns=1, beams_per_panel=3), 1),
        (ArrayConfig(beams_per_panel=1), 1),
        (ArrayConfig(beam_elevation_deg=[0.0, 15.0]), 2),
        (ArrayConfig(codebook="dft"), 2),
    ],
)
def test_elevation_is_an_angle_only_if_beams_resolve_it(array: ArrayConfig, n_angles: int) -> None:
    assert Manifold(make_codebook(array, 60e9)).n_angles == n_angles


def test_estimated_weights_keep_the_angles_of_the_design() -> None:
    assert Manifold(_book("steered"), n_angles=2).n_angles == 2
    assert Manifold(_book("dft"), n_angles=1).n_angles == 1


@settings(max_examples=20, deadline=None)
@given(azimuth=st.floats(-1.2, 1.2))
def test_metric_of_a_full_set_of_beams_is_that_of_the_bare_array(azimuth: float) -> None:
    """DFT beams of a row are an orthogonal transform of its elements: variance of the phase slope pi n cos(az)."""
    book = make_codebook(ArrayConfig(rows=1, columns=9, codebook="dft", element_pattern="isotropic"), 60e9)
    expected = (np.pi * np.cos(azimuth)) ** 2 * (9**2 - 1) / 12
    assert np.isclose(Manifold(book).metric(np.array([[azimuth]]))[0, 0, 0], expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["steered", "four_panels", "campus"])
def test_grid_is_even_on_the_manifold_without_gaps(name: str) -> None:
    manifold = Manifold(_book(name))
    grid = manifold.grid(2.0)
    azimuth = np.unwrap(grid[:, 0])
    fine = np.linspace(azimuth[:-1], azimuth[1:], 50)
    speed = np.sqrt(manifold.metric(fine.reshape(-1, 1))[:, 0, 0]).reshape(fine.shape)
    length = np.trapezoid(speed, fine, axis=0)
    assert length.max() < 1.02 * CELL / 2
    assert length.min() > 0.9 * length.max()
    assert manifold.is_closed == (name == "four_panels")


def test_grid_of_beams_with_elevation_covers_both_angles() -> None:
    manifold = Manifold(_book("elevation"))
    grid = manifold.grid(2.0)
    directions = np.random.default_rng(3).uniform([-1.0, -0.5], [1.0, 0.5], (50, 2))
    unit = manifold.response(grid) / np.linalg.norm(manifold.response(grid), axis=1, keepdims=True)
    seen = manifold.response(directions)
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    assert (np.abs(seen @ unit.conj().T) ** 2).max(axis=1).min() > 0.8**2


def test_one_beam_resolves_no_directions() -> None:
    manifold = Manifold(make_codebook(ArrayConfig(beams_per_panel=1), 60e9))
    assert manifold.grid(2.0).shape == (1, 1)
    assert np.allclose(manifold.metric(np.array([[0.3]])), 0.0, atol=1e-9)


def test_combined_beams_respond_with_their_sum() -> None:
    manifold = Manifold(_book("four_panels"))
    rng = np.random.default_rng(4)
    matrix = rng.standard_normal((5, manifold.n_beams)) + 1j * rng.standard_normal((5, manifold.n_beams))
    angles = rng.uniform(-3, 3, (7, 1))
    combined = manifold.combined(matrix)
    assert combined.n_beams == 5
    assert np.allclose(combined.response(angles), manifold.response(angles) @ matrix.T)
    assert np.allclose(combined.tangents(angles)[:, 1:], manifold.tangents(angles)[:, 1:] @ matrix.T)


def test_symmetric_arrays_have_real_responses() -> None:
    book = _book("steered")
    assert Manifold(book).is_real
    assert not Manifold(with_element_errors(book, 0.0, 0.1, np.random.default_rng(6))).is_real


def test_azimuths_behind_all_panels_are_mirrored_to_the_front() -> None:
    one = Manifold(plain_link().tx_codebook)
    np.testing.assert_allclose(
        np.rad2deg(one.in_front(np.deg2rad([-141.8, 170.0, 60.0, -90.0]))), [-38.2, 10.0, 60.0, -90.0]
    )
    angles = np.deg2rad([[-141.8], [-38.2]])
    behind, front = one.response(angles)
    shares = np.abs(behind) / np.linalg.norm(behind), np.abs(front) / np.linalg.norm(front)
    np.testing.assert_allclose(*shares, atol=1e-9)
    four = Manifold(plain_link(rx=PANELS).rx_codebook)
    every = np.linspace(-3.1, 3.1, 9)
    np.testing.assert_array_equal(four.in_front(every), every)
