"""Errors of elements: their effect on directions is that of a simulation, their level is what sweeps show."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.incoherent.likelihood import LinkBeams
from estimation.channel.incoherent.response_errors import TELLING, EndErrors, ResponseErrors, expected_level
from estimation.channel.model.manifold import Manifold
from sim.config import ArrayConfig
from sim.signal.arrays.codebook import beam_response
from tests.estimation.channel.plain_sweeps import ELEVATION, plain_link, plain_paths, plain_sweep

LINK = plain_link()
LEVEL = 1e-3
FAR_APART = ArrayConfig(columns=8, beams_per_panel=9, sector_deg=140.0)  # a beam at 0 deg, the next at 15.6


def erring_response(codebook, angles, rng: np.random.Generator):
    """Response (beam,) in one direction, with errors of `LEVEL` in every element, the same for all beams."""
    n = codebook.weights.shape[1]
    error = np.sqrt(LEVEL / 2) * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    return beam_response(replace(codebook, weights=codebook.weights * (1 + error)), *angles)[:, 0]


@pytest.mark.parametrize(
    ("link", "toward"),
    [(LINK, (12.0, 0.0)), (plain_link(rx=ELEVATION), (12.0, 6.0)), (plain_link(rx=FAR_APART), (0.0, 0.0))],
    ids=["horizontal", "elevations", "pointing there"],
)
def test_directions_err_as_in_a_simulation(link, toward) -> None:
    """The weighted fit of gain and direction to magnitudes with errors, over many draws of the errors."""
    rng = np.random.default_rng(1)
    manifold = Manifold(link.rx_codebook)
    angles = np.deg2rad(toward)[: manifold.n_angles]
    errors = EndErrors.of(manifold, angles, TELLING)
    assert len(errors.beam) > 1
    true = manifold.tangents(angles[None])[0][:, errors.beam]
    slope = np.column_stack([np.ones(len(errors.beam)), (true[1:] / true[0]).real.T])
    root = np.abs(true[0])[:, None]
    found, magnitudes = [], []
    for _ in range(2000):
        other = erring_response(link.rx_codebook, np.deg2rad(toward), rng)[errors.beam]
        magnitudes.append((other / true[0]).real - 1)
        found.append(np.linalg.lstsq(root * slope, root[:, 0] * magnitudes[-1])[0][1:])
    for values, expected in ((magnitudes, errors.covariance), (found, np.squeeze(errors.angle_covariance))):
        scale = LEVEL * expected
        np.testing.assert_allclose(np.cov(np.array(values).T), scale, atol=0.1 * np.max(scale))


def test_the_level_is_exceeded_as_often_as_not() -> None:
    rng = np.random.default_rng(2)
    manifold = Manifold(LINK.rx_codebook)
    angles = np.array([0.2])
    errors = EndErrors.of(manifold, angles)
    true = manifold.response(angles[None])[0, errors.beam]
    levels = []
    for _ in range(1000):
        other = erring_response(LINK.rx_codebook, (0.2, 0.0), rng)[errors.beam]
        levels.append(errors.evidence((other / true).real - 1, np.zeros(len(true))).level)
    assert np.mean(np.array(levels) > LEVEL) == pytest.approx(0.5, abs=0.06)


def test_the_expected_level_of_a_few_paths_is_right_in_the_mean() -> None:
    """As a variance is that errors are divided by; and a path that another one misleads does not spoil it."""
    rng = np.random.default_rng(4)
    manifold = Manifold(LINK.rx_codebook)
    angles = np.deg2rad([-25.0, -8.0, 12.0, 31.0])
    errors = [EndErrors.of(manifold, angles[None, k]) for k in range(4)]
    found = []
    for _ in range(300):
        shown = []
        for angle, end in zip(angles, errors, strict=True):
            true = manifold.response(angle[None, None])[0, end.beam]
            other = erring_response(LINK.rx_codebook, (angle, 0.0), rng)[end.beam]
            shown.append(end.evidence((other / true).real - 1, np.full(len(true), 1e-6)))
        misled = replace(shown[0], found=3e4 * shown[0].found)
        found.append((expected_level(shown), expected_level([*shown, misled])))
    assert np.mean(LEVEL / np.array(found), axis=0) == pytest.approx(1, abs=0.35)


def test_noise_alone_shows_no_level() -> None:
    rng = np.random.default_rng(3)
    errors = EndErrors.of(Manifold(LINK.rx_codebook), np.array([0.2]))
    variance = 1e-4 / errors.weight
    noise = np.sqrt(variance) * rng.standard_normal((1000, len(variance)))
    levels = np.array([errors.evidence(one, variance).level for one in noise])
    assert np.median(levels) < 1e-4


def test_the_floor_of_a_strong_path_hides_weak_ones_at_its_delay_only() -> None:
    ends = LinkBeams(Manifold(LINK.tx_codebook), Manifold(LINK.rx_codebook), np.ones(10))
    paths = np.array([[30.0, -0.3, 0.2, 3.0, 0.0], [30.0, 0.5, 0.2, 0.0, 0.0], [70.0, 0.5, 0.2, 0.0, 0.0]])
    noise = ResponseErrors(0.02).noise(ends, paths, 288)
    assert noise[1] > 100 * noise[2] > 0
    assert noise[0] < 0.01 * noise[1]
    assert (ResponseErrors().noise(ends, paths, 288) == 0).all()


def test_directions_of_a_fit_are_as_uncertain_as_the_errors_make_them() -> None:
    tx, rx = Manifold(LINK.tx_codebook), Manifold(LINK.rx_codebook)
    fit = fit_over_background(
        plain_sweep(LINK, plain_paths(LINK, 100.0, -15.0, 12.0, 40.0), np.random.default_rng(5))
    )
    added = ResponseErrors(mean=LEVEL).added_to(fit, tx, rx).covariance - fit.covariance
    expected = [EndErrors.of(tx, fit.aod_rad[0], TELLING), EndErrors.of(rx, fit.aoa_rad[0], TELLING)]
    np.testing.assert_allclose(
        np.diagonal(added[0])[1:], [LEVEL * end.angle_covariance.item() for end in expected], rtol=1e-6
    )
    assert (added[:, 0] == 0).all()
