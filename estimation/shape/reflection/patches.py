"""Rough places of walls: objects that are scattering points of a wall whose mirror reflections show it.

A rough wall scatters from places along it. Their paths obey no mirror law, so they look like edge points or thin
pillars beside or in the wall. An object is a patch of a wall where this explains its paths better than every kind
of object of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.laws.plane import bounce, residual, start_point
from estimation.shape.fit import ShapeFit
from estimation.shape.reflection.association import GATE
from estimation.shape.reflection.choice import Choice
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from scenes.record import FloatArray

_MARGIN_M = 1.0  # added to half the lit length of a wall: the scale of where its patches are
_SPREADS_M = (0.05, 0.1, 0.2, 0.4, 0.8)  # of the places of a patch along the wall
_STEPS = 4  # of each path to its place along the wall


class WallLine(NamedTuple):
    """The line of a wall, and where along it patches are likely: a Cauchy density about its lit part."""

    shape: ShapeFit

    @property
    def normal(self) -> FloatArray:
        """Unit normal (xy,)."""
        azimuth = self.shape.parameter[0]
        return np.array([np.cos(azimuth), np.sin(azimuth)])

    @property
    def tangent(self) -> FloatArray:
        """Unit vector (xy,) along the wall: the normal turned by +90 deg."""
        return np.array([-self.normal[1], self.normal[0]])

    def variance_m2(self, place_m: FloatArray, relief_m: float) -> FloatArray:
        """Variance (place,) of the wall along its normal, with its relief."""
        lever = np.stack([-place_m, np.ones_like(place_m)], axis=-1)
        known = np.einsum("...i,ij,...j", lever, self.shape.parameter_covariance[:2, :2], lever)
        return np.asarray(known + relief_m**2)

    def log_density(self, place_m: FloatArray) -> FloatArray:
        """Log density (place,) per m of patches along the wall."""
        first, last = self.shape.parameter[2:]
        scale = (last - first) / 2 + _MARGIN_M
        away = (place_m - (first + last) / 2) / scale
        return np.asarray(-np.log(np.pi * scale) - np.log1p(away**2))


def wall_patches(
    choices: Sequence[Choice], parts: Sequence[Reflections], config: ReflectionConfig
) -> dict[int, Choice]:
    """The choices of the objects that are patches of walls, with this in the probabilities of their classes."""
    walls = [WallLine(choice.best) for choice in choices if choice.best.kind == "wall"]
    found = {}
    for k, (choice, data) in enumerate(zip(choices, parts, strict=True)):
        if choice.best.kind != "wall" and walls:
            evidence = max(patch_evidence(line, choice.fits, data, config) for line in walls)
            if evidence > choice.log_evidence:
                found[k] = _as_patch(choice, evidence)
    return found


def _as_patch(choice: Choice, evidence: float) -> Choice:
    """The choice with one kind more, of the class of walls."""
    total = float(np.logaddexp(choice.log_evidence, evidence))
    share = float(np.exp(choice.log_evidence - total))
    by_class = {name: share * value for name, value in choice.class_probability.items()}
    by_class["wall"] += 1 - share
    return replace(choice, class_probability=by_class, log_evidence=total)


def patch_evidence(
    line: WallLine, fits: Mapping[str, ShapeFit], data: Reflections, config: ReflectionConfig
) -> float:
    """Log evidence of the paths of one object as scattered by a wall; ghosts are possible, as for any object.

    The larger of two: all paths by way of one point, whose fit as an edge is at hand, and places along a part of
    the wall.
    """
    alone = along_wall(line, data, config)
    edge = fits["edge"]
    if not edge.is_usable:
        return alone
    distance = float(edge.parameter @ line.normal - line.shape.parameter[1])
    place = edge.parameter @ line.tangent
    variance = line.variance_m2(place, config.wall_relief_m)
    variance = variance + line.normal @ edge.parameter_covariance @ line.normal
    on_line = line.log_density(place) - 0.5 * (distance**2 / variance + np.log(2 * np.pi * variance))
    return max(alone, float(edge.log_evidence + np.log(config.area_m2) + on_line))


def along_wall(line: WallLine, data: Reflections, config: ReflectionConfig) -> float:
    """Log evidence of the paths, each by way of a place of its own along a part of the wall.

    The places are normal about the middle of the part, with a spread of `_SPREADS_M`, all alike beforehand. Paths
    beyond the gate are ghosts.
    """
    place, variance, log_mass, square = _places(line, data, config)
    is_near = square < GATE
    n = np.count_nonzero(is_near)
    ghosts = (len(data) - n) * config.log_ghost_density
    if not n:
        return ghosts
    place, weight = place[is_near], 1 / (variance[is_near] + np.square(_SPREADS_M)[:, None])
    total = weight.sum(axis=1)
    middle = weight @ place / total
    log_part = 0.5 * np.log(weight / (2 * np.pi)).sum(axis=1) + 0.5 * np.log(2 * np.pi / total)
    log_part -= 0.5 * np.sum(weight * (place - middle[:, None]) ** 2, axis=1)
    log_part += line.log_density(middle) - np.log(len(_SPREADS_M))
    inliers = log_mass[is_near].sum() + n * config.log_path_share
    return float(np.logaddexp.reduce(log_part) + inliers + ghosts)


def _places(
    line: WallLine, data: Reflections, config: ReflectionConfig
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where each path met the wall.

    Returns
    -------
    place, variance, log_mass, square
        The most likely places (path,) in m along the wall and their variances; the logarithms of the likelihood
        integrated over the place (Laplace); the squared Mahalanobis distances there.
    """
    offset = line.shape.parameter[1]
    place = start_point(data.tx, data.rx_state, data.measured) @ line.tangent
    step = np.zeros(len(data))
    for _ in range(_STEPS + 1):
        place = place + step
        predicted = bounce(data.tx, data.rx_state, offset * line.normal + place[:, None] * line.tangent)
        by_place, across = predicted.by_landmark @ line.tangent, predicted.by_landmark @ line.normal
        by_rx, relief = predicted.by_state, line.variance_m2(place, config.wall_relief_m)
        covariance = data.covariance + by_rx @ data.rx_covariance @ np.swapaxes(by_rx, 1, 2)
        covariance = covariance + relief[:, None, None] * across[:, :, None] * across[:, None, :]
        weight, error = np.linalg.inv(covariance), residual(data.measured, predicted.value)
        information = np.einsum("pa,pab,pb->p", by_place, weight, by_place)
        step = np.einsum("pa,pab,pb->p", by_place, weight, error) / information
    square = np.einsum("pa,pab,pb->p", error, weight, error)
    log_mass = -0.5 * (square + np.linalg.slogdet(covariance)[1] + np.log(information)) - np.log(2 * np.pi)
    return place, 1 / information, log_mass, square
