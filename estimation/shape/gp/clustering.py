"""Clusters of incidence points (IPs) and their polar form (paper, section III-A)."""

from collections.abc import Sequence

import numpy as np

from estimation.shape.config import CentroidBias
from scenes.record import FloatArray, IntArray

NOISE = -1


def cluster_points(position_m: FloatArray, eps_m: float, min_samples: int) -> IntArray:
    """Cluster label of every point (ip, xy) by DBSCAN: 0 .. C-1, or -1 for points in no cluster.

    The largest cluster has number 0; equal sizes are ordered by the x and then the y of the centroid. Source:
    Ester et al. 1996, in scikit-learn's implementation.
    """
    if len(position_m) == 0:
        return np.zeros(0, dtype=np.int64)
    from sklearn.cluster import DBSCAN  # noqa: PLC0415  (it takes a second, and pandas comes with it)

    found = DBSCAN(eps=eps_m, min_samples=min_samples).fit_predict(position_m)
    centroid = centroids(position_m, found)
    size = np.bincount(found[found != NOISE], minlength=len(centroid))
    order = np.lexsort((centroid[:, 1], centroid[:, 0], -size))
    label = np.full(len(found), NOISE)
    for number, cluster in enumerate(order):
        label[found == cluster] = number
    return label


def centroids(position_m: FloatArray, label: IntArray) -> FloatArray:
    """Mean position (cluster, xy) in m of the points of each cluster 0 .. max(label)."""
    n_clusters = int(np.max(label, initial=NOISE)) + 1
    return np.array([position_m[label == c].mean(axis=0) for c in range(n_clusters)]).reshape(n_clusters, 2)


def apply_biases(centroid_m: FloatArray, biases: Sequence[CentroidBias]) -> FloatArray:
    """Centres (cluster, xy) in m: the centroids plus the biases near them; biases of one cluster add up."""
    center = centroid_m.copy()
    for bias in biases:
        distance = np.linalg.norm(centroid_m - np.array(bias.near_m), axis=1)
        if np.min(distance, initial=np.inf) <= bias.within_m:
            center[np.argmin(distance)] += bias.bias_m
    return center


def to_polar(position_m: FloatArray, center_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angle in rad, [-pi, pi], and radius in m of points (ip, xy) about a centre: the polar form of III-A."""
    dx, dy = (position_m - center_m).T
    return np.arctan2(dy, dx), np.hypot(dx, dy)


def radial_variance(covariance_m2: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Variance (ip,) in m^2 along the radius of points at polar angle (ip,) with covariance (ip, xy, xy)."""
    outward = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)
    return np.asarray(np.einsum("ij,ijk,ik->i", outward, covariance_m2, outward))
