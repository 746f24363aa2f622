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
_MOST_POINTS = 150  # of either kind: more are averaged along the wall


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
    at, n_mirrored = wall.contour_m @ line.tangent, len(mirrored_m)
    sure = _thinned(mirrored_m, np.zeros(n_mirrored), n_mirrored * line.variance_m2(mirrored_m, 0.0))
    seen = _thinned(place_m, away_m, variance_m2)
    for _ in range(_ROUNDS):
        every = np.concatenate([sure, seen], axis=1)
        found = _averaged(every, at, line.variance_m2(at, 0.0))
        off_m = seen[1] - np.interp(seen[0], at, found.mean_m)
        seen[2] = np.maximum(seen[2], off_m**2 / ONE_GATE)
    contour = wall.contour_m + found.mean_m[:, None] * line.normal
    return replace(wall, contour_m=contour, std_m=np.sqrt(found.variance_m2))


def _thinned(place_m: FloatArray, depth_m: FloatArray, variance_m2: FloatArray) -> FloatArray:
    """Places, depths and variances (3, ip) of points; of many, neighbours along the wall are averaged."""
    groups = np.array_split(np.argsort(place_m, kind="stable"), min(len(place_m), _MOST_POINTS))
    weight = 1 / variance_m2
    total = np.array([weight[rows].sum() for rows in groups])
    means = [[weight[rows] @ value[rows] for rows in groups] / total for value in (place_m, depth_m)]
    return np.array([*means, 1 / total])


def _averaged(points: FloatArray, at_m: FloatArray, line_m2: FloatArray) -> DepthPosterior:
    """The depth at places (sample,) from points (3, ip): none, or a process, and the variance of the line."""
    place_m, depth_m, variance_m2 = points
    seen = DepthPoints(place_m, np.zeros_like(place_m), depth_m, variance_m2)
    flat = DepthKernel(_FLAT_STD_M, 1.0, False, line_std=_KNOWN)
    rough = [DepthKernel(*each, True, line_std=_KNOWN) for each in product(_DEPTH_STD_M, _LENGTH_M)]
    share = np.log(np.repeat([1 / 2, 1 / 2 / len(rough)], [1, len(rough)]))
    found = average([fit_kernel(seen, at_m, each) for each in (flat, *rough)], share)
    return found._replace(variance_m2=found.variance_m2 + line_m2)
