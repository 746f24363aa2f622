"""Scores of our contours on a made-up campaign whose contours are exact, or wrong by a known amount."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from estimation.shape.reflection.rows import no_contours
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.stages.contours import (
    contour_errors,
    contour_metrics,
    is_class_right,
    is_phantom,
    score_contours,
)
from isac_arena.scoring.stages.maps import score_ips
from isac_arena.scoring.stages.scene import score_scene
from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from tests.isac_arena.scoring.test_score import LIMITS


def test_a_contour_of_points_on_the_floor_has_no_class(campaign, tables):
    """Reflections on the floor are inliers too; the floor is no object of the scene."""
    result = campaign.results.mapping
    ips = score_ips(campaign.scene, result, tables.paths)
    first = result.contours.object == 0
    ips = replace(ips, object=np.where(first, "floor", ips.object))
    table = score_contours(campaign.scene, result, ips, tables.significant)
    assert table.object[0] == "floor"
    assert np.isnan(table.class_right[0])
    values = {metric.key: metric.value for metric in contour_metrics("mapping", campaign.scene, table)}
    assert values["contours.mapping.class_mean_coverage95"] == 1


@pytest.fixture
def scored(campaign, tables):
    def run(contours):
        result = replace(campaign.results.mapping, contours=contours)
        ips = score_ips(campaign.scene, result, tables.paths)
        table = score_contours(campaign.scene, result, ips, tables.significant)
        return {metric.key: metric.value for metric in contour_metrics("mapping", campaign.scene, table)}

    return run


def test_exact_contours_have_no_error(campaign, scored):
    values = scored(campaign.results.mapping.contours)
    assert values["contours.mapping.pillar.iou.mean"] == pytest.approx(1, abs=1e-3)
    assert values["contours.mapping.pillar.full_rmse.mean_m"] == pytest.approx(0, abs=1e-9)
    assert values["contours.mapping.wall.seen_rmse.mean_m"] == pytest.approx(0, abs=1e-9)
    assert values["contours.mapping.wall.extent_iou.mean"] == pytest.approx(1)
    assert values["contours.mapping.class_accuracy"] == 1
    assert values["contours.mapping.class_mean_coverage95"] == 1
    assert values["contours.mapping.ghosts"] == 0
    assert values["contours.mapping.objects_found.pillar"] == 2


def test_contours_have_every_score_of_shapes(campaign, true_power):
    found = score_campaign(
        campaign.scene, iter(campaign.truths), campaign.results, true_power_dbm=true_power, significance=LIMITS
    )
    keys = {metric.key for metric in found.metrics}
    for name in ("mapping", "slam"):
        own = {key.removeprefix(f"shapes.{name}") for key in keys if key.startswith(f"shapes.{name}.")}
        assert {f"contours.{name}{rest}" for rest in own} <= keys


def test_a_wall_moved_off_its_place_is_wrong_by_that_much(campaign, scored):
    contours = campaign.results.mapping.contours
    shift = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.05], [0.05, 0.0]])
    values = scored(replace(contours, contour_m=contours.contour_m + shift[:, None]))
    assert values["contours.mapping.wall.seen_rmse.mean_m"] == pytest.approx(0.05)
    assert values["contours.mapping.wall.coverage95.mean"] == 0  # a band of 1.96 cm
    assert values["contours.mapping.class_mean_coverage95"] == 0.5


def test_closed_contours_of_open_size_and_open_ones_of_pillars(campaign, scored):
    contours = campaign.results.mapping.contours
    values = scored(replace(contours, is_closed=np.array([True, False, False, False])))
    assert values["contours.mapping.pillar.count"] == 2
    assert values["contours.mapping.pillar.iou.count"] == 1  # an edge has no area
    assert values["contours.mapping.pillar.iou.mean"] == pytest.approx(1, abs=1e-3)
    values = scored(replace(contours, is_closed=np.zeros(4, bool)))
    assert np.isnan(values["contours.mapping.pillar.iou.mean"])
    grown = contours.center_m[:, None] + 2 * (contours.contour_m - contours.center_m[:, None])
    values = scored(replace(contours, contour_m=grown))
    assert values["contours.mapping.pillar.iou.mean"] == pytest.approx(0.25, abs=1e-3)


def test_a_contour_of_no_object_is_a_ghost(campaign, tables, scored):
    mapping = campaign.results.mapping
    path = mapping.ips.path.copy()
    path[mapping.contours.object == 1] = 5  # made from the double bounce
    result = replace(mapping, ips=replace(mapping.ips, path=path))
    ips = score_ips(campaign.scene, result, tables.paths)
    table = score_contours(campaign.scene, result, ips, tables.significant)
    assert table.is_ghost.tolist() == [False, True, False, False]
    assert np.isnan(table.class_right[1])
    assert np.isnan(table.iou[1])


def test_a_closed_contour_where_nothing_stands_is_a_phantom(campaign, scored):
    contours, mesh = campaign.results.mapping.contours, trimesh.creation.cylinder(0.3, 2.0)
    away = contours.contour_m + np.array([[2.0, 0.0], [0.0, 0.0], [9.0, 9.0], [0.0, 0.0]])[:, None]
    moved = replace(contours, contour_m=away)
    assert scored(contours)["contours.mapping.phantoms"] == 0
    values = scored(moved)
    assert values["contours.mapping.phantoms"] == values["contours.mapping.false"] == 1  # an open one has no area
    outline = mesh.vertices + np.array([*away[0].mean(axis=0), 0.0])
    drum = Clutter("drum", "clutter", Material("tin", 1.0, 1e7), outline, np.asarray(mesh.faces))
    assert not is_phantom(replace(campaign.scene, clutter=(drum,)), moved).any()


def test_classes_are_judged_by_kind_of_object_and_corners(campaign):
    contours, scene = campaign.results.mapping.contours, campaign.scene
    wall = scene.object("wall_south")
    edge = replace(contours, class_probability=np.tile([0.1, 0.8, 0.1], (4, 1)))
    assert is_class_right(contours, 2, wall)
    assert not is_class_right(contours, 2, scene.object("pillar_a"))
    assert not is_class_right(edge, 2, wall)  # in its middle
    corner = replace(edge, center_m=np.tile([7.4, -7.0], (4, 1)))
    assert is_class_right(corner, 2, wall)
    unknown = replace(contours, class_probability=np.full((4, 3), np.nan))
    assert is_class_right(unknown, 0, scene.object("pillar_a"))
    assert is_class_right(unknown, 2, wall)


def test_an_edge_point_has_distances_but_no_area(campaign):
    contours, wall = campaign.results.mapping.contours, campaign.scene.object("wall_south").contour
    point = replace(contours, contour_m=np.tile([0.0, -6.9], (4, 180, 1)))
    errors = contour_errors(point, 2, np.zeros((1, 2)), wall, np.zeros((0, 2)))
    assert errors.seen_rmse_m == pytest.approx(0.1)
    assert errors.hausdorff_m == pytest.approx(np.hypot(7.5, 0.1))
    assert np.isnan(errors.iou)


def test_no_contour_gives_the_same_keys(campaign, scored):
    mapping = campaign.results.mapping
    full, none = (
        scored(contours) for contours in (mapping.contours, no_contours(len(mapping.ips), len(mapping.poses.stop)))
    )
    assert full.keys() == none.keys()
    assert none["contours.mapping.accepted"] == 0
    assert none["contours.mapping.ghosts"] == 0


def test_rows_must_fit_the_points(campaign, tables):
    mapping = campaign.results.mapping
    short = MapResult(mapping.poses, mapping.ips, mapping.shapes, no_contours(3, 12))
    ips = score_ips(campaign.scene, mapping, tables.paths)
    with pytest.raises(ValueError, match=r"Contours\.object: 3 values for \d+ incidence points"):
        score_contours(campaign.scene, short, ips, tables.significant)


def drum_in_place_of(scene, name):
    """The scene with a cylinder of the same name in place of an object, as a mesh."""
    item = scene.object(name)
    (west, south, low), (east, north, high) = item.bounds_m
    mesh = trimesh.creation.cylinder((east - west) / 2, high - low, sections=96)
    corners = mesh.vertices + np.array([(west + east) / 2, (south + north) / 2, (low + high) / 2])
    drum = Clutter(name, "clutter", Material("tin", 1.0, 1e7), corners, np.asarray(mesh.faces))
    return replace(scene, objects=tuple(one for one in scene.objects if one.name != name), clutter=(drum,))


def test_a_mesh_that_enough_points_show_is_found_and_not_false(campaign, tables):
    mapping = campaign.results.mapping
    scene = drum_in_place_of(campaign.scene, "pillar_a")
    ips = score_ips(scene, mapping, tables.paths)
    table = score_contours(scene, mapping, ips, tables.significant)
    before = score_contours(campaign.scene, mapping, ips, tables.significant)
    row = table.object.tolist().index("pillar_a")
    assert table.is_found[row] and table.n_close[row] == before.n_close[row] > 0
    assert not table.is_false.any()
    clusters = tables.mapping.clusters
    found = score_scene(scene, mapping, clusters, table, tables.significant)
    assert found.false.tolist() == found.missed.tolist() == [0, 0]
    values = {one.key: one.value for one in contour_metrics("mapping", scene, table)}
    old = {one.key: one.value for one in contour_metrics("mapping", campaign.scene, before)}
    assert (
        values["contours.mapping.objects_found"] == old["contours.mapping.objects_found"] - 1
    )  # a mesh is no object
