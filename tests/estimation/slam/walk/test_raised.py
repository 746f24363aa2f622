"""Points at heights of their own: the kernel against geometry in space, and a walk below scattering points."""

import numpy as np

from estimation.channel.record import AngleKind, ChannelEstimate
from estimation.laws.level import plan_paths
from estimation.laws.raised import PathHeights, raised_path, raised_range
from estimation.slam.config import MappingConfig, PathNoise, SnapshotConfig, TrajectoryConfig
from estimation.slam.level import KnownHeights
from estimation.slam.stops import locate_and_map
from estimation.slam.walk import association
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.motion import course_of
from estimation.slam.walk.raised import with_raised
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle

PANELS = np.deg2rad([-180.0, -90.0, 0.0, 90.0])
TX = Pose(np.array([0.0, 0.0, 1.4]), 0.3)
RX_HEIGHT = 1.4
CONFIG = TrajectoryConfig()


def seen_in_space(tx, state, point, difference_m, boresight):
    """Range and azimuths of a path by way of a point (3,) over the receiver, seen from above as if level."""
    ends = np.array([[*tx[:2], difference_m], [*state[:2], 0.0]])
    rays = point - ends
    length = np.linalg.norm(rays, axis=1).sum()
    azimuth = np.arctan2(rays[:, 1], rays[:, 0]) - [tx[2], state[2]]
    turn = wrap_angle(azimuth - np.nan_to_num(boresight))
    cone = np.arcsin(np.sin(turn) * np.hypot(*rays[:, :2].T) / np.linalg.norm(rays, axis=1)) + boresight
    is_cone = np.isfinite(boresight)
    level = plan_paths(
        np.array(length),
        np.where(is_cone, cone, azimuth),
        np.nan_to_num(boresight),
        is_cone,
        np.full(2, 1e-3),
        np.array(difference_m),
    )
    return level.value + np.array([state[3], 0.0, 0.0])


def drawn(rng):
    """A TX, a state, a point at a height and panels that face it."""
    tx = np.array([*rng.normal(size=2) * 5, rng.uniform(-3, 3)])
    state = np.array([*rng.normal(size=2) * 5 + 9, rng.uniform(-3, 3), 5 * rng.normal()])
    point = np.array([*rng.normal(size=2) * 6, rng.uniform(-2, 2)])
    azimuth = np.array([np.arctan2(*(point[1::-1] - end[1::-1])) - end[2] for end in (tx, state)])
    boresight = np.array([PANELS[np.argmin(np.abs(wrap_angle(one - PANELS)))] for one in azimuth])
    boresight[rng.random(2) < 0.25] = np.nan
    return tx, state, point, float(rng.choice([0.0, 0.7, -1.4])), boresight


def predicted(tx, state, point, difference_m, boresight):
    parts = np.empty(3), np.empty((3, 4)), np.empty((3, 3))
    raised_path(tx, state, point, difference_m, boresight, *parts)
    np.testing.assert_allclose(raised_range(tx, state, point, difference_m), parts[0][0], atol=1e-12)
    return parts


def test_a_raised_path_is_the_one_in_space_taken_as_level():
    rng = np.random.default_rng(1)
    for _ in range(100):
        case = drawn(rng)
        difference = predicted(*case)[0] - seen_in_space(*case)
        difference[1:] = wrap_angle(difference[1:])
        np.testing.assert_allclose(difference, 0.0, atol=1e-9)


def test_its_derivatives_match_finite_differences():
    rng, step = np.random.default_rng(2), 1e-6
    for _ in range(100):
        tx, state, point, height, boresight = drawn(rng)
        _, by_state, by_point = predicted(tx, state, point, height, boresight)
        for axis in range(4):
            move = step * np.eye(4)[axis]
            ahead, behind = (predicted(tx, state + s * move, point, height, boresight)[0] for s in (1, -1))
            slope = np.append(ahead[0] - behind[0], wrap_angle(ahead[1:] - behind[1:])) / (2 * step)
            np.testing.assert_allclose(by_state[:, axis], slope, rtol=1e-4, atol=1e-6)
        for axis in range(3):
            move = step * np.eye(3)[axis]
            ahead, behind = (predicted(tx, state, point + s * move, height, boresight)[0] for s in (1, -1))
            slope = np.append(ahead[0] - behind[0], wrap_angle(ahead[1:] - behind[1:])) / (2 * step)
            np.testing.assert_allclose(by_point[:, axis], slope, rtol=1e-4, atol=1e-6)


HALL = np.array([[4.0, 3.0, 3.4], [9.0, -2.0, 3.4], [12.0, 4.0, 0.0], [6.0, -4.0, 0.0], [14.0, -3.0, 2.0]])
POLES = np.array([[5.0, 2.5], [11.0, -1.8], [8.0, 4.0], [15.0, 1.0]])
STD = np.array([2e-3, 1e-3, 1e-3])  # of ranges and angles


def hall_walk(rng, n=10):
    """Paths of a walk by way of scattering points and thin poles: estimates with cone angles, and the truth."""
    heading = rng.uniform(-0.2, 0.2, n)
    position = np.column_stack([np.linspace(3, 12, n), 0.3 * np.sin(np.arange(n)), np.full(n, RX_HEIGHT)])
    clock_m = rng.normal(0, 3, n)
    estimates = []
    for k in range(n):
        spots = [*HALL, *upright(TX, position[k])]
        estimates.append(seen_estimate(rng, k, spots, TX, position[k], heading[k], clock_m[k]))
    return estimates, position, heading


def upright(tx, position):
    """The points of the poles at which paths are straight when unrolled."""
    spots = []
    for pole in POLES:
        legs = [np.hypot(*(pole - end[:2])) for end in (tx.position_m, position)]
        spots.append([*pole, position[2] + (tx.position_m[2] - position[2]) * legs[1] / sum(legs)])
    return spots


def seen_estimate(rng, stop, spots, tx, position, heading, clock_m):
    """The estimate of a stop, of paths by way of points (3,) and of the line of sight, the last path."""
    rows = [_cones(spot, position, heading, tx) for spot in spots]
    sight = position - tx.position_m
    straight, flat = np.arctan2(sight[1], sight[0]), np.hypot(*sight[:2]) / np.linalg.norm(sight)
    ends = [_cone(straight - tx.heading_rad, flat), _cone(straight + np.pi - heading, flat)]
    rows.append([np.linalg.norm(sight), *ends])
    value = np.array(rows) + rng.normal(size=(len(rows), 3)) * STD
    power = np.append(np.full(len(rows) - 1, -80.0), -50.0)
    return _estimate(stop, value, clock_m, power)


def _cone(azimuth, flat):
    boresight = PANELS[np.argmin(np.abs(wrap_angle(azimuth - PANELS)))]
    return boresight + np.arcsin(np.sin(wrap_angle(azimuth - boresight)) * flat)


def _cones(spot, position, heading, tx):
    value = [0.0]
    for end, turn in ((tx.position_m, tx.heading_rad), (position, heading)):
        ray = spot - end
        value[0] += np.linalg.norm(ray)
        value.append(_cone(np.arctan2(ray[1], ray[0]) - turn, np.hypot(*ray[:2]) / np.linalg.norm(ray)))
    return value


def _estimate(stop, value, clock_m, power_dbm):
    n = len(value)
    none = np.full(n, np.nan)
    scale = STD / [SPEED_OF_LIGHT_M_S, 1.0, 1.0]
    return ChannelEstimate(
        stop=stop,
        method="auto",
        delay_s=(value[:, 0] + clock_m) / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=wrap_angle(value[:, 1]),
        aoa_azimuth_rad=wrap_angle(value[:, 2]),
        aod_elevation_rad=none,
        aoa_elevation_rad=none,
        power_dbm=power_dbm,
        beam_loss_db=np.zeros(n),
        snr_db=np.full(n, 30.0),
        is_los=np.arange(n) == n - 1,
        covariance=np.tile(np.diag(scale**2), (n, 1, 1)),
        aod_angle_kind=AngleKind.CONE,
        aoa_angle_kind=AngleKind.CONE,
    )


def known_heights(n):
    return KnownHeights(np.full(n, TX.position_m[2] - RX_HEIGHT), 0.0, PANELS, PANELS)


def observed_paths(estimates, tx, heights, state):
    """All paths of estimates of equal length, seen from above at the clocks of the states."""
    above = [
        heights.seen(e, float(d), float(c) / SPEED_OF_LIGHT_M_S)
        for e, d, c in zip(estimates, heights.difference_m, state[:, 3], strict=True)
    ]
    measured = np.concatenate(
        [np.column_stack([SPEED_OF_LIGHT_M_S * e.delay_s, e.aod_azimuth_rad, e.aoa_azimuth_rad]) for e in above]
    )
    ends = PathHeights(*(np.concatenate(each) for each in zip(*heights.of_paths(estimates), strict=True)))
    n, per = len(estimates), len(estimates[0])
    covariance = np.tile(np.diag(STD**2), (n * per, 1, 1))
    return Observations(tx, n, np.repeat(np.arange(n), per), measured, covariance, np.zeros((3, 3)), heights=ends)


def test_clusters_become_points_at_heights_or_stay_upright():
    estimates, position, heading = hall_walk(np.random.default_rng(3))
    n, per = len(estimates), len(HALL) + len(POLES) + 1
    clock_s = np.array([e.delay_s[-1] for e in estimates]) - np.linalg.norm(position - TX.position_m, axis=1) / (
        SPEED_OF_LIGHT_M_S
    )
    state = np.column_stack([position[:, :2], heading, SPEED_OF_LIGHT_M_S * clock_s])
    seen = observed_paths(estimates, TX, known_heights(n), state)
    member = np.tile([*range(len(HALL) + len(POLES)), -1], n)
    start = np.column_stack([np.vstack([HALL[:, :2], POLES]), np.full(len(HALL) + len(POLES), 0.05)])
    start[:, :2] += 0.2
    now = TrajectoryState(state, np.zeros(1), np.empty((0, 2)), start, np.zeros(n, int), 0, course_of(state))
    thin = CONFIG.model_copy(update={"object_roughness_m": 0.005, "object_radius_m": 0.0})
    found = with_raised(seen, now, np.arange(n * per), member, thin)
    assert len(found.raised) == len(HALL)
    for spot in HALL:  # above or below does not show between devices of equal heights
        apart = np.column_stack(
            [found.raised[:, :2] - spot[:2], np.abs(found.raised[:, 2]) - abs(spot[2] - RX_HEIGHT)]
        )
        assert np.linalg.norm(apart, axis=1).min() < 0.1
    np.testing.assert_array_equal(found.objects, start[len(HALL) :])  # poles stay as they were


def test_points_below_the_devices_are_found_where_their_heights_differ():
    """Between devices at equal heights fits from below mirror those from above; between others they do not."""
    rng, n = np.random.default_rng(8), 30
    spots = np.array([[4.0, 3.0, 1.6], [9.0, -2.0, -1.4]])  # heights over the receiver
    state = np.column_stack([np.linspace(3, 12, n), np.sin(np.arange(n)), rng.uniform(-1, 1, n), np.zeros(n)])
    member = np.tile([0, 1], n)
    for difference_m in (0.0, 0.7):
        ends = PathHeights(np.full(2 * n, difference_m), np.full((2 * n, 2), np.nan))
        tx = np.array([*TX.position_m[:2], TX.heading_rad])
        measured = np.array(
            [predicted(tx, state[k], spot, *no_cone(difference_m))[0] for k in range(n) for spot in spots]
        )
        covariance = np.tile(np.diag(STD**2), (2 * n, 1, 1))
        seen = Observations(
            TX, n, np.repeat(np.arange(n), 2), measured, covariance, np.zeros((3, 3)), heights=ends
        )
        start = np.column_stack([spots[:, :2] + 0.2, [0.05, 0.05]])
        now = TrajectoryState(state, np.zeros(1), np.empty((0, 2)), start, np.zeros(n, int), 0, course_of(state))
        found = with_raised(
            seen, now, np.arange(2 * n), member, CONFIG.model_copy(update={"object_roughness_m": 0.005})
        )
        expected = np.column_stack([spots[:, :2], spots[:, 2] if difference_m else np.abs(spots[:, 2])])
        np.testing.assert_allclose(found.raised, expected, atol=0.02)


def no_cone(difference_m):
    return difference_m, np.full(2, np.nan)


def test_a_ceiling_that_scatters_helps_the_walk_instead_of_pulling_it(monkeypatch):
    estimates, position, _ = hall_walk(np.random.default_rng(5))
    slam = SnapshotConfig(noise=PathNoise())

    def error_m():
        poses, _ = locate_and_map(estimates, TX, slam, CONFIG, MappingConfig(), known_heights(len(estimates)))
        return np.hypot(*(poses.position_m - position[:, :2]).T)

    ours = error_m()
    monkeypatch.setattr(association, "with_raised", lambda seen, now, *rest: now)
    planar = error_m()
    assert np.median(ours) < 0.03
    assert ours.max() < 0.08
    assert np.median(planar) > 2 * np.median(ours)


def test_moves_of_raised_points_are_in_the_residuals():
    rng = np.random.default_rng(6)
    n = 6
    cases = [drawn(rng) for _ in range(n)]
    state = np.array([case[1] for case in cases])
    ends = PathHeights(np.array([case[3] for case in cases]), np.array([case[4] for case in cases]))
    measured = np.column_stack([np.full(n, 15.0), rng.uniform(-1, 1, (n, 2))])
    covariance = np.tile(np.diag([0.1, 0.02, 0.02]) ** 2, (n, 1, 1))
    seen = Observations(TX, n, np.arange(n), measured, covariance, np.zeros((3, 3)), heights=ends)
    link = Association(np.full(n, PathClass.RAISED), np.column_stack([np.arange(n) % 2, np.full(n, -1)]))
    now = TrajectoryState(
        state, np.zeros(1), np.array([[0.1, 5.0]]), np.array([[1.0, 2.0, 0.1]]), np.zeros(n, int), 0,
        course_of(state), raised=np.array([[7.0, 3.0, 1.2], [5.0, -6.0, -0.8]]),
    )  # fmt: skip
    config, step = TrajectoryConfig(object_roughness_m=0.0), 1e-6
    at = linearise(seen, link, now, config)
    for column in range(now.n_shared):
        shared, none = step * np.eye(now.n_shared)[column], np.zeros_like(now.state)
        ahead, behind = (linearise(seen, link, now.moved(none, s * shared), config) for s in (1, -1))
        expected = np.einsum("pdi,pi->pd", at.by_shared, (at.shared == column).astype(float))
        np.testing.assert_allclose(expected, (ahead.value - behind.value) / (2 * step), rtol=1e-4, atol=1e-3)
