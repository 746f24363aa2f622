"""The published algorithm on the measured Campus Arena data: its numbers must come out.

The data is the authors' and no part of this project. ARENA_DATA names the folder with campus_arena_30.mat; by
default it is shared/data beside the repository.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig, PathNoise, SnapshotConfig, TrajectoryConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.stops import run_slam
from estimation.slam.walk.residuals import PathClass
from estimation.slam.walk.trajectory import run_trajectory
from isac_arena.campaign.measured import PUBLISHED_MAX_POSITION_STD_M
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle

BIAS_M = 10.0
TX_HEADING_OFFSET_RAD = np.deg2rad(-1.6)
FIXED = PathNoise(source="fixed")
OURS = SnapshotConfig(method="statistical", noise=FIXED, max_position_std_m=PUBLISHED_MAX_POSITION_STD_M)


class Campaign:
    """Channel estimates, TX, true RX states and labels of the measured stops; the paths sorted by delay."""

    def __init__(self, path: Path) -> None:
        data = loadmat(path, squeeze_me=True, struct_as_record=False)["sim"]
        self.tx = Pose(np.array([*data.tx[:2, 0], 0.0]), float(data.tx[2, 0]) + TX_HEADING_OFFSET_RAD)
        self.rx = data.rx.T
        self.estimates, self.is_single_bounce = [], []
        for stop, (y, power, label) in enumerate(zip(data.y, data.power, data.inlier, strict=True)):
            order = np.argsort(y[0], kind="stable")
            self.is_single_bounce.append(label[1, order] > 0)
            self.estimates.append(
                ChannelEstimate(
                    stop=stop,
                    delay_s=(y[0, order] + BIAS_M) / SPEED_OF_LIGHT_M_S,
                    aod_azimuth_rad=y[1, order],
                    aoa_azimuth_rad=y[2, order],
                    power_dbm=power[order],
                    beam_loss_db=np.zeros(len(order)),
                    snr_db=np.zeros(len(order)),
                    covariance=np.zeros((len(order), 3, 3)),
                    is_los=label[0, order] > 0,
                )
            )

    @property
    def has_los(self) -> np.ndarray:
        return np.array([estimate.is_los.any() for estimate in self.estimates])


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    beside = Path(__file__).resolve().parents[4] / "shared" / "data"
    path = Path(os.environ.get("ARENA_DATA", beside)) / "campus_arena_30.mat"
    if not path.is_file():
        pytest.skip(f"no measured data: {path.name} not found; set ARENA_DATA to its folder")
    return Campaign(path)


def errors(campaign: Campaign, poses: PoseEstimates) -> np.ndarray:
    """Errors (stop, 3) in m, deg, ns."""
    return np.column_stack(
        [
            np.hypot(*(poses.position_m - campaign.rx[:, :2]).T),
            np.rad2deg(wrap_angle(poses.heading_rad - campaign.rx[:, 2])),
            1e9 * (poses.clock_bias_s - BIAS_M / SPEED_OF_LIGHT_M_S),
        ]
    )


def rmse(error: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(error**2, axis=0))


def test_reference_reproduces_the_published_algorithm(campaign):
    mapping = MappingConfig(noise=FIXED)
    poses, points = run_slam(campaign.estimates, campaign.tx, SnapshotConfig(method="reference"), mapping)
    los = campaign.has_los
    assert np.array_equal(poses.status == SolveStatus.LOS, los)
    assert np.array_equal(poses.status == SolveStatus.NLOS, ~los)
    error = errors(campaign, poses)
    np.testing.assert_allclose(rmse(error[los]), [0.3115, 2.1511, 1.1390], atol=1e-4)
    np.testing.assert_allclose(rmse(error[~los]), [0.5475, 2.6034, 2.5046], atol=1e-4)
    np.testing.assert_allclose(rmse(error), [0.3973, 2.2962, 1.6703], atol=1e-4)
    assert np.isfinite(points.position_m).all()


def test_refinement_improves_every_error(campaign):
    mapping = MappingConfig(noise=FIXED)
    published, _ = run_slam(campaign.estimates, campaign.tx, SnapshotConfig(method="reference"), mapping)
    config = SnapshotConfig(
        method="reference", refine=True, noise=FIXED, max_position_std_m=PUBLISHED_MAX_POSITION_STD_M
    )
    refined, _ = run_slam(campaign.estimates, campaign.tx, config, mapping)
    assert np.all(rmse(errors(campaign, refined)) < rmse(errors(campaign, published)))
    assert rmse(errors(campaign, refined))[0] < 0.34


def test_statistical_method_beats_the_reference_with_line_of_sight(campaign):
    poses, _ = run_slam(campaign.estimates, campaign.tx, OURS, MappingConfig(noise=FIXED))
    assert rmse(errors(campaign, poses)[campaign.has_los])[0] < 0.25


def test_mapping_gate_agrees_with_the_single_bounce_labels(campaign):
    n = len(campaign.estimates)
    poses = PoseEstimates(
        stop=np.arange(n),
        position_m=campaign.rx[:, :2],
        heading_rad=campaign.rx[:, 2],
        clock_bias_s=np.full(n, BIAS_M / SPEED_OF_LIGHT_M_S),
        status=np.full(n, SolveStatus.GIVEN),
        n_inliers=np.zeros(n, int),
        cost=np.zeros(n),
    )
    points = map_stops(campaign.estimates, poses, campaign.tx, MappingConfig(noise=FIXED))
    label = np.array([campaign.is_single_bounce[s][p] for s, p in zip(points.stop, points.path, strict=True)])
    assert np.mean(points.is_inlier[label]) > 0.9
    assert np.mean(points.is_inlier[~label]) < 0.1


def test_statistical_method_flags_every_stop_that_is_far_off(campaign):
    solutions = [solve_snapshot(estimate, campaign.tx, OURS) for estimate in campaign.estimates]
    position = np.array([s.position_m for s in solutions])
    error = np.hypot(*(position - campaign.rx[:, :2]).T)
    assert np.sqrt(np.mean(error**2)) < 0.35
    assert all(s.is_ambiguous for s, e in zip(solutions, error, strict=True) if e > 0.9)
    assert np.array_equal([s.status == SolveStatus.LOS for s in solutions], campaign.has_los)
    assert np.array_equal([s.los_probability > 0.5 for s in solutions], campaign.has_los)


def test_trajectory_finds_the_two_sessions_and_beats_every_stop_alone(campaign):
    poses, _, details = run_trajectory(
        campaign.estimates, campaign.tx, OURS, TrajectoryConfig(), MappingConfig(noise=FIXED)
    )
    error = errors(campaign, poses)[:, 0]
    # The surveyed positions are good to about .1 m: with them the walls of the floor plan are .1 - .2 m too near.
    # The walk that has found these walls is no closer than that.
    assert np.sqrt(np.mean(error**2)) < 0.17
    assert error.max() < 0.4
    away = poses.position_m - campaign.rx[:, :2]
    square = np.einsum("si,sij,sj->s", away, np.linalg.inv(poses.covariance[:, :2, :2]), away)
    assert 0.5 < np.mean(square) / 2 < 2
    assert np.array_equal(poses.status == SolveStatus.LOS, campaign.has_los)
    assert np.flatnonzero(np.diff(details.session)).tolist() == [12]
    # Two walls of the floor plan [azimuth of normal in deg, offset in m].
    found = np.column_stack([np.rad2deg(details.walls[:, 0]) % 360, details.walls[:, 1]])
    for azimuth_deg, offset_m in ((180.0, -4.59), (0.0, -0.05)):
        off = np.abs(found - [azimuth_deg, offset_m])
        off[:, 0] = np.minimum(off[:, 0], 360 - off[:, 0])
        assert np.any((off[:, 0] < 1.5) & (off[:, 1] < 0.12))
    offset_deg = np.rad2deg(details.tx_offset_rad + TX_HEADING_OFFSET_RAD)
    np.testing.assert_allclose(offset_deg, [-3.8, -1.25], atol=0.5)
    label = np.concatenate(campaign.is_single_bounce)
    los = np.concatenate([estimate.is_los for estimate in campaign.estimates])
    found = np.isin(details.path_kind, [PathClass.BOUNCE, PathClass.WALL, PathClass.OBJECT])
    hits = np.count_nonzero(found & label & ~los)
    assert 2 * hits / (found[~los].sum() + label[~los].sum()) > 0.96
