"""Errors of a planar trajectory: absolute (APE) and relative (RPE) pose errors.

Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, equations (1) to (5),
in the plane. Poses that could not be estimated are NaN and are ignored; an RPE needs both of its poses.
"""

import numpy as np

from scenes.pose import wrap_angle
from scenes.record import FloatArray


def aligned(position_m: FloatArray, truth_m: FloatArray) -> tuple[FloatArray, float]:
    """Estimated positions (stop, xy) after the best rigid motion onto the truth, and the rotation in rad.

    The motion has the least squared distance over the stops where both positions are known (Umeyama 1991, without
    scale). The rotation is 0 where there are fewer than two such stops.
    """
    known = np.isfinite(position_m).all(axis=1) & np.isfinite(truth_m).all(axis=1)
    if not known.any():
        return position_m.copy(), 0.0
    from_mean, to_mean = position_m[known].mean(axis=0), truth_m[known].mean(axis=0)
    a, b = (position_m[known] - from_mean).T, (truth_m[known] - to_mean).T
    rotation = float(np.arctan2((a[0] * b[1] - a[1] * b[0]).sum(), (a * b).sum()))
    c, s = np.cos(rotation), np.sin(rotation)
    return (position_m - from_mean) @ np.array([[c, s], [-s, c]]) + to_mean, rotation


def absolute_errors(
    position_m: FloatArray,
    heading_rad: FloatArray,
    truth_m: FloatArray,
    true_heading_rad: FloatArray,
    *,
    align: bool,
) -> tuple[FloatArray, FloatArray]:
    """Distance (stop,) in m and heading error (stop,) in rad; with `align` after the best rigid motion."""
    rotation = 0.0
    if align:
        position_m, rotation = aligned(position_m, truth_m)
    error_m = np.linalg.norm(position_m - truth_m, axis=1)
    return error_m, np.asarray(wrap_angle(heading_rad + rotation - true_heading_rad))


def relative_errors(
    position_m: FloatArray,
    heading_rad: FloatArray,
    truth_m: FloatArray,
    true_heading_rad: FloatArray,
    *,
    delta: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Errors (stop - delta,) of the motion over `delta` stops: distance in m and rotation in rad.

    Raises `ValueError` for a delta below 1.
    """
    if delta < 1:
        raise ValueError(f"delta = {delta}: must be at least 1")
    estimate, turn = _motion(position_m, heading_rad, delta)
    truth, true_turn = _motion(truth_m, true_heading_rad, delta)
    return np.linalg.norm(estimate - truth, axis=1), np.asarray(wrap_angle(turn - true_turn))


def _motion(position_m: FloatArray, heading_rad: FloatArray, delta: int) -> tuple[FloatArray, FloatArray]:
    """Step (step, xy) in the frame of the first pose and turn (step,) of each motion over `delta` stops."""
    step = position_m[delta:] - position_m[:-delta]
    c, s = np.cos(heading_rad[:-delta]), np.sin(heading_rad[:-delta])
    local = np.stack([c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1]], axis=-1)
    return local, np.asarray(wrap_angle(heading_rad[delta:] - heading_rad[:-delta]))
