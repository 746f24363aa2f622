"""Raise horizontal paths that two panels see, and lower those that need no elevation.

Horizontal beams on several panels show the elevation of a path up to its sign (`Manifold.with_hidden_elevation`).
By this symmetry the likelihood has no slope at the horizon: steps of a fit stay there.
"""

import numpy as np

from estimation.channel.coherent.elevated import angles_at, hiding_ends, same_cone, with_angles
from estimation.channel.coherent.refine import Reference, Solution, refine_near, refine_separately
from estimation.channel.model.apparent import cone_angles
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, response_energies, responses
from scenes.record import IntArray

STARTS_RAD = np.deg2rad([8.0, 25.0])  # elevations that a path is refined from
START_STEPS = 4


def raise_paths(reference: Reference, solution: Solution, level: float, max_steps: int) -> Solution:
    """The solution, which is at the reference's paths, with paths raised or lowered where that explains more.

    A raised path must explain more by `level`. Horizontal paths whose elevation would not show are left.
    """
    before = solution.paths
    if not hiding_ends(reference.sweep):
        return solution
    for path in np.argsort(-np.abs(before.amplitude), kind="stable"):
        own = before.take(np.array([path]))
        changed, least_gain = lowered_path(reference.sweep, own), 0.0
        if changed is own and _would_show(reference.sweep, own, level):
            changed, least_gain = raised_paths(reference.with_path_back(own), own, level), level
        if not _differ(changed, own):
            continue
        trial = refine_near(reference, solution.paths.with_path(int(path), changed), changed, max_steps)
        if trial.explained > solution.explained + least_gain:
            solution = trial
    return solution


def raised_paths(reference: Reference, paths: PathParameters, least_gain: float) -> PathParameters:
    """Paths of a residual, with an elevation where that explains more by `least_gain` than the horizon does."""
    if not len(paths):
        return paths
    for is_tx, manifold in hiding_ends(reference.sweep):
        every, origin = _with_raised(paths, manifold, is_tx=is_tx)
        refined, power = refine_separately(reference, every, START_STEPS)
        n = len(paths)
        power[:n] += least_gain
        order = np.lexsort((-power, origin))
        best = order[np.unique(origin[order], return_index=True)[1]]
        paths = paths.joined(refined.take(slice(n, None))).take(best)
    return paths


def lowered_path(sweep: CompressedSweep, path: PathParameters) -> PathParameters:
    """One path with hidden elevations zero, on the same cones; the path itself if they are."""
    for is_tx, manifold in hiding_ends(sweep):
        angles = angles_at(path, is_tx=is_tx)
        if angles[0, 1] != 0:
            cone, _ = cone_angles(angles[:, 0], angles[:, 1], manifold.best_panel_rad(angles))
            path = with_angles(path, np.stack([cone, np.zeros(1)], axis=1), is_tx=is_tx)
    return path


def _with_raised(paths: PathParameters, manifold: Manifold, *, is_tx: bool) -> tuple[PathParameters, IntArray]:
    """The paths, then those at the horizon of one end raised on their cones; and the original of each."""
    angles = angles_at(paths, is_tx=is_tx)
    rows, turned = [np.arange(len(paths))], [angles]
    for path in np.flatnonzero(angles[:, 1] == 0):
        directions = same_cone(manifold, angles[path], STARTS_RAD)
        rows.append(np.full(len(directions), path))
        turned.append(directions)
    origin = np.concatenate(rows)
    return with_angles(paths.take(origin), np.concatenate(turned), is_tx=is_tx), origin


def _would_show(sweep: CompressedSweep, path: PathParameters, level: float) -> bool:
    """Whether some elevation of one horizontal path would change its power in the samples by a `level`."""
    for is_tx, manifold in hiding_ends(sweep):
        at = responses(sweep, _with_raised(path, manifold, is_tx=is_tx)[0])
        own = (at.tx if is_tx else at.rx)[:, 0]
        energy = np.square(np.abs(own)).sum(axis=1)
        same = np.square(np.abs(own @ own[0].conj())) / np.maximum(energy * energy[0], 1e-300)
        power = np.square(np.abs(path.amplitude[0])) * response_energies(at)[0]
        if power * (1 - same.min()) > level:
            return True
    return False


def _differ(one: PathParameters, other: PathParameters) -> bool:
    return bool((one.aod_rad != other.aod_rad).any() or (one.aoa_rad != other.aoa_rad).any())
