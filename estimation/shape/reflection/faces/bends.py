"""Curved faces: their depth over a line as a Gaussian process, where that is more evident than no depth."""

from dataclasses import replace
from itertools import product

import numpy as np

from estimation.shape.fit import ShapeFit
from estimation.shape.points.depth_line import DEPTH_STD_M, LENGTH_M, DepthKernel, average, fit_kernel
from estimation.shape.points.recess import DepthPoints
from estimation.shape.reflection.choice import CLASSES
from estimation.shape.reflection.faces.scattering import Bend, FaceLine
from scenes.record import FloatArray

_LEAST_LENGTH_M = 1.0  # of the kernel: shorter ones are the relief
_STRAIGHT_STD_M = 1e-6
_BEYOND_M = 2.0  # how far beyond its points a bend is known
_N_KNOTS = 80
_KNOWN_STD_M = 0.1  # of the depth: what two groups of points have between them may be no face


def fit_bend(place_m: FloatArray, away_m: FloatArray, variance_m2: FloatArray, curvature_std_per_m: float) -> Bend:
    """The bend through points (ip,) at distances from a line, with their variances."""
    middle = place_m.mean()
    points = DepthPoints(place_m - middle, np.zeros_like(place_m), away_m, variance_m2)
    at = np.linspace(points.place_m.min() - _BEYOND_M, points.place_m.max() + _BEYOND_M, _N_KNOTS)
    straight = fit_kernel(points, at, DepthKernel(_STRAIGHT_STD_M, 1.0, False)).log_likelihood
    grid = product(DEPTH_STD_M, LENGTH_M[LENGTH_M > _LEAST_LENGTH_M])
    models = [fit_kernel(points, at, DepthKernel(*each, False, curvature_std_per_m)) for each in grid]
    bent = average(models, np.full(len(models), -np.log(len(models))))
    prior = np.log(CLASSES["wall"]["arc"] / CLASSES["wall"]["wall"])
    return Bend(middle + at, bent.mean_m, bent.variance_m2, float(bent.log_likelihood - straight + prior))


def known_parts(bend: Bend, parts_m: FloatArray) -> FloatArray:
    """The parts (part, 2) of a curved face as far as its depth is known all along; the same if it is nowhere."""
    is_known = np.concatenate([[False], bend.variance_m2 < _KNOWN_STD_M**2, [False]])
    change = np.flatnonzero(np.diff(is_known.astype(int)))
    first, last = bend.place_m[change[::2]], bend.place_m[change[1::2] - 1]
    low, high = np.maximum(parts_m[:, :1], first).ravel(), np.minimum(parts_m[:, 1:], last).ravel()
    found = np.column_stack([low, high])[high > low]
    return found if len(found) else parts_m


def bent_wall(straight: ShapeFit, line: FaceLine, scale: float, relief_m: float) -> ShapeFit:
    """The record of a curved face, from that of the wall on its line; `scale` is that of its variances."""
    first, last = straight.parameter[2:]
    place = np.linspace(first, last, len(straight.contour_m))
    contour = line.depth_m(place)[:, None] * line.normal + place[:, None] * line.tangent
    length = float(np.hypot(*np.diff(contour, axis=0).T).sum())
    std = np.sqrt(scale * line.variance_m2(place, 0.0) + relief_m**2)
    return replace(straight, kind="depth_line", contour_m=contour, std_m=std, extent_m=length)
