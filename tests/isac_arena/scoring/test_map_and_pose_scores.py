from dataclasses import replace

import numpy as np
import pytest

from estimation.slam.bounds import StateBound
from estimation.slam.record import SolveStatus
from isac_arena.scoring.headline import bound_note
from isac_arena.scoring.provenance import cluster_origin, path_origin
from isac_arena.scoring.stages.maps import (
    level_distance_m,
    map_metrics,
    score_ips,
    surface_distance_m,
    variance_across_m2,
)
from isac_arena.scoring.stages.poses import pose_metrics, score_poses, unknown_bound
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.scene import HorizontalPlane
from sim.propagation.paths import BounceKind, empty_paths, with_bounce_slots


def test_surface_distance_is_that_to_the_nearest_boundary(campaign):
    points = np.array([[0.0, -4.0], [0.0, -3.5], [4.0, -4.9], [2.0, -6.8], [8.5, 0.0], [0.0, -4.25]])
    np.testing.assert_allclose(
        surface_distance_m(campaign.scene, points), [0.3, 0.2, 0.5, 0.2, 0.5, 0.05], atol=1e-9
    )


def test_surface_distance_matches_brute_force(campaign):
    rng = np.random.default_rng(1)
    points = rng.uniform([-3, -8], [9, 3], (40, 2))
    surface = np.concatenate([item.contour.sample(1e-3) for item in campaign.scene.objects])
    brute = np.linalg.norm(points[:, None] - surface[None], axis=2).min(axis=1)
    np.testing.assert_allclose(surface_distance_m(campaign.scene, points), brute, atol=2e-3)


def test_points_off_floor_and_ceiling_count_in_height(campaign):
    floor = HorizontalPlane(-0.5, campaign.scene.objects[0].material)
    scene = replace(campaign.scene, floor=floor, ceiling=None)
    names, height_m = np.array(["floor", "floor", "ceiling", "wall_south"]), np.array([-0.4, np.nan, 3.0, 1.0])
    np.testing.assert_allclose(level_distance_m(scene, names, height_m), [0.1, np.nan, np.nan, np.nan])


def test_the_variance_across_a_surface_is_that_along_its_normal(campaign):
    """South of a wall along x; north-east of a pillar whose centre is (0, -4); and on that wall itself."""
    points = np.array([[2.0, -6.8], [0.4, -3.6], [2.0, -7.0]])
    covariance = np.tile([[0.09, 0.02], [0.02, 0.01]], (3, 1, 1))
    expected = [0.01, (0.09 + 0.01 + 2 * 0.02) / 2, 0.01]
    distance = surface_distance_m(campaign.scene, points)
    found = variance_across_m2(campaign.scene, points, distance, covariance)
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    bare = replace(campaign.scene, objects=())
    assert np.isnan(variance_across_m2(bare, points, surface_distance_m(bare, points), covariance)).all()


def test_points_of_weak_paths_are_judged_across_their_surface(campaign, tables):
    """No true incidence point, an error of 2 deviations across: a NEES of 4. A ghost is not judged."""
    result, paths = campaign.results.mapping, tables.paths
    covariance = np.tile(np.diag([0.04, 0.01]), (len(result.ips), 1, 1))
    on_wall = tables.mapping.ips.object == "wall_south"
    ips = replace(result.ips, position_m=result.ips.position_m + np.array([0.0, 0.2]), covariance_m2=covariance)
    weak = replace(paths, vertex_m=np.full_like(paths.vertex_m, np.nan))
    found = score_ips(campaign.scene, replace(result, ips=ips), weak)
    np.testing.assert_allclose(found.surface_nees[on_wall], 4.0, rtol=1e-6)
    values = {one.key: one.value for one in map_metrics("mapping", campaign.scene, found, tables.mapping.clusters)}
    assert values["mapping.ip_position.nees.count"] == 0
    assert values["mapping.ip_to_surface.nees.count"] == (found.is_inlier & (found.object != "")).sum() > 0
    assert np.isnan(found.surface_nees[found.object == ""]).all()


def test_origin_knows_bounces_and_ignores_walls_passed(campaign):
    paths = campaign.truths[0].paths
    kind = paths.bounce_kind.copy()
    kind[5, 0] = BounceKind.REFRACTION
    kind[1, 0] = BounceKind.REFRACTION
    origin = path_origin(replace(paths, bounce_kind=kind))
    assert origin.kind.tolist() == [0, 0, 1, 1, 1, 1, 1, 1]
    assert origin.object[5] == "wall_south"
    assert origin.object[1] == ""
    np.testing.assert_array_equal([*origin.vertex_m[5], origin.height_m[5]], paths.vertex_m[5, 1])
    assert np.isnan(origin.vertex_m[:2]).all()
    assert len(path_origin(empty_paths(["wall"], 0)).kind) == 0


def test_by_way_of_the_floor_a_path_shows_its_upright_object_in_the_plan(campaign):
    """Wall and floor: two bounces, one of them seen from above. Two walls show none, the floor alone itself."""
    paths = campaign.truths[0].paths
    names = np.append(paths.object_name, "floor")
    floor, walls = len(names) - 1, np.flatnonzero(np.char.startswith(names, "wall"))
    bounces = [[walls[0], floor], [floor, walls[1]], [walls[0], walls[1]], [floor, -1]]
    kind = np.where(np.array(bounces) < 0, BounceKind.NONE, BounceKind.SPECULAR)
    some = with_bounce_slots(paths.take("path", [2, 3, 4, 5]), 2)
    origin = path_origin(replace(some, object_name=names, bounce_object=np.array(bounces), bounce_kind=kind))
    assert origin.plan_object.tolist() == [names[walls[0]], names[walls[1]], "", "floor"]
    assert origin.object.tolist() == ["", "", "", "floor"]
    assert origin.kind.tolist() == [2, 2, 2, 1]


def test_clusters_take_the_majority_object():
    label = np.array([0, 0, 0, 1, 1, 1, 2, 2, -1, 3, 3])
    names = np.array(["a", "a", "b", "a", "b", "c", "", "", "a", "a", ""])
    origin = cluster_origin(label, names, 5)
    assert origin.object.tolist() == ["a", "", "", "a", ""]
    np.testing.assert_allclose(origin.purity, [2 / 3, 1 / 3, 0, 0.5, 0])


def test_pose_errors_are_those_put_in(campaign):
    poses, truths = campaign.results.slam.poses, campaign.truths
    status = poses.status.copy()
    status[-1] = SolveStatus.FAILED
    shifted = replace(
        poses,
        position_m=poses.position_m + np.array([0.3, -0.4]),
        heading_rad=poses.heading_rad + 2 * np.pi - np.deg2rad(2),
        clock_bias_s=poses.clock_bias_s + 1e-9,
        status=status,
        covariance=np.tile(np.diag([0.3, 0.4, np.deg2rad(1), 2e-9]) ** 2, (len(truths), 1, 1)),
        height_m=np.array([truth.rx_pose.position_m[2] for truth in truths]) - 0.2,
        height_std_m=np.full(len(truths), 0.1),
    )
    has_los = np.arange(len(truths)) < 4
    order = np.arange(len(truths))[::-1]
    scores = score_poses(
        poses.stop,
        [t.rx_pose for t in truths],
        np.array([t.clock_bias_s for t in truths]),
        has_los,
        shifted.take("stop", order),
        StateBound(*np.array([0.1, np.deg2rad(4), SPEED_OF_LIGHT_M_S * 1e-10])[:, None] * np.ones(len(truths))),
    )
    values = {m.key: m.value for m in pose_metrics(scores)}
    assert values["slam.position.rmse_m"] == pytest.approx(0.5)
    assert values["slam.los.position.max_m"] == pytest.approx(0.5)
    assert values["slam.nlos.heading.rmse_deg"] == pytest.approx(2)
    assert values["slam.clock.rmse_ns"] == pytest.approx(1)
    assert values["slam.height.rmse_m"] == values["slam.nlos.height.rmse_m"] == pytest.approx(0.2)
    assert np.isnan(scores.height_error_m[-1]) and scores.height_error_m[0] == pytest.approx(-0.2)
    assert values["slam.height.nees"] == pytest.approx(4)
    assert values["slam.height.coverage95"] == 0
    assert values["slam.solved_share"] == pytest.approx(11 / 12)
    assert values["slam.los.stops"] == 4
    assert values["slam.nlos.solved_share"] == pytest.approx(7 / 8)
    assert values["slam.position.nees"] == pytest.approx(1)
    assert values["slam.nees"] == pytest.approx((1 + 1 + 4 + 0.25) / 4)
    assert values["slam.coverage95"] == values["slam.position.coverage95"] == 1
    assert values["slam.position.over_bound"] == values["slam.position.over_bound.median"] == pytest.approx(5)
    assert values["slam.heading.over_bound"] == pytest.approx(0.5)
    assert values["slam.clock.over_bound"] == pytest.approx(10)
    assert not bound_note(scores)
    position_m, error_m = scores.position_bound_m.copy(), scores.position_error_m.copy()
    position_m[[3, 5]], error_m[[3, 5]] = np.inf, 7.0
    note = bound_note(replace(scores, position_bound_m=position_m, position_error_m=error_m))
    assert note.startswith(
        f"bound: without one: stop {scores.stop[3]}, {scores.stop[5]} (2 of 12 stops); RMSE of this run"
    )
    assert note.endswith("over the others: 0.5 m, 2 deg, 1 ns")
    large = scores.position_bound_m.copy()
    large[4] *= 100
    note = bound_note(replace(scores, position_bound_m=large))
    assert note.startswith(f"bound: stop {scores.stop[4]} makes 100% of its mean square")
    assert values["slam.position.bound_median_m"] == pytest.approx(np.median(scores.position_bound_m))
    with pytest.raises(ValueError, match="stop 99 is missing"):
        score_poses(np.array([99]), [truths[0].rx_pose], np.zeros(1), np.ones(1, bool), poses, unknown_bound(1))
