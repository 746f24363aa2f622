"""Faces: lines and curves whose paths are mirrored by them or scattered from places along them.

A rough wall scatters from places along it. Alone these paths look like edge points or thin pillars in the wall,
and a wall that mirrors nothing to the stops looks like many of them. A face is the line of a wall that mirrors
paths, or a line through at least two objects of which it explains the paths better than they do. It takes those
objects, and the paths of no object that lie on it. It may bend, and it ends where its paths end. What a face
mirrors appears behind it and is no object.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from estimation.distributions import normal_log_density
from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.association import GATE, MIN_GAIN_NAT, ONE_GATE
from estimation.shape.reflection.faces.bends import known_parts
from estimation.shape.reflection.faces.face import Face
from estimation.shape.reflection.faces.parts import seen_parts
from estimation.shape.reflection.faces.points import FacePoints
from estimation.shape.reflection.faces.scattering import (
    OBJECT_REACH_M,
    PATH_REACH_M,
    FaceLine,
    Places,
    ScatteringPoints,
    along_face,
    at_point,
    place_evidence,
)
from estimation.shape.reflection.normals import oriented_points
from estimation.shape.reflection.objects import FoundObject
from estimation.shape.reflection.posterior import Optimum
from estimation.shape.reflection.reflections import Reflections
from scenes.record import FloatArray, IntArray

_MAX_ROUNDS = 8  # in which a face grows
_MIN_OBJECTS = 2  # show the line of a face that mirrors nothing
_IN_FACE_NAT = 3 * MIN_GAIN_NAT  # that a pillar in a face needs over the face: few pillars stand in walls
_LEAST_SHARE = 1e-6  # of ghosts


class FaceSearch:
    """Faces among the objects of a campaign and the paths of no object; `los` are the lines of sight."""

    def __init__(
        self, objects: Sequence[FoundObject], data: Reflections, los: Reflections, config: ReflectionConfig
    ) -> None:
        self.objects, self.data, self.config = objects, data, config
        points = oriented_points(data)
        self.points, scattering = FacePoints(data, points, los, config), ScatteringPoints.of(points, data)
        self._anywhere = np.logaddexp(config.log_window_density, scattering.log_mass - np.log(config.area_m2))
        self._about_one = [scattering.about_one(each.paths, config) for each in objects]
        free = np.setdiff1d(np.arange(len(data)), np.concatenate([np.zeros(0, int), *(e.paths for e in objects)]))
        size = np.linalg.eigvalsh(points.covariance_m2[free])[:, -1]
        self._free = free[size < PATH_REACH_M**2]
        self._left = list(range(len(objects)))
        self._size = np.ones(len(data))  # of the object of each path
        for each in objects:
            self._size[each.paths] = len(each.paths)

    def run(self) -> list[Face]:
        """Faces of the walls that mirror paths, then further ones; pillars that stand in them belong to them."""
        faces = []
        walls = [k for k, each in enumerate(self.objects) if each.kind == "wall" or self._is_arc(each)]
        for k in sorted(walls, key=self._object_gain, reverse=True):
            if k in self._left:
                self._left.remove(k)
                faces.append(self._taken(self._in_parts(self._grown(self._mirror_line(k), k))))
        for face in self._further():
            faces.append(self._taken(face))
        return [self._with_pillars(face) for face in faces]

    def standing(self, faces: Sequence[Face]) -> list[int]:
        """The objects that no face replaces or hides, and that are more than places about a point."""
        replaced = {k for face in faces for k in face.objects}
        found = [
            k
            for k, each in enumerate(self.objects)
            if k not in replaced
            and each.optimum.log_evidence > self._about_one[k] + MIN_GAIN_NAT
            and not self._is_hidden(k, faces)
        ]
        by_gain = sorted(found, key=self._object_gain)
        parts = {k for n, k in enumerate(by_gain) for of in by_gain[n:] if self.objects[of].holds(self.objects[k])}
        return [k for k in found if k not in parts]

    def _is_hidden(self, k: int, faces: Sequence[Face]) -> bool:
        """Whether most points of an object lie behind faces of more evidence: it is a mirror image."""
        rows = self.objects[k].paths
        hidden = np.zeros(len(rows), bool)
        for face in faces:
            mirrored = self._object_gain(face.mirror) if face.mirror >= 0 else 0.0
            if face.gain + mirrored > self._object_gain(k):
                crosses, met = self.points.crossings(face.line, rows)
                hidden |= crosses & face.covers(met).all(axis=0)
        return bool(hidden.mean() > 0.5)

    def _object_gain(self, k: int) -> float:
        """Log evidence of an object over that of the same paths anywhere."""
        each = self.objects[k]
        return each.optimum.log_evidence - len(each.paths) * self.config.log_window_density

    def _is_arc(self, each: FoundObject) -> bool:
        """Whether a circle is rather a curved wall than a pillar, by its radius."""
        if each.kind != "circle":
            return False
        config, log_radius = self.config, each.optimum.parameter[2]
        pillar = normal_log_density(log_radius, np.log(config.radius_median_m), config.radius_log_std)
        bend = normal_log_density(log_radius, np.log(config.bend_radius_median_m), config.bend_radius_log_std)
        return bool(bend > pillar)

    def _mirror_line(self, k: int) -> FaceLine:
        """The line of a wall that mirrors its paths, seen from its first to its last mirror point."""
        found, rows = self.objects[k].optimum, self._mirrored(k)
        if self.objects[k].kind == "circle":
            return self.points.bent(self.points.facing(rows), rows, rows)
        line = FaceLine(found.parameter, found.parameter_covariance, np.zeros(2), mirrors=True)
        place = self.points.places_m(line, rows)
        return line._replace(seen_m=np.array([place.min(), place.max()]))

    def _taken(self, face: Face) -> Face:
        """The face; what it takes is left to no other."""
        self._left = [k for k in self._left if k not in face.objects]
        self._free = np.setdiff1d(self._free, face.scattered)
        return face

    def _further(self) -> Iterator[Face]:
        """Faces without a wall that mirrors paths, the most evident first."""
        others = np.concatenate([self._free, *(self.objects[k].paths for k in self._left)])
        lines = {k: self.points.most_crowded(self.objects[k].paths, others) for k in self._left}
        faces = {k: self._curved(self._grown(line)) for k, line in lines.items()}
        for k in sorted(faces, key=lambda k: -faces[k].gain):
            if k not in self._left:
                continue
            face = self._curved(self._grown(lines[k]))  # others may have taken some of its paths
            if not _shows_line(face):
                continue
            face = self._in_parts(face)
            gain = face.gain + self._log_prior(face.line)
            if len(face.objects) >= _MIN_OBJECTS and gain > MIN_GAIN_NAT:
                yield replace(face, gain=gain)

    def _curved(self, face: Face) -> Face:
        """The face with a bend, grown along it, where its points show one; else as it is."""
        if not _shows_line(face):
            return face
        line = self.points.bent(face.line, face.scattered, np.zeros(0, int))
        if line.bend is None or line.bend.gain < MIN_GAIN_NAT:
            return face
        bent = self._grown(line)
        return bent if bent.gain > face.gain else face

    def _log_prior(self, line: FaceLine) -> float:
        """Log probability of a line and its ends within their covariance, all uniform over the area."""
        within = 0.5 * np.linalg.slogdet(2 * np.pi * line.covariance)[1]
        return float(min(within, 0.0) - np.log(2 * np.pi) - 1.5 * np.log(self.config.area_m2))

    def _grown(self, line: FaceLine, mirror: int = -1) -> Face:
        """The face with all it explains: a longer seen part makes more likely. Scattering lines are fitted."""
        for _ in range(_MAX_ROUNDS):
            line = line._replace(between_m=self.points.openings(line))
            face = self._explained(line, mirror)
            longer, mirrored = face.line, self._mirrored(mirror)
            rows = np.union1d(face.scattered, mirrored)
            if line.bend is not None and len(rows):
                longer = self.points.bent(line, rows, mirrored)
            elif mirror < 0 and len(rows):
                longer = self.points.fitted(line, rows)
            if np.allclose(longer.seen_m, line.seen_m) and np.allclose(longer.parameter, line.parameter):
                break
            line = longer
        return face

    def _explained(self, line: FaceLine, mirror: int) -> Face:
        """The objects and the free paths that the face explains better, seen as far as they reach."""
        near, free = self._near(line)
        rows = np.concatenate([free, *(self.objects[k].paths for k in near)])
        places, first = self.points.places(line, rows), len(free)
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
        n = sum(map(len, scattered)) + (len(self.objects[mirror].paths) if mirror >= 0 else 0)
        alone = self._alone(line, places.of(np.arange(len(free))), free, n)
        gain += float(alone[alone > 0].sum())
        members = np.sort(np.concatenate([*scattered, free[alone > 0]]))
        place = self.points.places_m(line, members)
        if mirror >= 0 or not len(place):
            place = np.append(place, line.seen_m)
        return Face(
            line._replace(seen_m=np.array([place.min(), place.max()])), mirror, tuple(chosen), members, gain
        )

    def _alone(self, line: FaceLine, places: Places, rows: IntArray, n_members: int) -> FloatArray:
        """Log odds (path,) that a path met a face of so many paths rather than anything else.

        Of all paths of no object the face has a share as that of its others.
        """
        share = np.log((n_members + 1) / (len(self._free) + 1))
        return np.asarray(place_evidence(line, places, self.config) + share - self._anywhere[rows])

    def _near(self, line: FaceLine) -> tuple[list[int], IntArray]:
        """The objects that are left with any point near the line, and the free paths whose points are."""
        rows = np.concatenate([self._free, *(self.objects[k].paths for k in self._left)])
        is_near = np.zeros(len(self.data), bool)
        is_near[rows] = self.points.squares(line, rows) < GATE
        return [k for k in self._left if is_near[self.objects[k].paths].any()], self._free[is_near[self._free]]

    def _is_corner(self, line: FaceLine, edge: Optimum) -> bool:
        """Whether an edge point is an end of the face: beyond its seen part, where a line of sight passes."""
        place = float(edge.parameter @ line.tangent)
        first, last = line.seen_m + np.array([PATH_REACH_M, -PATH_REACH_M])
        before, behind = np.abs(np.array(line.between_m) - place) < OBJECT_REACH_M
        return bool((place < first and before) or (place > last and behind))

    def _with_pillars(self, face: Face) -> Face:
        """The face with the pillars that it explains too, and those that do not stand out of it."""
        for k in self._left:
            found, rows = self.objects[k].optimum, self.objects[k].paths
            member = rows[found.inlier > 0.5]
            if self.objects[k].kind != "circle" or not len(member):
                continue
            place = self.points.places_m(face.line, member)
            is_on = face.covers(place, PATH_REACH_M)
            is_like = np.mean(is_on & (self.points.squares(face.line, member) < ONE_GATE)) > 0.5
            is_flush = face.is_flush(found, self.data.rx_state[rows, :2], self.config.wall_relief_m)
            if not (is_like or is_flush):
                continue
            evidence, near = along_face(face.line, self.points.places(face.line, rows), self.config)
            if (is_flush and face.reaches(found.parameter[:2])) or found.log_evidence < evidence + _IN_FACE_NAT:
                scattered = np.union1d(face.scattered, rows[near])
                face = self._taken(replace(face, objects=(*face.objects, k), scattered=scattered))
        return face

    def _in_parts(self, face: Face) -> Face:
        """The face in its seen parts, without the paths between them; a curve beyond a gap is not known."""
        line, mirrored = face.line, self._mirrored(face.mirror)
        rows = np.union1d(face.scattered, mirrored)
        places, is_mirrored = self.points.places(line, rows), np.isin(rows, mirrored)
        weight = self._alone(line, places, rows, len(rows))
        if len(mirrored):
            weight[is_mirrored] = self._object_gain(face.mirror) / len(mirrored)
        against = self._against(line, rows, mirrored)
        face = replace(
            face, parts_m=seen_parts(places.place_m, weight, *against, PATH_REACH_M * np.sqrt(np.pi / 2))
        )
        if line.bend is not None:
            sure = places.place_m[is_mirrored] if len(mirrored) else places.place_m
            parts_m = known_parts(line.bend, face.parts_m)
            on_part = [np.count_nonzero((sure >= first) & (sure <= last)) for first, last in parts_m]
            face = replace(face, parts_m=parts_m[[int(np.argmax(on_part))]])
        scattered = rows[~is_mirrored & face.covers(places.place_m)]
        objects = tuple(k for k in face.objects if np.isin(self.objects[k].paths, scattered).any())
        return replace(face, objects=objects, scattered=scattered)

    def _against(self, line: FaceLine, members: IntArray, mirrored: IntArray) -> tuple[FloatArray, FloatArray]:
        """Places (event,) along a face with evidence against it: paths that cross it, missing mirrored paths.

        A path that crosses a face is a ghost. Either of its ways shows half of that; an object counts as one path.
        """
        others = np.setdiff1d(np.flatnonzero(self._anywhere > self.config.log_window_density), members)
        crosses, met = self.points.crossings(line, others)
        ghost = self.config.log_path_share - np.log(max(self.config.ghost_share, _LEAST_SHARE))
        place, evidence = met[:, crosses].ravel(), np.tile(0.5 * ghost / self._size[others[crosses]], 2)
        if line.bend is not None:
            return place, evidence
        silent = self.points.unmirrored(line, mirrored)
        return np.append(place, silent[0]), np.append(evidence, silent[1])

    def _mirrored(self, k: int) -> IntArray:
        """The paths that an object mirrors; none of no object, -1."""
        if k < 0:
            return np.zeros(0, int)
        member = self.objects[k].optimum.inlier > 0.5
        return self.objects[k].paths[member if member.any() else slice(None)]


def _shows_line(face: Face) -> bool:
    """Whether enough objects, and paths scattered along it, show the line of a face; corners alone do not."""
    return len(face.objects) >= _MIN_OBJECTS and len(face.scattered) > 0
