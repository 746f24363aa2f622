"""From incidence points to contours: extended object estimation (paper, section III)."""

from __future__ import annotations

import numpy as np

from estimation.execution import one_blas_thread
from estimation.shape.config import ShapeConfig
from estimation.shape.gp.clustering import (
    NOISE,
    apply_biases,
    centroids,
    cluster_points,
    radial_variance,
    to_polar,
)
from estimation.shape.gp.radial import RadialGp, fit_radial_gps
from estimation.shape.record import Shapes
from estimation.slam.record import IncidencePoints
from scenes.record import FloatArray, IntArray


def estimate_shapes(ips: IncidencePoints, config: ShapeConfig) -> Shapes:
    """Cluster the inlier incidence points and fit one star-convex contour to each cluster.

    Points that are no inliers and points of no cluster have the label -1. Without clusters the record is
    empty, which is valid.
    """
    label = np.full(len(ips), NOISE)
    label[ips.is_inlier] = cluster_points(ips.position_m[ips.is_inlier], config.eps_m, config.min_samples)
    return fit_shapes(ips, label, config)


def fit_shapes(ips: IncidencePoints, label: IntArray, config: ShapeConfig) -> Shapes:
    """One star-convex contour for each cluster 0 .. max(label) of incidence points, which are given.

    `label` (ip,) is the cluster of every point, -1 for none; every cluster has at least one.
    """
    center = apply_biases(centroids(ips.position_m, label), config.biases)
    members = [ips.take("ip", label == cluster) for cluster in range(len(center))]
    polar = [to_polar(one.position_m, at) for one, at in zip(members, center, strict=True)]
    floor = [0.0] * len(members)
    if config.noise_floor:
        floor = [_radial_std(one, angle) for one, (angle, _) in zip(members, polar, strict=True)]
    contours = fit_radial_gps(polar, config.start, config.mean_uncertainty, floor)
    with one_blas_thread():
        return _sample(label, center, contours, config.n_samples)


def _radial_std(ips: IncidencePoints, angle_rad: FloatArray) -> float:
    """Median standard deviation in m of points along their radii."""
    return float(np.sqrt(np.median(radial_variance(ips.covariance_m2, angle_rad))))


def _sample(label: IntArray, center_m: FloatArray, contours: list[RadialGp], n_samples: int) -> Shapes:
    angle = np.linspace(-np.pi, np.pi, n_samples, endpoint=False)
    samples = np.array([contour.predict(angle) for contour in contours]).reshape(len(contours), 2, n_samples)
    return Shapes(
        label=label,
        center_m=center_m,
        angle_rad=angle,
        radius_m=samples[:, 0],
        radius_std_m=samples[:, 1],
        mean_m=np.array([contour.mean_m for contour in contours]),
        signal_std_m=np.array([contour.signal_std_m for contour in contours]),
        length_scale=np.array([contour.length_scale for contour in contours]),
        noise_std_m=np.array([contour.noise_std_m for contour in contours]),
        log_likelihood=np.array([contour.log_likelihood for contour in contours]),
    )
