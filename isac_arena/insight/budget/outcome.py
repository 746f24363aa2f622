"""The final errors of a budget, positions and contours. Failures count with the largest error."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from estimation.shape.record import Contours, Shapes
from estimation.slam.record import PoseEstimates, SolveStatus
from isac_arena.scoring.stages.shapes import SEEN_MARGIN_RAD, contour_points_m, seen_samples
from isac_arena.scoring.true_stop import TrueStop
from scenes.contours import Contour
from scenes.record import BoolArray, FloatArray, Record, TextArray, array
from scenes.scene import Scene

POSE_CUTOFF_M = 1.0  # error of a stop without solution, and largest error
SHAPE_CUTOFF_M = 0.5  # error of an object not found, and largest error: the limit of 'found' in the scores


@dataclass(frozen=True)
class FinalErrors(Record):
    """Final errors of one variant of a campaign; a method of contours that does not run has no objects."""

    pose_error_m: FloatArray = array("stop", unit="m", doc="distance of the position to the truth, capped")
    shape_error_m: FloatArray = array(
        "object", unit="m", doc="RMS distance of the paper's contours and the lit outline, capped"
    )
    contour_error_m: FloatArray = array("contour_object", unit="m", doc="the same of our contours")


@dataclass(frozen=True)
class LitObject:
    """An object with enough single bounces: its outline and the true incidence points (point, xy)."""

    name: str
    contour: Contour
    lit_m: FloatArray


@dataclass(frozen=True)
class Outline:
    """An estimated contour: points (sample, xy), and the part (sample,) that incidence points support."""

    points_m: FloatArray
    is_seen: BoolArray
    is_closed: bool

    @property
    def line(self) -> shapely.Geometry:
        """The contour as a line; as a point where all points are one."""
        if np.ptp(self.points_m, axis=0).max() == 0:
            return shapely.Point(self.points_m[0])
        return shapely.LinearRing(self.points_m) if self.is_closed else shapely.LineString(self.points_m)


def lit_objects(scene: Scene, stops: Sequence[TrueStop], least_points: int) -> list[LitObject]:
    """Objects with at least `least_points` significant single bounces over the walk, in scene order."""
    name = np.concatenate([stop.origin.object[stop.significant] for stop in stops])
    vertex = np.concatenate([stop.origin.vertex_m[stop.significant] for stop in stops])
    lit = [LitObject(item.name, item.contour, vertex[name == item.name]) for item in scene.fixtures]
    return [item for item in lit if len(item.lit_m) >= least_points]


def pose_errors(poses: PoseEstimates, stops: Sequence[TrueStop]) -> FloatArray:
    """Error (stop,) of the positions in m, at most `POSE_CUTOFF_M`; that where there is no position."""
    truth = np.array([stop.truth.rx_pose.position_m[:2] for stop in stops]).reshape(-1, 2)
    error = np.linalg.norm(poses.position_m - truth, axis=1)
    error[poses.status == SolveStatus.FAILED] = POSE_CUTOFF_M
    return np.asarray(np.minimum(error, POSE_CUTOFF_M))


def outlines_of_shapes(shapes: Shapes, ip_m: FloatArray, names: TextArray) -> dict[str, list[Outline]]:
    """The paper's contours by their object (cluster,); `ip_m` (ip, xy) are their points."""
    found: dict[str, list[Outline]] = {}
    for row, name in enumerate(names):
        members = np.arctan2(*(ip_m[shapes.label == row] - shapes.center_m[row]).T[::-1])
        seen = seen_samples(shapes.angle_rad, members, SEEN_MARGIN_RAD)
        found.setdefault(str(name), []).append(Outline(contour_points_m(shapes, row), seen, True))
    return found


def outlines_of_contours(contours: Contours, ip_m: FloatArray, names: TextArray) -> dict[str, list[Outline]]:
    """Our contours by their object (contour,); open ones are seen as a whole."""
    found: dict[str, list[Outline]] = {}
    for row, name in enumerate(names):
        points, closed = contours.contour_m[row], bool(contours.is_closed[row])
        seen = np.ones(len(points), bool)
        if closed:
            around = np.arctan2(*(points - contours.center_m[row]).T[::-1])
            members = np.arctan2(*(ip_m[contours.object == row] - contours.center_m[row]).T[::-1])
            seen = seen_samples(around, members, SEEN_MARGIN_RAD)
        found.setdefault(str(name), []).append(Outline(points, seen, closed))
    return found


def object_errors(objects: Sequence[LitObject], outlines: Mapping[str, Sequence[Outline]]) -> FloatArray:
    """Error (object,) of the contours in m, at most `SHAPE_CUTOFF_M`; that where there is no contour."""
    found = [(outlines.get(item.name), item) for item in objects]
    errors = [outline_error_m(lines, item) if lines else np.inf for lines, item in found]
    return np.asarray(np.minimum(np.array(errors, float), SHAPE_CUTOFF_M))


def outline_error_m(outlines: Sequence[Outline], item: LitObject) -> float:
    """Root of the mean of two mean squares: of the seen contours to the true outline, and of lit points to them.

    All contours of an object count together. So the error of a contour that is too short or too long is large, and
    parts of the outline that no path lights do not count.
    """
    seen_m = np.concatenate([one.points_m[one.is_seen] for one in outlines])
    forward = item.contour.signed_distance(seen_m) if len(seen_m) else np.full(1, np.inf)
    back = shapely.distance(shapely.union_all([one.line for one in outlines]), shapely.points(item.lit_m))
    return float(np.sqrt((np.square(forward).mean() + np.square(back).mean()) / 2))
