"""Scene checks: occupancy, names, devices inside objects."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.config import load_scene
from scenes.contour import Circle, Polyline
from scenes.material import Material
from scenes.pose import Pose
from scenes.scene import HorizontalPlane, SceneObject
from scenes.trajectory import Walk

WOOD = Material("wood", 2.0, 0.4)


@pytest.fixture(scope="module")
def room():
    return load_scene("box_room")


def test_occupied_finds_solids_and_thin_walls(room):
    sheet = SceneObject("sheet", "wall", Polyline([(1, 7), (3, 7)]), 0.0, 3.0, WOOD)
    scene = replace(room, objects=(*room.objects, sheet))
    points = [
        (5.0, 5.5, 1.0),
        (5.0, 5.5, 3.5),
        (7.5, 5.4, 1.0),
        (7.5, 5.4, 1.5),
        (2.0, 7.005, 1.0),
        (2, 7.02, 1),
    ]
    found = scene.occupied(np.array(points).reshape(2, 3, 3))
    names = [*scene.object_names, "none"]
    assert [names[i] for i in found.ravel()] == ["pillar", "none", "box", "none", "sheet", "none"]


def test_object_by_name(room):
    assert room.object("pillar").kind == "pillar"
    with pytest.raises(ValueError, match=r"object = 'pilar': must be one of .*pillar"):
        room.object("pilar")


def test_rx_stop_inside_an_object_names_stop_place_and_object(room):
    message = r"RX stop 1 at \(5\.000, 5\.500, 1\.500\) m lies inside object 'pillar'"
    with pytest.raises(ValueError, match=message):
        replace(room, walk=Walk([(1, 1), (5, 5.5)], 1.5, 0.0))
    with pytest.raises(ValueError, match=r"RX stop 0 .* lies inside object 'wall_south'"):
        replace(room, walk=Walk([(1, -0.1)], 1.5, 0.0))
    replace(room, walk=Walk([(7.5, 5.4)], 1.5, 0.0))  # above the box


def test_tx_and_heights(room):
    with pytest.raises(ValueError, match=r"TX at .* lies inside object 'box'"):
        replace(room, tx=Pose((7.5, 5.4, 1.0), 0.0))
    with pytest.raises(ValueError, match=r"TX at .* must lie between floor and ceiling, z 0 to 3 m"):
        replace(room, tx=Pose((1, 1, 3.2), 0.0))
    with pytest.raises(ValueError, match=r"ceiling\.z_m = -1"):
        replace(room, ceiling=HorizontalPlane(-1.0, WOOD))


def test_repeated_and_reserved_names(room):
    with pytest.raises(ValueError, match="the name 'box' is given twice"):
        replace(room, objects=(*room.objects, room.object("box")))
    for change, message in (
        ({"name": "floor"}, "name = 'floor'"),
        ({"kind": "tree"}, "kind = 'tree': must be one of wall"),
        ({"z_max_m": 0.0}, r"z_max_m = 0\.0: must be greater"),
    ):
        values = {
            "name": "x",
            "kind": "pillar",
            "contour": Circle((0, 0), 1.0),
            "z_min_m": 0.0,
            "z_max_m": 1.0,
        }
        with pytest.raises(ValueError, match=message):
            SceneObject(**(values | change), material=WOOD)
