"""Coherent maximum likelihood over a dense diffuse background.

Thousands of weak paths add to the noise of their cells. Their power over delay is estimated from the residual of
the found paths, without an assumed shape (RiMAX assumes an exponential decay; rooms have several). The delay bins
are whitened by it and the paths are found again, until both converge. A path must also exceed the background in
its own direction: the power that its matched filter shows at the delays around it, without strong paths, and the
heavier tail of powers if diffuse paths fill some cells and not others. The covariance of a path grows by the
background in its direction, and by a second factor if its residual shows unexplained samples (`misfit`).

With too few samples to separate the background from noise, it counts as noise.
"""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.coherent.misfit import misfit_factor, widen_covariances
from estimation.channel.coherent.paths import PreparedStop, compress_stop, fit_paths, path_fit
from estimation.channel.coherent.plan import DelayWindow
from estimation.channel.coherent.prune import wald_statistic
from estimation.channel.coherent.refine import Reference, Solution
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, manifold_rates, responses
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray
from sim.observation import BeamSweep

MAX_TURNS = 3
SMOOTHING_BINS = 2  # to either side, for the background's power over delay
NOISE_STD = 5.0  # deviation of a smoothed bin's power up to which it counts as noise
KEPT_SHARE = 0.95  # of the directions, from the weakest up, that the background is estimated from
AROUND_BINS = 24  # to either side of a path, for the background in its direction
NEAR_BINS = 12  # to either side, for the tail of the background
OWN_BINS = 2  # to either side, filled by the path itself
STRONG = 4.0  # power over the detection level, above which a path is no part of a background
NOTABLE = 1.7  # least background in a direction that counts: noise alone exceeds it once in 250 times
UNEVEN = 1.06  # least scale of the background's tail that counts: two standard deviations in noise
STRONG_CELL = 40.0  # power of a cell above which it is no dense background
UNEXPLAINED = 3.0  # mean residual power in a path's own cells, above which it is more than noise
CHANGED = 0.1  # relative change of the background above which the iteration continues


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
    found = _converged(stop)
    fit = path_fit(found.solution, found.sweep, stop.tx, stop.rx, sweep.noise_power_mw)
    return _reported(found, fit, stop.tx, stop.rx)


@dataclass(frozen=True)
class _Found:
    """Paths found after whitening by a background, and the background in the residual of those that exceed it."""

    sweep: CompressedSweep  # whitened
    solution: Solution
    noise_factor: FloatArray  # (path,) power of the background about the path, over the whitened noise
    stands_out: BoolArray  # (path,)
    background: FloatArray  # (bin,) noise power of every delay bin without the paths, receiver noise 1


def _converged(stop: PreparedStop) -> _Found:
    """Alternate between finding paths and estimating the background from their residual until both converge."""
    background = np.ones(len(stop.compressed.position))
    found = _turn(stop, background)
    for _ in range(MAX_TURNS if stop.config.whiten_background else 0):
        changed = np.abs(found.background / background - 1).max() > CHANGED
        if not changed:
            break
        background = found.background
        found = _turn(stop, background)
    return found


def _turn(stop: PreparedStop, background: FloatArray) -> _Found:
    sweep, window = stop.compressed, stop.window
    white = sweep
    if (background > 1).any():
        ranks = sweep.samples.shape[:2]
        white = sweep.whitened(np.eye(ranks[0]), np.eye(ranks[1]), np.sqrt(background))
    solution = fit_paths(white, window, stop.plan, stop.config)
    noise_factor, stands_out = _direction_test(white, solution, window)
    residual = without_paths(sweep, solution.paths.take(stands_out))
    return _Found(white, solution, noise_factor, stands_out, background_over_delay(residual))


def _reported(found: _Found, fit: PathFit, tx: Manifold, rx: Manifold) -> PathFit:
    """The paths of a `fit` that exceed the background, their covariances widened by background and misfit."""
    n, paths = found.sweep.n_subcarriers, found.solution.paths
    delay_bins = (paths.delay_bins + n / 8) % n - n / 8
    order = np.argsort(delay_bins, kind="stable")
    factor = found.noise_factor * misfit_factor(Reference(found.sweep, paths), found.solution)
    reported = PathParameters(
        fit.delay_s / found.sweep.bin_s, fit.aod_rad, fit.aoa_rad, fit.amplitude.astype(complex)
    )
    rate = manifold_rates(replace(found.sweep, tx=tx, rx=rx), reported)
    rate[:, 0] /= found.sweep.bin_s
    fit = replace(fit, covariance=widen_covariances(fit.covariance, factor[order], rate))
    kept: PathFit = fit.take("path", found.stands_out[order])
    return kept if len(kept) else replace(kept, status="no_paths")


def background_over_delay(residual: ComplexArray) -> FloatArray:
    """Smoothed power (bin,) of the residual (tx_rank, rx_rank, bin) of the paths; 1 if noise explains it.

    The strongest directions are left out: power only there, such as of unresolved paths, is no dense background.
    The mean of an exponential variable below its quantile p is 1 + (1 - p) log(1 - p) / p.
    """
    directions = np.sort(np.square(np.abs(residual)).reshape(-1, residual.shape[2]), axis=0)
    n_kept = max(1, int(np.ceil(KEPT_SHARE * len(directions))))
    share = n_kept / len(directions)
    expected = 1 + (1 - share) * np.log(1 - share) / share if share < 1 else 1.0
    power = directions[:n_kept].mean(axis=0, dtype=float) / expected
    width = 2 * SMOOTHING_BINS + 1
    smooth = np.convolve(np.pad(power, SMOOTHING_BINS, mode="edge"), np.ones(width) / width, "valid")
    n_cells = residual.shape[0] * residual.shape[1] * width
    return np.where(smooth > 1 + NOISE_STD / np.sqrt(n_cells), smooth, 1.0)


def without_paths(sweep: CompressedSweep, paths: PathParameters) -> ComplexArray:
    """The samples (tx_rank, rx_rank, bin) of a compressed sweep minus the signals of the paths."""
    at = responses(sweep, paths)
    tx, rx, delay = at.tx[:, 0], at.rx[:, 0], at.delay[:, 0]
    beams = (paths.amplitude[:, None, None] * tx[:, :, None] * rx[:, None]).reshape(
        len(paths), tx.shape[1] * rx.shape[1]
    )
    return np.asarray(sweep.samples - (beams.T @ delay).reshape(sweep.samples.shape))


def _direction_test(
    sweep: CompressedSweep, solution: Solution, window: DelayWindow
) -> tuple[FloatArray, BoolArray]:
    """Factor (path,), at least 1, that widens the paths' covariances; which paths exceed their background.

    Strong paths are removed from the background in a direction; weak ones, near the detection level, may be part
    of it and remain. The residual of all paths in a path's own cells widens its covariance too.
    """
    paths = solution.paths
    level = window.level_at(paths.delay_bins)
    at = responses(sweep, paths)
    energy = np.square(np.abs(at.tx[:, 0])).sum(axis=1) * np.square(np.abs(at.rx[:, 0])).sum(axis=1)
    energy *= np.square(at.delay[:, 0]).sum(axis=1)
    is_strong = np.square(np.abs(paths.amplitude)) * energy > STRONG * level
    residual = without_paths(sweep, paths.take(is_strong))
    residual_power = np.square(np.abs(without_paths(sweep, paths)))
    noise_factor, own_factor = np.ones(len(paths)), np.ones(len(paths))
    for path in range(len(paths)):
        beams = paths.amplitude[path] * at.tx[path, 0][:, None] * at.rx[path, 0]
        own = 0.0 if is_strong[path] else beams[:, :, None] * at.delay[path, 0]
        noise_factor[path] = _background_along(
            residual - own, at.tx[path, 0], at.rx[path, 0], sweep.position - paths.delay_bins[path]
        )
        own_factor[path] = _mean_over_cells(residual_power, at.tx[path, 0], at.rx[path, 0], at.delay[path, 0])
    tail = _tail_scale(residual_power, sweep.position, paths.delay_bins)
    needed = np.maximum(np.where(noise_factor > NOTABLE, noise_factor, 0.0), np.where(tail > UNEVEN, tail, 0.0))
    stands_out = wald_statistic(solution) >= needed * level
    widened = np.maximum(
        np.where(noise_factor > NOTABLE, noise_factor, 1.0), np.where(own_factor > UNEXPLAINED, own_factor, 1.0)
    )
    return widened, np.asarray(stands_out)


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


def _mean_over_cells(power: FloatArray, tx: ComplexArray, rx: ComplexArray, delay: FloatArray) -> float:
    """Mean residual power in the cells that a path fills, weighted by the share of the path in them."""
    weights = [np.square(np.abs(part)) for part in (tx, rx, delay)]
    total = np.einsum("m,mnd,n,d->", weights[0], power, weights[1], weights[2], optimize=True)
    return float(total / np.prod([weight.sum() for weight in weights]))


def _background_along(
    residual: ComplexArray, tx: ComplexArray, rx: ComplexArray, offset_bins: FloatArray
) -> float:
    """Noise power about a path in the output of its direction's matched filter, at least 1.

    It is the median over the delays around the path, so a few other paths there do not count.
    """
    beside = (np.abs(offset_bins) > OWN_BINS) & (np.abs(offset_bins) <= AROUND_BINS)
    if beside.sum() < AROUND_BINS:
        return 1.0
    filtered = np.einsum("m,mnd,n->d", tx.conj(), residual[:, :, beside], rx.conj(), optimize=True)
    energy = np.square(np.abs(tx)).sum() * np.square(np.abs(rx)).sum()
    return float(max(1.0, np.median(np.square(np.abs(filtered))) / np.log(2) / energy))
