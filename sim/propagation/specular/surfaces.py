"""The reflecting surfaces of a scene as flat tables: vertical faces, curved walls, floor, ceiling and lids.

The faces of a closed solid reflect on their outer side. The sheet of an open wall reflects on both sides, so it is
listed twice with opposite normals.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import shapely

from scenes.contours.pieces import ArcPiece, EllipsePiece, LinePiece, Piece, SplinePiece
from scenes.record import BoolArray, FloatArray, IntArray, Record, array
from scenes.scene import Scene, SceneObject
from sim.propagation.specular.curves import MAX_SEGMENTS, Curves, conic_curves, cubic_curves, joined_curves

LID_SAGITTA_M = 1e-6  # the outline of a lid stays this close to the contour
HERMITE_ERROR_M = 1e-11  # largest error of the cubics that replace a smooth piece, if it is no arc and no cubic


@dataclass(frozen=True)
class Faces(Record):
    """Flat vertical faces. The normal is that of the lit side, to the right of start -> end."""

    start_m: FloatArray = array("face", "xy", unit="m", doc="one end in plan view")
    end_m: FloatArray = array("face", "xy", unit="m", doc="other end")
    normal: FloatArray = array("face", "xy", doc="unit normal of the lit side")
    surface: IntArray = array("face", dtype=int, doc="index of the object")

    def height_over(self, face: IntArray, point_m: FloatArray) -> FloatArray:
        """Signed distance (...) in m of points (..., xy) to faces (...), positive on the lit side."""
        normal, start = self.normal[face], self.start_m[face]
        x, y = point_m[..., 0] - start[..., 0], point_m[..., 1] - start[..., 1]
        return np.asarray(normal[..., 0] * x + normal[..., 1] * y)

    def mirror(self, face: IntArray, point_m: FloatArray) -> FloatArray:
        """Images (..., xy) of points (..., xy) in the planes of faces (...)."""
        return np.asarray(point_m - 2 * self.height_over(face, point_m)[..., None] * self.normal[face])


@dataclass(frozen=True)
class HorizontalFace:
    """A horizontal face: floor, ceiling, or the lid of a closed solid; `facing` +1 looks up, -1 down."""

    z_m: float
    facing: int
    surface: int
    outline: shapely.Polygon

    def holds(self, xy_m: FloatArray) -> BoolArray:
        """Whether points (point, xy) lie over the face."""
        return np.asarray(shapely.contains_xy(self.outline, xy_m[:, 0], xy_m[:, 1]))


@dataclass(frozen=True)
class Surfaces:
    """All reflecting surfaces of a scene. `z_range_m` (object, 2) holds the lower and upper end of the objects."""

    faces: Faces
    curves: Curves
    horizontal_faces: tuple[HorizontalFace, ...]
    z_range_m: FloatArray


def reflecting_surfaces(scene: Scene) -> Surfaces:
    """Tables of all reflecting surfaces, targets are none; the objects' indices are those of `surface_names`."""
    flat: list[tuple[FloatArray, FloatArray, int]] = []
    curved = []
    for index, item in enumerate(scene.objects):
        for piece in () if item.target else item.contour.pieces:
            if isinstance(piece, LinePiece):
                flat.append((piece.start_m, piece.end_m, index))
                if not item.contour.closed:
                    flat.append((piece.end_m, piece.start_m, index))
            else:
                curved += curves_of_piece(piece, index, closed=item.contour.closed)
    z_range = np.array([(item.z_min_m, item.z_max_m) for item in scene.objects]).reshape(-1, 2)
    targets = [index for index, item in enumerate(scene.objects) if item.target]
    level = tuple(face for face in horizontal_faces(scene) if face.surface not in targets)
    return Surfaces(_faces(flat), joined_curves(curved), level, z_range)


def horizontal_faces(scene: Scene) -> Iterable[HorizontalFace]:
    """Floor, ceiling, then the lids of the solids that lie between them."""
    names = [name for name in ("floor", "ceiling") if getattr(scene, name) is not None]
    x_min, y_min, x_max, y_max = scene.bounds_m
    for offset, name in enumerate(names):
        plane = getattr(scene, name)
        outline = shapely.box(x_min, y_min, x_max, y_max)
        yield HorizontalFace(plane.z_m, 1 if name == "floor" else -1, len(scene.objects) + offset, outline)
    low = scene.floor.z_m if scene.floor else -np.inf
    high = scene.ceiling.z_m if scene.ceiling else np.inf
    for index, item in enumerate(scene.objects):
        if item.contour.closed:
            yield from _lids(item, index, low, high)


def _lids(item: SceneObject, index: int, low: float, high: float) -> Iterable[HorizontalFace]:
    outline = shapely.Polygon(item.contour.vertices(LID_SAGITTA_M))
    shapely.prepare(outline)
    for z_m, facing in ((item.z_min_m, -1), (item.z_max_m, 1)):
        if low < z_m < high:
            yield HorizontalFace(z_m, facing, index, outline)


def _faces(flat: list[tuple[FloatArray, FloatArray, int]]) -> Faces:
    start = np.array([one[0] for one in flat]).reshape(-1, 2)
    end = np.array([one[1] for one in flat]).reshape(-1, 2)
    along = end - start
    normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(along[:, 0], along[:, 1])[:, None]
    return Faces(start, end, normal, np.array([one[2] for one in flat], int))


def curves_of_piece(piece: Piece, surface: int, *, closed: bool, max_segments: int = MAX_SEGMENTS) -> list[Curves]:
    """The curves of one piece: lit from outside, and for an open contour also from the other side."""
    if isinstance(piece, ArcPiece):
        axes = piece.radius_m * np.eye(2)
        make = conic_curves(piece.center_m, axes[0], axes[1], piece.start_rad, piece.sweep_rad)
    elif isinstance(piece, EllipsePiece):
        make = conic_curves(piece.center_m, piece.axes_m[0], piece.axes_m[1], 0.0, 2 * np.pi)
    else:
        make = cubic_curves(piece, _knots(piece), max_segments)
    sides = (1.0,) if closed else (1.0, -1.0)
    return [curve for side in sides for curve in make(surface, side)]


def _knots(piece: Piece) -> FloatArray:
    """Parameters t between which the piece is a cubic polynomial (exact for a spline)."""
    if isinstance(piece, SplinePiece):
        return piece.breaks
    n = 16
    while _hermite_error(piece, np.linspace(0, 1, n + 1)) > HERMITE_ERROR_M and n < 4096:
        n *= 2
    return np.linspace(0, 1, n + 1)


def _hermite_error(piece: Piece, knots: FloatArray) -> float:
    """Largest distance between the piece and its Hermite interpolation, in the middle of the intervals."""
    step = np.diff(knots)[:, None]
    point, slope = piece.point(knots), piece.derivative(knots)
    middle = (point[:-1] + point[1:]) / 2 + step * (slope[:-1] - slope[1:]) / 8
    return float(np.abs(middle - piece.point((knots[:-1] + knots[1:]) / 2)).max())
