"""Contours as lines to draw, with the edges of their 95 % bands."""

from dataclasses import dataclass

import numpy as np

from estimation.shape.record import Contours, Shapes, normals
from isac_arena.scoring.stages.contours import BAND_SIGMAS as CONTOUR_SIGMAS
from isac_arena.scoring.stages.shapes import BAND_SIGMAS as SHAPE_SIGMAS
from scenes.record import FloatArray


@dataclass(frozen=True)
class Curve:
    """A contour (sample, xy) in m between the inner and the outer edge of its band, sample by sample."""

    points_m: FloatArray
    outer_m: FloatArray
    inner_m: FloatArray
    is_closed: bool


def shape_curve(shapes: Shapes, cluster: int, step: int = 1) -> Curve:
    """The paper's contour of a cluster, every `step`-th sample; its band lies along the radius, at 0 or above."""
    angle = shapes.angle_rad[::step]
    radius, half = shapes.radius_m[cluster, ::step], SHAPE_SIGMAS * shapes.radius_std_m[cluster, ::step]
    unit, center = np.stack([np.cos(angle), np.sin(angle)], axis=1), shapes.center_m[cluster]
    rings = [center + length[:, None] * unit for length in (radius, radius + half, np.maximum(radius - half, 0))]
    return Curve(rings[0], rings[1], rings[2], is_closed=True)


def contour_curve(contours: Contours, row: int) -> Curve:
    """One of our contours; its band lies along the normal, that of a closed one inwards to its middle at most."""
    points, is_closed = contours.contour_m[row], bool(contours.is_closed[row])
    half = (CONTOUR_SIGMAS * contours.std_m[row])[:, None]
    shift = half * normals(points, is_closed=is_closed)
    if not is_closed:
        return Curve(points, points + shift, points - shift, is_closed)
    inwards = contours.center_m[row] - points
    reach = np.linalg.norm(inwards, axis=1, keepdims=True)
    share = np.divide(half, reach, out=np.ones_like(half), where=half < reach)
    return Curve(points, points + shift, points + share * inwards, is_closed)


def line_m(points_m: FloatArray, *, is_closed: bool) -> FloatArray:
    """The points (point, xy) as a line: a closed one has its first point again at the end."""
    return np.concatenate([points_m, points_m[:1]]) if is_closed else points_m
