"""Walks in scene files: along way-points, along a spline through them, random, or recorded."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from scenes.contours import Contour
from scenes.contours.config import Points, Positive
from scenes.names import Name
from scenes.objects.config import find_file, naming_field
from scenes.toml_config import ConfigModel, Pair, read_text
from scenes.walks.random_walk import random_walk
from scenes.walks.trajectory import RecordedWalk, Walk
from scenes.walks.tum import parse_tum

Quadruple = Annotated[tuple[float, float, float, float], Field(strict=False)]
Count = Annotated[int, Field(ge=1, le=100_000)]


class WaypointWalkConfig(ConfigModel):
    """A walk along way-points. Without `n_stops` they are the stops; without `heading_deg` the RX looks ahead.

    `type = "spline"` follows the smooth curve through the way-points instead of straight lines.
    """

    name: Name = "walk"
    type: Literal["waypoints", "spline"] = "waypoints"
    waypoints_m: Points
    height_m: float
    n_stops: Count | None = None
    heading_deg: float | None = None

    def build(self, folder: Path) -> Walk:
        """The walk, angles in radians; it needs no file of `folder`."""
        waypoints = np.array(self.waypoints_m)
        return Walk(waypoints, self.height_m, _radians(self.heading_deg), self.n_stops, self.type == "spline")


class RandomWalkConfig(ConfigModel):
    """A random walk of equal steps with a seed; it keeps `clearance_m` from all objects and the area boundary.

    `area_m` is (x_min, y_min, x_max, y_max). Its default is the bounds of the scene.
    """

    name: Name = "walk"
    type: Literal["random"]
    seed: Annotated[int, Field(ge=0)]
    n_stops: Count
    height_m: float
    step_m: Positive = 0.5
    clearance_m: Annotated[float, Field(ge=0.01)] = 0.3
    area_m: Quadruple | None = None
    start_m: Pair | None = None
    heading_deg: float | None = None

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


class RecordedWalkConfig(ConfigModel):
    """Stops from a trajectory file (TUM format, `time x y z qx qy qz qw`) in the folder of the scene file."""

    name: Name = "walk"
    type: Literal["tum"]
    file: str

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
    | Annotated[RecordedWalkConfig, Tag("tum")],
    Discriminator(_type_of),
]
