"""Bounds of a campaign's receiver from the exact paths of its scene."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from rich.table import Table

from estimation.laws.wall import wall_line
from estimation.slam.bounds import StateBound, StopPaths, state_bound, stop_bound, trajectory_covariance
from estimation.slam.space.bounds import SpatialBound, SpatialPaths, spatial_bound
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.config import CampaignConfig
from isac_arena.report.figures.bound import BoundMap
from isac_arena.scoring.metrics.statistics import quantile
from isac_arena.scoring.provenance import path_origin
from isac_arena.scoring.record import PathKind
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray
from scenes.scene import Scene
from sim.propagation.paths import BounceKind, Paths
from sim.propagation.specular.solver import ExactSolver

MOST_CELLS = 400  # of the whole plan by default: some minutes where a place takes half a second
GAP_M = 0.02  # between walls: no wider one counts as open
MIN_TX_DISTANCE_M = 0.1  # no receiver stands closer to the TX
SMOOTHNESS_M = 0.1  # second difference of the walk, per coordinate and stop^2
SAME_LINE_DECIMALS = 6
HORIZONTAL = ("floor", "ceiling")
QUANTITIES = (
    ("position error bound", "position_m", 1.0, "m"),
    ("heading error bound", "heading_rad", 180 / np.pi, "deg"),
    ("clock error bound", "clock_m", 1e9 / SPEED_OF_LIGHT_M_S, "ns"),
)
IP_ROW = "incidence point error bound"


@dataclass(frozen=True)
class BoundInputs:
    """A scene with its solver and the covariance of the parameters of a path."""

    config: CampaignConfig
    scene: Scene
    solver: ExactSolver
    covariance: FloatArray  # (3, 3) in (m, rad, rad)^2; (5, 5) with elevations in space
    in_space: bool  # elevations are estimated


def bound_inputs(campaign: str | Campaign) -> BoundInputs:
    """Scene and settings of a campaign; every path gets the fixed covariance of the campaign's SLAM settings."""
    loaded = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
    config, scene = loaded.config, loaded.scene
    carrier_hz = config.waveform.carrier_ghz * 1e9
    noise, in_space = config.slam.noise, sees_elevations(config)
    angles = (4 if in_space else 2) * [np.deg2rad(noise.angle_std_deg)]
    std = np.array([SPEED_OF_LIGHT_M_S * 1e-9 * noise.delay_std_ns, *angles])
    single = config.propagation.model_copy(update={"max_bounces": min(1, config.propagation.max_bounces)})
    return BoundInputs(config, scene, ExactSolver(scene, carrier_hz, single), np.diag(std**2), in_space)


def sees_elevations(config: CampaignConfig) -> bool:
    """Whether beams of a device have several elevations, and the estimator and SLAM of the campaign use them."""
    arrays = (config.tx_array, config.rx_array)
    several = any(len(set(a.beam_elevation_deg)) * len(set(a.panel_tilt_deg)) > 1 for a in arrays)
    return several and config.channel.method != "power" and config.slam.solves_in_space


@dataclass(frozen=True)
class PlanGrid:
    """Places of a receiver over the plan, and the paths to those that are free."""

    x_m: FloatArray  # (x,)
    y_m: FloatArray  # (y,)
    is_free: BoolArray  # (y, x)
    position_m: FloatArray  # (place, xyz)
    solver: ExactSolver

    @cached_property
    def paths(self) -> list[Paths]:
        """Paths (place,) of the TX of the solver."""
        return self.solver.paths(self.position_m)

    @property
    def step_m(self) -> float:
        """Distance of neighbours."""
        return float(np.diff(max(self.x_m, self.y_m, key=len)).max(initial=0.0))

    @property
    def has_los(self) -> BoolArray:
        """Free places (y, x) that the TX sees: no object stands between them, whatever the beams do."""
        seen = self.is_free.copy()
        seen[self.is_free] = [paths.is_los.any() for paths in self.paths]
        return seen


def plan_grid(prepared: BoundInputs, step_m: float | None = None, n_links: int = 1) -> PlanGrid:
    """A grid over the whole plan, at the height of the walk, by default of at most `MOST_CELLS` square cells.

    With several TX or links they share this number. Free places are not inside objects, and outside of the walls
    only where a path comes.
    """
    scene = prepared.scene
    low, high = np.array(scene.bounds_m[:2]), np.array(scene.bounds_m[2:])
    step_m = step_m or _default_step_m(high - low, max(1, MOST_CELLS // n_links))
    x, y = (np.arange(low[axis] + min(step_m, (high - low)[axis]) / 2, high[axis], step_m) for axis in (0, 1))
    height = np.full((len(y), len(x)), scene.walk.height_m)
    places = np.stack([*np.meshgrid(x, y), height], axis=-1)
    to_tx = np.linalg.norm(places - scene.tx.position_m, axis=-1)
    is_free = scene.is_free(places) & (to_tx >= MIN_TX_DISTANCE_M)
    outside = is_free & ~within_walls(scene, places)
    reached = prepared.solver.paths(places[outside])  # through a wall, or over it
    is_free[outside] = [len(paths) > 0 for paths in reached]
    return PlanGrid(x, y, is_free, places[is_free], prepared.solver)


def within_walls(scene: Scene, places_m: FloatArray) -> BoolArray:
    """Whether walls do not part places (..., xyz), in plan, from every TX and from the walks."""
    walls = [item.contour.body().buffer(GAP_M / 2) for item in scene.fixtures if item.kind == "wall"]
    rooms = shapely.box(*scene.bounds_m).buffer(GAP_M).difference(shapely.union_all(walls))
    txs, walks = (scene.tx, *scene.other_txs.values()), (scene.walk, *scene.other_walks.values())
    known = np.vstack([*(tx.position_m for tx in txs), *(walk.positions_m() for walk in walks)])
    held = [room for room in shapely.get_parts(rooms) if shapely.intersects_xy(room, *known[:, :2].T).any()]
    within = [shapely.intersects_xy(room, places_m[..., 0], places_m[..., 1]) for room in held]
    return np.any(within, axis=0) if within else np.ones(places_m.shape[:-1], bool)


def _default_step_m(size_m: FloatArray, most: int) -> float:
    """The smallest step that divides the longer side of a plan (xy,) and makes at most so many cells."""
    long_m, short_m = float(size_m.max()), float(size_m.min())
    return long_m / next(n for n in range(most, 0, -1) if n * max(1, np.ceil(short_m * n / long_m)) <= most)


def over_plan(prepared: BoundInputs, grid: PlanGrid) -> BoundMap:
    """PEB of a snapshot at every place of a grid, in plan."""
    peb = np.full(grid.is_free.shape, np.nan)
    for at, position, paths in zip(np.argwhere(grid.is_free), grid.position_m, grid.paths, strict=True):
        bound = place_bound(prepared, position, paths)
        peb[tuple(at)] = bound.plan_m if isinstance(bound, SpatialBound) else bound.position_m
    return BoundMap(grid.x_m, grid.y_m, peb, grid.has_los)


def place_bound(prepared: BoundInputs, position_m: FloatArray, paths: Paths) -> StateBound | SpatialBound:
    """Bound of a receiver at a place (3,), in space with elevations."""
    if prepared.in_space:
        state = np.array([*position_m, 0.0, 0.0])
        return spatial_bound(prepared.scene.tx, state, spatial_paths(prepared, paths))[0]
    return stop_bound(prepared.scene.tx, np.array([*position_m[:2], 0.0, 0.0]), stop_paths(prepared, paths))[0]


def along_walk(prepared: BoundInputs) -> Table:
    """Median bounds over the stops that have one: each stop alone, and in the plane the whole walk jointly."""
    table = Table(
        "median over the stops with a bound, fixed errors of paths", "each stop alone", "whole walk", "unit"
    )
    for column in (1, 2):
        table.columns[column].justify = "right"
    for label, alone, together, unit in _in_space(prepared) if prepared.in_space else _in_plane(prepared):
        table.add_row(label, *(f"{v:.3g}" if np.isfinite(v) else "-" for v in (alone, together)), unit)
    return table


def _in_plane(prepared: BoundInputs) -> list[tuple[str, float, float, str]]:
    """Rows: label, median of stops alone and of the whole walk, unit."""
    scene = prepared.scene
    positions = scene.walk.positions_m()
    stops = [stop_paths(prepared, paths) for paths in prepared.solver.paths(positions)]
    states = np.column_stack([positions[:, :2], scene.walk.headings_rad(), np.zeros(len(positions))])
    alone = [stop_bound(scene.tx, state, stop) for state, stop in zip(states, stops, strict=True)]
    shared = share_walls(scene.tx, states, stops)
    together = state_bound(trajectory_covariance(scene.tx, states, shared, SMOOTHNESS_M))
    rows = []
    for label, name, scale, unit in QUANTITIES:
        own = scale * quantile([getattr(limits, name) for limits, _ in alone], 0.5)
        rows.append((label, own, scale * quantile(getattr(together, name), 0.5), unit))
    points = np.concatenate([ips for _, ips in alone])
    rows.append((IP_ROW, float(np.median(points)) if len(points) else np.nan, np.nan, "m"))
    return rows


def _in_space(prepared: BoundInputs) -> list[tuple[str, float, float, str]]:
    """Rows as in `_in_plane` with heights, of stops alone."""
    scene = prepared.scene
    positions = scene.walk.positions_m()
    states = np.column_stack([positions, scene.walk.headings_rad(), np.zeros(len(positions))])
    stops = [spatial_paths(prepared, paths) for paths in prepared.solver.paths(positions)]
    alone = [spatial_bound(scene.tx, state, stop) for state, stop in zip(states, stops, strict=True)]
    rows = []
    for label, name, scale, unit in (*QUANTITIES, ("height error bound", "height_m", 1.0, "m")):
        own = scale * quantile([getattr(limits, name) for limits, _ in alone], 0.5)
        rows.append((label, own, np.nan, unit))
    points = np.concatenate([ips for _, ips in alone])
    rows.append((IP_ROW, float(np.median(points)) if len(points) else np.nan, np.nan, "m"))
    return rows


def spatial_paths(prepared: BoundInputs, paths: Paths) -> SpatialPaths:
    """Line of sight and single bounces, also off floor and ceiling, within the estimator's dynamic range."""
    kind = path_origin(paths).kind
    seen = _within_range(prepared, paths)
    single = np.flatnonzero(seen & (kind == PathKind.SINGLE_BOUNCE))
    passed = (paths.bounce_kind == BounceKind.NONE) | (paths.bounce_kind == BounceKind.REFRACTION)
    point = np.zeros((0, 3))
    if len(single):
        point = paths.vertex_m[single, np.argmin(passed[single], axis=1)]
    has_los = bool(np.any(seen & (kind == PathKind.LOS)))
    covariance = np.tile(prepared.covariance, (len(single), 1, 1))
    return SpatialPaths(point, covariance, prepared.covariance if has_los else None)


def stop_paths(prepared: BoundInputs, paths: Paths) -> StopPaths:
    """Line of sight and single bounces off upright objects within the estimator's dynamic range."""
    origin, seen = path_origin(paths), _within_range(prepared, paths)
    single = seen & (origin.kind == PathKind.SINGLE_BOUNCE) & ~np.isin(origin.object, HORIZONTAL)
    has_los = bool(np.any(seen & (origin.kind == PathKind.LOS)))
    covariance = np.tile(prepared.covariance, (int(single.sum()), 1, 1))
    return StopPaths(
        origin.vertex_m[single],
        covariance,
        np.full(int(single.sum()), -1),
        prepared.covariance if has_los else None,
    )


def _within_range(prepared: BoundInputs, paths: Paths) -> BoolArray:
    """Mask (path,) of the paths within the estimator's dynamic range below the strongest path."""
    if not len(paths):
        return np.zeros(0, bool)
    least = 10 ** (-prepared.config.channel.power.dynamic_range_db / 10)
    return np.asarray(paths.power >= paths.power.max() * least)


def share_walls(tx: Pose, states: FloatArray, stops: list[StopPaths]) -> list[StopPaths]:
    """The same paths with a number for every flat face that reflects two or more of them.

    Faces are distinguished by their line: the sides of a block are different faces, and so are the points of a
    curve.
    """
    lines = np.concatenate([wall_line(tx, state, stop.point_m) for state, stop in zip(states, stops, strict=True)])
    _, face, count = np.unique(lines.round(SAME_LINE_DECIMALS), axis=0, return_inverse=True, return_counts=True)
    wall = np.where(count[face] > 1, face, -1)
    ends = np.cumsum([len(stop.point_m) for stop in stops])[:-1]
    return [replace(stop, wall=part) for stop, part in zip(stops, np.split(wall, ends), strict=True)]
