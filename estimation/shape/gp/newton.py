"""Most likely hyperparameters of a radial Gaussian process by a compiled search: a projected Newton ascent.

It runs over log beta with the analytic Hessian of the profiled log marginal likelihood, from the covariance matrix
of few points or from the harmonics of many (`fourier.py`). Small clusters are searched one after another in one
call, because for few points the function calls cost more than the algebra; no result depends on the others.
"""

import numpy as np

from estimation.execution import compiled
from estimation.shape.gp.harmonic_terms import harmonic_terms, needed_order
from scenes.record import FloatArray, IntArray

LARGEST_STEP = 1.5  # of a log parameter
SMALLEST_CURVATURE_NAT = 1e-3
SUFFICIENT_RISE = 1e-4  # share of the rise that the slope predicts (Armijo)
N_STEPS, N_HALVINGS = 60, 25


@compiled
def likelihood_terms(
    chords: FloatArray, radius_m: FloatArray, log_beta: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Log marginal likelihood with the most likely mu, its gradient (3,) and Hessian (3, 3) by log beta.

    As `exact.log_marginal_likelihood`. With P = K_y^-1, alpha = P (r - mu), D_i the derivatives of K_y and u_i =
    D_i alpha the Hessian is (alpha' D_ij alpha - tr P D_ij + tr P D_i P D_j) / 2 - u_i' P u_j, and mu being
    profiled adds (1' P u_i) (1' P u_j) / (1' P 1).
    """
    n = len(radius_m)
    signal_variance, length_squared, noise_variance = np.exp(log_beta)
    scaled = chords / length_squared
    by_signal = signal_variance * np.exp(-scaled)
    K_y = by_signal.copy()
    for i in range(n):
        K_y[i, i] += noise_variance
    log_determinant = 2 * np.sum(np.log(np.diag(np.linalg.cholesky(K_y))))
    P = np.linalg.inv(K_y)
    row_sum = P.sum(axis=0)
    eta = radius_m - (row_sum @ radius_m) / row_sum.sum()
    alpha = P @ eta
    value = -0.5 * (eta @ alpha + log_determinant + n * np.log(2 * np.pi))

    by_length = by_signal * scaled
    twice_by_length = by_length * (scaled - 1)
    u = np.stack((by_signal @ alpha, by_length @ alpha, noise_variance * alpha))
    W = np.stack((P @ by_signal, P @ by_length, noise_variance * P))
    Pu = u @ P
    from_mean = u @ row_sum
    inner = np.outer(alpha, alpha) - P
    second = np.zeros((3, 3))
    second[0, 0] = np.sum(inner * by_signal)
    second[0, 1] = second[1, 0] = np.sum(inner * by_length)
    second[1, 1] = np.sum(inner * twice_by_length)
    second[2, 2] = noise_variance * np.trace(inner)
    gradient, hessian = np.empty(3), np.empty((3, 3))
    for i in range(3):
        gradient[i] = 0.5 * (alpha @ u[i] - np.trace(W[i]))
        for j in range(3):
            hessian[i, j] = 0.5 * (second[i, j] + np.sum(W[i] * W[j].T)) - u[i] @ Pu[j]
            hessian[i, j] += from_mean[i] * from_mean[j] / row_sum.sum()
    return value, gradient, hessian


@compiled
def _terms(
    chords: FloatArray, radius_m: FloatArray, gram: FloatArray, moment: FloatArray, log_beta: FloatArray
) -> tuple[int, float, FloatArray, FloatArray]:
    """The terms of the likelihood by the covariance matrix or by harmonics, whichever is smaller.

    First comes the highest harmonic that they need: where `gram` has fewer, the terms are not known. It is 0 for
    the covariance matrix, which is taken where `gram` is empty.
    """
    n, order = len(radius_m), 0
    if len(gram) > 0:
        signal_variance, length_squared, noise_variance = np.exp(log_beta)
        order = needed_order(length_squared, n * signal_variance / noise_variance)
    if order == 0 or (len(chords) > 0 and n < 2 * order + 1):
        value, gradient, hessian = likelihood_terms(chords, radius_m, log_beta)
        return 0, value, gradient, hessian
    if 2 * order + 1 > len(gram):
        return order, -np.inf, np.zeros(3), np.zeros((3, 3))
    eta = radius_m - radius_m.mean()
    value, _, gradient, hessian = harmonic_terms(gram, moment, eta @ eta, n, order, log_beta)
    return order, value, gradient, hessian


@compiled
def ascend(
    chords: FloatArray,
    radius_m: FloatArray,
    gram: FloatArray,
    moment: FloatArray,
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    enough_nat: float,
) -> tuple[int, float, FloatArray]:
    """Likelihood and log beta after the first step within the bounds that promised at most `enough_nat`.

    Parameters
    ----------
    chords, radius_m
        Chords (ip, ip) and radii (ip,); no chords where harmonics alone are used.
    gram, moment
        Sums of `FourierSums` up to some harmonic; empty where the covariance matrix alone is used.

    Returns
    -------
    The highest harmonic that is needed, the likelihood and log beta. Where `gram` has fewer harmonics the ascent
    stopped there, to go on with more.
    """
    at = np.minimum(np.maximum(start, low), high)
    order, value, gradient, hessian = _terms(chords, radius_m, gram, moment, at)
    if 2 * order + 1 > max(len(gram), 1):
        return order, value, at
    for _ in range(N_STEPS):
        held = ((at <= low) & (gradient < 0)) | ((at >= high) & (gradient > 0))
        slope = np.where(held, 0.0, gradient)
        if np.max(np.abs(slope)) == 0.0:
            break
        curvature = -hessian
        for i in range(3):
            if held[i]:
                curvature[i, :] = 0.0
                curvature[:, i] = 0.0
                curvature[i, i] = 1.0
        eigenvalue, vector = np.linalg.eigh(curvature)
        step = vector @ ((vector.T @ slope) / np.maximum(np.abs(eigenvalue), SMALLEST_CURVATURE_NAT))
        is_last = slope @ step <= 2 * enough_nat
        step *= min(1.0, LARGEST_STEP / np.max(np.abs(step)))
        rose = False
        for _ in range(N_HALVINGS):
            there = np.minimum(np.maximum(at + step, low), high)
            order, found, its_gradient, its_hessian = _terms(chords, radius_m, gram, moment, there)
            if 2 * order + 1 > max(len(gram), 1):
                return order, value, at
            if found >= value + SUFFICIENT_RISE * (slope @ (there - at)):
                at, value, gradient, hessian = there, found, its_gradient, its_hessian
                rose = True
                break
            step = step / 2
        if is_last or not rose:
            break
    return 0, value, at


@compiled
def most_likely(
    first: IntArray,
    angle_rad: FloatArray,
    radius_m: FloatArray,
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    enough_nat: float,
) -> FloatArray:
    """Log beta (cluster, 3) of the most likely optimum of every cluster.

    Cluster c holds the points `first[c]` up to `first[c + 1]` of `angle_rad` and `radius_m` (ip,). Each of its
    starts of log beta (cluster, start, 3) is followed within the bounds `low` and `high` (cluster, 3) until a step
    promises at most `enough_nat`.
    """
    log_beta, none = np.empty((len(first) - 1, 3)), np.zeros((0, 0))
    for c in range(len(first) - 1):
        angle, radius = angle_rad[first[c] : first[c + 1]], radius_m[first[c] : first[c + 1]]
        chords = np.empty((len(angle), len(angle)))
        for i in range(len(angle)):
            for j in range(len(angle)):
                chords[i, j] = 2 * np.sin((angle[i] - angle[j]) / 2) ** 2
        best = -np.inf
        for k in range(start.shape[1]):
            _, value, end = ascend(chords, radius, none, np.zeros(0), start[c, k], low[c], high[c], enough_nat)
            if value > best:
                best = value
                log_beta[c] = end
    return log_beta
