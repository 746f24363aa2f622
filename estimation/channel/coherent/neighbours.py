"""Covariance of paths that may have an undetected neighbour: the average over models with and without it.

A neighbour within half a resolution cell can escape every test of the model order: the path that is there moves
and absorbs it. The closer, the stronger it may be. So each path has a posterior over one hidden neighbour: its
place about the path and its complex amplitude (zero-mean Gaussian), at distances and powers that are equally
likely on logarithmic scales, and whether it exists. The number of neighbours per path is learned from all paths of
the stop. Given a neighbour, all paths near it shift by what the normal equations say, and the second moment of the
shifts adds to the covariance: the covariance of a model average (Hoeting et al., 1999) about the reported
estimate.
"""

import numpy as np

from estimation.channel.coherent.hidden import KnownPaths, ProbeScores, probes_about
from estimation.channel.coherent.refine import NEAR_CELLS, Reference, Solution
from estimation.channel.model.path_model import cells_apart, manifold_rates
from scenes.record import FloatArray

N_AXES = 2  # along which a neighbour may be off at once
OFFSETS = (0.5, 0.25, 0.125)  # of a neighbour along them, in resolution cells
NEIGHBOUR_POWER = 10.0 ** -np.arange(0, 4.5, 0.5)  # over that of the path
LARGEST_LOG = 600.0  # of a Bayes factor in double precision
LEARNING_STEPS = 50  # of the number of neighbours per path


def neighbour_covariance(
    reference: Reference, solution: Solution, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Covariance (path, parameter, parameter) by hidden neighbours, and probability (path,) that a path has one.

    `solution` is at the reference's paths; `noise` (path,) is the power that they compete with, white noise 1.
    """
    paths, rate = solution.paths, manifold_rates(reference.sweep, solution.paths)
    known, n, n_parameters = KnownPaths(reference, solution), len(paths), solution.slope.shape[1] - 2
    near = cells_apart(paths, paths, rate) <= NEAR_CELLS
    bayes_factor, tests, moments = np.zeros(n), [], []
    for path in range(n):
        probes = probes_about(paths.take(np.array([path])), rate[path], N_AXES, OFFSETS)
        test = known.test(probes, near[:, path])
        away = cells_apart(probes, paths.take(test.near), rate[test.near])
        n_owners = (away <= 1.001 * max(OFFSETS)).sum(axis=1)
        share = 1 / len(probes) / np.maximum(n_owners, 1)  # a place near several paths belongs to all of them
        factor, moment = _amplitude_posterior(test, float(np.abs(paths.amplitude[path]) ** 2), noise[path])
        bayes_factor[path] = share @ factor
        tests.append(test)
        moments.append(share[:, None, None] * moment)
    odds = _learned_odds(bayes_factor)
    weight = odds / (1 + odds * bayes_factor)
    covariance = np.zeros((n, n_parameters, n_parameters))
    for path, (test, moment) in enumerate(zip(tests, moments, strict=True)):
        turned = np.einsum("qij,qjpk->qipk", weight[path] * moment, test.shift)
        covariance[test.near] += np.einsum("qipk,qipl->pkl", turned, test.shift)
    return covariance, np.minimum(weight * bayes_factor, 1.0)


def _amplitude_posterior(test: ProbeScores, power: float, noise: float) -> tuple[FloatArray, FloatArray]:
    """Bayes factor (probe,) of a neighbour, and that times the second moment (probe, 2, 2) of its amplitude.

    Both are means over the powers of neighbours relative to `power`.
    """
    value, axes = np.linalg.eigh((test.own + test.own.swapaxes(1, 2)) / (2 * noise))
    score = np.einsum("qij,qi->qj", axes, test.score) / noise
    variance = NEIGHBOUR_POWER[:, None, None] * power
    precision = np.maximum(value, 0.0) + 1 / variance
    mean = score / precision
    log_factor = (score * mean).sum(axis=2) - np.log(variance[..., 0]) - np.log(precision).sum(axis=2) / 2
    factor = np.exp(np.minimum(log_factor, LARGEST_LOG)) / len(NEIGHBOUR_POWER)
    moment = np.eye(2) * (0.5 / precision)[..., None] + mean[..., None] * mean[..., None, :]
    total = np.einsum("kq,kqij->qij", factor, moment)
    return factor.sum(axis=0), axes @ total @ axes.swapaxes(1, 2)


def _learned_odds(bayes_factor: FloatArray) -> float:
    """Prior odds of a neighbour, from all paths of a stop by expectation maximisation with Jeffreys' prior."""
    odds, n = 1.0, len(bayes_factor)
    for _ in range(LEARNING_STEPS):
        expected = float((odds * bayes_factor / (1 + odds * bayes_factor)).sum())
        odds = (expected + 0.5) / (n - expected + 0.5)
    return odds
