"""One entry for all methods: the same record from each, and a clear answer to bad input."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.assemble import ordered_covariance
from estimation.channel.config import ChannelConfig, MaximumLikelihoodConfig
from estimation.channel.estimate import estimate_channel, path_capacity
from estimation.channel.record import AngleKind, ChannelEstimate, EstimateStatus, check_estimate
from scenes.pose import wrap_angle
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.observation import BeamSweep
from sim.propagation.paths import Paths
from sim.signal.link import Link, make_link

Maker = Callable[..., Paths]
SweepMaker = Callable[..., BeamSweep]
METHODS = ("power", "coherent", "incoherent", "auto")
GAIN_AT_6M = 3.98e-3 / (4 * np.pi * 6) * 1.255
PERIOD_S = 1 / 240e3


@pytest.fixture(scope="module")
def link() -> Link:
    array = ArrayConfig(beams_per_panel=12, sector_deg=120.0)
    waveform = WaveformConfig(n_rb=32)
    return make_link(SimulationConfig(scene="none", waveform=waveform, tx_array=array, rx_array=array))


@pytest.fixture(scope="module")
def tall_link() -> Link:
    """Both ends with beams at two elevations."""
    array = ArrayConfig(beams_per_panel=10, sector_deg=100.0, rows=4, beam_elevation_deg=[-12.0, 12.0])
    waveform = WaveformConfig(n_rb=32)
    return make_link(SimulationConfig(scene="none", waveform=waveform, tx_array=array, rx_array=array))


@pytest.fixture
def sweep(make_sweep: SweepMaker, make_paths: Maker, link: Link) -> BeamSweep:
    paths = make_paths([GAIN_AT_6M, 0.3 * GAIN_AT_6M], [2e-8, 6e-8], [-1.4, -1.9], [0.4, 0.9])
    return make_sweep(paths, np.random.default_rng(2), over=link)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_returns_the_same_record(sweep: BeamSweep, method: str) -> None:
    estimate = estimate_channel(sweep, method)
    check_estimate(estimate, PERIOD_S)
    assert estimate.method == method
    assert estimate.status == EstimateStatus.OK
    assert len(estimate) == 2
    np.testing.assert_allclose(estimate.delay_s, [2e-8, 6e-8], atol=1e-9)
    np.testing.assert_allclose(estimate.aod_azimuth_rad, [-1.4 + np.pi / 2, -1.9 + np.pi / 2], atol=0.02)
    np.testing.assert_allclose(np.diff(20 * np.log10(estimate.gain_amplitude)), -10.46, atol=1.5)
    assert np.isnan(estimate.gain_phase_rad).all() == (method in ("power", "incoherent"))
    assert estimate.aod_angle_kind == estimate.aoa_angle_kind == AngleKind.CONE
    assert np.isnan(estimate.aod_elevation_rad).all()
    assert estimate.is_los.tolist() == [True, False]


def test_auto_reports_its_choice_and_reason(sweep: BeamSweep) -> None:
    assert estimate_channel(sweep, "auto").reason.startswith("coherent: ")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (np.zeros_like, "all zero"),
        (lambda s: np.where(np.arange(s.shape[2]) == 5, np.nan, s), "beam pair (0, 0) are not finite"),
        (lambda s: np.where(np.arange(s.shape[2]) == 5, np.inf, s), "not finite"),
    ],
)
def test_uninformative_samples_are_refused(
    sweep: BeamSweep, method: str, spoil: Callable[[np.ndarray], np.ndarray], reason: str
) -> None:
    estimate = estimate_channel(replace(sweep, samples=spoil(sweep.samples)), method)
    assert len(estimate) == 0
    assert estimate.status == EstimateStatus.REFUSED
    assert reason in estimate.reason


@pytest.mark.parametrize("method", METHODS)
def test_noise_alone_holds_no_paths(make_sweep: SweepMaker, make_paths: Maker, link: Link, method: str) -> None:
    sweep = make_sweep(make_paths(1e-12, 2e-8, -1.5, 0.4), np.random.default_rng(8), over=link)
    estimate = estimate_channel(sweep, method)
    assert len(estimate) == 0
    assert estimate.status == EstimateStatus.NO_PATHS


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["one beam", "rank 1"])
def test_an_end_without_direction_information_is_reported(
    make_sweep: SweepMaker, make_paths: Maker, link: Link, method: str, kind: str
) -> None:
    book = link.tx_codebook.take("beam", [6] if kind == "one beam" else [6, 6, 6])
    n = len(book)
    blind = replace(link, tx_codebook=book, prs_symbol=link.prs_symbol[:n])
    paths = make_paths(GAIN_AT_6M, 2e-8, -np.pi / 2, 0.4)
    estimate = estimate_channel(make_sweep(paths, np.random.default_rng(3), over=blind), method)
    assert len(estimate) == 1
    assert "TX beams of rank 1" in estimate.reason
    assert estimate.covariance[0, 1, 1] == pytest.approx(np.pi**2 / 3)
    assert estimate.delay_s[0] == pytest.approx(2e-8, abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_empty_sweep_is_refused(sweep: BeamSweep, method: str, axis: int) -> None:
    cut = [slice(None)] * 3
    cut[axis] = slice(0)
    kept_tx, kept_rx = ([] if axis == end else list(range(12)) for end in (0, 1))
    empty = replace(
        sweep,
        tx_codebook=sweep.tx_codebook.take("beam", kept_tx),
        rx_codebook=sweep.rx_codebook.take("beam", kept_rx),
        samples=sweep.samples[tuple(cut)],
        prs_symbol=sweep.prs_symbol[cut[0], cut[2]],
        frequency_offset_hz=sweep.frequency_offset_hz[cut[2]],
        noise_power_mw=sweep.noise_power_mw[cut[1]],
    )
    estimate = estimate_channel(empty, method)
    assert len(estimate) == 0
    assert estimate.status == EstimateStatus.REFUSED
    assert "at least 1 x 1 beams" in estimate.reason


@pytest.mark.parametrize("method", METHODS)
def test_one_beam_at_either_end_and_two_subcarriers_are_valid(sweep: BeamSweep, method: str) -> None:
    least = replace(
        sweep,
        tx_codebook=sweep.tx_codebook.take("beam", [6]),
        rx_codebook=sweep.rx_codebook.take("beam", [6]),
        samples=sweep.samples[6:7, 6:7, :2],
        prs_symbol=sweep.prs_symbol[6:7, :2],
        frequency_offset_hz=sweep.frequency_offset_hz[:2],
        noise_power_mw=sweep.noise_power_mw[6:7],
    )
    estimate = estimate_channel(least, method)
    check_estimate(estimate, PERIOD_S)
    assert len(estimate) <= 1
    assert "TX beams of rank 1" in estimate.reason and "RX beams of rank 1" in estimate.reason


@pytest.mark.parametrize(
    ("spoilt", "message"),
    [
        ({"delay_s": np.array([np.nan, 1e-8])}, "delay_s = nan: must be finite"),
        ({"delay_s": np.array([6e-8, 2e-8])}, "not sorted"),
        ({"covariance": np.zeros((2, 3, 3))}, "symmetric and positive definite"),
        ({"covariance": np.full((2, 3, 3), np.nan)}, "must be finite"),
        ({"los_probability": np.array([1.5, 0.0])}, "los_probability = 1.5"),
        ({"status": "fine"}, "status = 'fine'"),
    ],
)
def test_garbage_of_a_users_function_is_refused_in_one_line(
    sweep: BeamSweep, spoilt: dict[str, object], message: str
) -> None:
    good = estimate_channel(sweep, "power")
    with pytest.raises(ValueError, match=message) as caught:
        estimate_channel(sweep, lambda _: replace(good, **spoilt))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("method", ["coherent", "incoherent", "auto"])
def test_more_paths_than_the_limit_are_reported(sweep: BeamSweep, method: str) -> None:
    one = ChannelConfig(maximum_likelihood=MaximumLikelihoodConfig(max_paths=1))
    estimate = estimate_channel(sweep, method, one)
    assert len(estimate) == 1
    assert estimate.status == EstimateStatus.LIMITED
    assert "max_paths = 1" in estimate.reason


def test_the_limit_of_paths_is_what_samples_determine(link: Link, sweep: BeamSweep) -> None:
    assert path_capacity(sweep) > 1000
    few = replace(
        sweep,
        tx_codebook=link.tx_codebook.take("beam", [5, 6]),
        rx_codebook=link.rx_codebook.take("beam", [5, 6]),
        samples=sweep.samples[5:7, 5:7, :8],
        prs_symbol=sweep.prs_symbol[5:7, :8],
        frequency_offset_hz=sweep.frequency_offset_hz[:8],
        noise_power_mw=sweep.noise_power_mw[5:7],
    )
    assert path_capacity(few) == 6
    for method in METHODS:
        assert len(estimate_channel(few, method)) <= 6


def test_a_function_is_a_method_and_is_checked(sweep: BeamSweep) -> None:
    def mine(given: BeamSweep) -> ChannelEstimate:
        return estimate_channel(given, "power")

    assert len(estimate_channel(sweep, mine)) == 2
    with pytest.raises(ValueError, match="a ChannelEstimate is needed"):
        estimate_channel(sweep, lambda _: None)
    with pytest.raises(ValueError, match="returned stop 99"):
        estimate_channel(sweep, lambda given: replace(mine(given), stop=99))
    with pytest.raises(ValueError, match="method = 'best': must be auto, coherent"):
        estimate_channel(sweep, "best")


def test_beams_at_two_elevations_give_both_angles(
    make_sweep: SweepMaker, make_paths: Maker, tall_link: Link
) -> None:
    level = make_paths(GAIN_AT_6M, 2e-8, -1.2, 1.0)
    paths = replace(level, aod_elevation_rad=np.array([0.15]), aoa_elevation_rad=np.array([-0.1]))
    estimate = estimate_channel(make_sweep(paths, np.random.default_rng(4), over=tall_link), "coherent")
    assert estimate.aod_angle_kind == AngleKind.AZIMUTH
    assert estimate.covariance.shape == (1, 5, 5)
    check_estimate(estimate, PERIOD_S)
    std = np.sqrt(np.diagonal(estimate.covariance[0]))
    error = [
        wrap_angle(estimate.aod_azimuth_rad[0] - (-1.2 + np.pi / 2)),
        estimate.aod_elevation_rad[0] - 0.15,
        estimate.aoa_elevation_rad[0] + 0.1,
    ]
    assert (np.abs(error) < 4 * std[[1, 3, 4]]).all()
    assert (std[1:] < 0.01).all()


def test_horizontal_beams_give_the_cone_angle_of_a_path_from_above(
    make_sweep: SweepMaker, make_paths: Maker, link: Link
) -> None:
    azimuth, elevation = 0.6, 0.3
    level = make_paths(GAIN_AT_6M, 2e-8, azimuth - np.pi / 2, 0.4)
    paths = replace(level, aod_elevation_rad=np.array([elevation]))
    estimate = estimate_channel(make_sweep(paths, np.random.default_rng(4), over=link), "coherent")
    assert estimate.aod_angle_kind == AngleKind.CONE
    cone = np.arcsin(np.sin(azimuth) * np.cos(elevation))
    assert estimate.aod_azimuth_rad[0] == pytest.approx(cone, abs=2e-3)
    assert azimuth - cone > 0.02


def test_covariances_have_the_order_of_the_record() -> None:
    fit = np.diag([1e-20, 1e-4, 2e-4, 3e-4, 4e-4])[None] + 1e-13 * (np.eye(5, k=1) + np.eye(5, k=-1))
    both = ordered_covariance(fit, 2, 2)
    np.testing.assert_allclose(np.diagonal(both[0]), [1e-20, 1e-4, 3e-4, 2e-4, 4e-4])
    assert both[0, 0, 1] == both[0, 1, 3] == 1e-13
    one = ordered_covariance(fit[:, :4, :4], 2, 1)
    np.testing.assert_allclose(np.diagonal(one[0]), [1e-20, 1e-4, 3e-4, 2e-4, np.nan])
    wide = ordered_covariance(np.diag([1e-20, np.inf, 1e-4])[None], 1, 1)
    np.testing.assert_allclose(np.diagonal(wide[0]), [1e-20, np.pi**2 / 3, 1e-4])
