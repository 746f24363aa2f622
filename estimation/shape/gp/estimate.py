"""Contours from incidence points: extended object estimation (paper, section III)."""

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

    Outliers and points of no cluster have the label -1. Without clusters the record is empty, which is valid.
    """
    label = np.full(len(ips), NOISE)
    label[ips.is_inlier] = cluster_points(ips.position_m[ips.is_inlier], config.eps_m, config.min_samples)
    return fit_shapes(ips, label, config)


def fit_shapes(ips: IncidencePoints, label: IntArray, config: ShapeConfig) -> Shapes:
    """One star-convex contour for each given cluster 0 .. max(label) of incidence points.

    `label` (ip,) is the cluster of every point, -1 for none; every cluster has at least one point.
    """
    center = apply_biases(centroids(ips.position_m, label), config.biases)
    members = [ips.take("ip", label == cluster) for cluster in range(len(center))]
    polar = [to_polar(one.position_m, at) for one, at in zip(members, center, strict=True)]
    floor = [0.0] * len(members)
    if config.noise_floor:
        variances = (
            radial_variance(one.covariance_m2, angle) for one, (angle, _) in zip(members, polar, strict=True)
        )
        floor = [float(np.sqrt(np.median(variance))) for variance in variances]
    contours = fit_radial_gps(polar, config.start, config.mean_uncertainty, floor)
    with one_blas_thread():
        return _sample(label, center, contours, config.n_samples)


def _sample(label: IntArray, center_m: FloatArray, contours: list[RadialGp], n_samples: int) -> Shapes:
    angle = np.linspace(-np.pi, np.pi, n_samples, endpoint=False)
    samples = np.array([contour.predict(angle) for contour in contours]).reshape(len(contours), 2, n_samples)
    names = ("mean_m", "signal_std_m", "length_scale", "noise_std_m", "log_likelihood")
    return Shapes(
        label=label,
        center_m=center_m,
        angle_rad=angle,
        radius_m=samples[:, 0],
        radius_std_m=samples[:, 1],
        **{name: np.array([getattr(contour, name) for contour in contours]) for name in names},
    )
