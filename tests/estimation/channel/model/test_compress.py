from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.channel.model.compress import DelayCube, beam_span, check_sweep, compress
from estimation.channel.model.manifold import Manifold
from scenes.record import ComplexArray
from sim.config import ArrayConfig
from sim.observation import BeamSweep
from sim.signal.hardware.impairments import with_element_errors
from tests.estimation.channel.plain_sweeps import no_plain_paths, plain_link, plain_paths, plain_sweep

SMALL = plain_link()


def _compressed(sweep: BeamSweep) -> DelayCube:
    tx, rx = Manifold(sweep.tx_codebook), Manifold(sweep.rx_codebook)
    return compress(sweep, beam_span(tx), beam_span(rx, sweep.noise_power_mw))


def _whitened_norm(samples: ComplexArray, noise_mw: Any) -> float:
    return float((np.abs(samples) ** 2 / np.asarray(noise_mw)[:, None]).sum())


ARRAYS = {
    "oversampled": ArrayConfig(columns=8, beams_per_panel=20, sector_deg=120.0),
    "panels": ArrayConfig(columns=4, beams_per_panel=5, sector_deg=90.0, panel_azimuth_deg=[-90.0, 0.0, 90.0]),
    "elevation": ArrayConfig(columns=6, beams_per_panel=8, beam_elevation_deg=[-15.0, 15.0]),
    "one_beam": ArrayConfig(beams_per_panel=1),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_likelihood_is_unchanged(name: str) -> None:
    """Squared distance of samples to the model of a path: the same before and after, up to what is constant."""
    link = plain_link(ARRAYS[name], ARRAYS[name])
    rng = np.random.default_rng(1)
    noise_mw = rng.uniform(0.5, 2.0, len(link.rx_codebook))
    paths = plain_paths(link, [20.0, 31.0], [10.0, -20.0], [-5.0, 30.0], [30.0, 25.0])
    sweep = plain_sweep(link, paths, rng, noise_mw)
    cube = _compressed(sweep)
    compressed = cube.window(np.arange(cube.n_bins) - 20)
    distances = []
    for guess in (plain_paths(link, 20.3, 9.0, -4.0, 29.0), plain_paths(link, -40.0, -31.0, 31.0, 20.0)):
        model = plain_sweep(link, guess).samples.astype(complex)
        before = _whitened_norm(sweep.samples - model, noise_mw) - _whitened_norm(sweep.samples, noise_mw)
        angles = [np.zeros((1, m.n_angles)) for m in (compressed.tx, compressed.rx)]
        angles[0][:, 0], angles[1][:, 0] = guess.aod_rad[0, 0], guess.aoa_rad[0, 0]
        wave = compressed.delay_response(guess.delay_s / compressed.bin_s)[0, 0]
        amplitude = guess.amplitude[0] * np.exp(-2j * np.pi * compressed.centre_hz * guess.delay_s[0])
        beams = np.outer(compressed.tx.response(angles[0])[0], compressed.rx.response(angles[1])[0])
        shape = amplitude * beams[..., None] * wave / np.sqrt(compressed.noise_scale)
        after = np.linalg.norm(compressed.samples - shape) ** 2 - np.linalg.norm(compressed.samples) ** 2
        distances.append([before, after * compressed.noise_scale])
    scale = _whitened_norm(sweep.samples, noise_mw)
    assert np.abs(np.diff(distances, axis=1)).max() < 2e-7 * scale


def test_beams_of_one_array_span_its_columns() -> None:
    link = plain_link(ARRAYS["oversampled"], ARRAYS["panels"])
    cube = _compressed(plain_sweep(link, plain_paths(link, 20.0, 0.0, 0.0, 20.0)))
    assert cube.spectrum.shape == (8, 3 * 4, 288)


def test_noise_stays_white_and_of_unit_power() -> None:
    link = plain_link(ARRAYS["oversampled"], ARRAYS["panels"])
    noise_mw = np.linspace(0.2, 5.0, len(link.rx_codebook))
    nothing = no_plain_paths(link)
    cube = _compressed(plain_sweep(link, nothing, np.random.default_rng(2), noise_mw))
    cells = cube.spectrum.reshape(-1, cube.n_bins)
    covariance = cells @ cells.conj().T / cube.n_bins
    assert np.abs(np.diagonal(covariance) - 1).max() < 6 / np.sqrt(cube.n_bins)
    assert np.abs(covariance - np.diag(np.diagonal(covariance))).max() < 6 / np.sqrt(cube.n_bins)
    lagged = (cells[:, 1:] * cells[:, :-1].conj()).mean()
    assert abs(lagged) < 5 / np.sqrt(cells.size)


def test_noise_level_is_estimated() -> None:
    paths = plain_paths(SMALL, [20.0, 31.0], [10.0, -20.0], [-5.0, 30.0], [30.0, 25.0], noise_mw=3e-9)
    sweep = plain_sweep(SMALL, paths, np.random.default_rng(3), 3e-9)
    too_low = replace(sweep, noise_power_mw=sweep.noise_power_mw / 2)
    assert abs(_compressed(too_low).noise_scale - 2) < 0.1


def test_window_is_periodic() -> None:
    """A path of negative delay lies in the last bins of the period; a window sees it below zero."""
    sweep = plain_sweep(SMALL, plain_paths(SMALL, -30.0, 5.0, 0.0, 30.0))
    cube = _compressed(sweep)
    below = cube.window(np.arange(-25, 10))
    wave = below.delay_response(np.array([-30e-9 / below.bin_s]))[0, 0]
    beams = np.outer(below.tx.response(np.deg2rad([[5.0]]))[0], below.rx.response(np.zeros((1, 1)))[0])
    shape = beams[..., None] * wave
    fitted = np.vdot(shape, below.samples) / np.vdot(shape, shape)
    assert np.linalg.norm(below.samples - fitted * shape) < 1e-5 * np.linalg.norm(below.samples)
    around = cube.window(np.arange(-25, 10) + cube.n_bins)
    sign = (-1) ** (cube.n_bins - 1)
    assert np.allclose(around.samples, sign * below.samples)
    again = around.delay_response(np.array([-30e-9 / below.bin_s]))[0, 0]
    assert np.allclose(again, sign * wave)


def test_further_whitening_changes_the_model_with_the_samples() -> None:
    cube = _compressed(plain_sweep(SMALL, plain_paths(SMALL, 20.0, 5.0, 0.0, 30.0)))
    window = cube.window(np.arange(-10, 40))
    rng = np.random.default_rng(4)
    whitened = window.over_background(np.square(rng.uniform(0.5, 2.0, 50)))
    wave = whitened.delay_response(np.array([20e-9 / whitened.bin_s]))[0, 0]
    angles = np.deg2rad([[5.0]]), np.zeros((1, 1))
    beams = np.outer(whitened.tx.response(angles[0])[0], whitened.rx.response(angles[1])[0])
    shape = beams[..., None] * wave
    fitted = np.vdot(shape, whitened.samples) / np.vdot(shape, shape)
    assert np.linalg.norm(whitened.samples - fitted * shape) < 1e-5 * np.linalg.norm(whitened.samples)


def test_real_bases_are_used_where_responses_are_real() -> None:
    book = SMALL.tx_codebook
    assert not np.iscomplexobj(beam_span(Manifold(book)).basis)
    erroneous = with_element_errors(book, 1.0, 0.2, np.random.default_rng(5))
    assert np.iscomplexobj(beam_span(Manifold(erroneous)).basis)


def test_samples_that_are_not_finite_are_refused() -> None:
    sweep = plain_sweep(SMALL, plain_paths(SMALL, 20.0, 0.0, 0.0, 20.0))
    for value in (np.nan, np.inf):
        samples = sweep.samples.copy()
        samples[1, 2, 5] = value
        with pytest.raises(ValueError, match="stop 3"):
            _compressed(replace(sweep, samples=samples))


def test_sweeps_without_delay_information_are_refused() -> None:
    sweep = plain_sweep(SMALL, plain_paths(SMALL, 20.0, 0.0, 0.0, 20.0))
    with pytest.raises(ValueError, match="2 subcarriers"):
        check_sweep(sweep.take("subcarrier", slice(0, 1)))
    with pytest.raises(ValueError, match="ascend evenly"):
        check_sweep(sweep.take("subcarrier", [0, 1, 3]))
    with pytest.raises(ValueError, match="must be positive"):
        check_sweep(replace(sweep, noise_power_mw=np.zeros(len(sweep.noise_power_mw))))
