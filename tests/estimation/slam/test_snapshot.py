"""Snapshot SLAM on simulated path parameters: exactness, robustness, consistency, degenerate input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.channel.record import ChannelEstimate
from estimation.laws.plane import predict_bounce, predict_los
from estimation.slam.config import MappingConfig, PathNoise, SnapshotConfig
from estimation.slam.record import SolveStatus
from estimation.slam.snapshot.problem import packed_normal, snapshot_problem, solve_packed
from estimation.slam.snapshot.refine import bounce_terms
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.stops import run_slam
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle

TX = Pose(np.array([2.25, 2.5, 1.8]), -1.6)
SHARP = PathNoise(source="fixed", delay_std_ns=0.02, angle_std_deg=0.02)
NOISE_STD = np.array([0.15, np.deg2rad(0.6), np.deg2rad(0.6)])
METHODS = [
    SnapshotConfig(method="reference"),
    SnapshotConfig(method="reference", refine=True),
    SnapshotConfig(method="statistical"),
]


def estimate_of(measured: np.ndarray, power_dbm: np.ndarray) -> ChannelEstimate:
    n = len(measured)
    std = NOISE_STD / [SPEED_OF_LIGHT_M_S, 1, 1]
    return ChannelEstimate(
        stop=0,
        delay_s=measured[:, 0] / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=measured[:, 1],
        aoa_azimuth_rad=measured[:, 2],
        power_dbm=power_dbm,
        beam_loss_db=np.zeros(n),
        snr_db=np.full(n, 20.0),
        covariance=np.tile(np.diag(std**2), (n, 1, 1)),
        is_los=np.zeros(n, bool),
    )


def simulate(rng, *, bounces: int, clutter: int = 0, los: bool, noise: float = 0.0):
    """RX state [x, y, heading, bias in m] and the channel estimate of a random stop, line of sight first."""
    state = rng.uniform([-5, -6, -3, 3], [6, -2.5, 3, 20])
    points = rng.uniform([-12, -14], [12, 1], (100, 2))
    direct = predict_los(TX, state)
    paths = predict_bounce(TX, state, points)
    visible = (paths[:, 0] > direct[0] + 0.5) & (np.abs(paths[:, 1]) < 1.6)
    near = np.minimum(np.hypot(*(points - TX.position_m[:2]).T), np.hypot(*(points - state[:2]).T)) < 1
    paths = paths[visible & ~near][:bounces]
    ghosts = rng.uniform([direct[0] + 0.5, -1.5, -np.pi], [direct[0] + 25, 1.5, np.pi], (clutter, 3))
    measured = np.concatenate([np.atleast_2d(direct)[:los], paths, ghosts])
    length = measured[:, 0] - state[3]
    power = -13 - 20 * np.log10(length) - 15.0
    power[:los] = -13 - 17 * np.log10(length[:los])
    measured = measured + noise * rng.normal(size=measured.shape) * NOISE_STD
    return state, estimate_of(measured, power)


def state_error(solution, state: np.ndarray) -> np.ndarray:
    return np.array(
        [
            *(solution.position_m - state[:2]),
            wrap_angle(solution.heading_rad - state[2]),
            solution.clock_bias_s - state[3] / SPEED_OF_LIGHT_M_S,
        ]
    )


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_noiseless_line_of_sight_is_exact_with_every_method(seed):
    state, estimate = simulate(np.random.default_rng(seed), bounces=5, los=True)
    for config in METHODS:
        solution = solve_snapshot(estimate, TX, config.model_copy(update={"noise": SHARP}))
        assert solution.status == SolveStatus.LOS
        assert np.abs(state_error(solution, state)[:3]).max() < 1e-6
        assert solution.is_inlier.all()


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_noiseless_single_bounces_alone_are_exact_with_the_statistical_method(seed):
    state, estimate = simulate(np.random.default_rng(seed), bounces=7, los=False)
    solution = solve_snapshot(estimate, TX, SnapshotConfig(method="statistical", noise=SHARP))
    assert solution.status == SolveStatus.NLOS
    assert np.abs(state_error(solution, state)[:3]).max() < 1e-5


def test_refinement_moves_the_grid_solution_to_the_truth():
    for seed in range(5):
        state, estimate = simulate(np.random.default_rng(seed), bounces=7, los=False)
        config = SnapshotConfig(method="reference", noise=SHARP)
        grid = solve_snapshot(estimate, TX, config)
        refined = solve_snapshot(estimate, TX, config.model_copy(update={"refine": True}))
        assert np.hypot(*state_error(grid, state)[:2]) > 1e-3
        assert np.abs(state_error(refined, state)[:3]).max() < 1e-9


def monte_carlo(config: SnapshotConfig, trials: int, **setting):
    """Errors (trial, 4) and normalised estimation errors squared (trial,)."""
    errors, nees = [], []
    for trial in range(trials):
        state, estimate = simulate(np.random.default_rng([11, trial]), **setting)
        solution = solve_snapshot(estimate, TX, config)
        error = state_error(solution, state)
        errors.append(error)
        scale = np.array([1, 1, 1, SPEED_OF_LIGHT_M_S])
        covariance = solution.covariance * np.outer(scale, scale)
        nees.append(error * scale @ np.linalg.solve(covariance, error * scale))
    return np.array(errors), np.array(nees)


def test_each_step_improves_and_covariances_are_consistent():
    setting = {"bounces": 6, "clutter": 2, "los": True, "noise": 1.0}
    median = []
    for config in METHODS:
        errors, nees = monte_carlo(config, 60, **setting)
        median.append(np.nanmedian(np.hypot(errors[:, 0], errors[:, 1])))
        if config.refine or config.method == "statistical":
            assert 2.0 < np.nanmedian(nees) < 4.7  # 3.36 for chi-square with 4 degrees of freedom
    assert median[0] > 1.1 * median[1] > 1.1 * 1.1 * median[2]
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 1.0


@pytest.mark.slow
def test_statistical_method_makes_fewer_gross_errors_without_line_of_sight():
    setting = {"bounces": 6, "clutter": 3, "los": False, "noise": 1.0}
    gross = []
    for config in (SnapshotConfig(method="reference", refine=True), SnapshotConfig(method="statistical")):
        errors, _ = monte_carlo(config, 80, **setting)
        gross.append(np.mean(np.hypot(errors[:, 0], errors[:, 1]) > 1.0))
    assert gross[1] < 0.75 * gross[0]


def test_jacobian_and_variance_of_the_bounce_residual_match_finite_differences():
    state, estimate = simulate(np.random.default_rng(2), bounces=6, los=False, noise=1.0)
    problem = snapshot_problem(estimate, TX, PathNoise(source="fixed"))
    state = state + 0.1

    def value(moved_state, moved):
        return bounce_terms(TX, moved, problem.covariance, moved_state).value_m

    at = bounce_terms(TX, problem.measured, problem.covariance, state)
    for i in range(4):
        step = 1e-6 * np.eye(4)[i]
        slope = (value(state + step, problem.measured) - value(state - step, problem.measured)) / 2e-6
        np.testing.assert_allclose(at.jacobian[:, i], slope, atol=1e-6)
    for i in range(3):
        step = 1e-6 * np.eye(3)[i]
        slope = (value(state, problem.measured + step) - value(state, problem.measured - step)) / 2e-6
        np.testing.assert_allclose(at.by_measurement[:, i], slope, atol=1e-6)
    expected = np.einsum("mi,mij,mj->m", at.by_measurement, problem.covariance, at.by_measurement)
    np.testing.assert_allclose(at.variance_m2, expected, rtol=1e-12)


def test_packed_equations_solve_like_least_squares():
    rng = np.random.default_rng(0)
    row, right = rng.normal(size=(5, 6, 3)), rng.normal(size=(5, 6))
    solved = solve_packed(packed_normal(row, right).sum(axis=1))
    expected = [np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(row, right, strict=True)]
    np.testing.assert_allclose(solved, expected, rtol=1e-9)
    assert np.isnan(solve_packed(packed_normal(np.ones((4, 3)), np.ones(4)).sum(axis=0))).all()


@pytest.mark.parametrize("config", METHODS, ids=["reference", "refined", "statistical"])
@pytest.mark.parametrize(
    ("bounces", "los"), [(0, False), (1, False), (2, False), (3, False), (0, True), (1, True)]
)
def test_too_few_paths_fail_as_a_status(config, bounces, los):
    _, estimate = simulate(np.random.default_rng(1), bounces=bounces, los=los)
    assert len(estimate) == bounces + los
    solution = solve_snapshot(estimate, TX, config)
    assert solution.status == SolveStatus.FAILED
    assert np.isnan(solution.position_m).all()
    assert not solution.is_inlier.any()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("config", METHODS, ids=["reference", "refined", "statistical"])
@pytest.mark.parametrize("case", ["identical", "parallel", "early", "quiet"])
def test_degenerate_paths_never_raise_or_warn(config, case):
    measured = np.tile([20.0, 0.3, 1.0], (6, 1))
    if case == "parallel":
        measured[:, 0] += np.arange(6)
        measured[:, 2] = measured[:, 1] + np.pi
    if case == "early":
        measured[:, 0] = -1e3 - np.arange(6)
    power = np.full(6, -300.0 if case == "quiet" else -45.0)
    solution = solve_snapshot(estimate_of(measured, power), TX, config)
    assert solution.status in (SolveStatus.FAILED, SolveStatus.LOS, SolveStatus.NLOS)


def test_many_paths_are_capped_by_power():
    state, estimate = simulate(np.random.default_rng(4), bounces=30, los=False)
    solution = solve_snapshot(estimate, TX, SnapshotConfig(method="statistical", noise=SHARP))
    assert np.abs(state_error(solution, state)[:3]).max() < 1e-6
    problem = snapshot_problem(estimate, TX, SHARP)
    strongest = problem.strongest
    assert len(strongest) == 12
    assert problem.power_dbm[strongest].min() >= np.delete(problem.power_dbm, strongest).max()


def test_slam_maps_the_stops_it_solved():
    rng = np.random.default_rng(8)
    state, good = simulate(rng, bounces=6, clutter=1, los=True)
    _, bad = simulate(rng, bounces=2, los=False)
    bad = type(bad)(**{**vars(bad), "stop": 1})
    poses, points = run_slam([good, bad], TX, SnapshotConfig(method="statistical"), MappingConfig())
    assert poses.status.tolist() == [SolveStatus.LOS, SolveStatus.FAILED]
    assert np.isnan(poses.position_m[1]).all()
    assert set(points.stop.tolist()) == {0}
    assert points.path.tolist() == list(range(1, 8))
    assert points.is_inlier[:6].all()
    assert not points.is_inlier[6]
    np.testing.assert_allclose(
        predict_bounce(TX, state, points.position_m[:6])[:, 0], SPEED_OF_LIGHT_M_S * good.delay_s[1:7], atol=0.1
    )


def test_slam_incidence_points_match_their_covariance():
    nees = []
    for trial in range(60):
        rng = np.random.default_rng([21, trial])
        _, clean = simulate(rng, bounces=6, los=True)
        noisy = estimate_of(
            np.column_stack([SPEED_OF_LIGHT_M_S * clean.delay_s, clean.aod_azimuth_rad, clean.aoa_azimuth_rad])
            + rng.normal(size=(7, 3)) * NOISE_STD,
            clean.power_dbm,
        )
        noise = PathNoise(floor_delay_std_ns=0.0, floor_angle_std_deg=0.0)
        config = SnapshotConfig(method="statistical", noise=noise)
        _, points = run_slam([noisy], TX, config, MappingConfig(noise=noise))
        _, exact = run_slam([clean], TX, config, MappingConfig(noise=noise))
        error = points.position_m - exact.position_m
        use = points.is_inlier & exact.is_inlier
        inverse = np.linalg.inv(points.covariance_m2)
        nees.extend(np.einsum("ni,nij,nj->n", error, inverse, error)[use])
    assert np.median(nees) * 2 / 1.386 == pytest.approx(2.0, abs=0.5)  # 1.386: median, 2 degrees of freedom


def test_same_input_gives_the_same_bits():
    _, estimate = simulate(np.random.default_rng(9), bounces=9, clutter=2, los=False, noise=1.0)
    for config in METHODS:
        first, second = (solve_snapshot(estimate, TX, config) for _ in range(2))
        assert first.position_m.tobytes() == second.position_m.tobytes()
        assert first.cost == second.cost


def test_unknown_keys_are_refused():
    with pytest.raises(ValueError, match="grid"):
        SnapshotConfig.model_validate({"grid": 3})
