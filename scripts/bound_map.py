"""Bounds of a campaign's receiver from the exact paths of its scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

from estimation.config import CampaignConfig
from estimation.report.bound_figure import BoundMap
from estimation.scoring.provenance import path_origin
from estimation.scoring.record import PathKind
from estimation.slam.bounds import StopPaths, state_bound, stop_bound, trajectory_covariance, wall_line
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray
from scenes.scene import Scene
from scripts.campaign_file import campaign_scene, load_campaign
from sim.exact import ExactSolver
from sim.paths import Paths

MARGIN_M = 3.0  # of the grid round the TX and the walk
MIN_TX_DISTANCE_M = 0.1  # no receiver stands closer to the TX
SMOOTHNESS_M = 0.1  # second difference of the walk, per coordinate and stop^2
SAME_LINE_DECIMALS = 6
HORIZONTAL = ("floor", "ceiling")


@dataclass(frozen=True)
class Prepared:
    """A scene with its solver and the covariance of a path."""

    config: CampaignConfig
    scene: Scene
    solver: ExactSolver
    covariance: FloatArray  # (3, 3) in (m, rad, rad)^2


def prepare(campaign: str) -> Prepared:
    """Scene and settings of a campaign; every path gets the fixed covariance of the campaign's SLAM settings."""
    config, scene_file = load_campaign(campaign)
    carrier_hz = config.waveform.carrier_ghz * 1e9
    scene = campaign_scene(config, scene_file)
    noise = config.slam.noise
    angle = np.deg2rad(noise.angle_std_deg)
    std = np.array([SPEED_OF_LIGHT_M_S * 1e-9 * noise.delay_std_ns, angle, angle])
    single = config.propagation.model_copy(update={"max_bounces": min(1, config.propagation.max_bounces)})
    return Prepared(config, scene, ExactSolver(scene, carrier_hz, single), np.diag(std**2))


@dataclass(frozen=True)
class PlanGrid:
    """Places of a receiver over the plan, with the paths to those that are free."""

    x_m: FloatArray  # (x,)
    y_m: FloatArray  # (y,)
    is_free: BoolArray  # (y, x)
    position_m: FloatArray  # (place, xyz)
    paths: list[Paths]  # (place,)


def plan_grid(prepared: Prepared, step_m: float) -> PlanGrid:
    """A grid round the TX and the walk, at the height of the walk."""
    scene = prepared.scene
    known = np.vstack([scene.walk.positions_m()[:, :2], scene.tx.position_m[:2]])
    low, high = known.min(axis=0) - MARGIN_M, known.max(axis=0) + MARGIN_M
    x, y = (np.arange(low[axis], high[axis] + step_m / 2, step_m) for axis in (0, 1))
    height = np.full((len(y), len(x)), scene.walk.height_m)
    places = np.stack([*np.meshgrid(x, y), height], axis=-1)
    to_tx = np.linalg.norm(places - scene.tx.position_m, axis=-1)
    is_free = (scene.occupied(places) < 0) & (to_tx >= MIN_TX_DISTANCE_M)
    return PlanGrid(x, y, is_free, places[is_free], prepared.solver.paths(places[is_free]))


def over_plan(prepared: Prepared, grid: PlanGrid) -> BoundMap:
    """PEB of a snapshot at every place of a grid."""
    peb, has_los = np.full(grid.is_free.shape, np.nan), np.zeros(grid.is_free.shape, bool)
    for at, position, paths in zip(np.argwhere(grid.is_free), grid.position_m, grid.paths, strict=True):
        stop = stop_paths(prepared, paths)
        limits, _ = stop_bound(prepared.scene.tx, np.array([*position[:2], 0.0, 0.0]), stop)
        peb[tuple(at)], has_los[tuple(at)] = limits.position_m, stop.los_covariance is not None
    return BoundMap(grid.x_m, grid.y_m, peb, has_los)


def along_walk(prepared: Prepared) -> Table:
    """Median bounds over the stops of the walk: each alone, and all together with shared walls."""
    scene = prepared.scene
    positions = scene.walk.positions_m()
    stops = [stop_paths(prepared, paths) for paths in prepared.solver.paths(positions)]
    states = np.column_stack([positions[:, :2], scene.walk.headings_rad(), np.zeros(len(positions))])
    alone = [stop_bound(scene.tx, state, stop) for state, stop in zip(states, stops, strict=True)]
    shared = share_walls(scene.tx, states, stops)
    together = state_bound(trajectory_covariance(scene.tx, states, shared, SMOOTHNESS_M))
    table = Table("median over the walk", "each stop alone", "whole walk", "unit")
    for column in (1, 2):
        table.columns[column].justify = "right"
    for label, name, scale, unit in (
        ("position error bound", "position_m", 1.0, "m"),
        ("heading error bound", "heading_rad", 180 / np.pi, "deg"),
        ("clock error bound", "clock_m", 1e9 / SPEED_OF_LIGHT_M_S, "ns"),
    ):
        values = [scale * np.median([getattr(limits, name) for limits, _ in alone])]
        values.append(scale * np.median(getattr(together, name)))
        table.add_row(label, *(f"{value:.3g}" for value in values), unit)
    points = np.concatenate([ips for _, ips in alone])
    table.add_row("incidence point error bound", f"{np.median(points):.3g}" if len(points) else "-", "", "m")
    return table


def stop_paths(prepared: Prepared, paths: Paths) -> StopPaths:
    """Line of sight and single bounces off upright objects within the estimator's dynamic range."""
    origin = path_origin(paths)
    seen = np.zeros(0, bool)
    if len(paths):
        seen = paths.power >= paths.power.max() * 10 ** (-prepared.config.channel.power.dynamic_range_db / 10)
    single = seen & (origin.kind == PathKind.SINGLE_BOUNCE) & ~np.isin(origin.object, HORIZONTAL)
    has_los = bool(np.any(seen & (origin.kind == PathKind.LOS)))
    covariance = np.tile(prepared.covariance, (int(single.sum()), 1, 1))
    return StopPaths(
        origin.vertex_m[single],
        covariance,
        np.full(int(single.sum()), -1),
        prepared.covariance if has_los else None,
    )


def share_walls(tx: Pose, states: FloatArray, stops: list[StopPaths]) -> list[StopPaths]:
    """The same paths with a number for every flat face that two or more of them reflect off.

    Faces are told apart by their line, so the sides of a block and the places along a curve stay different.
    """
    lines = np.concatenate(
        [wall_line(tx, state, stop.point_m) for state, stop in zip(states, stops, strict=True)]
    )
    _, face, count = np.unique(
        lines.round(SAME_LINE_DECIMALS), axis=0, return_inverse=True, return_counts=True
    )
    wall = np.where(count[face] > 1, face, -1)
    ends = np.cumsum([len(stop.point_m) for stop in stops])[:-1]
    return [replace(stop, wall=part) for stop, part in zip(stops, np.split(wall, ends), strict=True)]
