"""Outlines of objects that another method found, as the record of contours."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.shape.fit import OK, ShapeFit
from estimation.shape.record import CLASS_NAMES, Contours
from estimation.shape.reflection.fit_all import CampaignFit
from estimation.shape.reflection.rows import contour_record
from estimation.shape.reflection.tx_sessions import one_session
from estimation.slam.record import IncidencePoints, PoseEstimates
from scenes.arguments import need, need_each
from scenes.record import FloatArray, IntArray


@dataclass(frozen=True)
class ObjectOutline:
    """One object: points (sample, xy) in m, standard deviations (sample,) in m across, and its incidence points.

    A closed outline runs counter-clockwise without a repeated end, an open one end to end. `rows` are the indices
    of the incidence points that belong to it.
    """

    contour_m: FloatArray
    std_m: FloatArray
    is_closed: bool
    rows: IntArray


def contours_of(
    outlines: Sequence[ObjectOutline], poses: PoseEstimates, points: IncidencePoints, method: str = "function"
) -> Contours:
    """The record of contours of some outlines, sampled alike; classes and offsets are unknown (NaN).

    The extent of a closed outline is its mean distance from its centre, of an open one its length. Raises
    `ValueError` where the arrays of an outline do not fit each other.
    """
    need_each("outlines", outlines, ObjectOutline)
    need("poses", poses, PoseEstimates)
    need("points", points, IncidencePoints)
    unknown = np.full((len(outlines), len(CLASS_NAMES)), np.nan)
    rows = tuple(np.asarray(outline.rows, int) for outline in outlines)
    fit = CampaignFit(method, tuple(map(_fit, outlines)), unknown, rows, None, one_session(poses.stop))
    return contour_record(fit, np.full(len(points), -1), len(points))


def _fit(outline: ObjectOutline) -> ShapeFit:
    points = np.asarray(outline.contour_m, float)
    if outline.is_closed:
        extent = float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())
    else:
        extent = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    std = np.asarray(outline.std_m, float)
    return ShapeFit(
        kind="star_convex" if outline.is_closed else "wall",
        status=OK,
        is_closed=outline.is_closed,
        contour_m=points,
        std_m=std,
        log_evidence=np.nan,
        parameter=np.zeros(0),
        parameter_covariance=np.zeros((0, 0)),
        parameter_name=np.zeros(0, dtype=np.str_),
        extent_m=extent,
        extent_std_m=float(std.mean()) if len(std) else np.nan,
    )
