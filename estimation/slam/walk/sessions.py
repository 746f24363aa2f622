"""Sessions: parts of a campaign between which the heading offset of a device jumps."""

from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np

from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.residuals import Association, Observations, TrajectoryState
from estimation.slam.walk.smoother import minimise_robust_cost, normal_equations, robust_cost
from scenes.record import FloatArray, IntArray

# Share of a squared residual that counts beyond 3 standard deviations: the nearer of two far sessions is better.
_FAR_SHARE = 1e-3
_MOST_STARTS = 128  # of sessions that are tried: their time grows with the square
_STOPS_PER_JUMP = 128  # of a walk: so many sessions may open at the same time
_TRIALS = 5
_LEAST_INFORMATION = 1e-3  # about a jump
_MIN_STOPS = 4  # of a session: the positions of fewer stops can absorb a jump


def segment_offsets(
    residual_rad: FloatArray, std_rad: FloatArray, *, min_length: int = 3, min_gain: float = 8.0
) -> tuple[IntArray, FloatArray]:
    """Piecewise constant mean of a sequence of angles by dynamic programming with a penalty per jump.

    For known receivers: residuals of the line of sight show the offsets of both headings directly. Squared
    deviations are limited to 3 standard deviations.

    In a long sequence every second, third, ... residual may open a session first; then jumps move to their places.

    Parameters
    ----------
    residual_rad, std_rad
        (n,) residuals and their standard deviations.
    min_gain
        Fall of half the sum of squares that a jump needs.

    Returns
    -------
    first, offset_rad
        (session,) index of the first residual of every session, and its offset.
    """
    n = len(residual_rad)
    stride = -(-n // _MOST_STARTS) if n else 1

    def cost(start: int, stop: int) -> float:
        part = slice(start, stop)
        z2 = ((residual_rad[part] - _robust_mean(residual_rad[part], std_rad[part])) / std_rad[part]) ** 2
        return 0.5 * float(np.sum(np.minimum(z2, 9.0 + _FAR_SHARE * z2)))

    first = _partition(cost, [*range(0, n, stride), n], min_length, min_gain)
    bounds = [*first, n]
    for k in range(1, len(first)):
        before, after = bounds[k - 1], bounds[k + 1]
        low = max(bounds[k] - stride + 1, before + min_length)
        near = range(low, min(bounds[k] + stride, after - min_length + 1))
        bounds[k] = min([bounds[k], *near], key=lambda jump: cost(before, jump) + cost(jump, after))
    means = [_robust_mean(residual_rad[a:b], std_rad[a:b]) for a, b in pairwise(bounds)]
    return np.array(bounds[:-1], dtype=np.int64), np.array(means)


def _partition(
    cost: Callable[[int, int], float], bounds: list[int], min_length: int, min_gain: float
) -> list[int]:
    """First residual of every session, in the partition at some of `bounds` of least cost, `min_gain` a jump."""
    best, previous = {0: -min_gain}, dict[int, int]()
    for stop in bounds[1:]:
        for start in [start for start in best if stop - start >= min(min_length, bounds[-1])]:
            total = best[start] + min_gain + cost(start, stop)
            if total < best.get(stop, np.inf):
                best[stop], previous[stop] = total, start
    first, stop = list[int](), bounds[-1]
    while stop > 0:
        stop = previous[stop]
        first.append(stop)
    return first[::-1]


def split_sessions(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> TrajectoryState:
    """Split a session where a jump of the TX heading offset lowers the cost most, if by `min_session_gain`.

    Candidates are ranked by the gain of one Gauss-Newton step of all unknowns and a jump of all TX; the best five
    are solved. In a long walk each of these takes others with it, so that the number of turns does not grow with
    the walk; where they do not pay together, the best one is taken alone. With one TX the longest session has
    offset zero: an offset common to all sessions turns everything about the TX and is unobservable.
    """
    candidates = _candidates(now.session)
    if not len(candidates):
        return now
    slope, information = _jump_terms(seen, link, now, candidates, config)
    price = config.min_session_gain * now.n_tx
    best, least = now, robust_cost(seen, link, now, config)
    for most in dict.fromkeys((max(len(now.session) // _STOPS_PER_JUMP, 1), 1)):
        for first in np.argsort(-_gains(slope, information))[:_TRIALS].tolist():
            jumps = candidates[_together(first, slope, information, candidates, most, price)]
            trial = minimise_robust_cost(seen, link, reduce(with_jump, jumps.tolist(), now), config)
            cost = robust_cost(seen, link, trial, config) + price * len(jumps)
            if cost < least:
                best, least = trial, cost
        if best is not now:
            break
    return best


def _together(
    first: int, slope: FloatArray, information: FloatArray, candidates: IntArray, most: int, price: float
) -> list[int]:
    """Candidates that open sessions at the same time: the `first` and others worth their price, at most `most`.

    Each is worth what it gains after those before it: near a jump other candidates gain as well, but not twice.
    """
    chosen, slope, information = [first], slope.copy(), information.copy()
    while len(chosen) < most:
        last = chosen[-1]
        by_last = information[:, last] / max(information[last, last], _LEAST_INFORMATION)
        slope -= by_last * slope[last]
        information -= np.outer(by_last, information[last])
        apart = np.abs(candidates[:, None] - candidates[chosen]).min(axis=1)
        gain = np.where(apart >= _MIN_STOPS, _gains(slope, information), 0.0)
        if gain.max() < price:
            break
        chosen.append(int(np.argmax(gain)))
    return chosen


def _gains(slope: FloatArray, information: FloatArray) -> FloatArray:
    """Fall of the cost (candidate,) that one Gauss-Newton step predicts for a jump before each candidate."""
    return np.asarray(0.5 * slope**2 / np.maximum(np.diag(information), _LEAST_INFORMATION))


def _jump_terms(
    seen: Observations, link: Association, now: TrajectoryState, candidates: IntArray, config: TrajectoryConfig
) -> tuple[FloatArray, FloatArray]:
    """Slope (candidate,) and information (candidate, candidate) of jumps, all other unknowns eliminated."""
    system = normal_equations(seen, link, now, config)
    (n, size), m = now.state.shape, len(candidates)
    residuals = linearise(seen, link, now, config)
    turn = residuals.by_shared[:, :, 0] * residuals.weight(config.degrees_of_freedom)[:, None]
    # First the terms of the offset of one stop; a jump is the offset of all stops from a candidate on.
    by_stop = np.zeros((n, size))
    at = residuals.row[:, None], residuals.columns
    np.add.at(by_stop, at, np.einsum("pd,pdi->pi", turn, residuals.by_state))
    shared_by_stop = np.zeros((n, now.n_shared))
    product = np.einsum("pd,pdi->pi", turn, residuals.by_shared)
    used = residuals.shared >= 0
    np.add.at(
        shared_by_stop,
        (np.broadcast_to(residuals.row[:, None], used.shape)[used], residuals.shared[used]),
        product[used],
    )
    after = (np.arange(n)[:, None] >= candidates).astype(float)
    by_jump = (by_stop[:, :, None] * after[:, None, :]).reshape(size * n, m)
    shared_by_jump = shared_by_stop.T @ after
    own: FloatArray = np.bincount(residuals.row, product[:, 0], n) @ after
    slope: FloatArray = np.bincount(residuals.row, np.einsum("pd,pd->p", turn, residuals.value), n) @ after
    if now.n_tx == 1:
        shared_by_jump[now.anchor] = 0.0
    states, shared = system.solve_for(by_jump, shared_by_jump)
    slope = slope - system.gradient.ravel() @ states - system.shared_gradient @ shared
    both = own[np.maximum.outer(np.arange(m), np.arange(m))]  # candidates are in order: after the later of two
    return slope, both - by_jump.T @ states - shared_by_jump.T @ shared


def with_jump(now: TrajectoryState, stop: int) -> TrajectoryState:
    """The state with a new session from `stop` to the end of its session; the longest session is the anchor.

    With several TX the heading of each may jump there.
    """
    new = int(now.session.max()) + 1
    session = now.session.copy()
    session[stop:][session[stop:] == session[stop]] = new
    order = np.unique(session, return_index=True)[1]
    rank = np.argsort(np.argsort(order))
    session = rank[session]
    old_of_new = np.append(np.arange(new), now.session[stop])[np.argsort(order)]
    anchor = int(np.argmax(np.bincount(session)))
    offset = now.offset_rad.reshape(-1, now.n_tx)[old_of_new]
    if now.n_tx == 1:
        offset = offset - offset[anchor]
    return replace(now, session=session, offset_rad=offset.ravel(), anchor=anchor)


def _candidates(session: IntArray) -> IntArray:
    """Stops that may open a session: every session keeps `_MIN_STOPS`; at most about 60 of them."""
    least = _MIN_STOPS
    stops = [
        k
        for k in range(least, len(session) - least + 1)
        if session[k - least] == session[k] == session[k + least - 1]
    ]
    stride = max(1, len(stops) // 60)
    return np.array(stops[::stride], dtype=np.int64)


def _robust_mean(value: FloatArray, std: FloatArray) -> float:
    """Mean without values beyond 3 standard deviations, iterated from the median."""
    mean = float(np.median(value))
    for _ in range(5):
        weight = (np.abs(value - mean) <= 3 * std) / std**2
        if not weight.any():
            break
        mean = float(np.average(value, weights=weight))
    return mean
