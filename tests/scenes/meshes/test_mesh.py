"""Meshes: watertight prisms of the right volume, curved and flat facets apart."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from scenes.config import library_scenes, load_scene
from scenes.contours import Circle
from scenes.meshes.mesh import object_meshes, write_ply


@pytest.fixture(scope="module", params=library_scenes())
def scene(request):
    return replace(load_scene(request.param), clutter=())  # meshes of users are kept as they are


def whole(parts, name):
    mesh = trimesh.util.concatenate([part.mesh for part in parts if part.object_name == name])
    mesh.merge_vertices()
    return mesh


def test_solids_are_watertight_with_volume_area_times_height(scene):
    parts = object_meshes(scene, max_sagitta_m=1e-5)
    for item in scene.objects:
        mesh = whole(parts, item.name)
        height = item.z_max_m - item.z_min_m
        if item.contour.closed:
            assert mesh.is_watertight and mesh.is_winding_consistent, item.name
            assert mesh.volume == pytest.approx(item.contour.area_m2() * height, rel=2e-4)
        else:
            assert mesh.area == pytest.approx(item.contour.length_m * height, rel=1e-4)


def test_facets_of_curved_pieces_are_apart_and_few(scene):
    for part in object_meshes(scene):
        if part.object_name in ("floor", "ceiling"):
            assert not part.is_curved and len(part.mesh.faces) == 2
            continue
        item = scene.object(part.object_name)
        upright = np.abs(part.mesh.face_normals[:, 2]) < 1e-9
        if part.is_curved:
            assert upright.all()
            assert any(piece.is_curved for piece in item.contour.pieces)
        n_flat = sum(not piece.is_curved for piece in item.contour.pieces)
        assert part.is_curved or upright.sum() == 2 * n_flat
        if item.kind == "pillar" and part.is_curved:
            most = 32 if isinstance(item.contour, Circle) else 80
            assert 24 <= len(part.mesh.faces) / 2 <= most


def test_normals_point_outward_floor_up_ceiling_down(scene):
    for part in object_meshes(scene):
        normals, centers = part.mesh.face_normals, part.mesh.triangles_center
        if part.object_name in ("floor", "ceiling"):
            np.testing.assert_allclose(normals[:, 2], 1 if part.object_name == "floor" else -1)
            continue
        contour = scene.object(part.object_name).contour
        upright = np.abs(normals[:, 2]) < 1e-9
        if contour.closed and upright.any():
            ahead = centers[upright] + 0.03 * normals[upright]
            assert (contour.signed_distance(ahead[:, :2]) > 0).all()


def test_hidden_caps_can_be_left_out(scene):
    shown = object_meshes(scene, keep_hidden_caps=False)
    for part in shown:
        if part.object_name not in ("floor", "ceiling"):
            caps = np.abs(part.mesh.face_normals[:, 2]) > 0.5
            heights = part.mesh.triangles_center[caps, 2]
            assert not np.isin(heights, [scene.floor.z_m, scene.ceiling.z_m]).any()
    assert {part.object_name for part in shown} == {*scene.object_names, "floor", "ceiling"}


def test_ply_round_trip(tmp_path):
    part = next(p for p in object_meshes(load_scene("box_room")) if p.is_curved)
    path = write_ply(part, tmp_path)
    assert path.name == "pillar-curved.ply"
    assert trimesh.load(path).area == pytest.approx(part.mesh.area, rel=1e-6)
