"""Bounces off floor and ceiling: the law in space, the heights that are learned, a walk under a rough ceiling."""

import numpy as np
import pytest

from estimation.laws.flat import flat_log_densities, flat_path
from estimation.laws.plane import bounce_gap
from estimation.slam.config import MappingConfig, PathNoise, SnapshotConfig, TrajectoryConfig
from estimation.slam.level import KnownHeights
from estimation.slam.stops import locate_and_map
from estimation.slam.walk import alternation
from estimation.slam.walk.flats import _log_odds, excess_law, learned_flats, off_flats, with_possible_excess
from estimation.slam.walk.motion import course_of
from estimation.slam.walk.residuals import Association, PathClass, TrajectoryState
from scenes.pose import Pose, wrap_angle
from tests.estimation.slam.walk.test_raised import (
    PANELS,
    POLES,
    drawn,
    observed_paths,
    seen_estimate,
    seen_in_space,
    upright,
)

TX = Pose(np.array([0.0, 0.0, 2.2]), 0.3)
RX_HEIGHT, CEILING = 1.3, 3.9
N_FLAT, N_STOPS = 12, 10  # paths off each surface at a stop


def test_a_path_off_a_flat_surface_is_seen_from_above_at_its_height():
    rng, n_tried = np.random.default_rng(1), 0
    for _ in range(300):
        tx, state, point, difference_m, boresight = drawn(rng)
        legs = np.array([point[:2] - end[:2] for end in (tx, state)])
        azimuth = np.arctan2(legs[:, 1], legs[:, 0])
        if abs(np.cos((azimuth[1] - azimuth[0]) / 2)) < 0.2 or min(abs(point[2] - [0.0, difference_m])) < 0.1:
            continue  # nearly straight: the place of the bounce does not show
        n_tried += 1
        seen = seen_in_space(tx, state, point, difference_m, boresight)
        plan, slope = np.empty(3), np.empty(3)
        flat_path(tx, state, seen, point[2], difference_m, boresight, plan, slope)
        expected = [np.linalg.norm(legs, axis=1).sum() + state[3], *(azimuth - [tx[2], state[2]])]
        off = plan - expected
        np.testing.assert_allclose(np.append(off[0], wrap_angle(off[1:])), 0.0, atol=2e-2)
        gap = bounce_gap(tx[None], state[None], plan[None])[0][0]
        level_gap = bounce_gap(tx[None], state[None], seen[None])[0][0]
        assert abs(gap) < 0.05 * abs(level_gap) + 1e-3
    assert n_tried > 150


def test_the_slope_of_the_plan_length_is_that_of_its_differences():
    rng, step = np.random.default_rng(2), 1e-5
    for _ in range(50):
        tx, state, point, difference_m, _ = drawn(rng)
        level = np.full(2, np.nan)  # azimuths are no cone angles
        seen = seen_in_space(tx, state, point, difference_m, level)
        plan, slope, moved = np.empty((2, 3)), np.empty(3), np.empty(3)
        for k, sign in enumerate((1, -1)):
            moved[:] = seen
            moved[0] += sign * step
            flat_path(tx, state, moved, point[2], difference_m, level, plan[k], slope)
        assert slope[0] == pytest.approx((plan[0, 0] - plan[1, 0]) / (2 * step), rel=1e-3, abs=1e-3)
        np.testing.assert_array_equal(slope[1:], 1.0)


def rough_hall(rng):
    """Estimates of a walk between poles, under a ceiling and over a floor that scatter anywhere; and the truth."""
    position = np.column_stack(
        [np.linspace(3, 12, N_STOPS), 0.3 * np.sin(np.arange(N_STOPS)), np.full(N_STOPS, RX_HEIGHT)]
    )
    heading, clock_m = rng.uniform(-0.2, 0.2, N_STOPS), rng.normal(0, 3, N_STOPS)
    estimates, is_flat = [], np.repeat([False, True, False], [len(POLES), 2 * N_FLAT, 1])
    for k in range(N_STOPS):
        spots = upright(TX, position[k])
        for height in (0.0, CEILING):
            spots += [[*rng.uniform([2, -5], [15, 5]), height] for _ in range(N_FLAT)]
        estimates.append(seen_estimate(rng, k, spots, TX, position[k], heading[k], clock_m[k]))
    return estimates, position, heading, clock_m, np.tile(is_flat, N_STOPS)


HEIGHTS = KnownHeights(np.full(N_STOPS, TX.position_m[2] - RX_HEIGHT), 0.0, PANELS, PANELS)


def observed(estimates, position, heading, clock_m):
    """What the walk has of estimates, and the true states."""
    state = np.column_stack([position[:, :2], heading, clock_m])
    seen = observed_paths(estimates, TX, HEIGHTS, state)
    none = np.empty((0, 2)), np.empty((0, 3))
    return seen, TrajectoryState(state, np.zeros(1), *none, np.zeros(N_STOPS, int), 0, course_of(state))


def test_floor_and_ceiling_are_learned_and_their_paths_told():
    *hall, is_flat = rough_hall(np.random.default_rng(3))
    seen, now = observed(*hall)
    is_los = np.tile(np.arange(len(hall[0][0])) == len(hall[0][0]) - 1, N_STOPS)
    height_m = learned_flats(seen, now, is_los)
    np.testing.assert_allclose(np.sort(height_m), [-RX_HEIGHT, CEILING - RX_HEIGHT], atol=0.05)
    found = off_flats(seen, now, is_los, height_m)
    assert found[is_flat].mean() > 0.8
    assert found[~is_flat].mean() < 0.1
    assert not off_flats(seen, now, is_los, np.empty(0)).any()


def test_no_surface_is_learned_where_there_is_none():
    *hall, is_flat = rough_hall(np.random.default_rng(4))
    seen, now = observed(*hall)
    only = seen.take(~is_flat)
    is_los = np.tile(np.arange(len(POLES) + 1) == len(POLES), N_STOPS)
    assert learned_flats(only, now, is_los).size == 0


def test_the_density_of_an_upright_surface_is_that_of_the_gap():
    *hall, _ = rough_hall(np.random.default_rng(6))
    seen, now = observed(*hall)
    some, state = seen.take(np.arange(4)), np.tile(now.state[0], (4, 1))
    ends = some.heights
    density = flat_log_densities(
        some.tx_rows,
        state,
        some.measured,
        some.covariance,
        np.array([np.nan]),
        ends.difference_m,
        ends.boresight_rad,
    )
    gap, _, by, _ = bounce_gap(TX, state, some.measured)
    std = np.sqrt(np.einsum("pi,pij,pj->p", by, some.covariance, by)) / np.abs(by[:, 0])
    expected = -0.5 * (gap / by[:, 0] / std) ** 2 - np.log(np.sqrt(2 * np.pi) * std)
    np.testing.assert_allclose(density[0], expected, rtol=1e-9)


def test_a_rough_ceiling_does_not_pull_the_walk(monkeypatch):
    estimates, position, *_ = rough_hall(np.random.default_rng(5))
    slam = SnapshotConfig(noise=PathNoise())

    def error_m():
        poses, _ = locate_and_map(estimates, TX, slam, TrajectoryConfig(), MappingConfig(), HEIGHTS)
        return np.hypot(*(poses.position_m - position[:, :2]).T)

    ours = error_m()
    monkeypatch.setattr(alternation, "learned_flats", lambda *_: np.empty(0))
    without = error_m()

    assert np.sqrt(np.mean(ours**2)) < 0.02
    assert np.sqrt(np.mean(ours**2)) < np.sqrt(np.mean(without**2))


def test_level_bounces_are_told_from_those_of_other_heights():
    rng = np.random.default_rng(7)
    std_m = rng.uniform(0.002, 0.02, 400)
    excess_m = std_m * rng.normal(size=400)
    smooth = excess_law(excess_m, std_m).level_probability
    assert (smooth > 0.9).mean() > 0.9  # every path is level: so are they found
    is_raised = rng.random(400) < 0.7
    excess_m += np.where(is_raised, rng.exponential(0.3, 400), 0.0)
    law = excess_law(excess_m, std_m)
    rough = law.level_probability
    assert law.variance_m2 == pytest.approx(0.7 * 2 * 0.3**2, rel=0.3)  # of an exponential law
    assert (rough[is_raised] > 0.9).mean() < 0.02
    assert (rough[~is_raised] > 0.9).mean() > 0.4
    assert excess_law(np.empty(0), np.empty(0)).level_probability.size == 0


def test_only_bounces_that_nothing_checks_have_the_excess_of_others_as_an_error():
    *hall, _ = rough_hall(np.random.default_rng(8))
    seen, now = observed(*hall)
    kind = np.full(len(seen.row), PathClass.BOUNCE)
    for stop in range(1, N_STOPS):
        kind[np.flatnonzero(seen.row == stop)[:2]] = PathClass.OBJECT
    link = Association(kind, np.full((len(kind), 2), -1))
    added = with_possible_excess(seen, link, now).covariance - seen.covariance
    is_first = seen.row == 0
    assert np.all(added[is_first, 0, 0] > 0.01)
    assert np.ptp(added[is_first, 0, 0]) < 1e-9
    added[is_first, 0, 0] = 0.0
    assert not added.any()
    kind[seen.row == 0] = np.where(np.arange(is_first.sum()) == 0, PathClass.LOS, PathClass.BOUNCE)
    assert with_possible_excess(seen, Association(kind, link.landmark), now) is seen


@pytest.mark.parametrize("flat", [60.0, 0.0, -60.0])
def test_paths_that_all_agree_leave_odds_that_are_finite(flat):
    odds = _log_odds(np.full(3, flat), np.full(3, 0.0))
    assert np.isfinite(odds).all()
    assert (np.sign(odds) == np.sign(flat)).all()
