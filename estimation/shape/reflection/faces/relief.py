"""Relief of a wall that mirrors: a pane before a wall, or a step, where what the wall scatters shows it.

The mirror law gives the line to a millimetre where it mirrors. The depth over that line is a Gaussian process that
may jump (Matern of order 1/2), or zero; both are alike beforehand, and points of scattered paths weigh them.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from estimation.shape.fit import ShapeFit
from estimation.shape.points.depth_line import DepthKernel, average, fit_kernel
from estimation.shape.points.recess import DepthPoints, DepthPosterior
from estimation.shape.reflection.association import ONE_GATE
from estimation.shape.reflection.faces.scattering import FaceLine
from scenes.record import FloatArray

_DEPTH_STD_M = (0.01, 0.03, 0.1)
_LENGTH_M = (0.3, 1.0, 3.0, 10.0)
_FLAT_STD_M = 1e-6
_KNOWN = (0.0, 0.0)  # standard deviations of offset and slope of the line
_ROUNDS = 2  # of points that are far off


def with_relief(
    wall: ShapeFit, line: FaceLine, mirrored_m: FloatArray, place_m: FloatArray, away_m: FloatArray,
    variance_m2: FloatArray,
) -> ShapeFit:  # fmt: skip
    """The wall with the relief that scattered paths show.

    They met the wall at `place_m` (path,), and `away_m` with `variance_m2` from its line; `mirrored_m` (path,) are
    the places of its mirrored paths, which tell the line.
    """
    if not len(mirrored_m) or not len(place_m):
        return wall
    sure = len(mirrored_m) * line.variance_m2(mirrored_m, 0.0)
    at = wall.contour_m @ line.tangent
    every, depth = np.append(mirrored_m, place_m), np.append(np.zeros(len(mirrored_m)), away_m)
    middle, variance = every.mean(), np.append(sure, variance_m2)
    for _ in range(_ROUNDS):
        seen = DepthPoints(every - middle, np.zeros_like(every), depth, variance)
        found = _averaged(seen, at - middle, line.variance_m2(at, 0.0))
        off = (depth - np.interp(every, at, found.mean_m)) ** 2
        variance = np.maximum(variance, np.where(np.arange(len(every)) < len(mirrored_m), 0.0, off / ONE_GATE))
    contour = wall.contour_m + found.mean_m[:, None] * line.normal
    return replace(wall, contour_m=contour, std_m=np.sqrt(found.variance_m2))


def _averaged(seen: DepthPoints, at_m: FloatArray, line_m2: FloatArray) -> DepthPosterior:
    """The depth at places (sample,): none, with the variance of the line, or that of a process."""
    flat = DepthKernel(_FLAT_STD_M, 1.0, False, line_std=_KNOWN)
    rough = [DepthKernel(*each, True, line_std=_KNOWN) for each in product(_DEPTH_STD_M, _LENGTH_M)]
    share = np.log(np.repeat([1 / 2, 1 / 2 / len(rough)], [1, len(rough)]))
    found = average([fit_kernel(seen, at_m, each) for each in (flat, *rough)], share)
    return found._replace(variance_m2=found.variance_m2 + line_m2)
