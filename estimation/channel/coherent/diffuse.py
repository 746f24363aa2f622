"""Coherent maximum likelihood over a dense diffuse background.

Thousands of weak paths add to the noise of their cells. Their power over delay is estimated from the residual of
the found paths, without an assumed shape (RiMAX assumes an exponential decay; rooms have several). The delay bins
are whitened by it while paths are found, until both converge. A path must also exceed the background in its own
direction: the power that its matched filter shows at the delays around it, without strong paths, and the heavier
tail of powers if diffuse paths fill some cells and not others. The covariance of a path grows by the background in
its direction, and by a second factor if its residual shows unexplained samples (`misfit`).

With too few samples to separate the background from noise, it counts as noise.
"""

from dataclasses import replace

import numpy as np

from estimation.channel.coherent.background import background_along
from estimation.channel.coherent.misfit import misfit_factor, widen_covariances
from estimation.channel.coherent.paths import compress_stop, find_paths, path_fit, reported_delay_bins
from estimation.channel.coherent.plan import DelayWindow
from estimation.channel.coherent.prune import wald_statistic
from estimation.channel.coherent.refine import Reference, Solution
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, manifold_rates, residual, responses
from scenes.record import BoolArray, FloatArray, IntArray
from sim.observation import BeamSweep

NEAR_BINS = 12  # to either side, for the tail of the background
STRONG = 4.0  # power over the detection level, above which a path is no part of a background
UNEVEN = 1.06  # least scale of the background's tail that counts: two standard deviations in noise
STRONG_CELL = 40.0  # power of a cell above which it is no dense background
UNEXPLAINED = 3.0  # mean residual power in a path's own cells, above which it is more than noise


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
    noise_factor, stands_out = _direction_test(white, solution, stop.window)
    fit = path_fit(solution, white, stop.tx, stop.rx, sweep.noise_power_mw)
    factor = noise_factor * misfit_factor(Reference(white, solution.paths), solution)
    order = np.argsort(reported_delay_bins(white, solution.paths), kind="stable")  # of the paths in the fit
    fit = _widened(fit, factor[order], replace(white, tx=stop.tx, rx=stop.rx))
    kept: PathFit = fit.take("path", stands_out[order])
    return kept if len(kept) else replace(kept, status="no_paths")


def _widened(fit: PathFit, factor: FloatArray, sweep: CompressedSweep) -> PathFit:
    """A `fit` with covariances times factors (path,) by background and misfit; `sweep` has all beams."""
    reported = PathParameters(fit.delay_s / sweep.bin_s, fit.aod_rad, fit.aoa_rad, fit.amplitude.astype(complex))
    rate = manifold_rates(sweep, reported)
    rate[:, 0] /= sweep.bin_s
    return replace(fit, covariance=widen_covariances(fit.covariance, factor, rate))


def _direction_test(
    sweep: CompressedSweep, solution: Solution, window: DelayWindow
) -> tuple[FloatArray, BoolArray]:
    """Factor (path,), at least 1, that widens the paths' covariances; which paths exceed their background.

    Strong paths are removed from the background in a direction; weak ones, near the detection level, may be part
    of it and remain, but a path itself does not. The residual of all paths in a path's own cells widens its
    covariance too.
    """
    paths = solution.paths
    level = window.level_at(paths.delay_bins)
    at = responses(sweep, paths)
    energy = np.square(np.abs(at.tx[:, 0])).sum(axis=1) * np.square(np.abs(at.rx[:, 0])).sum(axis=1)
    energy *= np.square(at.delay[:, 0]).sum(axis=1)
    is_strong = np.square(np.abs(paths.amplitude)) * energy > STRONG * level
    parts = residual(sweep, paths.take(is_strong))
    noise_factor = background_along(sweep, parts, paths)
    residual_power = np.square(residual(sweep, paths)).sum(axis=0)
    tx, rx, delay = (np.square(np.abs(part[:, 0])) for part in (at.tx, at.rx, at.delay))
    own_factor = _mean_over_cells(residual_power, tx, rx, delay)
    tail = _tail_scale(residual_power, sweep.position, paths.delay_bins)
    needed = np.maximum(np.where(noise_factor > 1, noise_factor, 0.0), np.where(tail > UNEVEN, tail, 0.0))
    stands_out = wald_statistic(solution) >= needed * level
    return np.maximum(noise_factor, np.where(own_factor > UNEXPLAINED, own_factor, 1.0)), np.asarray(stands_out)


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


def _mean_over_cells(power: FloatArray, tx: FloatArray, rx: FloatArray, delay: FloatArray) -> FloatArray:
    """Mean residual power (path,) in the cells that paths fill, weighted by the share (path, cell) of a path."""
    by_delay = (delay / delay.sum(axis=1, keepdims=True)).astype(np.float32) @ power.reshape(-1, power.shape[2]).T
    beams = (tx[:, :, None] * rx[:, None]).reshape(len(tx), tx.shape[1] * rx.shape[1])
    return np.asarray((by_delay * beams).sum(axis=1) / beams.sum(axis=1))
