"""Likelihood of delays and angles as a mixture of paths of one contour and ghosts, and its normal equations."""

import numpy as np

from estimation.execution import compiled
from estimation.laws.contour import SpecularPaths
from estimation.laws.plane import residual
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from scenes.record import FloatArray, IntArray

N_COMMON = 2  # the first offsets are of delay and arrival; those of departure, one per session, follow


def path_weights(
    paths: SpecularPaths, data: Reflections, config: ReflectionConfig
) -> tuple[FloatArray, FloatArray]:
    """Inverse covariances (path, 3, 3), pose errors included, and log normalisations (path,) of the inliers."""
    covariance = path_covariance(paths, data)
    weight = np.linalg.inv(covariance)
    log_norm = np.log1p(-config.ghost_share) - 1.5 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(covariance)[1]
    return np.asarray(weight), np.asarray(log_norm)


def path_covariance(paths: SpecularPaths, data: Reflections) -> FloatArray:
    """Covariances (path, 3, 3) of the measurements with those of the RX states, to first order."""
    if not np.any(data.rx_covariance):
        return data.covariance
    return data.covariance + paths.by_rx @ data.rx_covariance @ np.swapaxes(paths.by_rx, 1, 2)


def squared_distances(
    paths: SpecularPaths, offset: FloatArray, data: Reflections, weight: FloatArray
) -> FloatArray:
    """Squared Mahalanobis distances (path,) of the measurements from the predicted ones with offsets."""
    difference = offset_residual(data, paths.measured, offset)
    return np.asarray(np.einsum("na,nab,nb->n", difference, weight, difference))


def offset_residual(data: Reflections, predicted: FloatArray, offset: FloatArray) -> FloatArray:
    """Measured minus predicted (path, 3) plus offsets, which are the first values of `offset`."""
    common = np.empty((len(data), 3))
    common[:, 0], common[:, 1], common[:, 2] = offset[0], offset[N_COMMON + data.session], offset[1]
    return residual(data.measured, predicted + common)


def normal_equations(
    paths: SpecularPaths,
    offset: FloatArray,
    data: Reflections,
    weight: FloatArray,
    log_norm: FloatArray,
    config: ReflectionConfig,
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Minus the log likelihood, its gradient and information by [parameter, offset], inlier shares (path,)."""
    size = paths.by_parameter.shape[2] + len(offset)
    gradient, hessian, inlier = np.zeros(size), np.zeros((size, size)), np.empty(len(data))
    cost = _accumulate(
        data.measured,
        paths.measured,
        paths.by_parameter,
        offset,
        data.session,
        weight,
        log_norm,
        config.log_ghost_density,
        gradient,
        hessian,
        inlier,
    )
    return cost, gradient, hessian, inlier


@compiled
def _accumulate(
    measured: FloatArray,
    predicted: FloatArray,
    by_parameter: FloatArray,
    offset: FloatArray,
    session: IntArray,
    weight: FloatArray,
    log_norm: FloatArray,
    log_ghost: float,
    gradient: FloatArray,
    hessian: FloatArray,
    inlier: FloatArray,
) -> float:
    m, size = by_parameter.shape[2], len(gradient)
    jacobian, weighted_jacobian = np.zeros((3, size)), np.zeros((3, size))
    difference, weighted = np.zeros(3), np.zeros(3)
    cost = 0.0
    for i in range(len(measured)):
        jacobian[:, m:] = 0.0
        jacobian[0, m], jacobian[2, m + 1], jacobian[1, m + N_COMMON + session[i]] = 1.0, 1.0, 1.0
        difference[0] = measured[i, 0] - predicted[i, 0] - offset[0]
        difference[1] = measured[i, 1] - predicted[i, 1] - offset[N_COMMON + session[i]]
        difference[2] = measured[i, 2] - predicted[i, 2] - offset[1]
        for k in range(1, 3):
            difference[k] = (difference[k] + np.pi) % (2 * np.pi) - np.pi
        square = 0.0
        for k in range(3):
            w = weight[i, k]
            weighted[k] = w[0] * difference[0] + w[1] * difference[1] + w[2] * difference[2]
            square += weighted[k] * difference[k]
            for j in range(m):
                jacobian[k, j] = by_parameter[i, k, j]
        log_inlier = log_norm[i] - 0.5 * square
        top = max(log_inlier, log_ghost)
        log_total = top + np.log(np.exp(log_inlier - top) + np.exp(log_ghost - top))
        share = np.exp(log_inlier - log_total)
        inlier[i] = share
        cost -= log_total
        for k in range(3):
            w = weight[i, k]
            for j in range(size):
                weighted_jacobian[k, j] = share * (
                    w[0] * jacobian[0, j] + w[1] * jacobian[1, j] + w[2] * jacobian[2, j]
                )
        for j in range(size):
            for k in range(3):
                gradient[j] -= weighted_jacobian[k, j] * difference[k]
                for other in range(size):
                    hessian[j, other] += weighted_jacobian[k, j] * jacobian[k, other]
    return float(cost)
