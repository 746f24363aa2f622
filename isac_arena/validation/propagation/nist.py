"""Every path of the L-shaped room of NIST's Q-D realization software, an independent ray tracer.

Its files are `nist_qd/L-Room` in the folder of the measured data: walls, 200 receivers, and per receiver the line
of sight and the reflections off up to two of walls, floor and ceiling. The reference takes 3e8 m/s, so lengths are
compared. Its TX stands in the plane of the ceiling and sends nothing up to it: ours is a micrometre higher.
"""

from pathlib import Path

import numpy as np

from isac_arena.exchange.nist_qd import FILES, NistRoom, read_nist_room
from isac_arena.validation.measured_data import data_folder
from isac_arena.validation.measurement import InfoTable, Measured, at_most
from scenes.contours import Polyline
from scenes.objects.material import itu_material
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import BoolArray, FloatArray
from scenes.scene import HorizontalPlane, Scene, SceneObject
from scenes.walks.trajectory import Walk
from sim.config import PropagationConfig
from sim.propagation.paths import Paths
from sim.propagation.specular.solver import exact_paths

ROOM = Path("nist_qd") / "L-Room"
FLOOR_M, CEILING_M = 0.003, 3.000001
CARRIER_HZ = 60e9
QUICK_STEP = 20  # of receivers
SAME_M, SAME_RAD = 1e-3, 1e-4  # nearer paths are the same one


def check_nist_room(seed: int, quick: bool) -> Measured:
    """All paths of the reference among ours, and the largest differences of their lengths and angles."""
    folder = data_folder() / ROOM
    absent = [name for name in FILES if not (folder / name).is_file()]
    if absent:
        reason = f"{absent[0]} is not in {folder}"
        return Measured([], (InfoTable("NIST L-Room", ("not measured",), ((reason,),)),))
    room = read_nist_room(folder)
    chosen = np.arange(0, len(room.rx_m), QUICK_STEP if quick else 1)
    n_missed = n_extra = n_reference = 0
    worst: FloatArray = np.zeros(3)
    config = PropagationConfig(max_bounces=2)
    for stop, found in zip(chosen, exact_paths(_scene(room), room.rx_m[chosen], CARRIER_HZ, config), strict=True):
        ours, known = path_places(found), room.paths[stop]
        apart = np.abs(place_differences(known[:, None], ours[None]))
        same: BoolArray = np.asarray((apart <= [SAME_M, *(4 * [SAME_RAD])]).all(axis=2))
        n_reference, n_missed = n_reference + len(known), n_missed + int((~same.any(axis=1)).sum())
        up = ours[:, 2] > 0  # departures towards the ceiling
        n_extra += int((~same.any(axis=0) & ~up).sum())
        for gaps, alike in zip(apart, same, strict=True):
            if alike.any():
                nearest = gaps[alike][gaps[alike][:, 0].argmin()]
                worst = np.maximum(worst, [nearest[0], nearest[1:3].max(), nearest[3:].max()])
    reason = f"of {n_reference} paths at {len(chosen)} receivers"
    delay_ps, angles_deg = 1e12 * worst[0] / SPEED_OF_LIGHT_M_S, np.rad2deg(worst[1:])
    return Measured(
        [
            at_most("nist_room.missed", n_missed, 0, reason, "paths"),
            at_most("nist_room.extra", n_extra, 2, "a specular point on the inner corner; none upwards", "paths"),
            at_most("nist_room.delay", delay_ps, 0.1, "largest difference, as length over c", "ps"),
            at_most("nist_room.departure", angles_deg[0], 1e-4, "largest difference of either angle", "deg"),
            at_most("nist_room.arrival", angles_deg[1], 1e-4, "largest difference of either angle", "deg"),
        ]
    )


def _scene(room: NistRoom) -> Scene:
    """The walls of the room, a floor and a ceiling, all of metal."""
    metal = itu_material("metal", CARRIER_HZ)
    walls = [
        SceneObject(name, "wall", Polyline(line), 0.0, CEILING_M, metal) for name, line in room.walls_m.items()
    ]
    ends = np.concatenate(list(room.walls_m.values()))
    low, high = ends.min(axis=0), ends.max(axis=0)
    return Scene(
        name="nist_l_room",
        objects=tuple(walls),
        tx=Pose(room.tx_m, 0.0),
        walk=Walk(room.rx_m[:, :2], float(room.rx_m[0, 2]), 0.0),
        bounds_m=(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
        floor=HorizontalPlane(FLOOR_M, metal),
        ceiling=HorizontalPlane(CEILING_M, metal),
    )


def path_places(paths: Paths) -> FloatArray:
    """Length in m, azimuth and elevation of departure and of arrival in rad (path, 5)."""
    return np.column_stack(
        [
            SPEED_OF_LIGHT_M_S * paths.delay_s,
            paths.aod_azimuth_rad,
            paths.aod_elevation_rad,
            paths.aoa_azimuth_rad,
            paths.aoa_elevation_rad,
        ]
    )


def place_differences(first: FloatArray, second: FloatArray) -> FloatArray:
    """Differences of what `path_places` gives, angles within half a turn."""
    return np.concatenate([(first - second)[..., :1], wrap_angle((first - second)[..., 1:])], axis=-1)
