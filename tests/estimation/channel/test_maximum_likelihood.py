"""The contract of both maximum-likelihood methods; the incoherent one gets a random phase per pair."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from estimation.channel.coherent.paths import fit_coherent
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.paths import fit_incoherent
from estimation.channel.model.manifold import Manifold
from sim.config import ArrayConfig
from sim.observation import BeamSweep
from sim.signal.hardware.impairments import with_element_errors
from tests.estimation.channel.plain_sweeps import (
    ELEVATION,
    PANELS,
    no_plain_paths,
    places,
    plain_link,
    plain_paths,
    plain_sweep,
    scrambled,
)

SMALL = plain_link()


@dataclass(frozen=True)
class Method:
    """A method, and its accuracy for noiseless (delay in s, angles in rad, amplitude) paths."""

    name: str
    fit: Callable[..., PathFit]
    near: tuple[float, float, float]

    def sweep(self, sweep: BeamSweep, rng: np.random.Generator) -> BeamSweep:
        """The sweep as the method gets it."""
        return scrambled(sweep, rng) if self.name == "incoherent" else sweep


METHODS = (
    Method("coherent", fit_coherent, (1e-12, 1e-5, 1e-4)),
    Method("incoherent", fit_incoherent, (2e-11, 1e-3, 2e-3)),
)
for_methods = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)


@for_methods
@pytest.mark.parametrize(
    ("tx", "rx"), [(None, None), (None, PANELS), (ELEVATION, None)], ids=["azimuth", "panels", "elevation"]
)
def test_without_noise_estimates_are_exact(method: Method, tx: ArrayConfig | None, rx: ArrayConfig | None) -> None:
    link = plain_link(tx, rx)
    aod: Any = [[10.0, 5.0], [-25.0, -8.0], [35.0, 12.0]] if tx is ELEVATION else [10.0, -25.0, 35.0]
    aoa = [-100.0, 20.0, 170.0] if rx is PANELS else [-20.0, 5.0, 30.0]
    paths = plain_paths(link, [-40.0, 85.0, 230.0], aod, aoa, [45.0, 40.0, 38.0], phase=[0.5, -2.0, 3.0])
    fit = method.fit(method.sweep(plain_sweep(link, paths), np.random.default_rng(1)))
    assert fit.status == "ok"
    assert len(fit) == 3
    delay_s, angle_rad, amplitude = method.near
    assert np.allclose(fit.delay_s, paths.delay_s, atol=delay_s)
    assert np.allclose(places(fit)[:, 1:], places(paths)[:, 1:], atol=angle_rad)
    assert np.allclose(fit.amplitude, np.abs(paths.amplitude), rtol=amplitude)
    if method.name == "coherent":
        assert np.allclose(fit.amplitude * np.exp(1j * fit.phase_rad), paths.amplitude, rtol=amplitude)
    else:
        assert np.isnan(fit.phase_rad).all()


@for_methods
def test_noise_alone_has_the_given_false_alarm_probability(method: Method) -> None:
    rng = np.random.default_rng(4)
    config = MaximumLikelihoodConfig(false_alarm_probability=0.2)
    n = 150 if method.name == "coherent" else 80
    assert abs(_false_alarm_rate(method, config, n, rng) - 0.2) < 3.5 * np.sqrt(0.2 * 0.8 / n)


@pytest.mark.slow
@for_methods
def test_false_alarms_are_rare_at_unexpected_delays(method: Method) -> None:
    rng = np.random.default_rng(5)
    config = MaximumLikelihoodConfig(false_alarm_probability=0.01)
    assert 0.5 < _false_alarm_rate(method, config, 3000, rng) / 0.01 < 1.5


def _false_alarm_rate(method: Method, config: MaximumLikelihoodConfig, n: int, rng: np.random.Generator) -> float:
    nothing = no_plain_paths(SMALL)
    return sum(len(method.fit(plain_sweep(SMALL, nothing, rng), config)) > 0 for _ in range(n)) / n


@for_methods
def test_calibrated_manifolds_replace_nominal_ones(method: Method) -> None:
    rng = np.random.default_rng(9)
    built = replace(
        SMALL,
        tx_codebook=with_element_errors(SMALL.tx_codebook, 1.0, 0.3, rng),
        rx_codebook=with_element_errors(SMALL.rx_codebook, 1.0, 0.3, rng),
    )
    paths = plain_paths(built, [80.0, 150.0], [12.0, -30.0], [0.0, 20.0], [40.0, 35.0])
    sweep = replace(plain_sweep(built, paths, rng), tx_codebook=SMALL.tx_codebook, rx_codebook=SMALL.rx_codebook)
    sweep = method.sweep(sweep, rng)
    if method.name == "coherent":
        assert len(method.fit(sweep)) > 2
    known = method.fit(sweep, None, Manifold(built.tx_codebook, 1), Manifold(built.rx_codebook, 1))
    assert np.allclose(places(known), places(paths), atol=[3e-10, 0.01, 0.01])


@for_methods
def test_more_paths_than_allowed_are_not_reported(method: Method) -> None:
    paths = plain_paths(SMALL, [30.0, 130.0, 260.0], [0.0, 30.0, -30.0], [0.0, -30.0, 20.0], [35.0, 33.0, 30.0])
    sweep = plain_sweep(SMALL, paths, np.random.default_rng(12))
    fit = method.fit(sweep, MaximumLikelihoodConfig(max_paths=2))
    assert np.allclose(fit.delay_s, paths.delay_s[:2], atol=2e-9)


@for_methods
def test_silence_and_noise_have_a_status(method: Method) -> None:
    nothing = no_plain_paths(SMALL)
    silent = method.fit(plain_sweep(SMALL, nothing))
    assert (silent.status, len(silent)) == ("no_signal", 0)
    noise = method.fit(plain_sweep(SMALL, nothing, np.random.default_rng(14)))
    assert (noise.status, len(noise)) == ("no_paths", 0)
    assert noise.covariance.shape == (0, 3, 3)


@for_methods
def test_same_samples_same_bits(method: Method) -> None:
    paths = plain_paths(SMALL, [30.0, 45.0], [0.0, 10.0], [0.0, -10.0], [35.0, 33.0])
    sweep = plain_sweep(SMALL, paths, np.random.default_rng(15))
    one, other = method.fit(sweep), method.fit(sweep)
    assert np.array_equal(places(one), places(other))
    assert np.array_equal(one.covariance, other.covariance)
