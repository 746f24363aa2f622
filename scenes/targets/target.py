"""A target on its body: which way it faces, and where its scattering points are."""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray
from scenes.targets.standard import TargetClass, TargetType

SIDES = {"front": (0.5, 0.0, 0.5), "back": (-0.5, 0.0, 0.5), "left": (0.0, 0.5, 0.5), "right": (0.0, -0.5, 0.5)}
SIDES |= {"roof": (0.0, 0.0, 1.0), "bottom": (0.0, 0.0, 0.0)}  # of the box, from the middle of its bottom


@dataclass(frozen=True)
class Target:
    """The standard's class of a target, where its front faces, and whether each lobe is a point of its own.

    `kind` and `rcs_model` are those that the class was chosen by.
    """

    kind: TargetType
    rcs_model: int
    standard: TargetClass
    heading_rad: float
    has_points: bool

    def points_m(self, foot_m: FloatArray) -> FloatArray:
        """Scattering points (point, xyz) of the target whose bottom has its middle at `foot_m` (xyz,).

        One in the middle of the body, or one on the middle of each side, in the order of the lobes.
        """
        sides = [SIDES[lobe.side] for lobe in self.standard.lobes] if self.has_points else [(0.0, 0.0, 0.5)]
        offset = np.array(sides) * self.standard.size_m
        c, s = np.cos(self.heading_rad), np.sin(self.heading_rad)
        turned = offset @ np.array([(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)])
        return np.asarray(foot_m + turned)
