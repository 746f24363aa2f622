"""What a data set holds of a stop and of a scene: arrays by the name of their field."""

from collections.abc import Iterator

import numpy as np
import scipy.fft
import shapely
from numpy.typing import NDArray

from estimation.channel.beam_power_map import beam_power_map
from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.datasets.config import DatasetConfig
from scenes.pose import wrap_angle
from scenes.random_arena import random_arena
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.signal.link import Link
from sim.truth import Truth

Arrays = dict[str, NDArray[np.generic]]

# Fields with axes, units and meaning: they go into the datasheet.
ABOUT = {
    "samples": "(tx_beam, rx_beam, subcarrier) complex64, sqrt(mW): received samples over pilots",
    "power_map": "(tx_beam, rx_beam) dBm: mean power over the subcarriers",
    "cube": "(tx_beam, rx_beam, delay) dB over the noise, 0 at least: delay profile of every beam pair",
    "paths": "(path, 8) float32: delay with clock bias in ns; azimuth and elevation of departure in the frame of "
    "the TX, of arrival in that of the receiver, in rad; power in dBm between isotropic elements; bounces; 1 for "
    "a line of sight",
    "pose": "(5,) float64: x, y, z in m, heading in rad, clock bias in ns of the receiver",
    "tx_pose": "(4,) float64: x, y, z in m, heading in rad of the TX",
    "contours": "(object, point, 2) float32, m: closed or open contours of all objects",
    "occupancy": "(row, column) uint8: 1 where a cell, counted from the origin along y and x, meets an object, "
    "0 where free, 2 outside of the room",
}
FIELDS_OF = {"poses": ("pose", "tx_pose")}
OF_SCENE = ("contours", "occupancy", "tx_pose")  # stored once per scene


def fields_of(config: DatasetConfig) -> list[str]:
    """The fields of a data set, in the order of `ABOUT`."""
    kept = {field for name in config.keep for field in FIELDS_OF.get(name, (name,))}
    return [field for field in ABOUT if field in kept]


def scene_of(config: DatasetConfig, index: int) -> Scene:
    """The random scene of a number, from a generator of its own."""
    rng = np.random.default_rng([config.seed, 1, index])
    difficulty = float(rng.uniform(*config.scenes.difficulty))
    return random_arena(rng, difficulty, config.scenes.n_stops)


def campaign_config(config: DatasetConfig, index: int = 0) -> CampaignConfig:
    """The settings of the campaign of a scene; raises `ConfigError` where the tables are wrong."""
    seed = int(np.random.default_rng([config.seed, 2, index]).integers(2**62))
    wrong = [name for name in ("name", "scene", "seed") if name in config.campaign]
    if wrong:
        raise ValueError(f"campaign.{wrong[0]}: is that of the data set; leave it out")
    tables = {"name": config.name, "scene": "box_room", "seed": seed, **config.campaign}
    return load_campaign(tables).config


def stops_of(config: DatasetConfig, index: int) -> tuple[Arrays, Iterator[Arrays]]:
    """The arrays of a scene, and those of each of its stops, made one at a time."""
    scene = scene_of(config, index)
    run = CampaignRun(campaign_config(config, index), scene)
    fields = fields_of(config)
    return _of_scene(config, scene, fields), (_of_stop(config, run, truth, fields) for truth in run.truths())


def _of_scene(config: DatasetConfig, scene: Scene, fields: list[str]) -> Arrays:
    found: Arrays = {}
    if "tx_pose" in fields:
        found["tx_pose"] = np.array([*scene.tx.position_m, scene.tx.heading_rad])
    if "contours" in fields:
        share = np.linspace(0, 1, config.contour_points)
        lines = [shapely.get_exterior_ring(one) if one.geom_type == "Polygon" else one for one in _bodies(scene)]
        points = [
            shapely.get_coordinates(shapely.line_interpolate_point(line, share, normalized=True)) for line in lines
        ]
        found["contours"] = np.array(points, np.float32)
    if "occupancy" in fields:
        found["occupancy"] = occupancy(scene, config.grid_cells, config.cell_m)
    return found


def _bodies(scene: Scene) -> list[shapely.Geometry]:
    return [item.contour.body() for item in scene.objects]


def occupancy(scene: Scene, cells: int, cell_m: float) -> NDArray[np.uint8]:
    """Cells (row, column) from the origin along y and x: 1 where they meet an object, 2 outside the room, or 0."""
    edge = cell_m * np.arange(cells)
    x, y = np.meshgrid(edge, edge)
    boxes = shapely.box(x, y, x + cell_m, y + cell_m)
    grid = np.zeros((cells, cells), np.uint8)
    grid[~shapely.intersects(shapely.box(*scene.bounds_m), boxes)] = 2
    for body in _bodies(scene):
        shapely.prepare(body)
        grid[shapely.intersects(body, boxes)] = 1
    return grid


def _of_stop(config: DatasetConfig, run: CampaignRun, truth: Truth, fields: list[str]) -> Arrays:
    found: Arrays = {}
    sweep = run.sweep(truth) if {"samples", "power_map", "cube"} & set(fields) else None
    for field in fields:
        if field in OF_SCENE:
            continue
        if field == "pose":
            place = truth.rx_pose
            found[field] = np.array([*place.position_m, place.heading_rad, 1e9 * truth.clock_bias_s])
        elif field == "paths":
            found[field] = _paths(truth, run.scene, run.link)
        elif sweep is not None and field == "samples":
            found[field] = (sweep.samples * sweep.prs_symbol[:, None, :].conj()).astype(np.complex64)
        elif sweep is not None and field == "power_map":
            found[field] = beam_power_map(sweep).power_dbm.astype(config.dtype)
        elif sweep is not None:
            found[field] = delay_cube(sweep, config.cube_delays).astype(config.dtype)
    return found


def _paths(truth: Truth, scene: Scene, link: Link) -> NDArray[np.float32]:
    paths, power_mw = truth.paths, link.tx_power_mw * truth.paths.power
    order = np.argsort(-power_mw, kind="stable")
    table = np.column_stack(
        [
            1e9 * (paths.delay_s + truth.clock_bias_s),
            wrap_angle(paths.aod_azimuth_rad - scene.tx.heading_rad),
            paths.aod_elevation_rad,
            wrap_angle(paths.aoa_azimuth_rad - truth.rx_pose.heading_rad),
            paths.aoa_elevation_rad,
            10 * np.log10(np.maximum(power_mw, np.finfo(float).tiny)),
            (paths.bounce_kind != 0).sum(axis=1),
            (paths.bounce_kind == 0).all(axis=1),
        ]
    )
    return table[order].astype(np.float32)


def delay_cube(sweep: BeamSweep, n_delays: int) -> FloatArray:
    """Delay profiles (tx_beam, rx_beam, delay) in dB over the noise, 0 dB at least, with a Hann window."""
    n = sweep.samples.shape[2]
    if n_delays > n:
        raise ValueError(f"cube_delays = {n_delays}: the sweep has {n} subcarriers, at most as many delays")
    window = np.hanning(n).astype(np.float32)
    channel = sweep.samples * sweep.prs_symbol[:, None, :].conj() * window
    profile = np.square(np.abs(scipy.fft.ifft(channel, axis=2)[:, :, :n_delays])) * n**2
    noise = sweep.noise_power_mw[:, None] * np.square(window).sum()
    return np.asarray(10 * np.log10(np.maximum(profile / noise, 1.0)))
