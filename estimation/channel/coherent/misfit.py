"""Errors of paths from an incomplete model: unresolved neighbours, unknown elevations.

An undetected neighbour (too weak or too close) of relative amplitude rho and offset d adds rho d times the
derivative of the path's response. Its part in phase with the path shifts the estimate and is invisible in the
residual. No shift explains its part in quadrature: it remains in the residual. Phases of true paths are
independent and uniform, so both parts have one distribution: the energy of the derivatives in quadrature, over its
value in noise, measures the squared error over the bound. In noise it is chi-square, with one degree of freedom
per parameter. It may grow without limit, but the error does not: neighbours further away are detected.
"""

import numpy as np
from scipy.stats import chi2

from estimation.channel.coherent.refine import Reference, Solution, regular_inverse
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import gram_matrix, tangents
from scenes.record import FloatArray, IntArray

LEAST_SEEN = 1e-9  # information on a shift, relative to the amplitude, below which it is unobservable
UNRESOLVED_CELLS = 0.4  # Rayleigh cells below which two equal paths are not resolved
BY_NOISE = 1e-3  # least probability of the quadrature that noise explains, for a path or a stop


def misfit_factor(reference: Reference, solution: Solution) -> FloatArray:
    """Factor (path,), at least 1, on the covariances of paths at the maximum of the likelihood.

    It is 1 for paths that noise explains, in a stop that noise explains. `solution` is at the reference's paths.
    """
    shown, n_seen = quadrature_statistic(reference, solution)
    is_misfit = shown > chi2.isf(BY_NOISE, np.maximum(1, n_seen))
    if shown.sum() > chi2.isf(BY_NOISE, max(1, n_seen.sum())):
        is_misfit[:] = True
    return np.where(is_misfit, np.maximum(1.0, shown / np.maximum(1, n_seen)), 1.0)


def quadrature_statistic(reference: Reference, solution: Solution) -> tuple[FloatArray, IntArray]:
    """Energy (path,) of the residual along each path's derivatives in quadrature: chi-square in noise alone.

    It is the score test of one more amplitude per parameter, imaginary shifts, against the model of all paths. The
    second result is the number (path,) of observable parameters, the degrees of freedom.
    """
    n, n_columns = solution.slope.shape
    amplitude = solution.paths.amplitude
    at = tangents(reference.sweep, solution.paths)
    inner, residual = gram_matrix(at, at), reference.residual_products(at)
    energy = np.einsum("papa->pa", inner)[:, 0].real
    tangent = np.maximum(np.arange(n_columns) - 1, 0)  # of every column of the normal equations
    scale = np.repeat(amplitude[:, None], n_columns, axis=1)
    scale[:, :2] = [1.0, 1.0j]
    inverse = regular_inverse(solution.flat_information)
    statistic, n_seen = np.zeros(n), np.zeros(n, int)
    for path in range(n):
        turned = (1j * amplitude[path]).conj()
        cross = (turned * inner[path, 1:][:, :, tangent] * scale).real.reshape(n_columns - 2, -1)
        own = np.square(np.abs(amplitude[path])) * inner[path, 1:, path, 1:].real
        known = cross @ inverse
        score = (turned * residual[path, 1:]).real - known @ solution.slope.ravel()
        information = own - known @ cross.T
        seen = np.diagonal(information) > LEAST_SEEN * np.square(np.abs(amplitude[path])) * energy[path]
        n_seen[path] = seen.sum()
        statistic[path] = 2 * score[seen] @ regular_inverse(information[np.ix_(seen, seen)]) @ score[seen]
    return statistic, n_seen


def widen_covariances(covariance: FloatArray, factor: FloatArray, rate: FloatArray) -> FloatArray:
    """Covariances (path, parameter, parameter) times factors (path,), up to the largest error by misfit.

    A path that stands for itself and an unresolved neighbour lies between them: its error is at most half their
    distance. The factor adds C' with C'^-1 = ((factor - 1) C)^-1 + B^-1, B the square of that half. `rate` (path,
    parameter) is the length on the manifold per unit of each parameter.
    """
    half = UNRESOLVED_CELLS / 2 * CELL / np.maximum(rate, np.finfo(float).tiny ** 0.25)
    scale = half[:, :, None] * half[:, None]
    added = covariance * (factor - 1)[:, None, None] / scale
    bounded = added - added @ np.linalg.solve(added + np.eye(added.shape[1]), added)
    return np.asarray(covariance + scale * (bounded + np.swapaxes(bounded, 1, 2)) / 2)
