"""Methods for incidence points only, our own and those of peers, with one interface."""

from collections.abc import Callable, Mapping

import numpy as np

from estimation.shape.baselines.peers import (
    fit_circle,
    fit_convex_hull,
    fit_paper_gp,
    fit_prior_only,
    fit_random_matrix,
)
from estimation.shape.baselines.recursive import fit_recursive_gp, fit_star_convex_rhm
from estimation.shape.fit import ShapeFit
from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.depth_line import fit_depth_line
from estimation.shape.points.line import fit_line
from estimation.shape.points.mic import fit_mic
from estimation.shape.record import CLASS_NAMES
from scenes.record import FloatArray

POINT_METHODS: Mapping[str, Callable[[PointCluster], ShapeFit]] = {
    "mic": fit_mic,
    "line": fit_line,
    "depth_line": fit_depth_line,
    "paper_gp": fit_paper_gp,
    "prior_only": fit_prior_only,
    "convex_hull": fit_convex_hull,
    "random_matrix": fit_random_matrix,
    "circle": fit_circle,
    "recursive_gp": fit_recursive_gp,
    "star_convex_rhm": fit_star_convex_rhm,
}

# Our methods with their class and prior share; points alone do not show an edge.
_OWN = {"mic": ("pillar", 0.5), "line": ("wall", 0.25), "depth_line": ("wall", 0.25)}


def choose_points(points: PointCluster) -> tuple[ShapeFit, FloatArray]:
    """The fit of contour, line or line of varying depth with most evidence, and the probability (class,)."""
    fits = {name: POINT_METHODS[name](points) for name in _OWN}
    score = {name: fit.log_evidence + np.log(_OWN[name][1]) for name, fit in fits.items() if fit.is_usable}
    total = np.logaddexp.reduce(list(score.values()))
    probability = np.zeros(len(CLASS_NAMES))
    for name, value in score.items():
        probability[CLASS_NAMES.index(_OWN[name][0])] += np.exp(value - total)
    best = CLASS_NAMES[int(probability.argmax())]
    own = {name: value for name, value in score.items() if _OWN[name][0] == best}
    return fits[max(own, key=lambda name: own[name])], probability
