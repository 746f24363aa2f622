"""Coherent maximum likelihood over a dense diffuse background.

Thousands of weak paths add to the noise of their cells. Their power over delay is estimated from the residual of
the found paths, without an assumed shape (RiMAX assumes an exponential decay; rooms have several). The delay bins
are whitened by it while paths are found, until both converge. Paths that are not resolved, or that sums of weak
fields may show, are marked as weak. The covariance of a path is that of noise, scaled by what the residual shows
of the weak field about it (`misfit`), plus that by undetected neighbours (`neighbours`).

With too few samples to separate the background from noise, it counts as noise.
"""

from dataclasses import replace

import numpy as np

from estimation.channel.coherent.cancel import has_neighbour, is_lost
from estimation.channel.coherent.hidden import seen_axes
from estimation.channel.coherent.misfit import PathErrors, error_scale, quadrature_statistic, weak_field
from estimation.channel.coherent.moving import shift_covariance
from estimation.channel.coherent.neighbours import neighbour_covariance
from estimation.channel.coherent.pair_errors import PairErrors
from estimation.channel.coherent.paths import ROUND_STEPS, compress_stop, find_paths, path_fit, reported_delay_bins
from estimation.channel.coherent.plan import DelayWindow
from estimation.channel.coherent.prune import redundant_paths, wald_statistic
from estimation.channel.coherent.refine import Reference, Solution, joint_covariance, refine_near, response_powers
from estimation.channel.coherent.search import searched_turns
from estimation.channel.companions import companions
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit, empty_fit
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, manifold_rates
from scenes.record import BoolArray, FloatArray
from sim.observation import BeamSweep

OWN_SHARE = 0.5  # of the energy of a path, which others cannot replace: with less it may be redundant
QUADRANT_VARIANCE = (np.pi / 2) ** 2 / 12  # of an azimuth in a quadrant: at the edge of a panel, cells are as wide


def fit_over_background(
    sweep: BeamSweep,
    config: MaximumLikelihoodConfig | None = None,
    tx_manifold: Manifold | None = None,
    rx_manifold: Manifold | None = None,
    pair_errors: PairErrors | None = None,
) -> PathFit:
    """Paths of one stop by coherent maximum likelihood; dense diffuse multipath counts as noise.

    Arguments and errors are those of `fit_coherent`; without a background so are the paths. `pair_errors`
    are the errors of beam pairs, if they differ.
    """
    stop = compress_stop(sweep, config, tx_manifold, rx_manifold, pair_errors)
    if isinstance(stop, PathFit):
        return stop
    white, solution = find_paths(stop.compressed, stop.window, stop.plan, stop.config)
    if pair_errors is not None and not len(solution.paths):
        return empty_fit(stop.tx.n_angles, stop.rx.n_angles, "no_paths")
    solution = resolved_paths(white, solution, stop.window)
    reference = Reference(white, solution.paths)
    errors = path_errors(reference, solution, stop.window)
    turns = searched_turns(white.turns, stop.plan.grids, stop.plan.oversampling)
    if len(turns):
        errors = replace(errors, beside=errors.beside + shift_covariance(reference, solution, turns))
    fit = path_fit(solution, white, stop.tx, stop.rx, sweep.noise_power_mw, errors)
    weak = _is_weak(fit, replace(white, tx=stop.tx, rx=stop.rx), stop.window.level)
    if white.turns is None and len(fit):
        is_weak = np.zeros(len(fit), bool)
        is_weak[np.argsort(reported_delay_bins(white, solution.paths), kind="stable")] = weak
        field = weak_field(reference, solution.paths, is_weak)
        errors = replace(errors, scale=np.maximum(errors.scale, field))
        fit = path_fit(solution, white, stop.tx, stop.rx, sweep.noise_power_mw, errors)
    return replace(fit, is_weak=weak)


def resolved_paths(sweep: CompressedSweep, solution: Solution, window: DelayWindow) -> Solution:
    """The solution without redundant paths that have a neighbour within half a cell; the others are fitted again.

    Strong paths that the model does not describe exactly are found as several. The errors of the model explain
    the others as well, and each of them would take the place of the one path with a share of its power.
    """
    for _ in range(len(solution.paths)):
        reference = Reference(sweep, solution.paths)
        scale = _noise_scale(reference, solution, window)
        out = _redundant(solution, scale, window) & has_neighbour(solution)
        if not out.any():
            break
        kept, without = solution.paths.take(~out), solution.paths.take(out)
        solution = refine_near(reference, kept, without, ROUND_STEPS)
    return solution


def path_errors(reference: Reference, solution: Solution, window: DelayWindow) -> PathErrors:
    """Errors by noise, times the scale that the quadrature shows (`error_scale`), plus those by neighbours."""
    scale = _noise_scale(reference, solution, window)
    by_neighbours, probability = neighbour_covariance(reference, solution, window.noise_at(solution.paths))
    lost = 0.0 if window.pairs is None else window.pairs.lost_information(reference.sweep, solution.paths)
    by_noise = joint_covariance(solution, reference.sweep.n_subcarriers, lost)
    is_redundant = _redundant(solution, scale, window)
    if window.pairs is not None:
        is_redundant |= window.pairs.may_be_floor(solution.paths, reference.sweep.n_subcarriers)
    return PathErrors(by_noise, scale, by_neighbours, probability, is_redundant)


def _noise_scale(reference: Reference, solution: Solution, window: DelayWindow) -> FloatArray:
    """Scale (path,) of the noise that the quadrature shows, at least the noise of the path's beam pairs."""
    shown = error_scale(*quadrature_statistic(reference, solution))
    return np.maximum(shown, window.noise_at(solution.paths))


def _redundant(solution: Solution, scale: FloatArray, window: DelayWindow) -> BoolArray:
    """Mask (path,) of the paths that others can replace: the errors of the model reach as far.

    The others share most of the energy of such a path, and what it adds is below its level in the window times the
    `scale` (path,) of the noise.
    """
    is_small = wald_statistic(solution) < OWN_SHARE * response_powers(solution)
    return redundant_paths(solution, scale * window.white_level_at(solution.paths.delay_bins)) & is_small


def _is_weak(fit: PathFit, sweep: CompressedSweep, level: float) -> BoolArray:
    """Mask (path,) of paths that are redundant, companions, faint over a background, or not resolved.

    Those below the `level` in every beam pair show only in many beams together; over a background so does the sum
    of weak paths. The `sweep` has all beams.
    """
    is_faint = _is_over_background(sweep, fit.delay_s / sweep.bin_s) & (fit.snr_db < 10 * np.log10(level))
    return np.asarray(fit.is_weak | _is_unresolved(fit, sweep) | companions(fit, sweep.tx, sweep.rx) | is_faint)


def _is_unresolved(fit: PathFit, sweep: CompressedSweep) -> BoolArray:
    """Mask (path,) of paths known no better than to their cell, or to a quadrant.

    They are parts of a group that the data cannot resolve. The `sweep` has all beams.
    """
    paths = PathParameters(
        fit.delay_s / sweep.bin_s, fit.aod_rad, fit.aoa_rad, fit.amplitude.astype(complex), fit.doppler_hz
    )
    n_places = 1 + sweep.tx.n_angles + sweep.rx.n_angles
    rate = manifold_rates(sweep, paths)[:, :n_places]
    rate[:, 0] /= sweep.bin_s
    variance = np.einsum("ipp->ip", fit.covariance)[:, :n_places]
    azimuths = [1, 1 + sweep.tx.n_angles]
    is_beyond = (seen_axes(rate).any(axis=0) & (variance > QUADRANT_VARIANCE))[:, azimuths].any(axis=1)
    return np.asarray(is_lost(variance, rate) | is_beyond)


def _is_over_background(sweep: CompressedSweep, delay_bins: FloatArray) -> BoolArray:
    """Mask (path,) of the delays where the sweep was whitened by a background above the noise."""
    half = sweep.n_subcarriers / 2
    apart = np.abs((sweep.position - delay_bins[:, None] + half) % sweep.n_subcarriers - half)
    return np.asarray(sweep.weight[apart.argmin(axis=1)] < 1)
