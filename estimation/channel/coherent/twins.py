"""Choose between directions in which the beams respond alike, by what is likely in a hall.

Beams at two elevations show little more of an elevation than the ratio of their gains, which returns further up:
two or three directions explain the samples equally well. Between them decides what is known of paths
(`direction_prior`).
"""

from dataclasses import replace

import numpy as np

from estimation.channel.coherent.misfit import error_scale, quadrature_statistic
from estimation.channel.coherent.refine import Reference, Solution, refine_near, refine_separately
from estimation.channel.coherent.search import DirectionGrid
from estimation.channel.coherent.tried import TriedPaths
from estimation.channel.model.alike import twins_on_cone
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.direction_prior import direction_log_prior, sees_elevation
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, manifold_rates
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

ALIKE = 0.99  # least coherence of twins on a cone: samples tell others apart
TWIN_STEPS = 8  # twins of strong paths differ little: they are compared after convergence


class TwinChooser:
    """Moves the paths of one stop to their twins; it knows those that it has tried in vain."""

    def __init__(self, grids: tuple[DirectionGrid, DirectionGrid]) -> None:
        self._grids, self._tried = grids, TriedPaths()

    def __call__(self, reference: Reference, solution: Solution, max_steps: int) -> Solution:
        """The solution, which is at the reference's paths, with every path at its likeliest twin.

        The strongest paths come first.
        """
        if not (sees_elevation(reference.sweep.tx) or sees_elevation(reference.sweep.rx)):
            return solution
        before = solution.paths
        tried: BoolArray = np.any(self._tried.among(before, manifold_rates(reference.sweep, before)), axis=0)
        scale = error_scale(*quadrature_statistic(reference, solution))
        every, origin = _twins(reference.sweep, before, self._grids, np.flatnonzero(~tried))
        refined, power = refine_separately(reference, every, TWIN_STEPS, before.take(origin))
        posterior = power / scale[origin] + _log_prior(reference.sweep, refined)
        for path in np.argsort(-np.abs(before.amplitude), kind="stable"):
            own = np.flatnonzero(origin == path)  # the path itself is the first
            best = own[np.argmax(posterior[own])] if len(own) else -1
            if not len(own) or best == own[0]:
                continue
            twin, itself = refined.take(np.array([best])), np.array([path])
            trial = refine_near(reference, solution.paths.with_paths(itself, twin), twin, max_steps)
            prior, moved_prior = _log_prior(
                reference.sweep, solution.paths.take(itself).joined(trial.paths.take(itself))
            )
            if trial.explained + scale[path] * (moved_prior - prior) > solution.explained:
                solution, tried[path] = trial, True
        self._tried.add(before.take(~tried))
        return solution


def _log_prior(sweep: CompressedSweep, paths: PathParameters) -> FloatArray:
    return direction_log_prior(sweep.tx, sweep.rx, paths.aod_rad, paths.aoa_rad)


def _twins(
    sweep: CompressedSweep, paths: PathParameters, grids: tuple[DirectionGrid, DirectionGrid], some: IntArray
) -> tuple[PathParameters, IntArray]:
    """Those of `some` paths with twins, each followed by itself at every twin; and the number of each path."""
    paths = paths.take(some)
    departures = _directions(sweep.tx, paths.aod_rad, grids[0])
    arrivals = _directions(sweep.rx, paths.aoa_rad, grids[1])
    aod, aoa, origin = [paths.aod_rad[:0]], [paths.aoa_rad[:0]], []
    for path, (tx, rx) in enumerate(zip(departures, arrivals, strict=True)):
        n = len(tx) * len(rx)
        if n > 1:
            aod.append(np.repeat(tx, len(rx), axis=0))
            aoa.append(np.tile(rx, (len(tx), 1)))
            origin += [path] * n
    index = np.array(origin, int)
    return replace(paths.take(index), aod_rad=np.concatenate(aod), aoa_rad=np.concatenate(aoa)), some[index]


def _directions(manifold: Manifold, angles_rad: FloatArray, grid: DirectionGrid) -> list[FloatArray]:
    """Of every direction (path, angle) itself and its twins (direction, angle) at one end.

    Twins are those of the nearest direction of the grid, and those that the steps of the grid hide.
    """
    if not sees_elevation(manifold) or not len(angles_rad):
        return list(angles_rad[:, None])
    rate = manifold.rates(angles_rad)
    apart = (np.abs(wrap_angle(grid.angle_rad - angles_rad[:, None])) * rate[:, None]).max(axis=2)
    mirrored, is_behind = manifold.mirrored(angles_rad), manifold.is_behind(angles_rad)
    on_cone, found = twins_on_cone(manifold, angles_rad, ALIKE), []
    for path, near in enumerate(apart.argmin(axis=1)):
        twin = grid.angle_rad[np.setdiff1d(grid.twin[near], near)]
        behind = mirrored[[path]] if is_behind[path] else mirrored[:0]
        found.append(np.concatenate([angles_rad[[path]], twin, on_cone[path], behind]))
    return found
