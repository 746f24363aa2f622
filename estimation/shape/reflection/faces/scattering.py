"""Scattering places: paths by way of anywhere along the line of a face, about one point, or anywhere at all.

A rough surface scatters from places beside its mirror points. Such paths obey no mirror law: each has a place of
its own, over which its likelihood is integrated.
"""

from typing import NamedTuple, Self

import numpy as np

from estimation.laws.plane import bounce, residual, start_point
from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.association import GATE, ONE_GATE
from estimation.shape.reflection.normals import OrientedPoints
from estimation.shape.reflection.posterior import Optimum
from estimation.shape.reflection.reflections import Reflections
from scenes.record import BoolArray, FloatArray, IntArray

OBJECT_REACH_M, PATH_REACH_M = 1.0, 0.3  # scales of how far beyond its seen part a face has objects, single paths
_SPREADS_M = (0.05, 0.1, 0.2, 0.4, 0.8)  # of the places of an object
_STEPS = 2  # of each path to its place along the face
_LEAST_SHARE = 1e-12  # of the largest variance, in every direction
_PLACE_GATE = 13.82  # chi-square of 2 degrees of freedom at 0.999


class Bend(NamedTuple):
    """Depth of a curved face over its line, between places in order."""

    place_m: FloatArray  # (knot,)
    depth_m: FloatArray  # (knot,)
    variance_m2: FloatArray  # (knot,) of the depth, that of the line included
    gain: float  # of log evidence over a straight face


class FaceLine(NamedTuple):
    """The line of a face, and where along it its paths are likely."""

    parameter: FloatArray  # azimuth of the normal in rad, offset in m
    covariance: FloatArray  # (2, 2)
    seen_m: FloatArray  # first and last place along it
    between_m: tuple[float, float] = (-np.inf, np.inf)  # places where lines of sight pass through it
    bend: Bend | None = None  # of a curved face
    mirrors: bool = False  # the line of a flat wall that mirrors paths

    @property
    def normal(self) -> FloatArray:
        """Unit normal (xy,)."""
        return np.array([np.cos(self.parameter[0]), np.sin(self.parameter[0])])

    @property
    def tangent(self) -> FloatArray:
        """Unit vector (xy,) along the face: the normal turned by +90 deg."""
        return np.array([-self.normal[1], self.normal[0]])

    def depth_m(self, place_m: FloatArray) -> FloatArray:
        """Offset (place,) of the face along its normal, its bend included."""
        bend = 0.0 if self.bend is None else np.interp(place_m, self.bend.place_m, self.bend.depth_m)
        return np.asarray(self.parameter[1] + bend + 0 * place_m)

    def slope(self, place_m: FloatArray) -> FloatArray:
        """Change (place,) of the depth along the face."""
        if self.bend is None:
            return np.asarray(0 * place_m)
        change = np.gradient(self.bend.depth_m, self.bend.place_m)
        return np.asarray(np.interp(place_m, self.bend.place_m, change))

    def away_m(self, point_m: FloatArray) -> FloatArray:
        """Distances (point,) of points from the face along its normal."""
        return np.asarray(point_m @ self.normal - self.depth_m(point_m @ self.tangent))

    def variance_m2(self, place_m: FloatArray, relief_m: float) -> FloatArray:
        """Variance (place,) of the face along its normal, with its relief."""
        if self.bend is not None:
            return np.asarray(np.interp(place_m, self.bend.place_m, self.bend.variance_m2) + relief_m**2)
        lever = np.stack([-place_m, np.ones_like(place_m)], axis=-1)
        return np.asarray(np.einsum("...i,ij,...j", lever, self.covariance, lever) + relief_m**2)

    def log_density(self, place_m: FloatArray, reach_m: float) -> FloatArray:
        """Log density (place,) per m of paths along the face: even over its seen part, less beyond.

        A wall that mirrors may go on far beyond what is seen of it: the tails are those of Cauchy, else normal.
        """
        first, last = self.seen_m
        beyond = np.maximum(np.maximum(first - place_m, place_m - last), 0.0) / reach_m
        if self.mirrors:
            density = -np.log(last - first + np.pi * reach_m) - np.log1p(beyond**2)
        else:
            density = -np.log(last - first + np.sqrt(2 * np.pi) * reach_m) - 0.5 * beyond**2
        return np.asarray(np.where(self.is_between(place_m), density, -np.inf))

    def is_between(self, place_m: FloatArray) -> BoolArray:
        """Whether places (...) are between those where lines of sight pass through the line."""
        return np.asarray((place_m > self.between_m[0]) & (place_m < self.between_m[1]))


class Places(NamedTuple):
    """Where paths met a face."""

    place_m: FloatArray  # (path,) most likely, along the face
    variance_m2: FloatArray  # (path,) of that place
    log_mass: FloatArray  # (path,) logarithm of the likelihood integrated over the place (Laplace)
    square: FloatArray  # (path,) squared Mahalanobis distance at that place

    def of(self, rows: IntArray) -> Self:
        """Those of some of the paths."""
        return type(self)(*(each[rows] for each in self))


def place_evidence(line: FaceLine, places: Places, config: ReflectionConfig) -> FloatArray:
    """Log evidence (path,) of each path as scattered from a place of its own, -inf beyond the gate."""
    evidence = places.log_mass + line.log_density(places.place_m, PATH_REACH_M) + config.log_path_share
    return np.asarray(np.where(places.square < _PLACE_GATE, evidence, -np.inf))


def at_point(line: FaceLine, edge: Optimum, config: ReflectionConfig) -> float:
    """Log evidence of paths that all go by way of one point, their `edge`, as a place of a face."""
    distance, place = float(line.away_m(edge.parameter)), edge.parameter @ line.tangent
    variance = line.variance_m2(place, config.wall_relief_m)
    variance = variance + line.normal @ edge.parameter_covariance @ line.normal
    on_line = line.log_density(place, OBJECT_REACH_M)
    on_line = on_line - 0.5 * (distance**2 / variance + np.log(2 * np.pi * variance))
    return float(edge.log_evidence + np.log(config.area_m2) + on_line)


def along_face(line: FaceLine, places: Places, config: ReflectionConfig) -> tuple[float, BoolArray]:
    """Log evidence of the paths, each by way of a place of its own along a part of the face.

    The places are normal about the middle of the part, with a spread of `_SPREADS_M`, all alike beforehand. Paths
    beyond the gate are ghosts.
    """
    is_near = places.square < GATE
    n = np.count_nonzero(is_near)
    ghosts = (len(is_near) - n) * config.log_ghost_density if n < len(is_near) else 0.0
    if not n:
        return ghosts, is_near
    place, weight = places.place_m[is_near], 1 / (places.variance_m2[is_near] + np.square(_SPREADS_M)[:, None])
    total = weight.sum(axis=1)
    middle = weight @ place / total
    log_part = 0.5 * np.log(weight / (2 * np.pi)).sum(axis=1) + 0.5 * np.log(2 * np.pi / total)
    log_part -= 0.5 * np.sum(weight * (place - middle[:, None]) ** 2, axis=1)
    log_part += line.log_density(middle, OBJECT_REACH_M) - np.log(len(_SPREADS_M))
    inliers = places.log_mass[is_near].sum() + n * config.log_path_share
    return float(np.logaddexp.reduce(log_part) + inliers + ghosts), is_near


def scattering_places(line: FaceLine, data: Reflections, config: ReflectionConfig) -> Places:
    """Where each path met the face."""
    place = start_point(data.tx, data.rx_state, data.measured) @ line.tangent
    step = np.zeros(len(data))
    for _ in range(_STEPS + 1):
        place = place + step
        depth, slope = line.depth_m(place)[:, None], line.slope(place)[:, None]
        predicted = bounce(data.tx, data.rx_state, depth * line.normal + place[:, None] * line.tangent)
        across = predicted.by_landmark @ line.normal
        by_place = predicted.by_landmark @ line.tangent + slope * across
        by_rx, relief = predicted.by_state, line.variance_m2(place, config.wall_relief_m)
        covariance = data.covariance_with_poses(by_rx)
        covariance = _invertible(covariance + relief[:, None, None] * across[:, :, None] * across[:, None, :])
        weight, error = np.linalg.inv(covariance), residual(data.measured, predicted.value)
        information = np.einsum("pa,pab,pb->p", by_place, weight, by_place)
        step = np.einsum("pa,pab,pb->p", by_place, weight, error) / information
    square = np.einsum("pa,pab,pb->p", error, weight, error)
    log_mass = -0.5 * (square + np.linalg.slogdet(covariance)[1] + np.log(information)) - np.log(2 * np.pi)
    log_mass += data.log_diffuse
    return Places(place, 1 / information, log_mass, square)


def _invertible(covariance: FloatArray) -> FloatArray:
    """Covariances (path, 3, 3) that rounding leaves invertible: a point on a device has angles of any error."""
    largest = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
    return np.asarray(covariance + _LEAST_SHARE * largest * np.eye(covariance.shape[1]))


class ScatteringPoints(NamedTuple):
    """Points of paths that met anything anywhere."""

    points: OrientedPoints
    log_mass: FloatArray  # (path,) likelihood integrated over the point (Laplace); -inf for no single bounce

    @classmethod
    def of(cls, points: OrientedPoints, data: Reflections) -> Self:
        """Those of all paths of the data."""
        predicted = bounce(data.tx, data.rx_state, points.position_m)
        by_rx = predicted.by_state
        covariance = _invertible(data.covariance_with_poses(by_rx))
        error = residual(data.measured, predicted.value)
        square = np.einsum("pa,pab,pb->p", error, np.linalg.inv(covariance), error)
        log_size = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(points.covariance_m2)[1]
        log_mass = data.log_diffuse - 0.5 * (square + log_size + np.log(2 * np.pi))
        return cls(points, np.where(square < ONE_GATE, log_mass, -np.inf))

    def about_one(self, rows: IntArray, config: ReflectionConfig) -> float:
        """Log evidence of paths by way of places about one point; ghosts are possible.

        The places are normal in the plane with a spread of `_SPREADS_M`, the point is uniform over the area.
        """
        near = rows[np.isfinite(self.log_mass[rows])]
        ghosts = (len(rows) - len(near)) * config.log_ghost_density if len(near) < len(rows) else 0.0
        if not len(near):
            return ghosts
        spread = np.square(_SPREADS_M)[:, None, None, None] * np.eye(2)
        weight, point = np.linalg.inv(self.points.covariance_m2[near] + spread), self.points.position_m[near]
        total = weight.sum(axis=1)
        middle = np.linalg.solve(total, np.einsum("snab,nb->sa", weight, point)[..., None])[..., 0]
        away = point - middle[:, None]
        log_part = 0.5 * np.linalg.slogdet(weight / (2 * np.pi))[1].sum(axis=1)
        log_part -= 0.5 * np.linalg.slogdet(total / (2 * np.pi))[1]
        log_part -= 0.5 * np.einsum("sna,snab,snb->s", away, weight, away)
        inliers = self.log_mass[near].sum() + len(near) * config.log_path_share
        return float(np.logaddexp.reduce(log_part) - np.log(config.area_m2 * len(_SPREADS_M)) + inliers + ghosts)
