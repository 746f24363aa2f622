"""The statistical snapshot method: compiled functions against NumPy, lines of sight, double bounces, priors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from estimation.inference.least_squares import student_t_efficiency
from estimation.laws.plane import predict_bounce, predict_los
from estimation.slam.config import Mixture, PathLoss, PathNoise, SnapshotConfig
from estimation.slam.record import SolveStatus
from estimation.slam.snapshot.evidence import log_clutter, log_evidence, power_law, prior_of
from estimation.slam.snapshot.hypotheses import distinct_states, four_bounce_states, line_of_sight_states
from estimation.slam.snapshot.likelihood import MAX_ITERATIONS, log_likelihood, refine_states
from estimation.slam.snapshot.path_table import line_of_sight, path_model, path_table
from estimation.slam.snapshot.problem import snapshot_problem
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.snapshot.statistical import los_candidates
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import channel_estimate, draw_stop
from scenes.pose import Pose, wrap_angle
from tests.estimation.slam import likelihood_oracle

NOISE = PathNoise(floor_delay_std_ns=0.0, floor_angle_std_deg=0.0)
OURS = SnapshotConfig(method="statistical", noise=NOISE)
RIGHT_ANGLES = Mixture(double_share=0.1)
CLUTTERED = ScenarioConfig(outlier_share=0.5)


def drawn(seed, **changes):
    """A simulated stop, its problem and the position of the TX as a state."""
    scenario = draw_stop(np.random.default_rng(seed), replace(CLUTTERED, **changes))
    tx = np.array([*scenario.tx.position_m[:2], 0.0, 0.0])
    return scenario, snapshot_problem(scenario.estimate, scenario.tx, NOISE), tx


def refined(problem, los, start, max_iterations=MAX_ITERATIONS):
    """States, information and log-likelihoods after the compiled refinement."""
    table, model = path_table(problem, OURS.mixture), path_model(OURS.mixture)
    return refine_states(table, line_of_sight(problem, los), model, start, max_iterations)[:3]


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), has_los=st.booleans(), doubles=st.booleans())
def test_compiled_likelihood_is_that_of_numpy(seed, has_los, doubles):
    scenario, problem, tx = drawn(seed, has_los=has_los)
    mixture = RIGHT_ANGLES if doubles else Mixture()
    los = int(np.argmax(scenario.is_los)) if has_los else -1
    spread = np.random.default_rng(seed).normal(size=(8, 4)) * [0.3, 0.3, 0.05, 0.5]
    states = scenario.state + spread * np.arange(8)[:, None]
    found = log_likelihood(
        path_table(problem, mixture), line_of_sight(problem, los), path_model(mixture), states - tx
    )
    if has_los:
        direct = [likelihood_oracle.los_exponent(problem, los, state) for state in states]
        found = found + direct
    expected = [likelihood_oracle.log_likelihood(problem, los, state, mixture) for state in states]
    assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("has_los", [True, False])
def test_refined_state_solves_the_estimating_equation(has_los):
    """Except for few that end where an IP reaches a device: the likelihood is discontinuous there."""
    solved = 0
    for seed in range(40):
        scenario, problem, tx = drawn(seed, has_los=has_los)
        los = int(np.argmax(scenario.is_los)) if has_los else -1
        states, information, likelihood = refined(problem, los, (scenario.state - tx)[None])
        state = states[0] + tx
        slope = likelihood_oracle.estimating_equation(problem, los, state, OURS.mixture)
        std = np.sqrt(np.diag(np.linalg.inv(information[0] + np.diag(OURS.prior_std**-2.0))))
        solved += bool(np.all(np.abs(slope * std) < 1e-4))
        expected = likelihood_oracle.log_likelihood(problem, los, state, OURS.mixture)
        assert likelihood[0] == pytest.approx(expected, abs=1e-8)
        before = likelihood_oracle.log_likelihood(problem, los, scenario.state, OURS.mixture)
        assert likelihood[0] > before - 1.0
    assert solved >= 36


def test_refinement_converges_quadratically():
    for seed in range(20):
        scenario, problem, tx = drawn(seed, has_los=False, outlier_share=0.2, n_paths=9)
        start = (scenario.state - tx + [0.05, -0.05, 0.005, 0.05])[None]
        few, many = (refined(problem, -1, start, n)[0] for n in (20, 200))
        assert_allclose(few, many, atol=1e-6)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), noisy=st.booleans())
def test_states_of_four_bounces_are_those_of_numpy(seed, noisy):
    scenario, problem, tx = drawn(seed, has_los=False, n_paths=7, outlier_share=0.0, is_noisy=noisy)
    states = four_bounce_states(path_table(problem, OURS.mixture), np.arange(len(problem))) + tx
    states[:, 2] = wrap_angle(states[:, 2])
    expected = likelihood_oracle.four_bounce_states(problem)
    assert len(states) == len(expected)
    assert_allclose(states[np.argsort(states[:, 2])], expected, rtol=1e-6, atol=1e-6)
    if not noisy:
        assert np.median(np.abs(states - scenario.state)[:, :2].max(axis=1)) < 1e-6


def test_line_of_sight_and_one_bounce_give_the_true_state():
    scenario, problem, tx = drawn(3, has_los=True, outlier_share=0.0, is_noisy=False)
    los = int(np.argmax(scenario.is_los))
    angles = np.array([problem.departure_rad[los], problem.measured[los, 2]])
    others = np.flatnonzero(scenario.is_single)
    states = line_of_sight_states(path_table(problem, OURS.mixture), los, angles, others) + tx
    states[:, 2] = wrap_angle(states[:, 2])
    assert_allclose(states, np.tile(scenario.state, (len(others), 1)), atol=1e-6)


def test_distinct_states_are_the_best_of_their_neighbourhoods():
    states = np.array(
        [[0.0, 0, 3.14, 0], [0.1, 0, -3.14, 0], [0, 0, 2.9, 0], [5, 0, 0, 0], [6, 0, 0, 0], [7, 0, 0, 0]]
    )
    score = np.array([1.0, 2.0, 0.5, 9.0, np.nan, -30.0])
    assert_array_equal(distinct_states(states, score, 9, np.inf), [3, 1, 2, 5])
    assert_array_equal(distinct_states(states, score, 9, 10.0), [3, 1, 2])
    assert_array_equal(distinct_states(states, score, 2, np.inf), [3, 1])
    assert len(distinct_states(states[:0], score[:0], 3, np.inf)) == 0


def test_a_bounce_that_comes_first_does_not_hide_the_line_of_sight():
    """The measured line of sight is late by 2.5 standard deviations, and a bounce beside it early."""
    for seed in range(5):
        scenario, problem, _ = drawn(seed, has_los=True, outlier_share=0.3, is_noisy=False)
        los = int(np.argmax(scenario.is_los))
        beside = problem.measured[los] + [-0.1, 0.02, -0.03]
        measured = np.vstack([problem.measured, beside])
        power = np.append(problem.power_dbm, problem.power_dbm[los] - 15.0)
        is_los = np.arange(len(measured)) == los
        estimate = channel_estimate(0, measured, power, CLUTTERED.covariance, is_los)
        late = snapshot_problem(estimate, scenario.tx, NOISE)
        assert late.earliest == len(measured) - 1
        assert los in los_candidates(late)
        solution = solve_snapshot(estimate, scenario.tx, OURS)
        assert solution.status == SolveStatus.LOS
        assert_array_equal(solution.is_los, is_los)
        assert np.hypot(*(solution.position_m - scenario.state[:2])) < 0.1


@pytest.mark.parametrize("has_los", [True, False])
def test_a_false_path_before_all_others_does_not_hide_the_receiver(has_los):
    for seed in range(5):
        scenario, problem, _ = drawn(seed, has_los=has_los, outlier_share=0.1, n_paths=9, is_noisy=False)
        ghost = [problem.measured[:, 0].min() - 1.5, 0.3, -1.0]
        measured = np.vstack([ghost, problem.measured])
        power = np.append(problem.power_dbm.min(), problem.power_dbm)
        is_los = np.append(False, scenario.is_los)
        estimate = channel_estimate(0, measured, power, CLUTTERED.covariance, is_los)
        solution = solve_snapshot(estimate, scenario.tx, OURS)
        assert np.hypot(*(solution.position_m - scenario.state[:2])) < 0.3


def test_double_bounces_off_perpendicular_walls_fix_the_heading():
    """Four single bounces agree at two headings or more; two double bounces select the true one."""
    with_doubles = OURS.model_copy(update={"mixture": RIGHT_ANGLES})
    wrong = np.zeros(2, int)
    for seed in range(40):
        scenario, _, _ = drawn(seed, has_los=False, n_paths=8, double_share=1.0)
        for k, config in enumerate((OURS, with_doubles)):
            solution = solve_snapshot(scenario.estimate, scenario.tx, config)
            wrong[k] += abs(wrap_angle(solution.heading_rad - scenario.state[2])) > 0.1
    assert wrong[1] < 0.5 * wrong[0]
    assert wrong[1] <= 6


def test_efficiency_of_the_student_estimate_is_that_of_monte_carlo():
    """Location of Gaussian samples by the Student-t score, against the mean."""
    rng = np.random.default_rng(5)
    sample = rng.standard_normal((4000, 400))
    place = np.zeros((4000, 1))
    for _ in range(50):
        weight = 4.0 / (3.0 + (sample - place) ** 2)
        place = np.sum(weight * sample, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
    assert student_t_efficiency(3, 1) == pytest.approx(1 / (400 * np.var(place)), rel=0.07)
    assert student_t_efficiency(10_000, 1) == pytest.approx(1.0, abs=2e-3)


def test_powers_of_bounces_have_the_density_of_their_covariance():
    loss = PathLoss()
    power, length = np.array([-40.0, -52.0, -47.0]), np.array([[5.0, 20.0, 9.0], [15.0, 30.0, 19.0]])
    covariance = loss.reflection_std_db**2 * np.eye(3) + loss.level_std_db**2
    excess = power - loss.expected_dbm(length) + loss.reflection_loss_db
    square = np.einsum("ki,ij,kj->k", excess, np.linalg.inv(covariance), excess)
    expected = -0.5 * (square + np.linalg.slogdet(2 * np.pi * covariance)[1])
    assert_allclose(loss.log_density_of_others(power, length), expected)
    assert loss.log_density(np.array(-30.0), np.array(10.0)) == pytest.approx(norm.logpdf(0.0, scale=1.8))
    assert_allclose(loss.log_density_of_others(power[:0], length[:, :0]), 0.0)


def test_near_parallel_paths_along_a_corridor_give_no_false_certainty():
    """Line of sight and both side walls at 15 m do not separate clock bias and distance."""
    tx = Pose(np.zeros(3), 0.0)
    covariance = np.diag([0.05, np.deg2rad(0.5), np.deg2rad(0.5)]) ** 2
    failed = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        state = np.array([15.0, rng.uniform(-0.5, 0.5), np.pi, 4.0])
        walls = np.array([-1.0, 1.0])
        points = np.column_stack([state[0] * walls / (2 * walls - state[1]), walls])
        exact = np.vstack([predict_los(tx, state), predict_bounce(tx, state, points)])
        measured = exact + rng.standard_normal(exact.shape) * np.sqrt(np.diag(covariance))
        power = -13.0 - 17.0 * np.log10(15.0) - np.array([0.0, 8.0, 8.0])
        solution = solve_snapshot(channel_estimate(0, measured, power, covariance, np.zeros(3, bool)), tx, OURS)
        failed += solution.status == SolveStatus.FAILED
        error = np.hypot(*(solution.position_m - state[:2]))
        assert solution.status == SolveStatus.FAILED or error < 5 * solution.position_std_m
    assert failed >= 10


def test_clutter_alone_is_no_solution():
    rng = np.random.default_rng(7)
    solved = 0
    for stop in range(40):
        measured = np.column_stack([rng.uniform(5, 30, 5), rng.uniform([-1.5, -np.pi], [1.5, np.pi], (5, 2))])
        estimate = channel_estimate(stop, measured, rng.normal(-45, 4, 5), CLUTTERED.covariance, np.zeros(5, bool))
        solved += solve_snapshot(estimate, Pose(np.zeros(3), 0.0), OURS).status != SolveStatus.FAILED
    assert solved <= 10


def test_a_mode_with_an_incredible_clock_bias_is_dropped():
    scenario, _, _ = drawn(2, has_los=True, outlier_share=0.0)
    narrow = OURS.model_copy(update={"max_clock_bias_ns": 0.5})
    assert abs(scenario.state[3]) > 1.0
    solution = solve_snapshot(scenario.estimate, scenario.tx, narrow)
    assert solution.status == SolveStatus.FAILED or abs(solution.clock_bias_s) <= 0.5e-9


def test_shares_of_clutter_and_doubles_must_be_below_one():
    with pytest.raises(ValueError, match="must be below 1"):
        Mixture(clutter_share=0.6, double_share=0.4)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), has_los=st.booleans())
def test_compiled_evidence_is_that_of_its_parts(seed, has_los):
    """Likelihood, prior, powers, and the density of clutter instead of the line of sight."""
    scenario, problem, tx = drawn(seed, has_los=has_los)
    los = int(np.argmax(scenario.is_los)) if has_los else -1
    state, root = scenario.state - tx, np.random.default_rng(seed).normal(size=(4, 4))
    information, loss, reach = 50 * root @ root.T, OURS.path_loss, float(np.hypot(*(scenario.state - tx)[:2]))
    ranges, clock = problem.measured[:, 0], OURS.max_clock_bias_m
    found, covariance = log_evidence(
        ranges, problem.power_dbm, los, problem.covariance[los], state, information, -3.0,
        power_law(loss), prior_of(OURS),
    )  # fmt: skip
    full = information + np.diag(OURS.prior_std**-2.0)
    assert_allclose(covariance @ full, np.eye(4), atol=1e-8)
    others = np.arange(len(problem)) != los
    length = np.maximum(ranges[others] - state[3], reach)
    expected = -3.0 - 0.5 * np.linalg.slogdet(full)[1]
    expected += norm.logpdf(state[:2], scale=OURS.reach_m).sum() - np.log(2 * np.pi * 2 * clock)
    # The evidence omits the factors 2 pi of the determinant of the Laplace approximation.
    expected += 2 * np.log(2 * np.pi)
    expected += float(loss.log_density_of_others(problem.power_dbm[others], length))
    if has_los:
        expected += float(loss.log_density(problem.power_dbm[los], np.array(reach)))
        expected -= 0.5 * np.linalg.slogdet(2 * np.pi * problem.covariance[los])[1]
        expected += np.log((2 * np.pi) ** 2 * OURS.mixture.clutter_width_m)
    assert found == pytest.approx(expected, abs=1e-8)


def test_clutter_is_averaged_over_lengths_of_the_straight_line():
    _, problem, _ = drawn(5, has_los=False)
    loss, ranges = OURS.path_loss, problem.measured[:, 0]
    distance = OURS.reach_m * np.geomspace(0.05, 2.0, 12)[:, None]
    density = loss.log_density_of_others(problem.power_dbm, ranges - ranges.min() + distance)
    expected = np.log(np.mean(np.exp(density))) + len(problem) * np.log(OURS.mixture.clutter_share)
    found = log_clutter(ranges, problem.power_dbm, power_law(loss), prior_of(OURS))
    assert found == pytest.approx(expected)
