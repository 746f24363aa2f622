"""Choice of one mode per stop: the most probable sequence along the trajectory (Viterbi)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimation.slam.config import TrajectoryConfig
from estimation.slam.snapshot.problem import Fit
from estimation.slam.walk.relocate import Place
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray

_FREEDOM = 2.0  # of the Student-t laws of displacement and turn
# Penalty of a stop that is in none of its modes, in log evidence below its best mode.
_NONE_COST = 12.0


def choose_modes(modes: Sequence[Sequence[Fit]], config: TrajectoryConfig) -> IntArray:
    """Mode (stop,) of every stop, -1 for none, that maximises evidence and smoothness together.

    Displacement and turn between neighbouring solved stops are Student-t with the stop spacing and
    `heading_step_deg` as scales, widened by the modes' own covariances and by the number of stops between them.
    The spacing is `config.spacing_m`, or else the median displacement between the best modes of neighbours.
    """
    spacing = config.spacing_m or typical_spacing(modes)
    n = len(modes)
    score: list[FloatArray] = []
    back: list[list[tuple[int, int]]] = []
    for k in range(n):
        own = np.array([-fit.cost for fit in modes[k]])
        own = own - own.max(initial=-np.inf) if len(own) else own
        reached = np.full(len(own), -_NONE_COST * k)
        pointer = [(-1, -1)] * len(own)
        for j in range(max(0, k - 8), k):
            if not len(own) or not len(score[j]):
                continue
            skipped = sum(1 for i in range(j + 1, k) if modes[i])
            through = score[j][:, None] - transition_cost(modes[j], modes[k], (k - j) * spacing, config)
            through = through - _NONE_COST * skipped
            best = np.argmax(through, axis=0)
            for m, origin in enumerate(best):
                if through[origin, m] > reached[m]:
                    reached[m], pointer[m] = through[origin, m], (j, int(origin))
        score.append(own + reached)
        back.append(pointer)
    return _trace_back(score, back, modes)


@dataclass(frozen=True)
class Rivals:
    """The chosen mode of each stop against its other modes, with the neighbours in their chosen modes."""

    gap: FloatArray  # (stop,) log odds over the best other mode; NaN where there is none
    state: FloatArray  # (stop, state) that mode's state
    los_probability: FloatArray  # (stop,) of all modes with a line of sight; NaN where no mode is chosen
    square_m2: FloatArray  # (stop,) mean square distance from the mode chosen, by the modes' probabilities


def rival_modes(modes: Sequence[Sequence[Fit]], chosen: IntArray, config: TrajectoryConfig) -> Rivals:
    """Weigh every mode of a stop by its evidence and the moves from and to its neighbours."""
    spacing = config.spacing_m or typical_spacing(modes)
    gap, los, square = np.full(len(modes), np.nan), np.full(len(modes), np.nan), np.zeros(len(modes))
    solved = np.flatnonzero(chosen >= 0).tolist()
    size = len(modes[solved[0]][0].state) if solved else 4
    state = np.full((len(modes), size), np.nan)
    for at, k in enumerate(solved):
        fits, own = modes[k], chosen[k]
        score = np.array([-fit.cost for fit in fits])
        if at > 0:
            j = solved[at - 1]
            score -= transition_cost([modes[j][chosen[j]]], fits, (k - j) * spacing, config)[0]
        if at + 1 < len(solved):
            j = solved[at + 1]
            score -= transition_cost(fits, [modes[j][chosen[j]]], (j - k) * spacing, config)[:, 0]
        probability = np.exp(score - score.max())
        probability /= probability.sum()
        place = np.array([fit.state[:2] for fit in fits])
        los[k] = probability[[bool(fit.is_los.any()) for fit in fits]].sum()
        square[k] = probability @ np.sum((place - place[own]) ** 2, axis=1)
        others = np.delete(np.arange(len(fits)), own)
        if len(others):
            best = others[np.argmax(score[others])]
            gap[k], state[k] = score[own] - score[best], fits[best].state
    return Rivals(gap, state, los, square)


def with_places(rivals: Rivals, places: dict[int, Place]) -> Rivals:
    """The rivals with those that landmarks left at the stops they placed."""
    gap, state, los, square = (
        part.copy() for part in (rivals.gap, rivals.state, rivals.los_probability, rivals.square_m2)
    )
    for stop, place in places.items():
        gap[stop], state[stop] = place.gap, place.rival
        los[stop], square[stop] = place.los_probability, place.square_m2
    return Rivals(gap, state, los, square)


def transition_cost(
    before: Sequence[Fit], after: Sequence[Fit], scale_m: float, config: TrajectoryConfig
) -> FloatArray:
    """Minus the log-likelihood (before, after), up to a constant, of moving between two stops' modes."""
    first, second = (np.array([fit.state for fit in fits]) for fits in (before, after))
    spread, spread2 = (np.array([np.diag(fit.covariance)[:3] for fit in fits]) for fits in (before, after))
    variance = spread[:, None] + spread2[None]
    distance2 = np.sum((first[:, None, :2] - second[None, :, :2]) ** 2, axis=-1)
    turn2 = wrap_angle(first[:, None, 2] - second[None, :, 2]) ** 2
    place = distance2 / (scale_m**2 + 0.5 * variance[..., :2].sum(axis=-1))
    turn = turn2 / (np.deg2rad(config.heading_step_deg) ** 2 + variance[..., 2])
    return np.asarray(
        (_FREEDOM + 2) / 2 * np.log1p(place / _FREEDOM) + (_FREEDOM + 1) / 2 * np.log1p(turn / _FREEDOM)
    )


def typical_spacing(modes: Sequence[Sequence[Fit]]) -> float:
    """Median displacement in m between the best modes of neighbouring stops; 1 m where there are none."""
    steps = [np.hypot(*(a[0].state[:2] - b[0].state[:2])) for a, b in pairwise(modes) if a and b]
    return max(float(np.median(steps)), 1e-3) if steps else 1.0


def _trace_back(
    score: Sequence[FloatArray], back: Sequence[Sequence[tuple[int, int]]], modes: Sequence[Sequence[Fit]]
) -> IntArray:
    chosen = np.full(len(score), -1)
    solved = [k for k in range(len(score)) if len(score[k])]
    if not solved:
        return chosen
    # Stops after the last one of the path count as being in no mode.
    final = [score[k].max() - _NONE_COST * sum(1 for i in solved if i > k) for k in solved]
    k = solved[int(np.argmax(final))]
    m = int(np.argmax(score[k]))
    while k >= 0:
        chosen[k] = m
        k, m = back[k][m]
    return chosen
