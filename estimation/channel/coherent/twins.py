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
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.direction_prior import direction_log_prior, sees_elevation
from estimation.channel.model.path_model import PathParameters, manifold_rates
from scenes.pose import wrap_angle
from scenes.record import FloatArray

TWIN_STEPS = 8  # twins of strong paths differ little: they are compared after convergence


def move_to_twins(
    reference: Reference, solution: Solution, grids: tuple[DirectionGrid, DirectionGrid], max_steps: int
) -> Solution:
    """The solution, which is at the reference's paths, with every path at its likeliest twin; strongest first."""
    ends = zip((reference.sweep.tx, reference.sweep.rx), grids, strict=True)
    if not any(sees_elevation(manifold) and grid.twin.shape[1] > 1 for manifold, grid in ends):
        return solution
    before = solution
    scale = error_scale(*quadrature_statistic(reference, solution))
    for path in np.argsort(-np.abs(before.paths.amplitude), kind="stable"):
        own = before.paths.take(np.array([path]))
        every = _twins(reference, own, grids)
        if len(every) == 1:
            continue
        refined, power = refine_separately(reference.with_path_back(own), every, TWIN_STEPS)
        posterior = power / scale[path] + _log_prior(reference.sweep, refined)
        best = int(np.argmax(posterior))
        if best == 0:
            continue
        twin = refined.take(np.array([best]))
        itself = np.array([path])
        trial = refine_near(reference, solution.paths.with_paths(itself, twin), twin, max_steps)
        prior, moved_prior = _log_prior(
            reference.sweep, solution.paths.take(itself).joined(trial.paths.take(itself))
        )
        if trial.explained + scale[path] * (moved_prior - prior) > solution.explained:
            solution = trial
    return solution


def _log_prior(sweep: CompressedSweep, paths: PathParameters) -> FloatArray:
    return direction_log_prior(sweep.tx, sweep.rx, paths.aod_rad, paths.aoa_rad)


def _twins(
    reference: Reference, path: PathParameters, grids: tuple[DirectionGrid, DirectionGrid]
) -> PathParameters:
    """The one path, then the same at every twin of its directions."""
    rate = manifold_rates(reference.sweep, path)[0, 1:]
    n_aod, n_aoa = path.aod_rad.shape[1], path.aoa_rad.shape[1]
    ends = []
    for manifold, angles, grid, own in (
        (reference.sweep.tx, path.aod_rad, grids[0], rate[:n_aod]),
        (reference.sweep.rx, path.aoa_rad, grids[1], rate[n_aod : n_aod + n_aoa]),
    ):
        twin = np.zeros((0, angles.shape[1]))
        if sees_elevation(manifold):
            near = int(np.argmin((np.abs(wrap_angle(grid.angle_rad - angles)) * own).max(axis=1)))
            twin = grid.angle_rad[np.setdiff1d(grid.twin[near], near)]
            if manifold.is_behind(angles)[0]:
                twin = np.concatenate([twin, manifold.mirrored(angles)])
        ends.append(np.concatenate([angles, twin]))
    tx, rx = (index.ravel() for index in np.meshgrid(*(np.arange(len(end)) for end in ends), indexing="ij"))
    return replace(path.take(np.zeros(len(tx), int)), aod_rad=ends[0][tx], aoa_rad=ends[1][rx])
