"""Model order: remove redundant paths."""

from collections.abc import Callable, Iterator

import numpy as np

from estimation.channel.coherent.hidden import hidden_second_paths
from estimation.channel.coherent.refine import FEW, Reference, Solution, paths_near, refine_near, refine_paths
from estimation.channel.model.path_model import PathParameters
from scenes.record import BoolArray, FloatArray

LevelOfPaths = Callable[[PathParameters], FloatArray]  # power over noise power that each path needs

DROP_TURNS = 3  # of many paths, in a round


def wald_statistic(solution: Solution) -> FloatArray:
    """Squared amplitude (path,) of every path over twice its variance when all parameters are unknown.

    For small errors of the amplitudes it is the increase of the squared residual, in units of the noise power, if
    the path is removed and all others are fitted again (Wald's test for the likelihood ratio).
    """
    n = len(solution.paths)
    inverse = solution.inverse.reshape(solution.information.shape)
    own = np.einsum("iaib->iab", inverse)[:, :2, :2]
    amplitude = np.stack([solution.paths.amplitude.real, solution.paths.amplitude.imag], axis=1)
    weighted = np.linalg.solve(own, amplitude[..., None])[..., 0] if n else np.zeros((0, 2))
    return np.asarray((amplitude * weighted).sum(axis=1))


def prune_paths(reference: Reference, solution: Solution, levels: LevelOfPaths, max_steps: int) -> Solution:
    """The solution without paths whose likelihood ratio is below their level; the others are fitted again.

    Wald's test selects candidates. The likelihood without them decides, of all redundant ones together or of the
    weakest alone. If test and likelihood disagree, the path is in a side maximum: it is moved. Of many paths, the
    redundant ones are only tested together: the time for tests one by one grows with the square of their number.
    """
    if len(solution.paths) > FEW:
        return _prune_together(reference, solution, levels, max_steps)
    needed: BoolArray = np.zeros(len(solution.paths), bool)
    is_changed = False
    tested, statistic = solution, wald_statistic(solution)
    while True:
        if solution is not tested:
            tested, statistic = solution, wald_statistic(solution)
        level = levels(solution.paths)
        excess = np.where(needed, np.inf, statistic - level)
        if not (excess < 0).any():
            return refine_paths(reference, solution.paths, max_steps) if is_changed else solution
        weakest = np.arange(len(level)) == np.argmin(excess)
        enough = solution.explained - level[weakest][0]
        together = redundant_paths(solution, np.where(needed, 0.0, level))
        for dropped in (together, weakest) if together.any() else (weakest,):
            out = solution.paths.take(dropped)
            without = refine_near(reference, solution.paths.take(~dropped), out, max_steps, enough)
            if without.explained > enough:
                solution, needed, is_changed = without, needed[~dropped], True
                break
        else:
            moved = _moved(reference, without, solution.paths.take(weakest), max_steps, solution.explained)
            if moved.explained > solution.explained:
                solution, needed, is_changed = moved, np.append(needed[~weakest], True), True
            else:
                needed = needed | weakest


def _prune_together(reference: Reference, solution: Solution, levels: LevelOfPaths, max_steps: int) -> Solution:
    """The solution without redundant paths; where the likelihood disagrees, without the weaker half of them.

    What a few turns leave is for the next round of the search.
    """
    for _ in range(DROP_TURNS):
        level = levels(solution.paths)
        for dropped in _redundant_together(solution, level):
            without = refine_paths(reference, solution.paths.take(~dropped), max_steps)
            if solution.explained - without.explained <= level[dropped].sum():
                solution = without
                break
        else:
            break
    return solution


def _redundant_together(solution: Solution, level: FloatArray) -> Iterator[BoolArray]:
    """Masks (path,) of all redundant paths, then of the weaker half of them; none where no path is redundant."""
    dropped = redundant_paths(solution, level)
    if dropped.any():
        yield dropped
        excess = np.where(dropped, wald_statistic(solution) - level, np.inf)
        yield np.argsort(np.argsort(excess)) < (dropped.sum() + 1) // 2


def redundant_paths(solution: Solution, level: FloatArray) -> BoolArray:
    """Paths (path,) that the others can replace in the linearised model, dropped one after another.

    To drop a path is to set all its columns of the normal equations to zero. Their joint covariance gives the
    increase of the squared residual and the shift of all others. The path of least increase is dropped, as long as
    it is below its `level` (path,), and the others are shifted before the next is tested.
    """
    n, n_columns = solution.slope.shape
    dropped: BoolArray = np.zeros(n, bool)
    covariance = solution.inverse.copy()
    value = np.zeros((n, n_columns))
    value[:, 0], value[:, 1] = solution.paths.amplitude.real, solution.paths.amplitude.imag
    while True:
        own = np.einsum("iaib->iab", covariance.reshape(n, n_columns, n, n_columns))
        weight = np.linalg.solve(own, value[..., None])[..., 0]
        loss = np.where(dropped, np.inf, (value * weight).sum(axis=1) - level)
        path = int(np.argmin(loss))
        if loss[path] >= 0:
            return dropped
        dropped[path] = True
        block = slice(path * n_columns, (path + 1) * n_columns)
        cross = covariance[:, block].copy()
        value -= (cross @ weight[path]).reshape(value.shape)
        covariance -= cross @ np.linalg.solve(own[path], cross.T)
        covariance[block, block] = np.eye(n_columns)  # fixed, without coupling to the others


def _moved(
    reference: Reference, without: Solution, path: PathParameters, max_steps: int, enough: float
) -> Solution:
    """The solution with one more path near a removed `path`, at the place of largest score."""
    about = path.joined(without.paths.take(paths_near(reference.sweep, without.paths, path)))
    place = hidden_second_paths(Reference(reference.sweep, without.paths), without, 0.0, about).take(slice(1))
    if not len(place):
        return without
    return refine_near(reference, without.paths.joined(place), path, max_steps, enough)
