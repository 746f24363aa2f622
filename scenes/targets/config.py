"""Targets in scene files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scenes.contours import rectangle
from scenes.motion.config import MotionConfig, build_motion
from scenes.motion.motion import AT_REST
from scenes.motion.placed import moved_contour
from scenes.names import Name
from scenes.objects.material import Material
from scenes.objects.scene_object import SceneObject
from scenes.targets.standard import ScatteringPoints, TargetType, target_class
from scenes.targets.target import Target
from scenes.toml_config import ConfigModel, Pair, naming_field

ABSORBER = Material("target", relative_permittivity=1.0, conductivity_s_m=0.5, thickness_m=0.2)


class TargetConfig(ConfigModel):
    """A target of TR 38.901 clause 7.9: a box of the standard's size that blocks, and points that scatter."""

    name: Name = Field(description="name of the target")
    type: TargetType = Field(
        description="adult, child, agv_small, agv_large, vehicle, truck, uav_small or uav_large"
    )
    position_m: Pair = Field(description="x, y of the middle of its plan")
    z_m: float = Field(0.0, description="height of its lower end")
    heading_deg: Annotated[float, Field(ge=-360, le=360)] = Field(0.0, description="azimuth that its front faces")
    rcs_model: Literal[1, 2] | None = Field(
        None,
        description="1: the same from everywhere (people, small UAVs); 2: over angle; by default 2 where there is",
    )
    scattering_points: ScatteringPoints = Field(
        "single", description="one point, or one per side (AGVs and vehicles)"
    )
    motion: MotionConfig | None = Field(None, description="how the target moves; by default it stands")

    def build(self, folder: Path = Path()) -> SceneObject:
        """The target as an object that does not reflect. A `ValueError` names the field."""
        with naming_field(f"targets[{self.name}]"):
            model = self.rcs_model or (1 if self.type == "uav_small" else 2)
            standard = target_class(self.type, model, self.scattering_points)
            length, width, height = standard.size_m
            turn = float(np.deg2rad(self.heading_deg))
            box = rectangle((-length / 2, length / 2), (-width / 2, width / 2))
            state = replace(AT_REST, shift_m=np.array([*self.position_m, 0.0]), turn_rad=turn)
            item = SceneObject(
                self.name,
                "target",
                moved_contour(box, np.zeros(2), state),
                self.z_m,
                self.z_m + height,
                ABSORBER,
                target=Target(self.type, model, standard, turn, self.scattering_points == "multiple"),
            )
            return replace(item, motion=build_motion(self.motion, folder, item.pivot_m))
