"""Flat faces: lines whose paths are mirrored by them or scattered from places along them.

A rough wall scatters from places along it. Alone these paths look like edge points or thin pillars in the wall,
and a wall that mirrors nothing to the stops looks like many of them. A face is the line of a wall that mirrors
paths, or a line through at least two objects of which it explains the paths better than they do. It takes those
objects, and the paths of no object that lie on it. What a face mirrors appears behind it and is no object.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.shape.fit import ShapeFit
from estimation.shape.kinds.mirror_wall import longer_wall, scattering_wall
from estimation.shape.reflection.association import GATE, MIN_GAIN_NAT
from estimation.shape.reflection.choice import CLASSES, Choice
from estimation.shape.reflection.faces.points import FacePoints
from estimation.shape.reflection.faces.scattering import (
    OBJECT_REACH_M,
    ONE_GATE,
    PATH_REACH_M,
    FaceLine,
    Places,
    ScatteringPoints,
    along_face,
    at_point,
    place_evidence,
    scattering_places,
)
from estimation.shape.reflection.normals import oriented_points
from estimation.shape.reflection.objects import FoundObject
from estimation.shape.reflection.posterior import Optimum
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from scenes.record import IntArray

_MAX_ROUNDS = 8  # in which a face grows
_MIN_OBJECTS = 2  # show the line of a face that mirrors nothing
_IN_FACE_NAT = 3 * MIN_GAIN_NAT  # that a pillar in a face needs over the face: few pillars stand in walls
_CHI2_MEDIAN = 0.455  # of 1 degree of freedom


@dataclass(frozen=True)
class Face:
    """A line with the objects that it replaces and all paths scattered from it."""

    line: FaceLine
    mirror: int  # the object that mirrors paths, -1 for none
    objects: tuple[int, ...]  # that it replaces
    scattered: IntArray  # rows of the data
    gain: float  # of log evidence

    @property
    def class_probability(self) -> list[float]:
        """Probabilities of `CLASSES`: that of a wall by its gain, the others alike."""
        other = float(np.exp(-np.logaddexp(0.0, self.gain)))
        return [1 - other, other / 2, other / 2]


def face_choice(choice: Choice, face: Face) -> Choice:
    """The choice for the object that a face mirrors: what the face scatters is evidence for a straight wall."""
    if not choice.fits["wall"].is_usable:
        return choice
    with np.errstate(divide="ignore"):
        log = {kind: float(np.log(value)) for kind, value in choice.probability.items()}
    log["wall"] += face.gain
    total = np.logaddexp.reduce(list(log.values()))
    probability = {kind: float(np.exp(value - total)) for kind, value in log.items()}
    by_class = {name: sum(probability[kind] for kind in CLASSES[name]) for name in choice.class_probability}
    return replace(choice, probability=probability, class_probability=by_class)


class FaceSearch:
    """Faces among the objects of a campaign and the paths of no object; `los` are the lines of sight."""

    def __init__(
        self, objects: Sequence[FoundObject], data: Reflections, los: Reflections, config: ReflectionConfig
    ) -> None:
        self.objects, self.data, self.config = objects, data, config
        points = oriented_points(data)
        self._points, scattering = FacePoints(data, points, los, config), ScatteringPoints.of(points, data)
        self._anywhere = np.logaddexp(config.log_window_density, scattering.log_mass - np.log(config.area_m2))
        self._about_one = [scattering.about_one(each.paths, config) for each in objects]
        free = np.setdiff1d(np.arange(len(data)), np.concatenate([np.zeros(0, int), *(e.paths for e in objects)]))
        size = np.linalg.eigvalsh(points.covariance_m2[free])[:, -1]
        self._free = free[size < PATH_REACH_M**2]
        self._left = list(range(len(objects)))

    def run(self) -> list[Face]:
        """Faces of the walls that mirror paths, then further ones; pillars that stand in them belong to them."""
        faces = []
        walls = [k for k, each in enumerate(self.objects) if each.kind == "wall"]
        for k in sorted(walls, key=self._object_gain, reverse=True):
            if k in self._left:
                self._left.remove(k)
                faces.append(self._taken(self._grown(self._mirror_line(k), k)))
        for face in self._further():
            faces.append(self._taken(face))
        return [self._with_pillars(face) for face in faces]

    def standing(self, faces: Sequence[Face]) -> list[int]:
        """The objects that no face replaces or hides, and that are more than places about a point."""
        replaced = {k for face in faces for k in face.objects}
        return [
            k
            for k, each in enumerate(self.objects)
            if k not in replaced
            and each.optimum.log_evidence > self._about_one[k] + MIN_GAIN_NAT
            and not self._is_hidden(k, faces)
        ]

    def shape(self, face: Face) -> ShapeFit:
        """The record of a face that mirrors no path. Its places may have their relief in common."""
        places = self._places(face.line, face.scattered)
        square = self._points.squares(face.line, face.scattered)
        covariance = face.line.covariance * max(float(np.median(square)) / _CHI2_MEDIAN, 1.0)
        covariance[1, 1] += self.config.wall_relief_m**2
        return scattering_wall(face.line.parameter, covariance, places.place_m, places.variance_m2)

    def extended(self, shape: ShapeFit, face: Face) -> ShapeFit:
        """The record of the wall that a face mirrors, seen where it scatters as well."""
        line = FaceLine(shape.parameter[:2], shape.parameter_covariance[:2, :2], face.line.seen_m)
        places = self._places(line, face.scattered)
        return longer_wall(shape, places.place_m, places.variance_m2)

    def _places(self, line: FaceLine, rows: IntArray) -> Places:
        return scattering_places(line, self.data.take("path", rows), self.config)

    def _is_hidden(self, k: int, faces: Sequence[Face]) -> bool:
        """Whether most points of an object lie behind faces of more evidence: it is a mirror image."""
        rows = self.objects[k].paths
        hidden = np.zeros(len(rows), bool)
        for face in faces:
            mirrored = self._object_gain(face.mirror) if face.mirror >= 0 else 0.0
            if face.gain + mirrored > self._object_gain(k):
                hidden |= self._points.behind(face.line, rows)
        return bool(hidden.mean() > 0.5)

    def _object_gain(self, k: int) -> float:
        """Log evidence of an object over that of the same paths anywhere."""
        each = self.objects[k]
        return each.optimum.log_evidence - len(each.paths) * self.config.log_window_density

    def _mirror_line(self, k: int) -> FaceLine:
        """The line of a wall that mirrors its paths, seen from its first to its last mirror point."""
        found, rows = self.objects[k].optimum, self.objects[k].paths
        member = found.inlier > 0.5
        line = FaceLine(found.parameter, found.parameter_covariance, np.zeros(2))
        place = self._points.places_m(line, rows[member] if member.any() else rows)
        return line._replace(seen_m=np.array([place.min(), place.max()]))

    def _taken(self, face: Face) -> Face:
        """The face; what it takes is left to no other."""
        self._left = [k for k in self._left if k not in face.objects]
        self._free = np.setdiff1d(self._free, face.scattered)
        return face

    def _further(self) -> Iterator[Face]:
        """Faces without a wall that mirrors paths, the most evident first."""
        others = np.concatenate([self._free, *(self.objects[k].paths for k in self._left)])
        lines = {k: self._points.most_crowded(self.objects[k].paths, others) for k in self._left}
        faces = {k: self._grown(line) for k, line in lines.items()}
        for k in sorted(faces, key=lambda k: -faces[k].gain):
            if k not in self._left:
                continue
            face = self._grown(lines[k])  # others may have taken some of its paths
            gain = face.gain + self._log_prior(face.line)
            if len(face.objects) >= _MIN_OBJECTS and gain > MIN_GAIN_NAT:
                yield replace(face, gain=gain)

    def _log_prior(self, line: FaceLine) -> float:
        """Log probability of a line and its ends within their covariance, all uniform over the area."""
        within = 0.5 * np.linalg.slogdet(2 * np.pi * line.covariance)[1]
        return float(min(within, 0.0) - np.log(2 * np.pi) - 1.5 * np.log(self.config.area_m2))

    def _grown(self, line: FaceLine, mirror: int = -1) -> Face:
        """The face with all it explains: a longer seen part makes more likely. Scattering lines are fitted."""
        for _ in range(_MAX_ROUNDS):
            line = line._replace(between_m=self._points.openings(line))
            face = self._explained(line, mirror)
            longer = face.line
            if mirror < 0 and len(face.scattered):
                longer = self._points.fitted(line, face.scattered)
            if np.allclose(longer.seen_m, line.seen_m) and np.allclose(longer.parameter, line.parameter):
                break
            line = longer
        return face

    def _explained(self, line: FaceLine, mirror: int) -> Face:
        """The objects and the free paths that the face explains better, seen as far as they reach."""
        near, free = self._near(line)
        rows = np.concatenate([free, *(self.objects[k].paths for k in near)])
        places, first = self._places(line, rows), len(free)
        gain, scattered, chosen = 0.0, [np.zeros(0, int)], []
        for k in near:
            each, end = self.objects[k], first + len(self.objects[k].paths)
            evidence, is_on = along_face(line, places.of(np.arange(first, end)), self.config)
            if each.kind == "edge" and not self._is_corner(line, each.optimum):
                evidence = max(evidence, at_point(line, each.optimum, self.config))
            more = evidence - max(each.optimum.log_evidence, self._about_one[k])
            if more > 0:
                gain += more
                chosen.append(k)
                scattered.append(each.paths[is_on])
            first = end
        # Of all paths of no object the face has a share as that of its others.
        n = sum(map(len, scattered)) + (len(self.objects[mirror].paths) if mirror >= 0 else 0)
        share = np.log((n + 1) / (len(self._free) + 1))
        alone = place_evidence(line, places.of(np.arange(len(free))), self.config) + share - self._anywhere[free]
        gain += float(alone[alone > 0].sum())
        members = np.sort(np.concatenate([*scattered, free[alone > 0]]))
        place = self._points.places_m(line, members)
        if mirror >= 0 or not len(place):
            place = np.append(place, line.seen_m)
        return Face(
            line._replace(seen_m=np.array([place.min(), place.max()])), mirror, tuple(chosen), members, gain
        )

    def _near(self, line: FaceLine) -> tuple[list[int], IntArray]:
        """The objects that are left with any point near the line, and the free paths whose points are."""
        rows = np.concatenate([self._free, *(self.objects[k].paths for k in self._left)])
        is_near = np.zeros(len(self.data), bool)
        is_near[rows] = self._points.squares(line, rows) < GATE
        return [k for k in self._left if is_near[self.objects[k].paths].any()], self._free[is_near[self._free]]

    def _is_corner(self, line: FaceLine, edge: Optimum) -> bool:
        """Whether an edge point is an end of the face: beyond its seen part, where a line of sight passes."""
        place = float(edge.parameter @ line.tangent)
        first, last = line.seen_m + np.array([PATH_REACH_M, -PATH_REACH_M])
        before, behind = np.abs(np.array(line.between_m) - place) < OBJECT_REACH_M
        return bool((place < first and before) or (place > last and behind))

    def _with_pillars(self, face: Face) -> Face:
        """The face with the pillars that stand in it: most of their points are on it, and it explains them too."""
        for k in self._left:
            found, rows = self.objects[k].optimum, self.objects[k].paths
            member = rows[found.inlier > 0.5]
            if self.objects[k].kind != "circle" or not len(member):
                continue
            place = self._points.places_m(face.line, member)
            is_on = (place >= face.line.seen_m[0]) & (place <= face.line.seen_m[1])
            if np.mean(is_on & (self._points.squares(face.line, member) < ONE_GATE)) <= 0.5:
                continue
            evidence, near = along_face(face.line, self._places(face.line, rows), self.config)
            if found.log_evidence < evidence + _IN_FACE_NAT:
                scattered = np.union1d(face.scattered, rows[near])
                face = self._taken(replace(face, objects=(*face.objects, k), scattered=scattered))
        return face
