"""Raise horizontal paths that two panels see, and lower those that need no elevation.

Horizontal beams on several panels show the elevation of a path up to its sign (`Manifold.with_hidden_elevation`).
By this symmetry the likelihood has no slope at the horizon: steps of a fit stay there.
"""

import numpy as np

from estimation.channel.coherent.elevated import angles_at, hiding_ends, same_cone, with_angles
from estimation.channel.coherent.refine import Reference, Solution, refine_near, refine_separately
from estimation.channel.coherent.tried import TriedPaths
from estimation.channel.model.apparent import cone_angles
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, manifold_rates, response_energies, responses
from scenes.record import BoolArray, IntArray

STARTS_RAD = np.deg2rad([8.0, 25.0])  # elevations that a path is refined from
START_STEPS = 4


class PathRaiser:
    """Raises and lowers the paths of one stop; it knows those that it has tried in vain."""

    def __init__(self) -> None:
        self._tried = TriedPaths()

    def __call__(self, reference: Reference, solution: Solution, level: float, max_steps: int) -> Solution:
        """The solution, which is at the reference's paths, with paths raised or lowered where that explains more.

        A raised path must explain more by `level`. Horizontal paths whose elevation would not show are left.
        """
        before = solution.paths
        if not hiding_ends(reference.sweep):
            return solution
        changed = lowered_paths(reference.sweep, before)
        is_raised = ~_differ(changed, before) & _would_show(reference.sweep, before, level)
        tried = self._tried.among(before, manifold_rates(reference.sweep, before))
        is_new = np.logical_not(np.asarray(tried.any(axis=0)))
        some = np.flatnonzero(is_raised & is_new)
        own = before.take(some)
        changed = changed.with_paths(some, raised_paths(reference, own, level, own))
        is_tried = _differ(changed, before) & is_new
        for path in np.argsort(-np.abs(before.amplitude), kind="stable"):
            if not is_tried[path]:
                continue
            itself = np.array([path])
            one = changed.take(itself)
            trial = refine_near(reference, solution.paths.with_paths(itself, one), one, max_steps)
            if trial.explained > solution.explained + (level if is_raised[path] else 0.0):
                solution, is_new[path] = trial, False
        self._tried.add(before.take(is_new))
        return solution


def raised_paths(
    reference: Reference, paths: PathParameters, least_gain: float, back: PathParameters | None = None
) -> PathParameters:
    """Paths of a residual, with an elevation where that explains more by `least_gain` than the horizon does.

    In the residual of each is its path of `back` (path,), where given.
    """
    if not len(paths):
        return paths
    for is_tx, manifold in hiding_ends(reference.sweep):
        every, origin = _with_raised(paths, manifold, is_tx=is_tx)
        refined, power = refine_separately(
            reference, every, START_STEPS, None if back is None else back.take(origin)
        )
        n = len(paths)
        power[:n] += least_gain
        order = np.lexsort((-power, origin))
        best = order[np.unique(origin[order], return_index=True)[1]]
        paths = paths.joined(refined.take(slice(n, None))).take(best)
    return paths


def lowered_paths(sweep: CompressedSweep, paths: PathParameters) -> PathParameters:
    """The paths with hidden elevations zero, on the same cones."""
    for is_tx, manifold in hiding_ends(sweep):
        angles = angles_at(paths, is_tx=is_tx)
        cone, _ = cone_angles(angles[:, 0], angles[:, 1], manifold.best_panel_rad(angles))
        level = np.stack([cone, np.zeros(len(paths))], axis=1)
        paths = with_angles(paths, np.where(angles[:, 1:] != 0, level, angles), is_tx=is_tx)
    return paths


def _with_raised(paths: PathParameters, manifold: Manifold, *, is_tx: bool) -> tuple[PathParameters, IntArray]:
    """The paths, then those at the horizon of one end raised on their cones; and the original of each."""
    angles = angles_at(paths, is_tx=is_tx)
    rows, turned = [np.arange(len(paths))], [angles]
    boresight_rad = manifold.best_panel_rad(angles)
    for path in np.flatnonzero(angles[:, 1] == 0):
        directions = same_cone(angles[path], boresight_rad[path], STARTS_RAD)
        rows.append(np.full(len(directions), path))
        turned.append(directions)
    origin = np.concatenate(rows)
    return with_angles(paths.take(origin), np.concatenate(turned), is_tx=is_tx), origin


def _would_show(sweep: CompressedSweep, paths: PathParameters, level: float) -> BoolArray:
    """Whether some elevation of a horizontal path would change its power in the samples by a `level`, (path,)."""
    shows: BoolArray = np.zeros(len(paths), bool)
    for is_tx, manifold in hiding_ends(sweep):
        every, origin = _with_raised(paths, manifold, is_tx=is_tx)
        at = responses(sweep, every)
        own = (at.tx if is_tx else at.rx)[:, 0]
        energy = np.square(np.abs(own)).sum(axis=1)
        inner = np.einsum("ij,ij->i", own, own[origin].conj())
        same = np.square(np.abs(inner)) / np.maximum(energy * energy[origin], 1e-300)
        power = np.square(np.abs(paths.amplitude)) * response_energies(at)[: len(paths)]
        shows[origin[power[origin] * (1 - same) > level]] = True
    return shows


def _differ(one: PathParameters, other: PathParameters) -> BoolArray:
    """Mask (path,) of paths with other angles."""
    return np.asarray((one.aod_rad != other.aod_rad).any(axis=1) | (one.aoa_rad != other.aoa_rad).any(axis=1))
