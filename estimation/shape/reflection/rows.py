"""Fits of objects as the record of contours: one sample count for all, and the paths of each."""

import numpy as np

from estimation.shape.fit import ShapeFit
from estimation.shape.record import CLASS_NAMES, N_CONTOUR_SAMPLES, Contours
from estimation.shape.reflection.fit_all import CampaignFit
from estimation.shape.reflection.search import N_COMMON
from estimation.shape.reflection.tx_sessions import one_session
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray


def contour_record(fit: CampaignFit, label: IntArray, n_ips: int) -> Contours:
    """The record of the objects of a campaign; `label` (ip,) gives the cluster of each object."""
    n = len(fit.shapes)
    owner = np.full(n_ips, -1)
    for k, rows in enumerate(fit.paths):
        owner[rows] = k
    sampled = [resample_contour(shape, N_CONTOUR_SAMPLES) for shape in fit.shapes]
    contour = np.array([points for points, _ in sampled]).reshape(n, N_CONTOUR_SAMPLES, 2)
    offset, offset_std = _offsets(fit)
    return Contours(
        method=fit.method,
        kind=np.array([shape.kind for shape in fit.shapes], dtype=str),
        status=np.array([shape.status for shape in fit.shapes], dtype=str),
        is_closed=np.array([shape.is_closed for shape in fit.shapes], dtype=bool),
        center_m=contour.mean(axis=1),
        contour_m=contour,
        std_m=np.array([std for _, std in sampled]).reshape(n, N_CONTOUR_SAMPLES),
        extent_m=np.array([shape.extent_m for shape in fit.shapes]),
        extent_std_m=np.array([shape.extent_std_m for shape in fit.shapes]),
        class_name=np.array(CLASS_NAMES),
        class_probability=fit.class_probability.reshape(n, len(CLASS_NAMES)),
        cluster=np.array([_most(label[rows]) for rows in fit.paths], dtype=int),
        object=owner,
        delay_offset_s=float(offset[0]) / SPEED_OF_LIGHT_M_S,
        delay_offset_std_s=float(offset_std[0]) / SPEED_OF_LIGHT_M_S,
        aoa_offset_rad=float(offset[1]),
        aoa_offset_std_rad=float(offset_std[1]),
        aod_offset_rad=offset[N_COMMON:],
        aod_offset_std_rad=offset_std[N_COMMON:],
        session=fit.sessions.of_stop,
    )


def no_contours(n_ips: int, n_stops: int, method: str = "none") -> Contours:
    """The record without any object."""
    sessions = one_session(np.zeros(n_stops, dtype=np.int64))
    fit = CampaignFit(method, (), np.zeros((0, len(CLASS_NAMES))), (), None, sessions)
    return contour_record(fit, np.zeros(0, dtype=np.int64), n_ips)


def resample_contour(shape: ShapeFit, n_samples: int) -> tuple[FloatArray, FloatArray]:
    """Points (sample, xy) and standard deviations (sample,) at even arc lengths; unchanged if as many."""
    points, std = shape.contour_m, shape.std_m
    if len(points) == n_samples:
        return points, std
    if len(points) == 1:
        return np.tile(points, (n_samples, 1)), np.tile(std, n_samples)
    if shape.is_closed:
        points, std = np.vstack([points, points[:1]]), np.append(std, std[0])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], n_samples, endpoint=not shape.is_closed)
    return np.column_stack([np.interp(at, along, column) for column in points.T]), np.interp(at, along, std)


def _most(label: IntArray) -> int:
    """The most frequent cluster, -1 where there is none."""
    found = label[label >= 0]
    return int(np.bincount(found).argmax()) if len(found) else -1


def _offsets(fit: CampaignFit) -> tuple[FloatArray, FloatArray]:
    """Offsets (2 + session,) and their standard deviations; NaN where none were fitted.

    Departure offsets include those removed before the bundle, which then had one session.
    """
    n = len(fit.sessions.offset_rad)
    if fit.bundle is None:
        return np.full(N_COMMON, np.nan), np.full(N_COMMON, np.nan)
    common, common_std = fit.bundle.offset[:N_COMMON], fit.bundle.offset_std[:N_COMMON]
    own, own_std = fit.bundle.offset[N_COMMON:], fit.bundle.offset_std[N_COMMON:]
    if len(own) == 0:
        return common, common_std
    if len(own) == 1:
        own, own_std = np.broadcast_to(own, n), np.broadcast_to(own_std, n)
    else:  # the last of several TX may show no object
        own, own_std = (np.append(value, np.full(n - len(value), np.nan)) for value in (own, own_std))
    offset, std = fit.sessions.offset_rad + own, np.hypot(fit.sessions.std_rad, own_std)
    return np.concatenate([common, offset]), np.concatenate([common_std, std])
