"""Objects of a scene: prisms over a contour, and the test for overlaps."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
import shapely

from scenes.contours import Contour
from scenes.motion.motion import Motion
from scenes.objects.material import Material
from scenes.record import FloatArray
from scenes.targets.target import Target

ObjectKind = Literal["wall", "pillar", "kiosk", "rail", "box", "polygon", "stairs", "rack", "clutter"]
OBJECT_KINDS: tuple[str, ...] = get_args(ObjectKind)
KIND_COLORS: dict[str, str] = {  # in plans, figures and exported meshes
    "wall": "#4d4d4d",
    "pillar": "#c0392b",
    "kiosk": "#8e44ad",
    "rail": "#b9770e",
    "box": "#d68910",
    "polygon": "#2e86c1",
    "stairs": "#7f8c8d",
    "rack": "#16807a",
    "clutter": "#b03a78",
    "target": "#117a65",
}
OVERLAP_TOLERANCE_M = 1e-3  # solids that penetrate each other more than this overlap
JOINT_TOLERANCE_M = 1e-6


@dataclass(frozen=True)
class SceneObject:
    """A vertical prism: a contour from `z_min_m` to `z_max_m` in one material.

    A closed contour makes a solid, an open contour a thin vertical sheet. Solids of one scene may touch. A solid
    that overlaps another one needs `may_overlap`, for example a pillar inside a room with glass walls. A target
    blocks paths and scatters at its points; its faces reflect nothing.
    """

    name: str
    kind: ObjectKind | Literal["target"]
    contour: Contour
    z_min_m: float
    z_max_m: float
    material: Material
    may_overlap: bool = False
    motion: Motion | None = None
    target: Target | None = None

    def __post_init__(self) -> None:
        if not self.name or self.name in ("floor", "ceiling"):
            raise ValueError(f"name = '{self.name}': must not be empty, 'floor' or 'ceiling'")
        if (self.kind == "target") != (self.target is not None) or self.kind not in (*OBJECT_KINDS, "target"):
            raise ValueError(f"kind = '{self.kind}': must be one of {', '.join(OBJECT_KINDS)}")
        if not self.z_min_m < self.z_max_m:
            raise ValueError(f"z_max_m = {self.z_max_m}: must be greater than z_min_m = {self.z_min_m}")
        if not np.isfinite([self.z_min_m, self.z_max_m]).all():
            raise ValueError(f"z_min_m, z_max_m = {self.z_min_m}, {self.z_max_m}: must be finite")
        _check_joined(self.name, self.contour)

    @property
    def pivot_m(self) -> FloatArray:
        """The point (xyz,) that way-points refer to and that the object turns about: the middle of its plan."""
        middle = self.contour.body().centroid
        return np.array([middle.x, middle.y, self.z_min_m])

    @property
    def bounds_m(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest coordinates, each (xyz,) in m."""
        x_min, y_min, x_max, y_max = self.contour.bounds_m
        return np.array([x_min, y_min, self.z_min_m]), np.array([x_max, y_max, self.z_max_m])


def check_overlaps(objects: Sequence[SceneObject]) -> None:
    """Raise `ValueError` with the names of two solids that overlap, unless one of them has `may_overlap`.

    Touching is allowed. Two solids overlap if their common part is thicker than 1 mm in plan view and in height.
    """
    solids = [item for item in objects if item.contour.closed and not item.may_overlap]
    bodies = np.array([item.contour.body() for item in solids], dtype=object)
    first, second = shapely.STRtree(bodies).query(bodies, predicate="intersects")
    for index, other in zip(first[first < second], second[first < second], strict=True):
        a, b = solids[index], solids[other]
        if min(a.z_max_m, b.z_max_m) - max(a.z_min_m, b.z_min_m) <= OVERLAP_TOLERANCE_M:
            continue
        common = shapely.intersection(bodies[index], bodies[other])
        if not common.buffer(-OVERLAP_TOLERANCE_M / 2).is_empty:
            raise ValueError(
                f"objects '{a.name}' and '{b.name}' overlap in {common.area:.3g} m^2: move one of them,"
                " or set may_overlap = true for one"
            )


def _check_joined(name: str, contour: Contour) -> None:
    """Check that each piece starts where the previous one ends, also the first one of a closed contour."""
    pieces = contour.pieces
    for before, after in pairwise([*pieces, pieces[0]] if contour.closed else pieces):
        end, start = before.point(1.0), after.point(0.0)
        if not np.linalg.norm(end - start) <= JOINT_TOLERANCE_M:
            raise ValueError(
                f"contour of '{name}' is open: a piece ends at {end.tolist()}, the next starts at {start.tolist()}"
            )
