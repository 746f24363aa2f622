"""Merge or separate paths that cancel each other, since such pairs do not exist in scenes.

Two paths that nearly coincide with opposite amplitudes are the derivative of one path. A fit of too few paths uses
such a pair to explain the residual of a group of several; the closer the two come, the larger both become, without
bound. True phases are independent: even with equal amplitudes two true paths cancel by 20 dB in only 3 % of cases.

Groups of three and more do the same with less cancelling in each pair: they explain what scatters about a strong
reflection by its higher derivatives. Then noise alone leaves the places of these paths unknown to a resolution
cell, however strong they are.
"""

import numpy as np

from estimation.channel.coherent.hidden import seen_axes
from estimation.channel.coherent.refine import (
    Reference,
    Solution,
    joint_covariance,
    refine_near,
    refine_separately,
    response_powers,
)
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import PathParameters, manifold_rates
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray

CANCELLED = 100.0  # power of a path over that of it and its neighbours together; true paths stay below
NEAR = 0.5  # squared coherence of neighbours, half a resolution cell apart
CLOSE_CANCELLED = 4.0  # as `CANCELLED`, of paths that are close too: one true pair in a thousand is
CLOSE = 0.97  # squared coherence of close paths, 0.1 cell apart
SAME = 0.997  # of paths in one place, 0.03 cell apart
APART_CELLS = (0.5, 1.0)  # resolution cells between two cancelling paths after they are separated
UNIFORM_VARIANCE = 1 / 12  # of a position in a resolution cell, in cells


def without_cancelling_paths(reference: Reference, solution: Solution, max_steps: int) -> Solution:
    """The solution without paths that cancel each other or coincide, in pairs or in groups."""
    return _without_lost_groups(reference, _without_pairs(reference, solution, max_steps), max_steps)


def is_lost(variance: FloatArray, rate: FloatArray) -> BoolArray:
    """Mask (path,) of places known no better than to their resolution cell, along any axis that beams resolve.

    From variances (path, parameter) of places, and `rate` (path, parameter), their length on the manifold.
    """
    return np.asarray((seen_axes(rate) & (variance * np.square(rate / CELL) > UNIFORM_VARIANCE)).any(axis=1))


def _without_pairs(reference: Reference, solution: Solution, max_steps: int) -> Solution:
    """The solution without pairs that cancel each other or coincide.

    They are separated by the distance whose refit explains most and has no such pair, else merged into one.
    """
    for _ in range(2 * len(solution.paths)):
        pair = _worst_pair(solution)
        if not pair.any():
            break
        others, two = solution.paths.take(~pair), solution.paths.take(pair)
        trials = [
            refine_near(reference, others.joined(_apart(reference, two, c)), two, max_steps) for c in APART_CELLS
        ]
        sound = [trial for trial in trials if not cancelling_coherence(trial)[-2:].any()]
        if sound:
            solution = max(sound, key=lambda trial: trial.explained)
        else:
            one = _apart(reference, two, 0.0).take(slice(1))
            solution = refine_near(reference, others.joined(one), two, max_steps)
    return solution


def _without_lost_groups(reference: Reference, solution: Solution, max_steps: int) -> Solution:
    """The solution without groups of neighbours that noise alone leaves lost: each becomes one path.

    It starts as the path of the group that alone explains most. Strong groups are the first.
    """
    for _ in range(len(solution.paths)):
        group = _strongest_lost_group(reference, solution)
        if not group.any():
            break
        others, several = solution.paths.take(~group), solution.paths.take(group)
        without = Reference(reference.sweep, solution.paths).with_path_back(several)
        alone, power = refine_separately(without, several)
        one = alone.take(np.array([power.argmax()]))
        solution = refine_near(reference, others.joined(one), several, max_steps)
    return solution


def cancelling_coherence(solution: Solution) -> FloatArray:
    """Squared coherence (path, path) of pairs that do not exist in scenes, 0 for all others.

    These are pairs that coincide, and neighbours whose first path is cancelled: it has far more power than its
    matched filter shows for it and all its neighbours together. The closer they are, the less is far.
    """
    inner, amplitude = solution.inner, solution.paths.amplitude
    energy, coherence = np.diagonal(inner).real, _coherence(solution)
    is_near = coherence >= NEAR
    together = np.square(np.abs(np.where(is_near, inner, 0.0) @ amplitude)) / energy
    least = np.where(coherence >= CLOSE, CLOSE_CANCELLED, CANCELLED)
    is_cancelled = (np.square(np.abs(amplitude)) * energy)[:, None] >= least * together[:, None]
    np.fill_diagonal(coherence, 0.0)
    return np.where((coherence >= SAME) | (is_near & is_cancelled), coherence, 0.0)


def has_neighbour(solution: Solution) -> BoolArray:
    """Mask (path,) of paths with another one within half a resolution cell."""
    return np.asarray((_coherence(solution) >= NEAR).sum(axis=1) > 1)


def _coherence(solution: Solution) -> FloatArray:
    """Squared coherence (path, path) of the responses of paths."""
    energy = np.diagonal(solution.inner).real
    return np.asarray(np.square(np.abs(solution.inner)) / (energy[:, None] * energy))


def _strongest_lost_group(reference: Reference, solution: Solution) -> BoolArray:
    """Mask (path,) of the strongest path that is lost beside lost neighbours, and of these; empty if none is."""
    covariance = joint_covariance(solution, reference.sweep.n_subcarriers)
    lost = is_lost(np.einsum("papa->pa", covariance), manifold_rates(reference.sweep, solution.paths))
    groups = (_coherence(solution) >= NEAR) & lost & lost[:, None]
    among: BoolArray = groups.sum(axis=1) > 1
    if not among.any():
        return among
    return np.asarray(groups[np.where(among, response_powers(solution), 0.0).argmax()])


def _worst_pair(solution: Solution) -> BoolArray:
    """Mask (path,) of the two paths of largest cancelling coherence; empty if there is no such pair."""
    pair: BoolArray = np.zeros(len(solution.paths), bool)
    coherence = cancelling_coherence(solution)
    if coherence.any():
        pair[list(np.unravel_index(np.argmax(coherence), coherence.shape))] = True
    return pair


def _apart(reference: Reference, two: PathParameters, cells: float) -> PathParameters:
    """Two paths this many resolution cells apart about their centre, on the line through both."""
    rate = manifold_rates(reference.sweep, two).mean(axis=0)
    step = np.concatenate(
        [
            np.diff(two.delay_bins),
            *(wrap_angle(np.diff(a, axis=0))[0] for a in (two.aod_rad, two.aoa_rad)),
            np.diff(two.doppler_turns, axis=0)[0],
        ]
    )
    length = max(float(np.linalg.norm(step * rate)), np.finfo(float).tiny)
    half = step / 2 * cells * CELL / length
    first = two.take(slice(1)).moved(step[None] / 2)
    return first.moved(-half[None]).joined(first.moved(half[None]))
