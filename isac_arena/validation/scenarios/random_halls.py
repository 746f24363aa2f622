"""Random halls: rooms drawn from rules with the campaign that measures each; no library scene is a model.

A room of 10 to 40 m has four walls, sometimes a corner cut out, floor and ceiling, windows, columns, partitions,
boxes and racks. Half of the rooms have the TX and the receiver at one height; the number of beam elevations and
the hardware take turns, so rooms 0 to 15 hold every combination once. Room k of a seed is the same whatever other
rooms are drawn, and whatever the length of its walk.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
import tomli_w

from isac_arena.campaign.config import CampaignConfig, with_link_levels
from isac_arena.validation.scenarios.hall_objects import COLUMN_HALF_M, MATERIALS, FreeSpace, Table, furnish
from scenes.config import SceneConfig
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.propagation.occlusion import sees_tx

N_STOPS = 8
SHORTEST_M, LONGEST_M = 10.0, 40.0  # of the longer side of a room
LEAST_SEEN = 5  # stops of a walk with a free line of sight inside the TX sector
EQUAL_HEIGHTS_M = 0.05  # devices within this are at equal heights: .4 ps on a path of 10 m
LEAST_DIFFERENCE_M = 0.5  # between unequal heights
LEAST_DISTANCE_M = 2.0  # between TX and receiver in plan view
TX_SECTOR_DEG, RX_SECTOR_DEG = 140.0, 90.0
MOST_POINTING_DEG = 1.0  # the TX heading of rooms with hardware is off by half of it to all of it
CARRIER_HZ = 60e9
WALL_M = 0.15
N_ROOMS, N_WALKS = 200, 12  # rooms and walks tried before giving up
CLEARANCE_M = 0.4  # of a walk from everything

# By number of elevations: columns of the arrays, beams of the TX and of an RX panel at each. Neighbouring beams
# are less than a Rayleigh cell apart.
ARRAYS = {1: (16, 28, 24), 2: (8, 12, 8), 3: (8, 10, 7), 4: (8, 9, 6)}
ELEVATIONS_DEG = {1: [0.0], 2: [-12.0, 12.0], 3: [-25.0, 0.0, 25.0], 4: [-33.0, -11.0, 11.0, 33.0]}
ELEVATION_TURNS = (1, 3, 2, 4)


@dataclass(frozen=True)
class RandomHall:
    """A room, the walk through it and the campaign that measures it."""

    room: int
    scene_text: str  # TOML
    config: CampaignConfig
    has_equal_heights: bool
    n_elevations: int
    has_hardware: bool


def draw_hall(
    seed: int,
    room: int,
    n_stops: int = N_STOPS,
    longest_m: float = LONGEST_M,
    column_half_m: tuple[float, float] = COLUMN_HALF_M,
) -> RandomHall:
    """Room number `room` of a seed, at most `longest_m` long, with a walk of `n_stops`.

    Fewer than 8 stops are the first ones of the same walk, more go on from its last one. Other `column_half_m`,
    half the width of the columns, give another room.

    Raises `ValueError` where no room can be drawn, or the walk cannot go on.
    """
    rng = np.random.default_rng([seed, room])
    equal, hardware = room % 2 == 0, room // 2 % 2 == 1
    n_elevations = ELEVATION_TURNS[(room + room // 4) % 4]
    for _ in range(N_ROOMS):
        scene = _draw_scene(rng, room, equal, longest_m, column_half_m)
        if scene is not None:
            stops = scene["walk"]["waypoints_m"]
            if n_stops > N_STOPS:
                stops += _further_stops(scene, n_stops - N_STOPS, np.random.default_rng([seed, room, N_STOPS]))
            scene["walk"] |= {"waypoints_m": stops[:n_stops]}
            config = _draw_campaign(rng, room, n_elevations, hardware)
            return RandomHall(room, tomli_w.dumps(scene), config, equal, n_elevations, hardware)
    raise ValueError(f"room {room} of seed {seed}: no walk with enough lines of sight in {N_ROOMS} rooms")


def _draw_scene(
    rng: np.random.Generator, room: int, equal: bool, longest_m: float, column_half_m: tuple[float, float]
) -> Table | None:
    """The tables of a scene file; None where no walk sees enough of the TX."""
    length = float(np.exp(rng.uniform(np.log(SHORTEST_M), np.log(longest_m))))
    size = np.array([length, max(5.0, length * float(rng.uniform(0.35, 1.0)))])
    height_m = float(rng.uniform(2.7, 3.2 + 0.12 * length))
    floor, walls = _walls(rng, size, height_m)
    free = FreeSpace(floor)
    tx_m, inward = _tx_place(rng, floor, free)
    free.area = free.area.difference(shapely.Point(tx_m).buffer(1.0))
    objects = [*walls, *furnish(rng, free, height_m, column_half_m)]
    rx_height_m = float(rng.uniform(0.9, 1.8))
    tx_height_m = _tx_height_m(rng, rx_height_m, height_m, equal)
    look = float(np.rad2deg(inward + 0.25 * rng.standard_normal()))
    scene: Table = {
        "name": f"hall_{room:02d}",
        "bounds_m": [0.0, 0.0, *size.tolist()],
        "tx": {"position_m": [*tx_m.tolist(), tx_height_m], "heading_deg": look},
        "floor": {"z_m": 0.0, "material": str(rng.choice(["concrete", "marble", "floorboard"]))},
        "ceiling": {"z_m": height_m, "material": str(rng.choice(["concrete", "ceiling_board", "metal"]))},
        "materials": MATERIALS,
        "objects": objects,
    }
    heading = {} if rng.random() < 0.5 else {"heading_deg": float(rng.uniform(-180, 180))}
    for _ in range(N_WALKS):
        walk = _random_walk(scene, int(rng.integers(2**31)), float(np.clip(length / 12, 0.8, 2.5)), rx_height_m)
        if walk is not None and _n_seen(walk) >= LEAST_SEEN:
            stops = walk.walk.positions_m()[:, :2].tolist()
            return {**scene, "walk": {"waypoints_m": stops, "height_m": rx_height_m, **heading}}
    return None


def _walls(rng: np.random.Generator, size: FloatArray, height_m: float) -> tuple[Any, list[Table]]:
    """The floor, a shapely polygon, and the tables of walls, of windows at some, and of a filled corner."""
    x, y = map(float, size)
    sides: dict[str, tuple[list[float], list[float]]] = {
        "south": ([-WALL_M, x + WALL_M], [-WALL_M, 0.0]),
        "east": ([x, x + WALL_M], [0.0, y]),
        "north": ([-WALL_M, x + WALL_M], [y, y + WALL_M]),
        "west": ([-WALL_M, 0.0], [0.0, y]),
    }
    names = ["concrete", "plasterboard", "glass", "wood", "sheet_steel"]
    floor, tables = shapely.box(0, 0, x, y), []
    for side, (xs, ys) in sides.items():
        material = str(rng.choice(names, p=[0.35, 0.3, 0.15, 0.1, 0.1]))
        tables.append(_wall(f"wall_{side}", material, 0.0, height_m, xs, ys))
        if material != "glass" and rng.random() < 0.4:
            tables.append(_window(rng, side, size, height_m))
    if rng.random() < 0.2:
        cut = size * rng.uniform(0.25, 0.5, 2)
        low = np.where(rng.random(2) < 0.5, 0.0, size - cut)
        spans = np.stack([low, low + cut], axis=1).tolist()
        tables = [table for table in tables if not table["name"].startswith("window")]
        tables.append(_wall("corner", str(rng.choice(names[:2])), 0.0, height_m, *spans))
        floor = floor.difference(shapely.box(*low, *(low + cut)))
    return floor, tables


def _window(rng: np.random.Generator, side: str, size: FloatArray, height_m: float) -> Table:
    """A pane of glass in front of a part of a wall."""
    span = size[0] if side in ("south", "north") else size[1]
    start, end = np.sort(rng.uniform(0.05, 0.95, 2)) * span
    along, level = [float(start), float(max(end, start + 0.5))], float(size[1] if side == "north" else size[0])
    across = [0.0, 0.02] if side in ("south", "west") else [level - 0.02, level]
    spans = (along, across) if side in ("south", "north") else (across, along)
    top = float(rng.uniform(1.9, height_m - 0.2))
    return _wall(f"window_{side}", "glass", float(rng.uniform(0.0, 1.0)), top, *spans)


def _wall(name: str, material: str, z_min: float, z_max: float, x_m: list[float], y_m: list[float]) -> Table:
    contour = {"type": "rectangle", "x_m": x_m, "y_m": y_m}
    return {
        "name": name,
        "kind": "wall",
        "material": material,
        "z_min_m": z_min,
        "z_max_m": z_max,
        "contour": contour,
    }


def _tx_place(rng: np.random.Generator, floor: Any, free: FreeSpace) -> tuple[FloatArray, float]:
    """Place (xy,) of the TX, mostly near a wall, and the azimuth in rad from it to the middle of the room."""
    rim = floor.buffer(-float(rng.uniform(0.3, 1.0))).exterior
    if rng.random() < 0.75:
        point = np.array(rim.interpolate(float(rng.random()), normalized=True).coords[0])
    else:
        point = free.point(rng)
    middle = np.array(floor.centroid.coords[0])
    return point, float(np.arctan2(*(middle - point)[::-1]))


def _tx_height_m(rng: np.random.Generator, rx_height_m: float, ceiling_m: float, equal: bool) -> float:
    if equal:
        return rx_height_m + float(rng.uniform(-EQUAL_HEIGHTS_M, EQUAL_HEIGHTS_M))
    return float(rng.uniform(rx_height_m + LEAST_DIFFERENCE_M, ceiling_m - 0.3))


def _random_walk(scene: Table, seed: int, step_m: float, height_m: float) -> Scene | None:
    """The scene with a random walk; None where no walk is free."""
    walk = {"n_stops": N_STOPS, "height_m": height_m, "step_m": step_m}
    return _built(scene, seed, walk)


def _built(scene: Table, seed: int, walk: Table) -> Scene | None:
    """The scene with a random walk of some settings; None where it is not free."""
    walk = {"type": "random", "seed": seed, "clearance_m": CLEARANCE_M, **walk}
    try:
        return SceneConfig.model_validate({**scene, "walk": walk}).build(CARRIER_HZ)
    except ValueError:
        return None


def _further_stops(scene: Table, n_stops: int, rng: np.random.Generator) -> list[list[float]]:
    """More stops (stop, xy) of a walk from its last one on, in steps of the same length.

    The first step turns by less than a right angle, where one of some walks does so.
    """
    here, tx_m = np.array(scene["walk"]["waypoints_m"]), np.array(scene["tx"]["position_m"][:2])
    last = here[-1] - here[-2]
    walk = {"n_stops": n_stops + 1, "height_m": scene["walk"]["height_m"], "start_m": here[-1].tolist()}
    turned: list[list[float]] = []
    for _ in range(10 * N_WALKS):
        built = _built(scene, int(rng.integers(2**31)), {**walk, "step_m": float(np.linalg.norm(last))})
        if built is None:
            continue
        stops = built.walk.positions_m()[:, :2]
        if np.linalg.norm(stops - tx_m, axis=1).min() < LEAST_DISTANCE_M:
            continue
        further: list[list[float]] = stops[1:].tolist()
        if (stops[1] - stops[0]) @ last > 0:
            return further
        turned = turned or further
    if not turned:
        raise ValueError(f"{scene['name']}: the walk cannot go on for {n_stops} stops")
    return turned


def _n_seen(scene: Scene) -> int:
    """Stops with a free line of sight inside the TX sector; none where a stop is too near the TX."""
    stops, tx = scene.walk.positions_m(), scene.tx
    offset = (stops - tx.position_m)[:, :2]
    if np.linalg.norm(offset, axis=1).min() < LEAST_DISTANCE_M:
        return 0
    azimuth = np.arctan2(offset[:, 1], offset[:, 0]) - tx.heading_rad
    inside = np.cos(azimuth) > np.cos(np.deg2rad(TX_SECTOR_DEG / 2))
    return int((inside & sees_tx(scene)).sum())


def _draw_campaign(rng: np.random.Generator, room: int, n_elevations: int, hardware: bool) -> CampaignConfig:
    """The campaign of a room: arrays with beams at some elevations, and ideal hardware or that of a real link."""
    columns, tx_beams, rx_beams = ARRAYS[n_elevations]
    array: Table = {"rows": 4, "columns": columns, "beam_elevation_deg": ELEVATIONS_DEG[n_elevations]}
    tx = {**array, "beams_per_panel": tx_beams, "sector_deg": TX_SECTOR_DEG}
    rx = {
        **array,
        "panel_azimuth_deg": [-180.0, -90.0, 0.0, 90.0],
        "beams_per_panel": rx_beams,
        "sector_deg": RX_SECTOR_DEG,
    }
    impairments: Table = {}
    slam: Table = {}
    if hardware:
        bits = int(rng.integers(4, 7))
        tx, rx = {**tx, "phase_bits": bits}, {**rx, "phase_bits": bits}
        impairments = _draw_impairments(rng)
        slam = {"consider": {"pointing_std_deg": MOST_POINTING_DEG}}  # as of a mount that is surveyed
    tables = {
        "name": f"hall_{room:02d}",
        "scene": f"hall_{room:02d}.toml",
        "seed": int(rng.integers(2**31)),
        "clock": {"initial_bias_ns": float(rng.uniform(-60, 60)), "walk_std_ns": 3.3},
        "tx_array": tx,
        "rx_array": rx,
        "impairments": impairments,
        "slam": slam,
    }
    return with_link_levels(CampaignConfig.model_validate(tables))


def _draw_impairments(rng: np.random.Generator) -> Table:
    """Half to all of the impairments of `campus_arena_hardware`; the signs of offsets are random."""
    share = dict(
        zip(("cfo", "noise", "iq", "element", "pointing"), rng.uniform(0.5, 1.0, 5).tolist(), strict=True)
    )
    sign = rng.choice([-1.0, 1.0], 3).tolist()
    return {
        "clock_bias_std_ns": 1.0,
        "clock_drift_ppm": 0.005 * share["cfo"] * sign[0],  # the sweeps of several elevations take longer
        "cfo_hz": 2000.0 * share["cfo"] * sign[1],
        "phase_noise_pair_deg": 5.0 * share["noise"],
        "phase_noise_linewidth_hz": 500.0 * share["noise"],
        "iq_gain_db": 0.5 * share["iq"],
        "iq_phase_deg": 3.0 * share["iq"],
        "adc_bits": 8,
        "adc_clip_db": 9.0,
        "element_gain_std_db": 0.7 * share["element"],
        "element_phase_std_deg": 8.0 * share["element"],
        "coupling_db": -20.0,
        "tx_pointing_offset_deg": MOST_POINTING_DEG * share["pointing"] * sign[2],
        "rx_placement_std_m": 0.03,
        "rx_heading_std_deg": 1.0,
        "beam_phase_std_deg": 60.0,
    }
