"""Methods that know incidence points only, ours and the peers', behind one interface."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from estimation.shape.depth_line import fit_depth_line
from estimation.shape.fit import ShapeFit
from estimation.shape.line import fit_line
from estimation.shape.mic import fit_mic
from estimation.shape.peers import (
    fit_circle,
    fit_convex_hull,
    fit_paper_gp,
    fit_prior_only,
    fit_random_matrix,
)
from estimation.shape.peers_recursive import fit_recursive_gp, fit_star_convex_rhm
from estimation.shape.points import PointCluster

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
