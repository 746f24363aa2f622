"""Walks in scene files: along way-points or a spline, random, on a grid, drops, given poses, or recorded."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from scenes.contours import Contour
from scenes.contours.config import Points, Positive
from scenes.names import FileName, Name
from scenes.record import FloatArray
from scenes.references import find_file
from scenes.toml_config import ConfigModel, Pair, naming_field, read_text
from scenes.walks.random_walk import grid_places, random_places, random_walk
from scenes.walks.trajectory import RecordedWalk, Walk
from scenes.walks.tum import MAX_STOPS, parse_tum

Quadruple = Annotated[tuple[float, float, float, float], Field(strict=False)]
Count = Annotated[int, Field(ge=1, le=MAX_STOPS)]
PosesTable = Annotated[tuple[Quadruple, ...], Field(strict=False, min_length=1, max_length=MAX_STOPS)]
Speed = Annotated[
    float, Field(ge=0, le=100, description="of a receiver that walks on while it sweeps; 0: it stands")
]
Interval = Annotated[
    float, Field(ge=0, le=1e6, description="from stop to stop of one that stands, no shorter than a sweep")
]
POSE_COLUMNS = ("x_m", "y_m", "z_m", "heading_deg")


class WaypointWalkConfig(ConfigModel):
    """A walk along way-points. Without `n_stops` they are the stops; without `heading_deg` the RX looks ahead.

    `type = "spline"` follows the smooth curve through the way-points instead of straight lines.
    """

    name: Name = Field("walk", description="name of the walk")
    type: Literal["waypoints", "spline"] = Field(
        "waypoints", description="straight lines between the way-points, or a smooth curve through them"
    )
    waypoints_m: Points = Field(description="x, y of the way-points")
    height_m: float = Field(description="height of the RX array at every stop")
    n_stops: Count | None = Field(
        None, description="stops at equal spacing; without it the way-points are the stops"
    )
    heading_deg: float | None = Field(None, description="heading at every stop; without it the RX looks ahead")
    speed_m_s: Speed = 0.0
    stop_interval_s: Interval = 0.0

    def build(self, folder: Path) -> Walk:
        """The walk, angles in radians; it needs no file of `folder`."""
        waypoints = np.array(self.waypoints_m)
        return Walk(waypoints, self.height_m, _radians(self.heading_deg), self.n_stops, self.type == "spline")


class RandomWalkConfig(ConfigModel):
    """A random walk of equal steps with a seed; it keeps `clearance_m` from all objects and the area boundary.

    `area_m` is (x_min, y_min, x_max, y_max). Its default is the bounds of the scene.
    """

    name: Name = Field("walk", description="name of the walk")
    type: Literal["random"]
    seed: Annotated[int, Field(ge=0)] = Field(description="seed of the walk")
    n_stops: Count = Field(description="number of stops")
    height_m: float = Field(description="height of the RX array at every stop")
    step_m: Positive = Field(0.5, description="length of a step")
    clearance_m: Annotated[float, Field(ge=0.01)] = Field(0.3, description="from objects and rim")
    area_m: Quadruple | None = Field(None, description="x_min, y_min, x_max, y_max; by default the bounds")
    start_m: Pair | None = Field(None, description="first stop; random by default")
    heading_deg: float | None = Field(None, description="heading at every stop; without it the RX looks ahead")
    speed_m_s: Speed = 0.0
    stop_interval_s: Interval = 0.0

    def build(self, obstacles: Sequence[Contour], bounds_m: Quadruple) -> Walk:
        """The walk, the same for the same seed and objects."""
        return random_walk(
            np.random.default_rng(self.seed),
            obstacles,
            area_m=self.area_m or bounds_m,
            n_stops=self.n_stops,
            step_m=self.step_m,
            height_m=self.height_m,
            clearance_m=self.clearance_m,
            start_m=None if self.start_m is None else np.array(self.start_m),
            heading_rad=_radians(self.heading_deg),
        )


class GridWalkConfig(ConfigModel):
    """Stops on a regular grid, row by row in alternating direction, where they keep `clearance_m` from everything.

    `area_m` is (x_min, y_min, x_max, y_max). Its default is the bounds of the scene.
    """

    name: Name = Field("walk", description="name of the walk")
    type: Literal["grid"]
    height_m: float = Field(description="height of the RX array at every stop")
    step_m: Positive = Field(1.0, description="distance between neighbours in x and in y")
    clearance_m: Annotated[float, Field(ge=0.01)] = Field(0.3, description="from objects, TX and rim")
    area_m: Quadruple | None = Field(None, description="x_min, y_min, x_max, y_max; by default the bounds")
    heading_deg: float = Field(0.0, description="heading at every stop")
    speed_m_s: Speed = 0.0
    stop_interval_s: Interval = 0.0

    def build(self, obstacles: Sequence[Contour], bounds_m: Quadruple) -> RecordedWalk:
        """The stops, the same for the same objects."""
        places = grid_places(obstacles, self.area_m or bounds_m, self.step_m, self.clearance_m)
        return _at_places(places, self.height_m, np.full(len(places), np.deg2rad(self.heading_deg)))


class DropsWalkConfig(ConfigModel):
    """Stops at random places with random headings, each drawn alone; they keep `clearance_m` from everything.

    `area_m` is (x_min, y_min, x_max, y_max). Its default is the bounds of the scene.
    """

    name: Name = Field("walk", description="name of the walk")
    type: Literal["drops"]
    seed: Annotated[int, Field(ge=0)] = Field(description="seed of places and headings")
    n_stops: Count = Field(description="number of stops")
    height_m: float = Field(description="height of the RX array at every stop")
    clearance_m: Annotated[float, Field(ge=0.01)] = Field(0.3, description="from objects, TX and rim")
    area_m: Quadruple | None = Field(None, description="x_min, y_min, x_max, y_max; by default the bounds")
    heading_deg: float | None = Field(None, description="heading at every stop; random by default")
    speed_m_s: Speed = 0.0
    stop_interval_s: Interval = 0.0

    def build(self, obstacles: Sequence[Contour], bounds_m: Quadruple) -> RecordedWalk:
        """The stops, the same for the same seed and objects."""
        rng = np.random.default_rng(self.seed)
        places = random_places(rng, obstacles, self.area_m or bounds_m, self.n_stops, self.clearance_m)
        heading = rng.uniform(-np.pi, np.pi, self.n_stops)
        if self.heading_deg is not None:
            heading[:] = np.deg2rad(self.heading_deg)
        return _at_places(places, self.height_m, heading)


class PosesWalkConfig(ConfigModel):
    """Stops with a pose each, in the scene file or in a CSV file in its folder: x_m, y_m, z_m, heading_deg."""

    name: Name = Field("walk", description="name of the walk")
    type: Literal["poses"]
    poses: Annotated[tuple[Quadruple, ...], Field(strict=False, min_length=1, max_length=MAX_STOPS)] | None = (
        Field(None, description="[x_m, y_m, z_m, heading_deg] of every stop")
    )
    file: FileName | None = Field(None, description="CSV file of these four columns, names on top or not")
    speed_m_s: Speed = 0.0
    stop_interval_s: Interval = 0.0

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.poses is None) == (self.file is None):
            raise ValueError("poses: give either poses or a file of them")
        return self

    def build(self, folder: Path) -> RecordedWalk:
        """The walk, with one stop per pose."""
        table = np.array(self.poses, float)
        if self.file is not None:
            with naming_field(self.file, ": "):
                table = parse_poses(read_text(find_file(folder, self.file)))
        return RecordedWalk(table[:, :3], np.deg2rad(table[:, 3]))


def parse_poses(text: str) -> FloatArray:
    """Poses (stop, 4) of CSV text: x, y, z in m and heading in deg. Raises `ValueError` that names the line."""
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if not any(cells) or line.startswith("#") or cells == list(POSE_COLUMNS):
            continue
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) != len(POSE_COLUMNS) or not np.isfinite(row).all():
            raise ValueError(f"line {number}: must be four finite numbers, {', '.join(POSE_COLUMNS)}")
        rows.append(row)
        if len(rows) > MAX_STOPS:
            raise ValueError(f"more than {MAX_STOPS} poses")
    if not rows:
        raise ValueError(f"no pose; a line each of {', '.join(POSE_COLUMNS)} is needed")
    return np.array(rows)


def _at_places(places_m: FloatArray, height_m: float, heading_rad: FloatArray) -> RecordedWalk:
    return RecordedWalk(np.column_stack([places_m, np.full(len(places_m), height_m)]), heading_rad)


class RecordedWalkConfig(ConfigModel):
    """Stops from a trajectory file (TUM format, `time x y z qx qy qz qw`) in the folder of the scene file."""

    name: Name = Field("walk", description="name of the walk")
    type: Literal["tum"]
    file: FileName = Field(description="trajectory in TUM format beside the scene file")
    speed_m_s: Speed = 0.0
    stop_interval_s: Interval = 0.0

    def build(self, folder: Path) -> RecordedWalk:
        """The walk, with one stop per line of the file."""
        with naming_field(self.file, ": "):
            _, position_m, heading_rad = parse_tum(read_text(find_file(folder, self.file)))
        return RecordedWalk(position_m, heading_rad)


def _radians(heading_deg: float | None) -> float:
    return np.nan if heading_deg is None else float(np.deg2rad(heading_deg))


def _type_of(walk: Any) -> Any:
    """Type of a walk; the default is way-points."""
    kind = walk.get("type", "waypoints") if isinstance(walk, dict) else getattr(walk, "type", None)
    return "waypoints" if kind == "spline" else kind


WalkConfig = Annotated[
    Annotated[WaypointWalkConfig, Tag("waypoints")]
    | Annotated[RandomWalkConfig, Tag("random")]
    | Annotated[GridWalkConfig, Tag("grid")]
    | Annotated[DropsWalkConfig, Tag("drops")]
    | Annotated[PosesWalkConfig, Tag("poses")]
    | Annotated[RecordedWalkConfig, Tag("tum")],
    Discriminator(_type_of),
]
