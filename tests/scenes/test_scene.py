"""Scene checks: occupancy, names, devices inside objects."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.config import load_scene
from scenes.contours import Circle, Contour, Ellipse, LinePiece, Polyline, rectangle
from scenes.objects.material import Material
from scenes.pose import Pose
from scenes.scene import HorizontalPlane, SceneObject
from scenes.walks.trajectory import Walk

WOOD = Material("wood", 2.0, 0.4)


@pytest.fixture(scope="module")
def room():
    return load_scene("box_room")


def test_occupied_finds_solids_and_thin_walls(room):
    sheet = SceneObject("sheet", "wall", Polyline([(1, 7), (3, 7)]), 0.0, 3.0, WOOD)
    scene = replace(room, objects=(*room.objects, sheet))
    points = [(5.0, 5.5, 1.0), (5.0, 5.5, 3.5), (7.5, 5.4, 1.0), (7.5, 5.4, 1.5), (2.0, 7.005, 1.0), (2, 7.02, 1)]
    found = scene.object_index_at(np.array(points).reshape(2, 3, 3))
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
        values = {"name": "x", "kind": "pillar", "contour": Circle((0, 0), 1.0), "z_min_m": 0.0, "z_max_m": 1.0}
        with pytest.raises(ValueError, match=message):
            SceneObject(**(values | change), material=WOOD)


def block(name, x_m, y_m=(6.5, 7.5), z_m=(0.0, 2.0), **more):
    return SceneObject(name, "box", rectangle(x_m, y_m), *z_m, WOOD, **more)


def test_overlapping_solids_are_refused_and_touching_ones_are_not(room):
    first = block("first", (1.0, 2.0))
    for second in (
        block("second", (2.0, 3.0)),
        block("second", (1.9995, 3.0)),
        block("second", (1.5, 3.0), z_m=(2.0, 3.0)),
        block("second", (1.5, 3.0), may_overlap=True),
        SceneObject("second", "wall", Polyline([(0.5, 7), (3, 7)]), 0.0, 2.0, WOOD),
    ):
        replace(room, objects=(*room.objects, first, second))
    for second in (
        block("second", (1.5, 3.0)),
        block("second", (1.2, 1.3), (6.8, 6.9)),
        block("second", (1.998, 3.0)),
        SceneObject("second", "pillar", Ellipse((2.2, 7.0), (0.3, 0.1), 0.0), 0.0, 3.0, WOOD),
    ):
        with pytest.raises(ValueError, match=r"^objects 'first' and 'second' overlap in .* m\^2: move one"):
            replace(room, objects=(*room.objects, first, second))


class Broken(Contour):
    """Two lines that do not meet."""

    closed = True

    @property
    def pieces(self):
        return tuple(LinePiece(*ends) for ends in [((0, 0), (1, 0)), ((1, 0.1), (0, 1)), ((0, 1), (0, 0))])


def test_an_open_outline_and_infinite_heights_are_refused():
    with pytest.raises(ValueError, match=r"contour of 'gate' is open: a piece ends at \[1\.0, 0\.0\]"):
        SceneObject("gate", "box", Broken(), 0.0, 1.0, WOOD)
    with pytest.raises(ValueError, match=r"z_min_m, z_max_m = 0\.0, inf: must be finite"):
        SceneObject("gate", "box", Circle((0, 0), 1.0), 0.0, np.inf, WOOD)
    with pytest.raises(ValueError, match=r"z_max_m = nan: must be greater"):
        SceneObject("gate", "box", Circle((0, 0), 1.0), 0.0, np.nan, WOOD)


def test_several_txs_and_walks(room):
    north, long = Pose((1, 7, 2), 0.0), Walk([(3, 7), (9, 7)], 1.5, 0.0, 7)
    scene = replace(room, other_txs={"north": north}, other_walks={"long": long})
    assert list(scene.txs) == ["tx", "north"] and list(scene.walks) == ["walk", "long"]
    chosen = scene.choose(tx="north", walk=1)
    assert chosen.tx is north and len(chosen.stops) == 7 and len(scene.stops) == 4
    assert list(chosen.txs) == ["north", "tx"] and chosen.walk_name == "long"
    back = chosen.choose("tx", "walk")
    assert back.tx is room.tx and back.walk is room.walk and back.txs.keys() == scene.txs.keys()
    assert scene.choose().tx is room.tx
    with pytest.raises(ValueError, match="tx = 'south': must be one of tx, north"):
        scene.choose(tx="south")
    with pytest.raises(ValueError, match="walk = 2: must be one of walk, long"):
        scene.choose(walk=2)
    with pytest.raises(ValueError, match=r"TX 'north' at .* lies inside object 'box'"):
        replace(room, other_txs={"north": Pose((7.5, 5.4, 1.0), 0.0)})
    with pytest.raises(ValueError, match=r"RX stop 1 of walk 'long' at .* lies inside object 'pillar'"):
        replace(room, other_walks={"long": Walk([(3, 7), (5, 5.5)], 1.5, 0.0)})
    with pytest.raises(ValueError, match="txs: the name 'tx' is given twice"):
        replace(room, other_txs={"tx": north})
