"""The power-only channel estimator: closed forms of its parts, Monte Carlo of the whole."""

from collections.abc import Callable

import numpy as np
import pytest

from estimation.channel.beam_power_map import beam_power_map
from estimation.channel.config import PowerMethodConfig
from estimation.channel.model.delay import delay_power, hann_window, parabola_peak, window_response
from estimation.channel.power.beams import BeamAxis
from estimation.channel.power.detect import noise_threshold
from estimation.channel.power.paths import estimate_power
from estimation.channel.record import ChannelEstimate, check_estimate
from scenes.pose import Pose, wrap_angle
from sim.config import ArrayConfig, SimulationConfig
from sim.observation import BeamSweep
from sim.propagation.paths import Paths, empty_paths
from sim.signal.link import Link, best_beam_power_dbm, make_link

Maker = Callable[..., Paths]
SweepMaker = Callable[..., BeamSweep]
GAIN_AT_6M = 3.98e-3 / (4 * np.pi * 6) * 1.255  # lambda / (4 pi d) at 60 GHz


def errors(
    estimate: ChannelEstimate, paths: Paths, tx_pose: Pose, rx_pose: Pose, bias_s: float = 0.0
) -> np.ndarray:
    """Delay (s), AoD and AoA (rad) errors (path, 3) of an estimate with the paths in the truth's delay order."""
    order = np.argsort(paths.delay_s)
    return np.stack(
        [
            estimate.delay_s - paths.delay_s[order] - bias_s,
            wrap_angle(estimate.aod_azimuth_rad - paths.aod_azimuth_rad[order] + tx_pose.heading_rad),
            wrap_angle(estimate.aoa_azimuth_rad - paths.aoa_azimuth_rad[order] + rx_pose.heading_rad),
        ],
        axis=1,
    )


def test_window_response_is_the_transform_of_the_window() -> None:
    n = 1584
    offset = np.linspace(-4, 4, 81)
    phases = np.exp(2j * np.pi * np.outer(offset, np.arange(n) - (n - 1) / 2) / n)
    expected = np.abs(phases @ hann_window(n)) / n
    np.testing.assert_allclose(window_response(offset, n), expected, atol=2e-6)


def test_noise_threshold_closed_form() -> None:
    assert noise_threshold(1, 0.01) == pytest.approx(-np.log(0.01))
    threshold = noise_threshold(1e6, 0.05)
    assert 1 - (1 - np.exp(-threshold)) ** 1e6 == pytest.approx(0.05)


def test_parabola_vertex() -> None:
    x = np.arange(5.0)
    assert parabola_peak(-((x - 2.3) ** 2), 2) == pytest.approx(0.3)
    assert parabola_peak(x, 4) == 0.0


def test_beam_neighbours_close_the_circle_only_when_beams_do(full_link: Link) -> None:
    rx, tx = BeamAxis(full_link.rx_codebook), BeamAxis(full_link.tx_codebook)
    assert rx.is_closed and not tx.is_closed
    azimuth = full_link.rx_codebook.azimuth_rad
    for beam in range(len(azimuth)):
        around = wrap_angle(azimuth[rx.neighbourhood(beam)] - azimuth[beam])
        assert len(around) == 5 and (np.diff(around) > 0).all() and around[2] == 0
    assert tx.neighbourhood(0).tolist() == [0, 1, 2]
    assert tx.neighbour(np.array([31]), 1).tolist() == [31]


def test_angle_is_unbiased_everywhere(full_link: Link) -> None:
    axis = BeamAxis(full_link.rx_codebook)
    for azimuth in np.linspace(-np.pi, np.pi, 97):
        amplitude = axis.relative_amplitude(azimuth)
        beams = axis.neighbourhood(int(np.argmax(amplitude)))
        fit = axis.match(beams, 3.0 * amplitude[beams])
        assert abs(wrap_angle(fit.azimuth_rad - azimuth)) < np.deg2rad(0.01)
        assert fit.residual < 1e-6


def test_without_patterns_angles_are_good_to_a_part_of_a_beam(full_link: Link) -> None:
    axis = BeamAxis(full_link.rx_codebook)
    spacing = np.diff(full_link.rx_codebook.azimuth_rad[:24]).max()
    for azimuth in np.linspace(-np.pi, np.pi, 97):
        amplitude = axis.relative_amplitude(azimuth)
        beams = axis.neighbourhood(int(np.argmax(amplitude)))
        fit = axis.match_without_patterns(beams, 3.0 * amplitude[beams])
        assert abs(wrap_angle(fit.azimuth_rad - azimuth)) < 0.3 * spacing
        known = axis.match(beams, amplitude[beams]).information
        assert known / 3 < fit.information < 3 * known


def test_without_patterns_a_gaussian_lobe_is_found_exactly(full_link: Link) -> None:
    codebook = full_link.tx_codebook
    axis = BeamAxis(codebook)
    beams = np.arange(10, 15)
    for true in codebook.azimuth_rad[12] + np.deg2rad([-1.0, 0.0, 1.5]):
        amplitude = np.exp(-np.square((codebook.azimuth_rad[beams] - true) / np.deg2rad(8.0)))
        assert axis.match_without_patterns(beams, amplitude).azimuth_rad == pytest.approx(true, abs=1e-12)
    assert axis.match_without_patterns(beams, np.ones(5)).azimuth_rad == codebook.azimuth_rad[10]


def test_noise_level_is_estimated_from_the_samples(make_sweep: SweepMaker, full_link: Link) -> None:
    sweep = make_sweep(empty_paths(["wall"]), np.random.default_rng(0))
    power = delay_power(sweep)
    n = sweep.samples.shape[-1]
    expected = full_link.noise_power_mw * (hann_window(n) ** 2).sum() / n**2
    np.testing.assert_allclose(power.noise_power_mw, expected, rtol=0.035)  # 5 sigma of the median
    assert len(estimate_power(sweep)) == 0


def test_false_alarm_probability_is_the_given_one(make_sweep: SweepMaker, small_link: Link) -> None:
    rng, trials, asked = np.random.default_rng(1), 150, 0.2
    config = PowerMethodConfig(false_alarm_probability=asked, max_misfit=1e9)
    alarms = sum(
        len(estimate_power(make_sweep(empty_paths(["wall"]), rng, over=small_link), config)) > 0
        for _ in range(trials)
    )
    spread = np.sqrt(trials * asked * (1 - asked))
    # Zero padding correlates cells and adds some: between the asked rate and that of all padded cells.
    assert asked * trials - 3 * spread < alarms < 2 * asked * trials + 3 * spread


def test_separated_paths_are_all_found_and_nothing_else(
    make_sweep: SweepMaker, make_paths: Maker, tx_pose: Pose, rx_pose: Pose, full_link: Link
) -> None:
    rng = np.random.default_rng(2)
    level_db = np.array([0, -6, -9, -14, -18, -21])
    delay = 2e-8 + 8e-9 * np.arange(6)
    gain = GAIN_AT_6M * 10 ** (level_db / 20) * np.exp(2j * np.pi * rng.random(6))
    paths = make_paths(gain, delay, -np.pi / 2 + rng.uniform(-1, 1, 6), rng.uniform(-np.pi, np.pi, 6))
    sweep = make_sweep(paths, rng, bias_s=3.3e-8)
    estimate = estimate_power(sweep)
    assert len(estimate) == 6
    error = np.abs(errors(estimate, paths, tx_pose, rx_pose, 3.3e-8))
    assert (error < [0.1e-9, np.deg2rad(0.3), np.deg2rad(0.3)]).all()
    expected_dbm = best_beam_power_dbm(paths, full_link, tx_pose, rx_pose)
    np.testing.assert_allclose(estimate.power_dbm, expected_dbm, atol=0.7)
    assert estimate.is_los.tolist() == [True] + 5 * [False]


def test_a_negative_delay_stays_negative(make_sweep: SweepMaker, make_paths: Maker) -> None:
    paths = make_paths(GAIN_AT_6M, 2e-8, -1.4, 0.2)
    estimate = estimate_power(make_sweep(paths, np.random.default_rng(3), bias_s=-9e-8))
    assert estimate.delay_s[0] == pytest.approx(-7e-8, abs=0.1e-9)


def test_side_lobes_of_one_strong_path_are_no_paths(make_sweep: SweepMaker, make_paths: Maker) -> None:
    rng = np.random.default_rng(4)
    config = PowerMethodConfig(dynamic_range_db=45)
    for aod, aoa in rng.uniform(-1, 1, (4, 2)):
        paths = make_paths(GAIN_AT_6M, 2e-8, aod - np.pi / 2, 3 * aoa)
        assert len(estimate_power(make_sweep(paths, rng), config)) == 1


def test_covariance_of_a_noise_limited_path_is_honest(
    make_sweep: SweepMaker, make_paths: Maker, tx_pose: Pose, rx_pose: Pose, small_link: Link
) -> None:
    rng, z = np.random.default_rng(5), []
    config = PowerMethodConfig(
        false_alarm_probability=1e-5, delay_std_floor_ns=0.0, angle_std_floor_deg=0.0, max_misfit=1.0
    )
    for _ in range(120):
        aod, aoa = rng.uniform(-0.4, 0.4, 2)
        paths = make_paths(GAIN_AT_6M, 4e-8 + 1e-8 * rng.random(), aod - np.pi / 2, aoa + rx_pose.heading_rad)
        estimate = estimate_power(make_sweep(paths, rng, over=small_link, noise_factor=3e4), config)
        assert len(estimate) == 1 and 12 < estimate.snr_db[0] < 40
        z.append(errors(estimate, paths, tx_pose, rx_pose)[0] / np.sqrt(np.diag(estimate.covariance[0])))
    rms = np.sqrt((np.array(z) ** 2).mean(axis=0))
    assert (rms > 0.5).all() and (rms < 1.3).all(), rms


def test_power_map_is_the_mean_power(make_sweep: SweepMaker, make_paths: Maker) -> None:
    sweep = make_sweep(make_paths(GAIN_AT_6M, 2e-8, -1.4, 0.2), np.random.default_rng(6))
    expected = 10 * np.log10((np.abs(sweep.samples[3, 7].astype(complex)) ** 2).mean())
    assert beam_power_map(sweep).power_dbm[3, 7] == pytest.approx(expected, abs=1e-4)


def test_with_a_single_beam_the_angle_is_unobservable(make_paths: Maker, make_sweep: SweepMaker) -> None:
    one = ArrayConfig(beams_per_panel=1)
    link = make_link(SimulationConfig(scene="none", tx_array=one, rx_array=one))
    paths = make_paths(GAIN_AT_6M, 2e-8, -np.pi / 2, 0.4)
    estimate = estimate_power(make_sweep(paths, np.random.default_rng(7), over=link))
    assert len(estimate) == 1
    spread = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)[0])
    np.testing.assert_allclose(spread[1:], np.pi / np.sqrt(3))


def estimate_with(**changes: object) -> ChannelEstimate:
    values: dict[str, object] = {
        "stop": 4, "delay_s": [1e-8, 2e-8], "aod_azimuth_rad": [0, 1], "aoa_azimuth_rad": [0, 1],
        "power_dbm": [-40, -50], "beam_loss_db": [0, 0], "snr_db": [30, 20],
        "covariance": np.tile(np.diag([1e-20, 1e-4, 1e-4]), (2, 1, 1)), "is_los": [True, False],
    }  # fmt: skip
    return ChannelEstimate(**(values | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"delay_s": [1e-8, np.nan]}, "stop 4: delay_s = nan: must be finite"),
        ({"delay_s": [10.0, 20.0]}, "stop 4: delay_s = 10: must be within"),
        ({"delay_s": [2e-8, 1e-8]}, "stop 4: delay_s is not sorted"),
        ({"covariance": np.zeros((2, 3, 3))}, "stop 4: covariance: every matrix"),
        ({"covariance": np.zeros((2, 4, 4))}, "stop 4: covariance has shape"),
        ({"is_los": [True, True]}, "stop 4: is_los = 2 paths"),
        ({"los_probability": [0.3, 0.2]}, "stop 4: is_los: must be set where los_probability"),
        ({"los_probability": [1.2, 0.0]}, "stop 4: los_probability = 1.2: must be within"),
        ({"aod_angle_kind": "zenith"}, "stop 4: aod_angle_kind = 'zenith': must be one of azimuth, cone"),
        ({"status": "fine"}, "stop 4: status = 'fine': must be one of ok"),
    ],
)
def test_estimates_that_break_the_record_are_refused(changes: dict[str, object], message: str) -> None:
    check_estimate(estimate_with(), 4e-6)
    with pytest.raises(ValueError, match=message):
        check_estimate(estimate_with(**changes), 4e-6)
