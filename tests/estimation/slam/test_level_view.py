"""Known heights: exact paths of horizontal beams give exact poses and points, and a planar model does not."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.record import AngleKind, ChannelEstimate
from estimation.laws.level import nearest_boresight
from estimation.laws.plane import predict_bounce, predict_los
from estimation.slam.config import TrajectoryConfig
from estimation.slam.level import KnownHeights, seen_from_above
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.stops import locate_and_map
from isac_arena.validation.slam.trials import MAPPING, OURS
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import FloatArray

TX = Pose(np.array([0.0, 0.0, 4.0]), 0.2)
RX_HEIGHT_M = 1.5
TX_PANEL, RX_PANELS = np.zeros(1), np.deg2rad([-180.0, -90.0, 0.0, 90.0])
STATES = np.array([[6.0 + 0.8 * k, 1.0 + 0.2 * k, 0.4 - 0.1 * k, 3.0] for k in range(5)])  # x, y, heading, bias
METHODS = [None, TrajectoryConfig(), TrajectoryConfig(method="filter")]


def _estimate(stop: int, state: FloatArray) -> ChannelEstimate:
    """The line of sight and seven single bounces, as horizontal beams show them."""
    rng = np.random.default_rng(stop)
    points = np.column_stack([rng.uniform(2, 12, 7), np.where(np.arange(7) % 2, 5.0, -4.0)])
    plan = np.concatenate([predict_los(TX, state)[None], predict_bounce(TX, state, points)])
    length_m = np.hypot(plan[:, 0] - state[3], TX.position_m[2] - RX_HEIGHT_M)
    share = (plan[:, 0] - state[3]) / length_m
    azimuth = []
    for end, panels in enumerate((TX_PANEL, RX_PANELS)):
        boresight = nearest_boresight(plan[:, 1 + end], panels)
        azimuth.append(boresight + np.arcsin(np.sin(wrap_angle(plan[:, 1 + end] - boresight)) * share))
    n, std = len(plan), np.array([3e-11, 1e-3, 1e-3])
    return ChannelEstimate(
        stop=stop,
        delay_s=(length_m + state[3]) / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=azimuth[0],
        aoa_azimuth_rad=azimuth[1],
        power_dbm=np.where(np.arange(n) == 0, -13.0 - 20 * np.log10(length_m), -33.0 - 20 * np.log10(length_m)),
        beam_loss_db=np.zeros(n),
        snr_db=np.full(n, 60.0),
        covariance=np.tile(np.diag(std**2), (n, 1, 1)),
        is_los=np.arange(n) == 0,
        aod_angle_kind=AngleKind.CONE,
        aoa_angle_kind=AngleKind.CONE,
    )


ESTIMATES = [_estimate(stop, state) for stop, state in enumerate(STATES)]
HEIGHTS = KnownHeights(np.full(len(STATES), TX.position_m[2] - RX_HEIGHT_M), 0.0, TX_PANEL, RX_PANELS)


@pytest.mark.parametrize("trajectory", METHODS, ids=["alone", "smooth", "filter"])
def test_exact_paths_give_exact_positions(trajectory: TrajectoryConfig | None) -> None:
    poses, points = locate_and_map(ESTIMATES, TX, OURS, trajectory, MAPPING, HEIGHTS)
    assert (poses.status != SolveStatus.FAILED).all()
    exact_m = {None: 1e-6, "auto": 0.01, "filter": 1e-4}  # the smoother has priors of the walk and of walls
    atol = exact_m[trajectory and trajectory.method]
    np.testing.assert_allclose(poses.position_m, STATES[:, :2], atol=atol)
    assert np.isfinite(points.position_m).all()
    flat, _ = locate_and_map(ESTIMATES, TX, OURS, trajectory, MAPPING)
    assert np.linalg.norm(flat.position_m - STATES[:, :2], axis=1).max() > 0.05


def test_exact_paths_give_points_on_the_walls() -> None:
    n = len(STATES)
    given = PoseEstimates(
        stop=np.arange(n), position_m=STATES[:, :2], heading_rad=STATES[:, 2],
        clock_bias_s=STATES[:, 3] / SPEED_OF_LIGHT_M_S, status=np.full(n, SolveStatus.GIVEN),
        n_inliers=np.zeros(n, int), cost=np.zeros(n),
    )  # fmt: skip
    points = map_stops(seen_from_above(ESTIMATES, given.clock_bias_s, HEIGHTS), given, TX, MAPPING)
    y = points.position_m[:, 1]
    np.testing.assert_allclose(np.minimum(np.abs(y - 5.0), np.abs(y + 4.0)), 0, atol=1e-6)
    assert points.is_inlier.all()


def test_an_uncertain_height_widens_covariances_to_first_order() -> None:
    wide = replace(HEIGHTS, std_m=0.1)
    bias_s = float(STATES[0, 3]) / SPEED_OF_LIGHT_M_S
    seen, sure = (one.seen(ESTIMATES[0], 2.5, bias_s) for one in (wide, HEIGHTS))
    higher = HEIGHTS.seen(ESTIMATES[0], 2.5001, bias_s)
    slope = np.column_stack([
        (getattr(higher, name) - getattr(sure, name)) / 1e-4
        for name in ("delay_s", "aod_azimuth_rad", "aoa_azimuth_rad")
    ])  # fmt: skip
    expected = 0.1**2 * slope[:, :, None] * slope[:, None]
    np.testing.assert_allclose(seen.covariance - sure.covariance, expected, rtol=1e-3, atol=1e-26)


def test_azimuths_elevations_and_equal_heights_are_left() -> None:
    azimuths = replace(ESTIMATES[0], aod_angle_kind=AngleKind.AZIMUTH, aoa_angle_kind=AngleKind.AZIMUTH)
    assert HEIGHTS.seen(azimuths, 2.5, 0.0) is azimuths
    elevated = replace(ESTIMATES[0], aod_elevation_rad=np.full(len(ESTIMATES[0]), 0.1))
    assert HEIGHTS.seen(elevated, 2.5, 0.0) is elevated
    assert HEIGHTS.seen(ESTIMATES[0], 0.0, 0.0) is ESTIMATES[0]
    equal = replace(HEIGHTS, difference_m=np.zeros(len(ESTIMATES)))
    assert HEIGHTS.matter(ESTIMATES) and not equal.matter(ESTIMATES)
