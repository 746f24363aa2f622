"""Motions in scene files: a velocity, way-points, or a recorded trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scenes.contours.config import Positive
from scenes.motion.motion import Motion, recorded_motion, steady_motion, waypoint_motion
from scenes.names import FileName
from scenes.record import FloatArray
from scenes.references import find_file
from scenes.toml_config import ConfigModel, Pair, naming_field, read_text
from scenes.walks.tum import parse_tum

TOP_SPEED_M_S = 100.0
MAX_WAYPOINTS = 1000

Speed = Annotated[float, Field(ge=0, le=TOP_SPEED_M_S)]
TurnRate = Annotated[float, Field(ge=-3600, le=3600)]
Start = Annotated[float, Field(ge=0, le=1e6)]
Points = Annotated[tuple[Pair, ...], Field(strict=False, min_length=1, max_length=MAX_WAYPOINTS)]


class VelocityMotionConfig(ConfigModel):
    """A steady motion from the place in the scene, on and on or until a time."""

    type: Literal["velocity"]
    speed_m_s: Speed = Field(0.0, description="horizontal speed")
    heading_deg: Annotated[float, Field(ge=-360, le=360)] = Field(
        0.0, description="azimuth of the motion, counter-clockwise from +x"
    )
    climb_m_s: Annotated[float, Field(ge=-TOP_SPEED_M_S, le=TOP_SPEED_M_S)] = Field(
        0.0, description="vertical speed, up"
    )
    angular_rate_deg_s: TurnRate = Field(0.0, description="turn about the vertical through the middle")
    start_s: Start = Field(0.0, description="time of the campaign when it starts to move")
    duration_s: Positive | None = Field(None, description="how long it moves; without end by default")

    def build(self) -> Motion:
        """The motion."""
        heading = np.deg2rad(self.heading_deg)
        velocity = np.array([self.speed_m_s * np.cos(heading), self.speed_m_s * np.sin(heading), self.climb_m_s])
        end_s = np.inf if self.duration_s is None else self.start_s + self.duration_s
        return steady_motion(velocity, float(np.deg2rad(self.angular_rate_deg_s)), self.start_s, end_s)


class WaypointMotionConfig(ConfigModel):
    """A motion at one speed, from the place in the scene to way-points in turn, straight from each to the next."""

    type: Literal["waypoints"]
    waypoints_m: Points = Field(description="x, y that the middle of the object goes to, after its place")
    speed_m_s: Annotated[float, Field(ge=1e-3, le=TOP_SPEED_M_S)] = Field(description="speed")
    angular_rate_deg_s: TurnRate = Field(0.0, description="turn about the vertical through the middle")
    start_s: Start = Field(0.0, description="time of the campaign when it starts to move")
    loop: bool = Field(False, description="goes back to its place and round again; else it stays at the last")

    def build(self, middle_m: FloatArray) -> Motion:
        """The motion of an object whose middle is at `middle_m` (xyz,)."""
        legs = np.diff(np.vstack([middle_m[:2], self.waypoints_m]), axis=0)
        legs = np.column_stack([legs, np.zeros(len(legs))])
        rate = float(np.deg2rad(self.angular_rate_deg_s))
        return waypoint_motion(legs, self.speed_m_s, rate, self.start_s, loops=self.loop)


class RecordedMotionConfig(ConfigModel):
    """A recorded trajectory (TUM format, `time x y z qx qy qz qw`), relative to its first pose."""

    type: Literal["file"]
    file: FileName = Field(description="trajectory in TUM format beside the scene file")
    start_s: Start = Field(0.0, description="time of the campaign when the first pose is reached")
    loop: bool = Field(False, description="starts again at the end, which must be where it starts")

    def build(self, folder: Path) -> Motion:
        """The smooth motion through the poses of the file."""
        with naming_field(self.file, ": "):
            poses = parse_tum(read_text(find_file(folder, self.file)))
            return recorded_motion(*poses, self.start_s, loops=self.loop)


MotionConfig = Annotated[
    VelocityMotionConfig | WaypointMotionConfig | RecordedMotionConfig, Field(discriminator="type")
]


def build_motion(config: MotionConfig | None, folder: Path, middle_m: FloatArray) -> Motion | None:
    """The motion of an object, mesh or device whose middle is at `middle_m` (xyz,); an error names the field."""
    if config is None:
        return None
    with naming_field("motion"):
        if isinstance(config, WaypointMotionConfig):
            return config.build(middle_m)
        return config.build() if isinstance(config, VelocityMotionConfig) else config.build(folder)
