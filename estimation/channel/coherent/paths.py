"""Coherent maximum likelihood: all paths of a stop jointly, phases known from beam pair to beam pair.

The sweep is whitened, compressed without loss and searched by matched filter. Peaks that side lobes do not explain
are refined, tested and fitted jointly with all others, round by round until the residual is noise. The idea is
that of Newtonised orthogonal matching pursuit (Mamandipoor, Ramasamy and Madhow, 2016), with batches of paths,
false alarms controlled over the continuous field, and the model order decided by likelihood ratios.
"""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.coherent.cancel import without_cancelling_paths
from estimation.channel.coherent.elevated import merge_elevated_images
from estimation.channel.coherent.hidden import hidden_second_paths
from estimation.channel.coherent.maxima import HigherMaximum
from estimation.channel.coherent.misfit import PathErrors, background_over_delay
from estimation.channel.coherent.moving import at_likeliest_turns, finer_turns, freeze_still_paths
from estimation.channel.coherent.pair_errors import LitPairs, PairErrors
from estimation.channel.coherent.plan import (
    SCALLOPING,
    DelayWindow,
    SearchPlan,
    delay_window,
    nominal_manifold,
    search_plan,
)
from estimation.channel.coherent.prune import prune_paths
from estimation.channel.coherent.raised import raised_paths
from estimation.channel.coherent.refine import (
    FEW,
    Reference,
    Solution,
    joint_covariance,
    refine_paths,
    refine_separately,
    solve_at,
)
from estimation.channel.coherent.search import SpectrumPeaks, SpectrumSearch, without_side_lobes
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.correlation import correlated_paths
from estimation.channel.fit import PathFit, empty_fit
from estimation.channel.model.apparent import reported_angles, reported_slopes
from estimation.channel.model.compress import CompressedSweep, check_sweep, compress
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, no_paths, residual
from estimation.channel.model.turns import sweep_turns
from scenes.pose import wrap_angle
from scenes.record import FloatArray
from sim.observation import BeamSweep

MAX_ROUNDS = 60
LEAST_OF_ROUND = 10**-0.5  # of a round's strongest peak, in amplitude: 10 dB
MAX_PASSES = 6  # of moves to higher maxima and convergence
LIMIT_PASSES = 2  # of as many paths as there may be: what is left out shifts them more than further passes
PASS_STEPS = 8  # of many paths in a pass
CHANGED = 0.1  # relative change of the background above which the search goes on
ROUND_STEPS = 3  # Levenberg-Marquardt steps per round: undetected paths would bias further steps
FINAL_STEPS = 30
CERTAIN = 1.5  # times the detection level, above which a grid peak needs no refined test
SIDE_LOBE_MARGIN = 1.7  # in amplitude: above the loss of a peak on a search grid of two points per cell


def fit_coherent(
    sweep: BeamSweep,
    config: MaximumLikelihoodConfig | None = None,
    tx_manifold: Manifold | None = None,
    rx_manifold: Manifold | None = None,
) -> PathFit:
    """Paths of one stop by coherent maximum likelihood, with the covariance of each.

    The default manifolds are those of the sweep's nominal codebooks; others, such as of calibrated arrays, can be
    given. Zero paths are valid, and so are samples that are all zero: see the status.

    Raises `ValueError` For a sweep without beams, subcarriers or noise power, and for samples that are not
    finite; in one line.
    """
    stop = compress_stop(sweep, config, tx_manifold, rx_manifold)
    if isinstance(stop, PathFit):
        return stop
    solution = fit_paths(stop.compressed, stop.window, stop.plan, stop.config)
    by_noise = joint_covariance(solution, stop.compressed.n_subcarriers)
    none, beside = np.zeros(len(by_noise)), np.zeros_like(by_noise[:, :, 0])
    errors = PathErrors(by_noise, np.ones_like(none), beside, none, none.astype(bool))
    return path_fit(solution, stop.compressed, stop.tx, stop.rx, sweep.noise_power_mw, errors)


@dataclass(frozen=True)
class PreparedStop:
    """A stop ready for the search of paths; `tx` and `rx` are the manifolds of all beams."""

    compressed: CompressedSweep
    window: DelayWindow
    plan: SearchPlan
    config: MaximumLikelihoodConfig
    tx: Manifold
    rx: Manifold


def compress_stop(
    sweep: BeamSweep,
    config: MaximumLikelihoodConfig | None,
    tx_manifold: Manifold | None,
    rx_manifold: Manifold | None,
    pair_errors: PairErrors | None = None,
) -> PreparedStop | PathFit:
    """The compressed samples of a stop at the delays that may hold paths, or the empty fit if there are none.

    Arguments and errors are those of `fit_over_background`.
    """
    config = config or MaximumLikelihoodConfig()
    check_sweep(sweep)
    tx = tx_manifold or nominal_manifold(sweep.tx_codebook)
    rx = rx_manifold or nominal_manifold(sweep.rx_codebook)
    turns = None if pair_errors is not None else sweep_turns(sweep, config.max_length_rate_m_s)
    plan = search_plan(tx, rx, tuple(sweep.noise_power_mw.tolist()), config.oversampling, turns)
    cube = compress(sweep, plan.tx, plan.rx, turns)
    if not cube.spectrum.any():
        return empty_fit(tx.n_angles, rx.n_angles, "no_signal")
    window = delay_window(cube, plan, config)
    if window is None:
        return empty_fit(tx.n_angles, rx.n_angles, "no_paths")
    if pair_errors is not None:
        window = replace(window, pairs=LitPairs(tx, rx, sweep.noise_power_mw, pair_errors))
    compressed = cube.window(window.position).with_hidden_elevation()
    return PreparedStop(compressed, window, plan, config, tx, rx)


def fit_paths(
    sweep: CompressedSweep, window: DelayWindow, plan: SearchPlan, config: MaximumLikelihoodConfig
) -> Solution:
    """Paths in a compressed sweep of white noise; as `find_paths` without a background."""
    return find_paths(sweep, window, plan, config.model_copy(update={"whiten_background": False}))[1]


def find_paths(
    sweep: CompressedSweep, window: DelayWindow, plan: SearchPlan, config: MaximumLikelihoodConfig
) -> tuple[CompressedSweep, Solution]:
    """Paths in a compressed sweep, and the sweep whitened by the background that they leave.

    Every round finds paths in the residual, fits them jointly with all others, prunes, and estimates the
    background from the new residual. It ends when nothing new explains more and the background stays. Where no
    path is found, moves to higher maxima take turns with convergence as long as they are worth a path. After the
    strongest paths a background is too high, never too low: weaker ones follow as it falls. Much weaker peaks than
    a round's strongest wait for a later one, unless the round is in vain: what strong paths leave at their first
    places would become paths. Not so where beam pairs err: there strong peaks are what errors leave.
    """
    background, white = np.ones(len(sweep.position)), sweep
    reference = Reference(white, no_paths(sweep))
    solution = solve_at(reference, reference.paths)
    most, n_passes = min(config.max_paths, _most_paths(sweep)), 0
    search = SpectrumSearch(white, plan.grids, plan.oversampling)
    higher_maximum = HigherMaximum(plan.grids, search.turns, window.level)
    least_share = LEAST_OF_ROUND if window.pairs is None else 0.0
    share = least_share
    for _ in range(MAX_ROUNDS):
        room = most - len(solution.paths)
        new, is_changed = _new_paths(search, reference, window, room, share), False
        if len(new):
            grown = _joined(reference, solution, new, window)
            is_changed = grown is not solution or share > 0  # after a round in vain, all peaks are tried
            share = 0.0 if grown is solution else least_share
            solution = grown
        if not is_changed and n_passes < (MAX_PASSES if room > 0 else LIMIT_PASSES):
            n_passes += 1
            finished = _finished(reference, higher_maximum(reference, solution), window, PASS_STEPS, most)
            is_changed = _worth(finished, window) > _worth(solution, window) + window.level / 2
            solution, reference = finished, Reference(white, finished.paths)
            if not is_changed and room > 0:
                second = hidden_second_paths(reference, solution, window.level).take(slice(room))
                grown = _joined(reference, solution, second, window)
                is_changed, solution = grown is not solution, grown
        now = _background(sweep, solution.paths, config)
        if np.abs(now / background - 1).max() > CHANGED:
            background, white, is_changed = now, sweep.over_background(now), True
            search = SpectrumSearch(white, plan.grids, plan.oversampling)
        reference = Reference(white, solution.paths)
        solution = solve_at(reference, solution.paths)
        if not is_changed:
            break
    finished = _finished(reference, solution, window, FINAL_STEPS, most)
    return white, freeze_still_paths(Reference(white, finished.paths), finished, FINAL_STEPS)


def _joined(reference: Reference, solution: Solution, new: PathParameters, window: DelayWindow) -> Solution:
    """The solution with new paths, pruned; the same solution where all of them are worth less than a path."""
    if not len(new):
        return solution
    trial = refine_paths(reference, solution.paths.joined(new), ROUND_STEPS)
    trial = prune_paths(reference, trial, window.level_at, ROUND_STEPS)
    trial = without_cancelling_paths(reference, trial, ROUND_STEPS)
    return trial if trial.explained - solution.explained >= window.level / 2 else solution


def _background(sweep: CompressedSweep, paths: PathParameters, config: MaximumLikelihoodConfig) -> FloatArray:
    """Noise power (bin,) of every delay bin without the paths, receiver noise 1."""
    if not config.whiten_background:
        return np.ones(len(sweep.position))
    return background_over_delay(replace(sweep, parts=residual(sweep, paths)).samples)


def _worth(solution: Solution, window: DelayWindow) -> float:
    """What the paths of a solution explain beyond the level that each of them needs."""
    return solution.explained - window.level * len(solution.paths)


def _finished(
    reference: Reference, solution: Solution, window: DelayWindow, many_steps: int, most: int
) -> Solution:
    """The converged solution after `merge_elevated_images`."""
    solution = _converged(reference, solution, window, many_steps, most)
    above = merge_elevated_images(reference, solution, window.level_at, FINAL_STEPS)
    return solution if above is solution else _converged(reference, above, window, many_steps, most)


def _converged(
    reference: Reference, solution: Solution, window: DelayWindow, many_steps: int, most: int
) -> Solution:
    """The solution without paths that are redundant or cancel each other, after convergence.

    Many paths, or as many as there may be at `most`, take `many_steps`, and a few after each change: their
    neighbours hardly move, and what is left out shifts them more than further steps.
    """
    is_few = len(solution.paths) <= min(FEW, most - 1)
    steps, after = (FINAL_STEPS, FINAL_STEPS) if is_few else (many_steps, ROUND_STEPS)
    solution = prune_paths(reference, refine_paths(reference, solution.paths, steps), window.level_at, after)
    apart = without_cancelling_paths(reference, solution, after)
    if apart is solution:
        return solution
    return without_cancelling_paths(reference, prune_paths(reference, apart, window.level_at, after), after)


def path_fit(
    solution: Solution,
    sweep: CompressedSweep,
    tx: Manifold,
    rx: Manifold,
    noise_power_mw: FloatArray,
    errors: PathErrors,
) -> PathFit:
    """A solution in physical units, sorted by delay; `tx` and `rx` are the manifolds of all beams."""
    paths, n = solution.paths, sweep.n_subcarriers
    delay_bins = reported_delay_bins(sweep, paths)
    delay_s = delay_bins * sweep.bin_s
    turns = np.round((delay_bins - paths.delay_bins) / n)  # every period rotates the phase at the band centre
    gain = paths.amplitude * np.sqrt(sweep.noise_scale) * np.where(turns * (n - 1) % 2, -1, 1)
    aod_rad, aod_slopes, tx_factor = reported_angles(tx, paths.aod_rad)
    aoa_rad, aoa_slopes, rx_factor = reported_angles(rx, paths.aoa_rad)
    gain = gain * np.exp(2j * np.pi * sweep.centre_hz * delay_s) * tx_factor * rx_factor
    tx_gain = np.abs(tx.response(aod_rad)) ** 2
    rx_gain = np.abs(rx.response(aoa_rad)) ** 2 / noise_power_mw
    snr = np.abs(gain) ** 2 * tx_gain.max(axis=1) * rx_gain.max(axis=1) * n / sweep.noise_scale
    slopes = reported_slopes(aod_slopes, aoa_slopes, paths.doppler_turns.shape[1])
    slopes[:, 0] *= sweep.bin_s
    doppler_hz, seen_s = np.zeros((len(paths), 0)), np.zeros(len(paths))
    if sweep.turns is not None:
        doppler_hz = paths.doppler_turns / sweep.turns.span_s
        seen_s = sweep.turns.span_s * sweep.turns.mean_time(
            sweep.tx.response(paths.aod_rad), sweep.rx.response(paths.aoa_rad)
        )
        delay_s = delay_s + doppler_hz[:, 0] * seen_s / sweep.turns.carrier_hz
        slopes[:, -1] /= sweep.turns.span_s
    order = np.argsort(delay_s, kind="stable")
    slopes, joint = slopes[order], errors.joint[order][:, :, order]
    joint = (slopes[:, None] @ joint.transpose(0, 2, 1, 3) @ slopes.swapaxes(1, 2)).transpose(0, 2, 1, 3)
    return PathFit(
        delay_s=delay_s[order],
        aod_rad=wrap_angle(aod_rad[order]),
        aoa_rad=wrap_angle(aoa_rad[order]),
        amplitude=np.abs(gain)[order],
        phase_rad=np.angle(gain)[order],
        snr_db=10 * np.log10(snr[order]),
        covariance=np.einsum("papb->pab", joint),
        correlated=correlated_paths(joint),
        unresolved_probability=errors.unresolved_probability[order],
        is_weak=errors.is_redundant[order],
        doppler_hz=doppler_hz[order],
        seen_s=seen_s[order],
        status="ok" if len(paths) else "no_paths",
    )


def reported_delay_bins(sweep: CompressedSweep, paths: PathParameters) -> FloatArray:
    """Delays (path,) in bins within one period, whose last eighth is negative delays."""
    n = sweep.n_subcarriers
    return np.asarray((paths.delay_bins + n / 8) % n - n / 8)


def _new_paths(
    search: SpectrumSearch, reference: Reference, window: DelayWindow, room: int, share: float
) -> PathParameters:
    """Paths in the residual above their level and a share of the strongest; doubtful ones are refined first."""
    if room <= 0:
        return no_paths(search.sweep)
    peaks = search.peaks(reference.parts, SCALLOPING * window.level, share)
    peaks = without_side_lobes(peaks, search.grids, SIDE_LOBE_MARGIN, room)
    places = search.paths(peaks)
    level = window.level_at(places)
    is_certain = np.abs(peaks.value) ** 2 >= CERTAIN * level
    doubtful, power = refine_separately(reference, places.take(~is_certain))
    certain = _best_of_twins(search, reference, peaks.take(is_certain))
    new = certain.joined(doubtful.take(power >= level[~is_certain]))
    if len(search.turns):
        new, _ = at_likeliest_turns(reference, new, finer_turns(search.turns))
    return raised_paths(reference, new, window.level / 2)


def _best_of_twins(search: SpectrumSearch, reference: Reference, peaks: SpectrumPeaks) -> PathParameters:
    """Paths at peaks; where other directions respond alike, the one whose refined path explains most."""
    every, origin = search.with_twins(peaks)
    has_twins = np.bincount(origin, minlength=len(peaks)) > 1
    some = np.flatnonzero(has_twins[origin])
    refined, power = refine_separately(reference, search.paths(every.take(some)))
    order = np.lexsort((-power, origin[some]))
    place = np.arange(len(peaks))
    place[has_twins] = len(peaks) + order[np.unique(origin[some][order], return_index=True)[1]]
    return search.paths(peaks).joined(refined).take(place)


def _most_paths(sweep: CompressedSweep) -> int:
    """Largest number of paths with at least as many samples as parameters."""
    n_parameters = 3 + sweep.tx.n_angles + sweep.rx.n_angles + (sweep.turns is not None)
    return max(1, sweep.samples.size // n_parameters)
