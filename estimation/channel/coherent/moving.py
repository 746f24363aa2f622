"""Doppler shifts of paths: the likeliest of several, and the evidence for any against a frozen path.

Few beams see a path, at times that are not even: in some orders of a scan several shifts explain it almost alike.
"""

from dataclasses import replace

import numpy as np

from estimation.channel.coherent.misfit import error_scale, quadrature_statistic
from estimation.channel.coherent.refine import Reference, Solution, refine_near, refine_paths, refine_separately
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import PathParameters, manifold_rates, responses
from estimation.channel.model.turns import is_moving
from scenes.record import FloatArray, IntArray

LEAST_EVIDENCE = (
    5.4  # likelihood over the noise that a shift must add: a frozen path reaches it once in 1,000 times
)
LEAST_GAIN = 2.0  # units of the noise power: less is a matter of rounding and of few steps
LOBES = 3  # shifts of a path that are refined
LEAST_OF_LOBE = 0.5  # of the largest power over the shifts
LOBE_STEPS = 4
FINER = 2  # searched shifts per shift of the search grid


def freeze_still_paths(reference: Reference, solution: Solution, max_steps: int) -> Solution:
    """The solution, which is at the reference's paths, with those paths frozen whose shift adds no evidence.

    The errors of the model count as in the covariances: with `error_scale`, evidence must be as much larger.
    """
    paths = solution.paths
    if reference.sweep.turns is None or not len(paths):
        return solution
    scale = error_scale(*quadrature_statistic(reference, solution))
    still = is_moving(paths.doppler_turns) & (doppler_evidence(solution) < LEAST_EVIDENCE * scale)
    if not still.any():
        return solution
    turns = np.where(still[:, None], 0.0, paths.doppler_turns)
    return refine_paths(reference, replace(paths, doppler_turns=turns), max_steps)


def doppler_evidence(solution: Solution) -> FloatArray:
    """What every path (path,) explains less, over the noise, without its Doppler shift; all others are adapted."""
    n, n_columns = solution.slope.shape
    variance = np.diagonal(solution.inverse).reshape(n, n_columns)[:, -1]
    return np.asarray(np.square(solution.paths.doppler_turns[:, 0]) / variance)


def at_likeliest_turns(
    reference: Reference, paths: PathParameters, turns: FloatArray, back: PathParameters | None = None
) -> tuple[PathParameters, FloatArray]:
    """Paths at their likeliest Doppler shifts among `turns` (shift, 1), refined alone, and their power (path,).

    In the residual of each is the path of `back` (path,), where given, as in `refine_separately`.
    """
    lobe, origin = _lobes(_power_over_turns(reference, paths, turns, back))
    start = replace(paths.take(origin), doppler_turns=turns[lobe])
    every, source = start.joined(paths), np.append(origin, np.arange(len(paths)))
    refined, power = refine_separately(reference, every, LOBE_STEPS, None if back is None else back.take(source))
    order = np.lexsort((-power, source))
    best = order[np.unique(source[order], return_index=True)[1]]
    return refined.take(best), power[best]


def move_to_likelier_turns(
    reference: Reference, solution: Solution, turns: FloatArray, max_steps: int
) -> Solution:
    """The solution, which is at the reference's paths, with paths at other Doppler shifts that explain more."""
    if not len(turns) or not len(solution.paths):
        return solution
    before = solution.paths
    now = refine_separately(reference, before, 0, before)[1]
    moved, power = at_likeliest_turns(reference, before, finer_turns(turns), before)
    for path in np.argsort(-power, kind="stable"):
        if power[path] < now[path] + LEAST_GAIN:
            continue
        itself = np.array([path])
        one = moved.take(itself)
        trial = refine_near(reference, solution.paths.with_paths(itself, one), one, max_steps)
        if trial.explained > solution.explained + LEAST_GAIN:
            solution = trial
    return solution


def shift_covariance(reference: Reference, solution: Solution, turns: FloatArray) -> FloatArray:
    """What other likely Doppler shifts add to the covariance (path, parameter, parameter), about the one found.

    Every other maximum among `turns` (shift, 1) has the weight of its likelihood against that of the path.
    """
    paths, n_parameters = solution.paths, solution.slope.shape[1] - 2
    added = np.zeros((len(paths), n_parameters, n_parameters))
    some = np.flatnonzero(is_moving(paths.doppler_turns))
    if not len(some):
        return added
    own = paths.take(some)
    now = refine_separately(reference, own, 0, own)[1]
    lobe, origin = _lobes(_power_over_turns(reference, own, finer_turns(turns), own))
    start = replace(own.take(origin), doppler_turns=finer_turns(turns)[lobe])
    refined, power = refine_separately(reference, start, LOBE_STEPS, own.take(origin))
    away = np.square(refined.doppler_turns - own.doppler_turns[origin])[:, 0]
    rate = manifold_rates(reference.sweep, own)[origin, -1]
    weight = np.where(away * rate**2 > CELL**2, np.exp(np.minimum(power - now[origin], 0.0)), 0.0)
    total = 1 + np.bincount(origin, weight, len(some))
    added[some, -1, -1] = np.bincount(origin, weight * away, len(some)) / total
    return added


def finer_turns(turns: FloatArray) -> FloatArray:
    """The searched shifts (shift, 1), closer together."""
    n = FINER * len(turns)
    span = turns[-1, 0] - turns[0, 0]
    return np.linspace(turns[0, 0] - span / n, turns[-1, 0] + span / n, n)[:, None]


def _power_over_turns(
    reference: Reference, paths: PathParameters, turns: FloatArray, back: PathParameters | None
) -> FloatArray:
    """Power (path, shift) over the noise that paths of other Doppler shifts explain in the residual."""
    clock = reference.sweep.turns
    assert clock is not None
    at = responses(reference.sweep, replace(paths, doppler_turns=np.zeros((len(paths), 1))))
    tx, rx, delay = at.tx[:, 0].conj(), at.rx[:, 0].conj(), at.delay[:, 0]
    real, imaginary = np.tensordot(delay.astype(np.float32), reference.parts, axes=(1, 3)).swapaxes(0, 1)
    seen = (real + 1j * imaginary) * tx[:, :, None] * rx[:, None]
    if back is not None:
        of = responses(reference.sweep, back)
        share = back.amplitude * (delay * of.delay[:, 0]).sum(axis=1)
        seen = seen + share[:, None, None] * (tx * of.tx[:, 0])[:, :, None] * (rx * of.rx[:, 0])[:, None]
    turned = seen @ clock.wave(turns, is_tx=False).conj().T  # (path, tx_beam, shift)
    total = (turned * clock.wave(turns, is_tx=True).conj().T).sum(axis=1)
    energy = np.prod([np.square(np.abs(factor)).sum(axis=1) for factor in (tx, rx, delay)], axis=0)
    return np.asarray(np.square(np.abs(total)) / np.maximum(energy, np.finfo(float).tiny)[:, None])


def _lobes(power: FloatArray) -> tuple[IntArray, IntArray]:
    """Numbers of the shifts, and of their paths, of the strongest maxima of power (path, shift)."""
    padded = np.pad(power, ((0, 0), (1, 1)), constant_values=-1.0)
    is_top = (power >= padded[:, :-2]) & (power > padded[:, 2:])
    is_top &= power >= LEAST_OF_LOBE * power.max(axis=1, keepdims=True, initial=0.0)
    ranked = np.where(is_top, power, -1.0)
    order = np.argsort(-ranked, axis=1, kind="stable")[:, :LOBES]
    origin, place = np.nonzero(np.take_along_axis(ranked, order, axis=1) >= 0)
    return order[origin, place], origin
