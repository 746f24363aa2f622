"""A flat or curved face with what it explains, and the records of its parts."""

from dataclasses import dataclass, field, replace

import numpy as np

from estimation.shape.fit import ShapeFit
from estimation.shape.kinds.mirror_wall import longer_wall, scattering_wall
from estimation.shape.reflection.association import ONE_GATE
from estimation.shape.reflection.choice import CLASSES, Choice
from estimation.shape.reflection.faces.bends import bent_wall
from estimation.shape.reflection.faces.points import FacePoints
from estimation.shape.reflection.faces.relief import with_relief
from estimation.shape.reflection.faces.scattering import PATH_REACH_M, FaceLine
from estimation.shape.reflection.posterior import Optimum
from scenes.record import BoolArray, FloatArray, IntArray

_CHI2_MEDIAN = 0.455  # of 1 degree of freedom
_PILLAR_STD = 3.0  # deviations of the prior of radii within which pillars are


@dataclass(frozen=True)
class Face:
    """A line with the objects that it replaces and all paths scattered from it."""

    line: FaceLine
    mirror: int  # the object that mirrors paths, -1 for none
    objects: tuple[int, ...]  # that it replaces
    scattered: IntArray  # rows of the data
    gain: float  # of log evidence
    parts_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))  # (part, 2) ends of what is seen of it

    @property
    def class_probability(self) -> list[float]:
        """Probabilities of `CLASSES`: that of a wall by its gain, the others alike."""
        other = float(np.exp(-np.logaddexp(0.0, self.gain)))
        return [1 - other, other / 2, other / 2]

    def covers(self, place_m: FloatArray, reach_m: float = 0.0) -> BoolArray:
        """Whether places (...) along the face are on any of its parts, or at most so far beyond its ends."""
        first, last = self.parts_m[:, 0] - reach_m, self.parts_m[:, 1] + reach_m
        return np.asarray(((place_m[..., None] >= first) & (place_m[..., None] <= last)).any(axis=-1))

    def reaches(self, point_m: FloatArray) -> bool:
        """Whether a point (xy,) is beside the face, between its ends."""
        place_m = point_m @ self.line.tangent
        first, last = self.parts_m.min(initial=np.inf), self.parts_m.max(initial=-np.inf)
        return bool(first - PATH_REACH_M < place_m < last + PATH_REACH_M)

    def is_flush(self, circle: Optimum, receivers_m: FloatArray, relief_m: float) -> bool:
        """Whether a circle touches the face, or the line beyond its ends, from behind: a patch that scatters.

        Seen from the receivers (path, xy), its front is off the face by no more than errors and `relief_m`.
        """
        line, center_m, radius_m = self.line, circle.parameter[:2], float(np.exp(circle.parameter[2]))
        if not (line.mirrors or self.reaches(center_m)):
            return False
        side = np.sign(np.median(line.away_m(receivers_m)))
        place_m, behind_m = center_m @ line.tangent, float(side * line.away_m(center_m))
        slope = np.append(side * line.normal, radius_m)
        variance = slope @ circle.parameter_covariance @ slope + line.variance_m2(place_m, relief_m)
        return bool(line.is_between(place_m) and behind_m < 0 and (behind_m + radius_m) ** 2 < ONE_GATE * variance)


def face_choice(choice: Choice, face: Face, points: FacePoints) -> Choice:
    """The choice for the object that a face mirrors: what the face scatters is evidence for its kinds."""
    with np.errstate(divide="ignore"):
        log = {kind: float(np.log(value)) for kind, value in choice.probability.items()}
    for kind in _kinds(choice, face, points):
        log[kind] += face.gain
    total = np.logaddexp.reduce(list(log.values()))
    probability = {kind: float(np.exp(value - total)) for kind, value in log.items()}
    by_class = {name: sum(probability[kind] for kind in CLASSES[name]) for name in choice.class_probability}
    return replace(choice, probability=probability, class_probability=by_class)


def _kinds(choice: Choice, face: Face, points: FacePoints) -> list[str]:
    """Kinds of objects with such a face: a flat one is that of a straight wall.

    A curved one is that of a curved wall, or the front of a body of the size of a pillar that most of its points
    lie on.
    """
    if face.line.bend is None:
        return ["wall"]
    config = points.config
    largest_m = config.radius_median_m * np.exp(_PILLAR_STD * config.radius_log_std)
    bodies = {kind: choice.fits[kind] for kind in CLASSES["pillar"]}
    fronts = [
        kind
        for kind, fit in bodies.items()
        if fit.is_usable and fit.extent_m < largest_m and points.on_body(fit, face.scattered)
    ]
    return ["arc", *fronts]


def part_walls(
    face: Face, rows: IntArray, points: FacePoints, mirrored: ShapeFit | None = None
) -> list[tuple[ShapeFit, IntArray]]:
    """The records of the parts of a face with their paths, of `rows`, as far as no line of sight passes.

    `mirrored` is the wall fitted to what a flat face mirrors. Without it the relief of all places may be the same.
    """
    line, relief_m, scale, log_evidence = face.line, points.config.wall_relief_m, 1.0, np.nan
    if mirrored is None or mirrored.kind != "wall" or line.bend is not None:
        scale = max(float(np.median(points.squares(line, rows))) / _CHI2_MEDIAN, 1.0)
        covariance = line.covariance * scale + np.diag([0.0, relief_m**2])
    else:
        log_evidence, covariance = mirrored.log_evidence, mirrored.parameter_covariance[:2, :2]
        line = FaceLine(mirrored.parameter[:2], covariance, line.seen_m)
        if len(face.parts_m) == 1 and face.line.is_between(mirrored.parameter[2:]).all():
            places = points.places(line, face.scattered)
            whole = longer_wall(mirrored, places.place_m, places.variance_m2)
            return [(_with_relief(whole, line, face, rows, rows, points), rows)]
    places = points.places(line, rows)
    outside = np.maximum(face.parts_m[:, :1] - places.place_m, places.place_m - face.parts_m[:, 1:])
    is_seen, found = face.line.is_between(places.place_m), []
    part = np.where(is_seen, outside.argmin(axis=0), -1)
    for k in np.unique(part[is_seen]):
        own = places.of(part == k)
        shape = scattering_wall(line.parameter, covariance, own.place_m, own.variance_m2, log_evidence)
        if line.bend is not None:
            shape = bent_wall(shape, line, scale, relief_m)
        elif mirrored is not None:
            shape = _with_relief(shape, line, face, rows, rows[part == k], points)
        found.append((shape, rows[part == k]))
    return found


def _with_relief(
    wall: ShapeFit, line: FaceLine, face: Face, rows: IntArray, own: IntArray, points: FacePoints
) -> ShapeFit:
    """The wall of some paths, `own` among all `rows` of its face, with the relief that those scattered show."""
    mirrored, seen = np.setdiff1d(rows, face.scattered), np.intersect1d(own, face.scattered)
    place_m, away_m = points.places_m(line, seen), line.away_m(points.points.position_m[seen])
    return with_relief(wall, line, points.places_m(line, mirrored), place_m, away_m, points.across_m2(line, seen))
