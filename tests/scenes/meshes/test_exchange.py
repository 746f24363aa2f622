"""Meshes in and out: what is written can be read again, here, and by Sionna."""

import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import trimesh

from scenes.config import SceneConfig, library_scenes, load_scene, referenced_contents
from scenes.meshes.mesh import Polyline3d, glb_bytes, object_meshes, ply_bytes, read_mesh, write_mitsuba
from scenes.toml_config import ConfigError, load_config

ROOM = (load_scene.__globals__["LIBRARY"] / "box_room.toml").read_text()
MESH = '\n[[meshes]]\nfile = "crate.{kind}"\nmaterial = "wood"\nposition_m = [3.0, 6.0, 0.6]\n{more}'
PLAN = '\n[[floorplans]]\nname = "plan"\nfile = "plan.csv"\nmaterial = "plasterboard"\nz_max_m = 2.2\n'


@pytest.fixture
def folder(tmp_path):
    box = trimesh.creation.box((1.0, 0.6, 1.2))
    for kind in ("stl", "obj", "ply", "off", "glb"):
        upright = (
            box if kind != "glb" else trimesh.Trimesh(box.vertices[:, [0, 2, 1]] * [1, 1, -1], box.faces)
        )  # y up
        upright.export(tmp_path / f"crate.{kind}")
    (tmp_path / "plan.csv").write_text("x0_m,y0_m,x1_m,y1_m\n8.5,3.5,9.3,3.5\n9.2,3.5,10,3.5\n8.5,3.5,8.5,4.2\n")
    return tmp_path


@pytest.fixture
def load(folder):
    def load(text):
        (folder / "room.toml").write_text(text)
        return load_scene(folder / "room.toml")

    return load


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off", "glb"])
def test_meshes_become_clutter(load, kind):
    scene = load(ROOM + MESH.format(kind=kind, more="scale = 0.5\nrotation_deg = [0.0, 0.0, 90.0]\n"))
    (item,) = scene.clutter
    assert (item.name, item.kind, item.material.name) == ("crate", "clutter", "wood") and item.is_closed
    np.testing.assert_allclose(item.bounds_m, [(2.85, 5.75, 0.3), (3.15, 6.25, 0.9)], atol=1e-6)
    part = object_meshes(scene)[-1]
    assert part.object_name == "crate" and not part.is_curved and part.mesh.is_volume
    assert list(scene.materials) == [*scene.object_names, "floor", "ceiling", "crate"]
    assert scene.kinds["crate"] == "clutter"


def test_a_floor_plan_becomes_thin_walls(load, folder):
    scene = load(ROOM + PLAN)
    assert scene.object_names[-2:] == ["plan_1", "plan_2"]
    wall = scene.object("plan_1")
    assert not wall.contour.closed and wall.contour.length_m == pytest.approx(1.5) and wall.z_max_m == 2.2
    config = load_config(folder / "room.toml", SceneConfig)
    assert list(referenced_contents(config, folder)) == ["scene_files/plan.csv"]


MISTAKES = [
    (MESH.format(kind="xyz", more=""), r"meshes\[crate\]\.file = '.*crate\.xyz': there is no such file"),
    (MESH.format(kind="stl", more="scale = 0.0\n"), r"meshes\[0\]\.scale = 0\.0: must be greater than 0"),
    (MESH.format(kind="stl", more='kind = "tree"\n'), r"meshes\[0\]\.kind = \"tree\": must be"),
    (MESH.format(kind="stl", more='name = "box"\n'), r"the name 'box' is given twice"),
    (
        MESH.format(kind="stl", more="").replace("[3.0, 6.0, 0.6]", "[1.5, 4.0, 1.5]"),
        r"TX at \(1\.500, 4\.000, 1\.500\) m lies inside mesh 'crate'",
    ),
    (
        MESH.format(kind="stl", more="").replace("[3.0, 6.0, 0.6]", "[4.0, 2.0, 1.2]"),
        r"RX stop 0 at .* lies inside mesh 'crate'",
    ),
    (MESH.format(kind="stl", more="").replace('"wood"', '"tin"'), r"meshes\[crate\]\.material = 'tin'"),
    (PLAN.replace("plan.csv", "none.csv"), r"floorplans\[plan\]\.none\.csv: .*none\.csv: cannot be read"),
    (
        MESH.format(kind="stl", more="scale = 1000.0\n"),
        r"meshes\[crate\] reaches from \(-497, -294\) to \(503, 306\): must lie in or near bounds_m = .*; "
        "scale = 1000 is given; a file in metres needs 1, one in millimetres 0.001",
    ),
    (
        MESH.format(kind="stl", more="").replace("[3.0,", "[3000.0,"),
        r"meshes\[crate\] reaches .* needs scale = 0\.001",
    ),
    (PLAN.replace("2.2", "0.0"), r"floorplans\[plan\]\.z_max_m = 0\.0: must be greater"),
]


@pytest.mark.parametrize(("more", "message"), MISTAKES)
def test_mistakes_name_the_mesh_or_the_plan(load, more, message):
    with pytest.raises(ConfigError, match=message) as caught:
        load(ROOM + more)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            MESH.format(kind="xyz", more=""),
            r"^meshes\[crate\]\.file = 'crate\.xyz': cannot be read \(No such file",
        ),
        (PLAN.replace("plan.csv", "no.csv"), r"^floorplans\[plan\]\.file = 'no\.csv': cannot be read"),
        (
            MESH.format(kind="stl", more='motion = { type = "file", file = "no.tum" }\n'),
            r"^meshes\[crate\]\.motion\.file = 'no\.tum': cannot be read",
        ),
    ],
)
def test_a_missing_file_is_named_by_its_field(folder, more, message):
    (folder / "room.toml").write_text(ROOM + more)
    config = load_config(folder / "room.toml", SceneConfig)
    with pytest.raises(ConfigError, match=message):
        referenced_contents(config, folder)


def test_copies_are_found_under_any_spelling_of_their_file(folder, tmp_path):
    text = ROOM + PLAN.replace("plan.csv", "./plan.csv")
    (folder / "room.toml").write_text(text)
    files = referenced_contents(load_config(folder / "room.toml", SceneConfig), folder)
    for name, data in files.items():
        (tmp_path / "copy" / name).parent.mkdir(parents=True)
        (tmp_path / "copy" / name).write_bytes(data)
    (tmp_path / "copy" / "scene.toml").write_text(text)
    assert load_scene(tmp_path / "copy" / "scene.toml").object_names[-1] == "plan_2"


def test_broken_files_are_named(load, folder):
    (folder / "crate.obj").write_text("nothing here")
    with pytest.raises(ConfigError, match=r"meshes\[crate\]\.file = .*crate\.obj"):
        load(ROOM + MESH.format(kind="obj", more=""))
    (folder / "crate.stl").write_bytes(b"\x00" * 90)
    with pytest.raises(ConfigError, match=r"meshes\[crate\]\.file = .*crate\.stl"):
        load(ROOM + MESH.format(kind="stl", more=""))
    (folder / "plan.csv").write_text("x0_m,y0_m,x1_m,y1_m\n0,0,inf,0\n")
    with pytest.raises(ConfigError, match=r"floorplans\[plan\]\.plan\.csv: line 2: x1_m = 'inf'"):
        load(ROOM + PLAN)
    (folder / "plan.csv").write_text("x0_m,y0_m,x1_m,y1_m\n4000,6200,4000,9000\n")
    with pytest.raises(
        ConfigError, match=r"floorplans\[plan\]\.plan\.csv: wall plan_1 reaches from \(4000, 6200\)"
    ):
        load(ROOM + PLAN)


def test_a_fin_on_a_box_is_not_manifold(load, folder):
    box = trimesh.creation.box((1.0, 0.6, 1.2))
    fin = trimesh.Trimesh([*box.vertices, (2, 2, 2)], [*box.faces, (*box.faces[0][:2], 8)], process=False)
    fin.export(folder / "crate.obj")
    with pytest.raises(ConfigError, match=r"mesh 'crate' is not manifold: 1 edge"):
        load(ROOM + MESH.format(kind="obj", more=""))


@pytest.mark.parametrize("name", library_scenes())
def test_ply_and_glb_round_trip(name, tmp_path):
    scene = load_scene(name)
    parts = object_meshes(scene, 1e-3)
    area = sum(part.mesh.area for part in parts)
    (tmp_path / "scene.ply").write_bytes(ply_bytes(scene))
    (tmp_path / "scene.glb").write_bytes(glb_bytes(scene))
    vertices, faces = read_mesh(tmp_path / "scene.ply")
    assert trimesh.Trimesh(vertices, faces, process=False).area == pytest.approx(area, rel=1e-5)
    loaded = trimesh.load_scene(tmp_path / "scene.glb")
    assert set(scene.object_names) <= {key.removesuffix("-curved") for key in loaded.geometry}
    assert len(loaded.geometry) == len(parts)
    assert loaded.to_mesh().area == pytest.approx(area, rel=1e-5)
    low, high = loaded.bounds  # x, z up, -y
    everything = np.concatenate([part.mesh.vertices for part in parts])
    np.testing.assert_allclose(low[[0, 1]], everything.min(axis=0)[[0, 2]], atol=1e-4)
    np.testing.assert_allclose(high[2], -everything[:, 1].min(), atol=1e-4)


def test_an_exported_scene_comes_back_as_a_mesh_of_another(load, folder):
    (folder / "crate.glb").write_bytes(glb_bytes(load_scene("box_room")))
    text = ROOM + MESH.format(kind="glb", more="scale = 0.05\n")
    (item,) = load(text).clutter
    np.testing.assert_allclose(item.bounds_m[1] - item.bounds_m[0], np.array([10.3, 8.3, 3.0]) / 20, atol=1e-4)


@pytest.mark.parametrize("name", library_scenes())
def test_mitsuba_xml_names_every_part_and_its_material(name, tmp_path):
    scene = load_scene(name)
    root = ET.parse(write_mitsuba(scene, tmp_path)).getroot()
    materials = {node.get("id"): node for node in root.findall("bsdf")}
    area = 0.0
    for shape in root.findall("shape"):
        file = tmp_path / shape.find("string").get("value")
        area += trimesh.load_mesh(file).area
        object_name = file.stem.rsplit("-", 1)[0]
        material = scene.materials[object_name]
        node = materials[shape.find("ref").get("id")]
        values = {child.get("name"): float(child.get("value")) for child in node}
        assert values["relative_permittivity"] == material.relative_permittivity
        assert values["scattering_coefficient"] == material.scattering_coefficient
    parts = object_meshes(scene, keep_hidden_caps=False)
    assert area == pytest.approx(sum(part.mesh.area for part in parts), rel=1e-5)
    assert len(root.findall("shape")) == len(parts)


@pytest.mark.slow
def test_sionna_loads_the_mitsuba_xml(tmp_path):
    from sim.propagation.llvm import LlvmError, require_llvm  # noqa: PLC0415

    try:
        require_llvm()
    except LlvmError:
        pytest.skip("no usable LLVM library")
    path = write_mitsuba(load_scene("box_room"), tmp_path)
    code = (
        "from sim.propagation.llvm import require_llvm; require_llvm(); import mitsuba as mi; "
        "mi.set_variant('llvm_ad_mono_polarized'); import sionna.rt as rt; "
        f"scene = rt.load_scene({str(path)!r}, merge_shapes=False); "
        "print(len(scene.objects), sorted(scene.radio_materials))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.startswith("8 ") and "arena-plasterboard" in found
    shutil.rmtree(tmp_path)


def test_rays_are_nodes_of_lines(tmp_path):
    scene = load_scene("box_room")
    corners = [np.array([[0, 0, 1], [2, 0, 1.0]]), np.array([[0, 0, 1], [0, 3, 1], [4, 3, 2.0]])]
    lines = [Polyline3d(f"ray {i}", "#ff0000", points) for i, points in enumerate(corners)]
    (tmp_path / "room.glb").write_bytes(glb_bytes(scene, polylines=lines))
    nodes = trimesh.load_scene(tmp_path / "room.glb").geometry
    rays = [nodes["ray 0"], nodes["ray 1"]]
    assert all(isinstance(ray, trimesh.path.Path3D) for ray in rays)
    assert [ray.length for ray in rays] == pytest.approx([2, 3 + np.sqrt(17)], rel=1e-6)
    np.testing.assert_allclose(np.ptp(rays[1].vertices, axis=0), [4, 1, 3], atol=1e-6)  # y is up in glTF
