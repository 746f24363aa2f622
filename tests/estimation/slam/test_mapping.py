"""Mapping: noiseless recovery, consistency of covariance and cost, gates, degenerate input."""

import numpy as np
import pytest
from scipy.stats import chi2

from estimation.channel.record import ChannelEstimate
from estimation.laws import plane as plane_law
from estimation.laws.plane import predict_bounce, predict_los
from estimation.slam.config import MappingConfig, PathNoise
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.mapping.point_fit import fit_points, point_covariance
from estimation.slam.record import PoseEstimates, SolveStatus
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose

TX = Pose(np.array([2.25, 2.5, 1.8]), -1.6)
STATE = np.array([-2.0, -3.0, 0.7, 12.0])
POINTS = np.array([[2.9, -4.4], [-5.4, -6.9], [0.0, 1.0], [4.5, -1.0], [-8.0, 0.0], [0.3, -9.2]])
FIXED = MappingConfig(noise=PathNoise(source="fixed"))


def estimate_of(measured: np.ndarray, *, stop: int = 0, is_los: np.ndarray | None = None) -> ChannelEstimate:
    n = len(measured)
    covariance = np.diag([1e-9, np.deg2rad(1.0), np.deg2rad(1.0)]) ** 2
    return ChannelEstimate(
        stop=stop,
        delay_s=measured[:, 0] / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=measured[:, 1],
        aoa_azimuth_rad=measured[:, 2],
        power_dbm=np.full(n, -45.0),
        beam_loss_db=np.zeros(n),
        snr_db=np.full(n, 20.0),
        covariance=np.tile(covariance, (n, 1, 1)),
        is_los=np.zeros(n, bool) if is_los is None else is_los,
    )


def given_poses(states: np.ndarray, status: SolveStatus = SolveStatus.GIVEN) -> PoseEstimates:
    n = len(states)
    return PoseEstimates(
        stop=np.arange(n),
        position_m=states[:, :2],
        heading_rad=states[:, 2],
        clock_bias_s=states[:, 3] / SPEED_OF_LIGHT_M_S,
        status=np.full(n, status),
        n_inliers=np.zeros(n, int),
        cost=np.zeros(n),
    )


def test_noiseless_paths_give_the_true_points_and_no_cost():
    ips = map_stops([estimate_of(predict_bounce(TX, STATE, POINTS))], given_poses(STATE[None]), TX, FIXED)
    np.testing.assert_allclose(ips.position_m, POINTS, atol=1e-8)
    np.testing.assert_allclose(ips.cost, 0.0, atol=1e-12)
    assert ips.is_inlier.all()
    assert ips.path.tolist() == list(range(len(POINTS)))


@pytest.mark.parametrize("covariance", ["fixed", "correlated"])
def test_errors_match_the_covariance_and_cost_is_chi_square(covariance):
    rng = np.random.default_rng(5)
    trials = 1500
    r = np.diag([0.3, 0.0175, 0.0175]) ** 2
    if covariance == "correlated":
        r[1, 2] = r[2, 1] = 0.6 * 0.0175**2
        r[0, 2] = r[2, 0] = -0.4 * 0.3 * 0.0175
    truth = np.tile(POINTS[[0, 3, 5]], (trials, 1))
    state = np.tile(STATE, (len(truth), 1))
    noise = rng.multivariate_normal(np.zeros(3), r, len(truth))
    measured = predict_bounce(TX, state, truth) + noise
    r_all = np.tile(r, (len(truth), 1, 1))
    point, cost = fit_points(plane_law, TX, state, measured, r_all)
    sigma, _ = point_covariance(plane_law, TX, state, point, r_all)
    error = point - truth
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(sigma), error)
    assert nees.mean() == pytest.approx(2.0, abs=0.15)
    assert np.mean(nees < chi2.ppf(0.95, 2)) == pytest.approx(0.95, abs=0.015)
    assert cost.mean() == pytest.approx(1.0, abs=0.08)
    assert np.mean(cost < chi2.ppf(0.99, 1)) == pytest.approx(0.99, abs=0.006)


def test_result_is_the_minimum_of_the_cost():
    rng = np.random.default_rng(6)
    measured = predict_bounce(TX, STATE, POINTS) + rng.normal(size=(6, 3)) * [0.3, 0.02, 0.02]
    r = np.tile(np.diag([0.3, 0.0175, 0.0175]) ** 2, (6, 1, 1))
    point, cost = fit_points(plane_law, TX, np.tile(STATE, (6, 1)), measured, r)
    for step in np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]) * 1e-3:
        difference = measured - predict_bounce(TX, STATE, point + step)
        nearby = np.einsum("ni,nij,nj->n", difference, np.linalg.inv(r), difference)
        assert np.all(nearby > cost)


def test_sensitivity_matches_a_moved_receiver():
    measured = predict_bounce(TX, STATE, POINTS)
    r = np.tile(np.diag([0.3, 0.0175, 0.0175]) ** 2, (6, 1, 1))
    _, sensitivity = point_covariance(plane_law, TX, np.tile(STATE, (6, 1)), POINTS, r)
    for i in range(4):
        step = 1e-5 * np.eye(4)[i]
        ahead, _ = fit_points(plane_law, TX, np.tile(STATE + step, (6, 1)), measured, r)
        behind, _ = fit_points(plane_law, TX, np.tile(STATE - step, (6, 1)), measured, r)
        np.testing.assert_allclose(sensitivity[..., i], (ahead - behind) / 2e-5, rtol=2e-3, atol=2e-3)


def test_a_path_that_fits_no_single_bounce_is_no_inlier():
    measured = predict_bounce(TX, STATE, POINTS)
    measured[2, 0] += 6.0
    measured[4, 2] += 0.5
    ips = map_stops([estimate_of(measured)], given_poses(STATE[None]), TX, FIXED)
    assert ips.is_inlier.tolist() == [True, True, False, True, False, True]


def test_line_of_sight_has_no_point_and_an_unflagged_one_is_no_inlier():
    measured = np.concatenate([predict_los(TX, STATE)[None], predict_bounce(TX, STATE, POINTS[:2])])
    flagged = np.array([True, False, False])
    ips = map_stops([estimate_of(measured, is_los=flagged)], given_poses(STATE[None]), TX, FIXED)
    assert ips.path.tolist() == [1, 2]
    ips = map_stops([estimate_of(measured)], given_poses(STATE[None]), TX, FIXED)
    assert ips.is_inlier.tolist() == [False, True, True]
    assert np.isfinite(ips.covariance_m2).all()


def test_stops_are_solved_independently():
    rng = np.random.default_rng(7)
    states = STATE + np.array([[0, 0, 0, 0], [1.0, 0.5, 0.2, -3.0], [2.0, -0.5, -2.0, 5.0]])
    measured = [predict_bounce(TX, s, POINTS) + rng.normal(size=(6, 3)) * [0.3, 0.02, 0.02] for s in states]
    estimates = [estimate_of(z, stop=i) for i, z in enumerate(measured)]
    together = map_stops(estimates, given_poses(states), TX, FIXED)
    assert together.stop.tolist() == np.repeat([0, 1, 2], 6).tolist()
    alone = map_stops([estimate_of(measured[1])], given_poses(states[1:2]), TX, FIXED)
    np.testing.assert_allclose(together.position_m[6:12], alone.position_m, atol=1e-9)


def test_noise_of_the_estimate_gets_its_floor():
    estimate = estimate_of(predict_bounce(TX, STATE, POINTS))
    noise = PathNoise(source="estimate", floor_delay_std_ns=2.0, floor_angle_std_deg=2.0)
    expected = np.diag([5 * (SPEED_OF_LIGHT_M_S * 1e-9) ** 2, 5 * np.deg2rad(1) ** 2, 5 * np.deg2rad(1) ** 2])
    np.testing.assert_allclose(noise.covariance(estimate)[0], expected)


def test_no_paths_no_stops_and_failed_stops_give_no_points():
    empty = estimate_of(np.empty((0, 3)))
    assert len(map_stops([], given_poses(np.empty((0, 4))), TX, FIXED)) == 0
    assert len(map_stops([empty], given_poses(STATE[None]), TX, FIXED)) == 0
    lost = given_poses(np.full((1, 4), np.nan), SolveStatus.FAILED)
    assert len(map_stops([estimate_of(predict_bounce(TX, STATE, POINTS))], lost, TX, FIXED)) == 0


def test_impossible_delays_give_no_warning():
    measured = predict_bounce(TX, STATE, POINTS)
    measured[:, 0] = STATE[3] + np.array([-5.0, 0.0, 1e-9, 0.5, 2.0, 1e4])
    with np.errstate(all="raise"):
        ips = map_stops([estimate_of(measured)], given_poses(STATE[None]), TX, FIXED)
    assert not ips.is_inlier.any()
    assert np.isfinite(ips.position_m).all()


def test_poses_of_other_stops_are_refused():
    with pytest.raises(ValueError, match=r"poses\.stop = \[0\]"):
        map_stops([estimate_of(np.empty((0, 3)), stop=4)], given_poses(STATE[None]), TX, FIXED)
