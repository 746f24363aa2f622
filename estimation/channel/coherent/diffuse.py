"""Coherent maximum likelihood over a dense diffuse background.

Thousands of weak paths add to the noise of their cells. Their power over delay is estimated from the residual of
the found paths, without an assumed shape (RiMAX assumes an exponential decay; rooms have several). The delay bins
are whitened by it while paths are found, until both converge. A path must also exceed the background in its own
direction: the power that its matched filter shows at the delays around it, without strong paths, and the heavier
tail of powers if diffuse paths fill some cells and not others. The covariance of a path is that of noise, scaled
by what the residual shows of the weak field about it (`misfit`), plus that by undetected neighbours
(`neighbours`).

With too few samples to separate the background from noise, it counts as noise.
"""

from dataclasses import replace

import numpy as np

from estimation.channel.coherent.background import background_along
from estimation.channel.coherent.misfit import error_scale, quadrature_statistic
from estimation.channel.coherent.neighbours import neighbour_covariance
from estimation.channel.coherent.paths import PathErrors, compress_stop, find_paths, path_fit, reported_delay_bins
from estimation.channel.coherent.plan import DelayWindow
from estimation.channel.coherent.prune import wald_statistic
from estimation.channel.coherent.refine import Reference, Solution, marginal_covariances
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import residual, responses
from scenes.record import BoolArray, FloatArray, IntArray
from sim.observation import BeamSweep

NEAR_BINS = 12  # to either side, for the tail of the background
STRONG = 4.0  # power over the detection level, above which a path is no part of a background
UNEVEN = 1.06  # least scale of the background's tail that counts: two standard deviations in noise
STRONG_CELL = 40.0  # power of a cell above which it is no dense background


def fit_over_background(
    sweep: BeamSweep,
    config: MaximumLikelihoodConfig | None = None,
    tx_manifold: Manifold | None = None,
    rx_manifold: Manifold | None = None,
) -> PathFit:
    """Paths of one stop by coherent maximum likelihood; dense diffuse multipath counts as noise.

    As `fit_coherent`, with equal results if there is no background.
    """
    stop = compress_stop(sweep, config, tx_manifold, rx_manifold)
    if isinstance(stop, PathFit):
        return stop
    white, solution = find_paths(stop.compressed, stop.window, stop.plan, stop.config)
    reference = Reference(white, solution.paths)
    errors = path_errors(reference, solution)
    fit = path_fit(solution, white, stop.tx, stop.rx, sweep.noise_power_mw, errors)
    stands_out = _stands_out(white, solution, stop.window)
    order = np.argsort(reported_delay_bins(white, solution.paths), kind="stable")  # of the paths in the fit
    kept: PathFit = fit.take("path", stands_out[order])
    return kept if len(kept) else replace(kept, status="no_paths")


def path_errors(reference: Reference, solution: Solution) -> PathErrors:
    """Errors by noise, times the scale that the quadrature shows (`error_scale`), plus those by neighbours."""
    by_neighbours, probability = neighbour_covariance(reference, solution)
    scale = error_scale(*quadrature_statistic(reference, solution))
    by_noise = marginal_covariances(solution, reference.sweep.n_subcarriers)
    return PathErrors(scale[:, None, None] * by_noise + by_neighbours, probability)


def _stands_out(sweep: CompressedSweep, solution: Solution, window: DelayWindow) -> BoolArray:
    """Mask (path,) of the paths that exceed the background in their direction, and its tail.

    Strong paths are removed from the background in a direction; weak ones, near the detection level, may be part
    of it and remain, but a path itself does not.
    """
    paths = solution.paths
    level = window.level_at(paths.delay_bins)
    at = responses(sweep, paths)
    energy = np.square(np.abs(at.tx[:, 0])).sum(axis=1) * np.square(np.abs(at.rx[:, 0])).sum(axis=1)
    energy *= np.square(at.delay[:, 0]).sum(axis=1)
    is_strong = np.square(np.abs(paths.amplitude)) * energy > STRONG * level
    parts = residual(sweep, paths.take(is_strong))
    along = background_along(sweep, parts, paths)
    residual_power = np.square(residual(sweep, paths)).sum(axis=0)
    tail = _tail_scale(residual_power, sweep.position, paths.delay_bins)
    needed = np.maximum(np.where(along > 1, along, 0.0), np.where(tail > UNEVEN, tail, 0.0))
    return np.asarray(wald_statistic(solution) >= needed * level)


def _tail_scale(power: FloatArray, position: IntArray, delay_bins: FloatArray) -> FloatArray:
    """Scale (path,) of the tail of the residual power (tx_rank, rx_rank, bin) around a path; 1 for noise.

    The power of noise is exponential, and so is that of cells with diffuse paths; but if these do not fill all
    cells, high powers come only from the filled ones. For a mixture of exponentials a third of the mean cube over
    the mean square is the mean scale of the cells of high power. Much stronger cells are residuals of strong
    paths.
    """
    weak = np.where(power < STRONG_CELL, power, 0.0)
    square = np.square(weak).mean(axis=(0, 1), dtype=float)
    cube = np.power(weak, 3).mean(axis=(0, 1), dtype=float)
    is_near = np.abs(position - delay_bins[:, None]) <= NEAR_BINS
    return np.asarray(is_near @ cube / 3 / np.maximum(is_near @ square, np.finfo(float).tiny))
