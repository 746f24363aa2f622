"""What stands in a scene as a record of arrays: objects, meshes and their corners, TXs and stops."""

from dataclasses import dataclass

import numpy as np

from scenes.contours.base import BODY_SAGITTA_M
from scenes.objects.clutter import Clutter
from scenes.record import BoolArray, FloatArray, IntArray, Record, TextArray, array
from scenes.scene import Scene, SceneObject


@dataclass(frozen=True)
class SceneInventory(Record):
    """Objects and meshes of a scene at time zero, with their corners in plan view, its TXs and its stops.

    The corners of one object are neighbours, in order; the line through those of a curved contour is within a
    millimetre of it. A mesh has the corners of the area that it covers; it is closed where it has an inside.
    """

    scene: str = array(dtype=str, doc="name of the scene")
    object: TextArray = array("object", dtype=str, doc="name of the object or mesh")
    kind: TextArray = array("object", dtype=str, doc="kind: wall, pillar, ...")
    material: TextArray = array("object", dtype=str, doc="name of the material")
    is_mesh: BoolArray = array("object", dtype=bool, doc="a triangle mesh, else a vertical prism")
    is_closed: BoolArray = array("object", dtype=bool, doc="has an inside; else a thin wall or an open mesh")
    is_moving: BoolArray = array("object", dtype=bool, doc="has a motion")
    low_m: FloatArray = array("object", "xyz", unit="m", doc="lowest coordinates")
    high_m: FloatArray = array("object", "xyz", unit="m", doc="highest coordinates")
    corner_m: FloatArray = array("corner", "xy", unit="m", doc="corners of the outlines in plan view")
    corner_object: IntArray = array("corner", dtype=int, doc="index of the object of a corner")
    tx: TextArray = array("tx", dtype=str, doc="name of the TX, the active one first")
    tx_position_m: FloatArray = array("tx", "xyz", unit="m", doc="position of the TX")
    tx_heading_rad: FloatArray = array("tx", unit="rad", doc="heading of the TX, from x towards y")
    stop_position_m: FloatArray = array("stop", "xyz", unit="m", doc="position of the receiver at a stop")
    stop_heading_rad: FloatArray = array("stop", unit="rad", doc="heading of the receiver, from x towards y")
    floor_z_m: float = array(unit="m", doc="height of the floor, NaN without one")
    ceiling_z_m: float = array(unit="m", doc="height of the ceiling, NaN without one")


def scene_inventory(scene: Scene) -> SceneInventory:
    """All that stands in a scene, meshes last."""
    things: list[SceneObject | Clutter] = [*scene.objects, *scene.clutter]
    corners = [item.contour.vertices(BODY_SAGITTA_M) for item in scene.objects]
    corners += [np.concatenate([np.zeros((0, 2)), *mesh.plan_outlines_m]) for mesh in scene.clutter]
    bounds_m: FloatArray = np.array([item.bounds_m for item in things], dtype=np.float64).reshape(-1, 2, 3)
    txs, stops = scene.txs, scene.stops
    planes = (scene.floor, scene.ceiling)
    floor_z_m, ceiling_z_m = (np.nan if plane is None else plane.z_m for plane in planes)
    return SceneInventory(
        scene=scene.name,
        object=np.array([item.name for item in things], dtype=str),
        kind=np.array([item.kind for item in things], dtype=str),
        material=np.array([item.material.name for item in things], dtype=str),
        is_mesh=np.arange(len(things)) >= len(scene.objects),
        is_closed=np.array(
            [*(item.contour.closed for item in scene.objects), *(mesh.is_closed for mesh in scene.clutter)], bool
        ),
        is_moving=np.array([item.motion is not None for item in things], dtype=bool),
        low_m=bounds_m[:, 0],
        high_m=bounds_m[:, 1],
        corner_m=np.concatenate([np.zeros((0, 2)), *corners]),
        corner_object=np.repeat(np.arange(len(things)), [len(each) for each in corners]),
        tx=np.array(list(txs), dtype=str),
        tx_position_m=np.array([pose.position_m for pose in txs.values()]),
        tx_heading_rad=np.array([pose.heading_rad for pose in txs.values()]),
        stop_position_m=np.array([pose.position_m for pose in stops]).reshape(-1, 3),
        stop_heading_rad=np.array([pose.heading_rad for pose in stops], float),
        floor_z_m=floor_z_m,
        ceiling_z_m=ceiling_z_m,
    )
