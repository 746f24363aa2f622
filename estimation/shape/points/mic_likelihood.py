"""Likelihood of points on a contour; their unknown places along it are integrated out."""

import numpy as np

from estimation.execution import compiled
from scenes.record import FloatArray


@compiled
def log_likelihood(
    position_m: FloatArray,
    precision_per_m2: FloatArray,
    log_constant: FloatArray,
    log_weight: FloatArray,
    node_m: FloatArray,
    log_noise_scale: float,
    log_background: float,
) -> tuple[float, FloatArray, float, FloatArray]:
    """Log likelihood, its gradient (node, xy) by the nodes in 1/m, its derivative by the log noise scale, and the
    expected number of points (node,) at every node, which is its gradient by weights shared by all points.

    The density of point i is sum_g exp(log_weight_g) N(p_i; x_g, s^2 Sigma_i) + exp(log_background).
    `position_m` (ip, xy), `precision_per_m2` (ip, xy, xy) the inverse of Sigma_i, `log_constant` (ip,) that of
    the normal density at s = 1, `log_weight` (node,), `node_m` (node, xy) the contour.
    """
    n_points, n_nodes = len(position_m), len(node_m)
    value = 0.0
    by_node = np.zeros((n_nodes, 2))
    by_scale = 0.0
    n_at_node = np.zeros(n_nodes)
    inverse_square = np.exp(-2 * log_noise_scale)
    background = np.exp(log_background)
    density = np.empty(n_nodes)
    pull = np.empty((n_nodes, 2))
    distance2 = np.empty(n_nodes)
    for i in range(n_points):
        xx, xy, yy = precision_per_m2[i, 0, 0], precision_per_m2[i, 0, 1], precision_per_m2[i, 1, 1]
        total = background
        for g in range(n_nodes):
            dx, dy = position_m[i, 0] - node_m[g, 0], position_m[i, 1] - node_m[g, 1]
            pull[g, 0] = inverse_square * (xx * dx + xy * dy)
            pull[g, 1] = inverse_square * (xy * dx + yy * dy)
            distance2[g] = pull[g, 0] * dx + pull[g, 1] * dy
            density[g] = inverse_square * np.exp(log_constant[i] + log_weight[g] - 0.5 * distance2[g])
            total += density[g]
        value += np.log(total)
        for g in range(n_nodes):
            share = density[g] / total
            by_node[g, 0] += share * pull[g, 0]
            by_node[g, 1] += share * pull[g, 1]
            by_scale += share * (distance2[g] - 2)
            n_at_node[g] += share
    return value, by_node, by_scale, n_at_node
