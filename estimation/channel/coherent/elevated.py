"""Merge the images of a path from above or below the horizon on several panels of horizontal beams.

Every panel observes a path at the cone angle about its own boresight. A direction of elevation e and azimuth a
from a boresight lies on the cone of sine sin(a) cos(e), so no horizontal direction fits two panels: a model of
horizontal paths needs an image for each panel. The images have the same delay and angle at the far end, and
dependent amplitudes. If one path with an elevation explains the samples as well as all images, it replaces them.
"""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.coherent.prune import LevelOfPaths
from estimation.channel.coherent.refine import Reference, Solution, refine_near
from estimation.channel.model.apparent import directions_on_cone
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, responses
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray

ELEVATIONS_RAD = np.deg2rad(np.arange(3.0, 75.0, 2.0))  # candidates
SAME_PLACE = 0.5  # least squared coherence over delay and far-end angle of the images of a path
OTHER_ANGLE = 0.25  # squared coherence over the angle at this end, below which two paths are no close pair
LARGEST_DEVIATION = 0.7  # largest relative difference between an image's amplitude and that of the elevated path
LARGEST_ALONE = 1.4  # the same with each image alone: images on other panels change it by their coherence


def merge_elevated_images(
    reference: Reference, solution: Solution, levels: LevelOfPaths, max_steps: int
) -> Solution:
    """The solution with an elevated path in place of several horizontal ones if it explains the samples as well.

    As well means: as much as with the images, minus their levels. Only manifolds that hide elevation change.
    """
    for is_tx, _ in hiding_ends(reference.sweep):
        kept = np.arange(len(solution.paths))  # of the paths before any change
        for images in _clearest_images(reference, solution.paths, is_tx=is_tx):
            if not np.isin([images.first, *images.seconds], kept).all():
                continue
            first, seconds = kept == images.first, np.isin(kept, images.seconds)
            enough = solution.explained - levels(solution.paths.take(seconds)).sum()
            angles_rad = np.where(first[:, None], images.angles_rad, angles_at(solution.paths, is_tx=is_tx))
            trial = with_angles(solution.paths, angles_rad, is_tx=is_tx).take(~seconds)
            one = refine_near(reference, trial, solution.paths.take(first | seconds), max_steps)
            if one.explained > enough:
                solution, kept = one, kept[~seconds]
    return solution


@dataclass(frozen=True)
class _Images:
    """A path `first`, its images `seconds` on other panels, its elevated angles (2,) and their common power."""

    first: int
    seconds: IntArray
    angles_rad: FloatArray
    power: float


def _clearest_images(reference: Reference, paths: PathParameters, *, is_tx: bool) -> list[_Images]:
    """Of every horizontal path the images, over all elevations, that explain most power; the strongest first."""
    at = responses(reference.sweep, paths)
    tx, rx, delay = at.tx[:, 0], at.rx[:, 0], at.delay[:, 0]
    own, far = (tx, rx) if is_tx else (rx, tx)
    angles_rad = angles_at(paths, is_tx=is_tx)
    manifold = reference.sweep.tx if is_tx else reference.sweep.rx
    beside = (far.conj() @ far.T) * (delay @ delay.T)
    energy = np.diagonal(beside).real
    together = np.square(np.abs(beside)) >= SAME_PLACE * energy * energy[:, None]
    inner = own.conj() @ own.T
    own_energy = np.diagonal(inner).real
    together &= np.square(np.abs(inner)) < OTHER_ANGLE * own_energy * own_energy[:, None]
    together[angles_rad[:, 1] != 0] = False
    boresight_rad, found = manifold.best_panel_rad(angles_rad), []
    for first in np.flatnonzero(together.any(axis=1)):
        others = np.flatnonzero(together[first])
        directions = same_cone(angles_rad[first], boresight_rad[first], ELEVATIONS_RAD)
        raised = manifold.response(directions)
        if reference.sweep.turns is not None:
            raised = raised * reference.sweep.turns.wave(paths.doppler_turns[[first]], is_tx=is_tx)
        change = paths.amplitude[first] * (raised - own[first])
        seen = paths.amplitude[others] * beside[first, others] / energy[first]
        alone = change @ own[others].conj().T / own_energy[others]
        may_agree = np.abs(alone / seen - 1) <= LARGEST_ALONE
        most = np.square(may_agree @ (np.abs(seen) * np.sqrt(own_energy[others])))  # power at most, by elevation
        best: _Images | None = None
        for k in np.argsort(-most, kind="stable"):
            if most[k] <= (best.power if best else 0.0):
                break
            some = others[may_agree[k]]
            agree, power = _agreeing(own[some], seen[may_agree[k]], change[k])
            if power > (best.power if best else 0.0):
                best = _Images(int(first), some[agree], directions[k], power)
        if best:
            found.append(best)
    return sorted(found, key=lambda images: -images.power)


def _agreeing(
    responses_: ComplexArray, amplitude: ComplexArray, difference: ComplexArray
) -> tuple[BoolArray, float]:
    """Mask (path,) of the paths (responses: (path, rank)) whose amplitudes fit a vector (rank,), and their power.

    Paths that do not fit are removed, the worst first, until all others fit.
    """
    agree: BoolArray = np.ones(len(amplitude), bool)
    while agree.any():
        shown = np.linalg.lstsq(responses_[agree].T, difference, rcond=None)[0]
        deviation = np.abs(shown / amplitude[agree] - 1)
        if deviation.max() <= LARGEST_DEVIATION:
            break
        agree[np.flatnonzero(agree)[np.argmax(deviation)]] = False
    power = np.square(np.abs(amplitude[agree] @ responses_[agree])).sum()
    return agree, float(power)


def same_cone(angles_rad: FloatArray, boresight_rad: float, elevation_rad: FloatArray) -> FloatArray:
    """Directions (direction, 2) of these elevations on the cone of a horizontal one (2,) about a boresight."""
    level = np.array([[angles_rad[0], 0.0]])
    directions, is_there = directions_on_cone(level, np.array([boresight_rad]), elevation_rad)
    return np.asarray(directions[is_there])


def hiding_ends(sweep: CompressedSweep) -> list[tuple[bool, Manifold]]:
    """Whether it is the TX, and the manifold, of the ends that hide elevation."""
    ends = ((True, sweep.tx), (False, sweep.rx))
    return [(is_tx, manifold) for is_tx, manifold in ends if manifold.hides_elevation]


def angles_at(paths: PathParameters, *, is_tx: bool) -> FloatArray:
    """Angles (path, angle) of paths at one end."""
    return paths.aod_rad if is_tx else paths.aoa_rad


def with_angles(paths: PathParameters, angles_rad: FloatArray, *, is_tx: bool) -> PathParameters:
    """The paths with other angles (path, angle) at one end."""
    return replace(paths, aod_rad=angles_rad) if is_tx else replace(paths, aoa_rad=angles_rad)
