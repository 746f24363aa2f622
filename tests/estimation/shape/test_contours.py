"""Contours of objects from paths and poses: whole synthetic campaigns and borderline input."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.plane import predict_los
from estimation.shape.baselines.peers import fit_circle
from estimation.shape.config import ContourConfig
from estimation.shape.contours import estimate_contours
from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.methods import POINT_METHODS, choose_points
from estimation.shape.record import Contours
from estimation.shape.reflection.bundle import fit_bundle
from estimation.shape.reflection.fit_all import object_noise, without_offsets
from estimation.shape.reflection.paths import campaign_paths, in_plane
from estimation.shape.reflection.rows import resample_contour
from estimation.shape.reflection.tx_sessions import los_sessions
from estimation.slam.config import PathNoise
from estimation.slam.record import SolveStatus
from isac_arena.campaign.chain.maps import make_map
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.files import read_record, write_record
from isac_arena.validation.scenarios.reflections import TX
from isac_arena.validation.shape.campaign import DELAY_OFFSET_NS, DEPARTURE_OFFSET_DEG, make_arena, score
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose

TX_POSE = Pose(np.array([*TX[:2], 0.0]), float(TX[2]))


@pytest.fixture(scope="module")
def config():
    return CampaignConfig(name="made", scene="-", seed=0)


@pytest.fixture(scope="module")
def made():
    return make_arena(np.random.default_rng([5, 0]), offset=True)


@pytest.fixture(scope="module")
def result(made, config):
    return make_map(config, made.channel, TX_POSE, made.poses)


def contours_of(made, result, channel=None, poses=None, ips=None, **settings):
    ips = result.ips if ips is None else ips
    return estimate_contours(
        made.channel if channel is None else channel,
        TX_POSE,
        made.poses if poses is None else poses,
        ips,
        result.shapes.label[: len(ips)],
        PathNoise(),
        ContourConfig(**settings),
    )


def test_a_campaign_shows_its_objects_and_no_ghost(made, result):
    found = score(made, result)
    assert found.iou > 0.75
    assert found.iou > found.paper_iou + 0.3
    assert found.ghosts == 0
    assert found.class_right == 1
    assert found.coverage > 0.7


def test_common_offsets_are_found(made, result):
    contours = result.contours
    assert abs(abs(contours.delay_offset_s) - 1e-9 * DELAY_OFFSET_NS) < 4 * contours.delay_offset_std_s
    error = np.abs(np.abs(contours.aod_offset_rad) - np.deg2rad(DEPARTURE_OFFSET_DEG))
    assert np.all(error < 4 * contours.aod_offset_std_rad)
    assert np.all(contours.session == 0)


def test_paths_of_an_object_are_one_per_stop_and_probabilities_add_up(result):
    contours, ips = result.contours, result.ips
    for row in range(len(contours)):
        stops = ips.stop[contours.object == row]
        assert len(stops) == len(np.unique(stops)) >= 5
    np.testing.assert_allclose(contours.class_probability.sum(axis=1), 1.0, atol=1e-9)


def test_the_record_survives_a_file_and_the_bits_are_the_same_twice(tmp_path, made, result):
    again = contours_of(made, result)
    write_record(tmp_path / "contours.nc", result.contours)
    read = read_record(tmp_path / "contours.nc", Contours)
    for name in ("contour_m", "std_m", "object", "kind", "class_probability", "aod_offset_rad"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result.contours, name))
        np.testing.assert_array_equal(getattr(read, name), getattr(result.contours, name))


def test_without_paths_or_poses_there_is_no_object(made, result):
    none = result.ips.take("ip", slice(0, 0))
    silent = [estimate.take("path", slice(0, 0)) for estimate in made.channel]
    failed = replace(made.poses, status=np.full(len(made.poses.stop), SolveStatus.FAILED))
    assert len(contours_of(made, result, channel=silent, ips=none)) == 0
    assert len(contours_of(made, result, poses=failed, ips=none)) == 0
    assert len(contours_of(made, result, ips=none)) == 0
    assert len(contours_of(made, result, method="none")) == 0


def test_objects_are_found_without_any_line_of_sight(made, result):
    rows = [np.flatnonzero(~estimate.is_los) for estimate in made.channel]
    blind = [estimate.take("path", row) for estimate, row in zip(made.channel, rows, strict=True)]
    number = {(stop, old): new for stop, row in enumerate(rows) for new, old in enumerate(row.tolist())}
    path = [number[key] for key in zip(result.ips.stop.tolist(), result.ips.path.tolist(), strict=True)]
    contours = contours_of(made, result, channel=blind, ips=replace(result.ips, path=np.array(path)))
    assert np.count_nonzero(contours.is_closed) == len(made.pillars)


@pytest.mark.parametrize("method", ["points", *POINT_METHODS])
def test_every_method_for_points_makes_contours_of_clusters(made, result, method):
    contours = contours_of(made, result, method=method)
    assert contours.method == method
    assert len(contours) > 0
    assert np.isfinite(contours.contour_m).all()
    assert np.isnan(contours.delay_offset_s)
    for row in range(len(contours)):
        assert set(result.shapes.label[contours.object == row]) == {contours.cluster[row]}


def test_points_alone_are_weighed_by_evidence():
    rng = np.random.default_rng(2)
    covariance = np.tile(1e-2 * np.eye(2), (40, 1, 1))
    wall = np.column_stack([np.linspace(0, 8, 40), np.zeros(40)]) + 0.1 * rng.standard_normal((40, 2))
    shape, probability = choose_points(PointCluster(wall, covariance, np.array([4.0, 5.0])))
    assert not shape.is_closed
    assert probability[0] > 0.99
    assert probability.sum() == pytest.approx(1)


def test_sessions_show_in_the_lines_of_sight(made, result):
    jump = np.where(np.arange(len(made.channel)) >= 20, np.deg2rad(2.0), 0.0)
    turned = [
        replace(estimate, aod_azimuth_rad=estimate.aod_azimuth_rad + shift)
        for estimate, shift in zip(made.channel, jump, strict=True)
    ]
    contours = contours_of(made, result, channel=turned)
    np.testing.assert_array_equal(contours.session, (jump > 0).astype(int))
    assert np.diff(contours.aod_offset_rad)[0] == pytest.approx(np.deg2rad(2.0), abs=np.deg2rad(0.4))
    assert np.count_nonzero(contours.is_closed) == len(made.pillars)


def test_offsets_of_sessions_are_relative_to_the_longest(made, result):
    paths = campaign_paths(made.channel, TX_POSE, made.poses, result.ips, PathNoise(), ContourConfig())
    los = paths.los
    exact = predict_los(TX_POSE, los.rx_state)
    exact[los.stop >= 30, 1] += 0.05
    sessions = los_sessions(replace(los, measured=exact), TX_POSE, made.poses.stop)
    np.testing.assert_array_equal(sessions.of_stop, made.poses.stop >= 30)
    np.testing.assert_allclose(sessions.offset_rad, [0.0, 0.05], atol=1e-9)


def test_only_poses_found_stop_by_stop_may_turn(made, result):
    def may_turn(**changes):
        poses = replace(made.poses, **changes)
        return campaign_paths(made.channel, TX_POSE, poses, result.ips, PathNoise(), ContourConfig()).may_turn

    n = len(made.poses.stop)
    solved = np.full(n, SolveStatus.LOS)
    assert not may_turn(status=np.full(n, SolveStatus.GIVEN))
    assert may_turn(status=solved)
    assert not may_turn(status=solved, is_of_walk=np.ones(n, bool))


def test_paths_from_above_are_level_paths_shortened(made):
    """A wall's path climbs evenly: seen from above its length falls by the cosine, after the clock bias."""
    estimate, bias_m = made.channel[0], 7.0
    n, elevation = len(estimate), 0.3
    rising = replace(
        estimate,
        delay_s=(bias_m + (SPEED_OF_LIGHT_M_S * estimate.delay_s - bias_m) / np.cos(elevation))
        / SPEED_OF_LIGHT_M_S,
        aod_elevation_rad=np.full(n, elevation),
        aoa_elevation_rad=np.full(n, np.nan),
    )
    noise = PathNoise().covariance(estimate)
    level, covariance = in_plane(estimate, noise, bias_m)
    seen, shrunk = in_plane(rising, noise, bias_m)
    np.testing.assert_allclose(seen, level, atol=1e-9)
    np.testing.assert_allclose(covariance, noise)
    np.testing.assert_allclose(shrunk[:, 0, 0], noise[:, 0, 0] * np.cos(elevation) ** 2)


def test_noise_of_an_object_never_falls_below_the_stated():
    rng = np.random.default_rng(0)
    square = rng.chisquare(3, 4000)
    assert object_noise(0.1 * square) == 1
    assert object_noise(square) == pytest.approx(1, abs=0.1)
    assert object_noise(9 * square) == pytest.approx(9, rel=0.1)


def test_corrected_paths_have_no_offset(made, result):
    paths = campaign_paths(made.channel, TX_POSE, made.poses, result.ips, PathNoise(), ContourConfig())
    bundle = fit_bundle([], paths.los, paths.config)
    data, settings = without_offsets(paths.los, bundle, paths.config)
    remaining = data.measured - predict_los(TX_POSE, data.rx_state)
    assert np.abs(remaining[:, 0]).mean() < 0.2
    assert settings.aod_offset_std_deg < paths.config.aod_offset_std_deg
    assert np.all(np.linalg.eigvalsh(data.rx_covariance) > 0)


def test_contours_are_resampled_evenly():
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    circle = fit_circle(PointCluster(ring, np.tile(1e-4 * np.eye(2), (40, 1, 1)), np.zeros(2)))
    points, std = resample_contour(circle, 25)
    assert points.shape == (25, 2)
    assert std.shape == (25,)
    step = np.linalg.norm(np.diff(np.vstack([points, points[:1]]), axis=0), axis=1)
    np.testing.assert_allclose(step, step.mean(), rtol=0.02)
