"""Versions tied: a group against a plain non-linear fit, gains and honesty over many stops, and what stays."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from estimation.channel.correlation import PointingErrors, correlated_paths
from estimation.channel.hall.campaign import hall_estimates
from estimation.channel.hall.geometry import HEIGHT_SLOPES, Heights
from estimation.channel.hall.groups import Groups
from estimation.channel.hall.model import GivenHeights, read_hall
from estimation.channel.hall.record import HallModel
from estimation.channel.hall.stop import HallStop, in_hall, located
from estimation.channel.hall.tied import tied_paths
from estimation.channel.record import ChannelEstimate
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from tests.estimation.channel.hall.hall_estimates import WEAK, TrueHall, hall_link, synthetic_hall

HEIGHTS = Heights(2.6, 1.4, 4.3)
SHARED_STD_M = np.array([0.01, 0.01, 0.01, 0.05])  # of heights and clock


def with_correlated_versions(truth: TrueHall, rng: np.random.Generator) -> list[ChannelEstimate]:
    """The estimates, with errors of versions of one plan path that nearly cancel: their sum is known well."""
    made = []
    for estimate, version, plan in zip(truth.estimates, truth.version, truth.plan, strict=True):
        n, size = len(estimate), estimate.covariance.shape[1]
        same = (np.abs(plan[:, None] - plan).max(axis=2) == 0) & (version[:, None] != WEAK) & (version != WEAK)
        joint = np.where(same, -0.4 / np.maximum(same.sum(axis=1) - 1, 1)[:, None], 0.0)
        joint[np.arange(n), np.arange(n)] = 1.0
        joint = (joint + joint.T) / 2
        std = np.sqrt(np.einsum("paa->pa", estimate.covariance)) * np.where(version == WEAK, 1.0, 3.0)[:, None]
        error = std * (np.linalg.cholesky(joint) @ rng.standard_normal((n, size)))
        whole = np.einsum("pq,pa,qb,ab->paqb", joint, std, std, np.eye(size))
        noisy = replace(
            estimate,
            delay_s=estimate.delay_s + error[:, 0],
            aod_azimuth_rad=estimate.aod_azimuth_rad + error[:, 1],
            aoa_azimuth_rad=estimate.aoa_azimuth_rad + error[:, 2],
            covariance=np.einsum("papb->pab", whole) + estimate.covariance,
            correlated=correlated_paths(whole),
        )
        made.append(noisy)
    return made


@cache
def stop_of(seed: int) -> tuple[HallStop, HallModel, TrueHall]:
    link = hall_link(sees_elevation=False)
    truth = synthetic_hall(np.random.default_rng(seed), HEIGHTS, link)
    estimates = with_correlated_versions(truth, np.random.default_rng(seed + 100))
    hall = read_hall(estimates, link, GivenHeights(HEIGHTS.tx_m, HEIGHTS.rx_m, 0.01))
    assert hall is not None
    return located(estimates[0], hall, link), hall, truth


def plain_fit(stop: HallStop, heights_m: np.ndarray, group: tuple[tuple[int, int], ...]) -> np.ndarray:
    """Ranges and azimuths (member, 3) of a group by a non-linear fit of plan path, heights and clock."""
    paths, members = stop.paths, [path for path, _ in group]
    joint = paths.cross[np.ix_(members, members)].copy()
    joint[np.arange(len(group)), np.arange(len(group))] = paths.covariance[members]
    noise = joint[:, :, :3, :3].transpose(0, 2, 1, 3).reshape(3 * len(group), -1)
    root = np.linalg.inv(np.linalg.cholesky(noise))
    observed = np.column_stack([paths.range_m, paths.azimuth_rad])[members]

    def expected(unknown: np.ndarray) -> np.ndarray:
        plan, shift = unknown[:3], unknown[3:] * SHARED_STD_M
        rows = []
        for path, version in group:
            difference = HEIGHT_SLOPES[version] @ (heights_m + shift[:3])
            length = np.hypot(plan[0], difference)
            turn = plan[1:] - paths.boresight_rad[path]
            cone = paths.boresight_rad[path] + np.arcsin(np.sin(turn) * plan[0] / length)
            rows.append([length + stop.clock_m + shift[3], *cone])
        return np.array(rows)

    def residuals(unknown: np.ndarray) -> np.ndarray:
        off = expected(unknown) - observed
        off[:, 1:] = wrap_angle(off[:, 1:])
        return np.concatenate([root @ off.ravel(), unknown[3:]])

    start = np.concatenate([stop.states.points.value[group[0]], np.zeros(4)])
    return expected(least_squares(residuals, start, x_scale=np.array([1, 0.01, 0.01, 1, 1, 1, 1])).x)


def test_a_group_is_the_least_squares_fit_of_its_plan_path() -> None:
    stop, hall, truth = stop_of(0)
    groups = Groups(stop.paths, stop.states, hall.priors, np.diag(SHARED_STD_M**2), hall.heights.differences_m)
    members = np.flatnonzero((truth.plan[0] == truth.plan[0][truth.version[0] == 1][0]).all(axis=1))
    group = tuple((int(path), int(truth.version[0][path])) for path in members)
    assert len(group) > 1
    observed = np.column_stack([stop.paths.range_m, stop.paths.azimuth_rad])[members]
    found = observed + groups.solve(group).shift[:, :3]
    std = np.sqrt(stop.paths.variance[members, :3])
    assert np.abs((found - plain_fit(stop, hall.heights_m, group)) / std).max() < 0.1  # second order


def test_tied_versions_err_less_and_say_so() -> None:
    before, after, nees = [], [], []
    for seed in range(3):
        link = hall_link(sees_elevation=False)
        truth = synthetic_hall(np.random.default_rng(seed), HEIGHTS, link)
        estimates = with_correlated_versions(truth, np.random.default_rng(seed + 100))
        hall = read_hall(estimates, link, GivenHeights(HEIGHTS.tx_m, HEIGHTS.rx_m, 0.01))
        assert hall is not None
        for row, estimate in enumerate(estimates):
            tied, classes = in_hall(estimate, hall, link)
            chosen = (classes.tied_probability > 0.9) & (truth.version[row] != WEAK)
            truth_s = true_delays_s(truth, row)
            before.append((estimate.delay_s - truth_s)[chosen])
            after.append((tied.delay_s - truth_s)[chosen])
            nees.append(np.square(after[-1]) / tied.covariance[chosen, 0, 0])
    rms = [float(np.sqrt(np.mean(np.square(np.concatenate(part))))) for part in (before, after)]
    assert rms[1] < 0.8 * rms[0]
    assert np.mean(np.concatenate(nees)) == pytest.approx(1, abs=0.5)


def true_delays_s(truth: TrueHall, row: int) -> np.ndarray:
    """True delays of the paths of a stop with its clock bias."""
    version = np.maximum(truth.version[row], 0)
    difference = np.where(truth.version[row] == WEAK, 0.0, HEIGHTS.differences_m[version])
    return (np.hypot(truth.plan[row][:, 0], difference) + truth.clock_m[row]) / SPEED_OF_LIGHT_M_S


def test_paths_without_versions_stay() -> None:
    stop, hall, _ = stop_of(1)
    none = replace(stop.states.pairs, ratio=np.zeros_like(stop.states.pairs.ratio))
    states = replace(stop.states, pairs=none)
    groups = Groups(stop.paths, states, hall.priors, stop.shared_m2, hall.heights.differences_m)
    tied = tied_paths(groups)
    np.testing.assert_array_equal(tied.shift, 0)
    np.testing.assert_array_equal(tied.covariance, stop.paths.covariance)
    assert not tied.probability.any()


def test_nothing_is_tied_where_errors_in_common_are_not_told() -> None:
    link = hall_link(sees_elevation=False)
    truth = synthetic_hall(np.random.default_rng(2), HEIGHTS, link)
    estimate = with_correlated_versions(truth, np.random.default_rng(3))[0]
    hall = read_hall(truth.estimates, link, GivenHeights(HEIGHTS.tx_m, HEIGHTS.rx_m, 0.01))
    assert hall is not None
    assert in_hall(estimate, hall, link)[1].tied_probability.any()
    arrays_err = replace(estimate, pointing=PointingErrors(1e-3 * estimate.covariance))
    for marked in (arrays_err, replace(estimate, correlated=None)):
        same, classes = in_hall(marked, hall, link)
        np.testing.assert_array_equal(same.delay_s, marked.delay_s)
        assert not classes.tied_probability.any()


def test_the_paths_of_a_campaign_come_back_in_order_of_delay() -> None:
    link = hall_link(sees_elevation=False)
    truth = synthetic_hall(np.random.default_rng(3), HEIGHTS, link)
    estimates = with_correlated_versions(truth, np.random.default_rng(7))
    given = GivenHeights(HEIGHTS.tx_m, HEIGHTS.rx_m, 0.01)
    silent = replace(estimates[0].take("path", []), stop=99)
    hall = hall_estimates([estimates[0], silent, *estimates[1:]], link, given, np.array([0, 2, 3]))
    assert hall.model is not None
    assert len(hall.applied(silent)) == 0
    for estimate in estimates:
        applied = hall.applied(estimate)
        assert (np.diff(applied.delay_s) >= 0).all()
        assert len(applied) == len(estimate)
        assert applied.hall is not None
        np.testing.assert_allclose(applied.hall.class_probability.sum(axis=1), 1)
        alone, _ = in_hall(estimate, hall.model, link)
        np.testing.assert_array_equal(np.sort(alone.delay_s), applied.delay_s)
