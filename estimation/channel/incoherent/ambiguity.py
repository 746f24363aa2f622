"""Ambiguous directions: directions that the magnitudes of the beams do not distinguish.

Without phases between beam pairs a path shows only the strength of every beam. Beams at few elevations are nearly
as strong a little above as a little below their peak, so two directions, even of different azimuths, explain the
same magnitudes: the likelihood has several modes. The modes are searched along the elevation, fitted, and weighted
by their likelihood, tempered by the errors of beam models, by the prior of their power (strong paths are rare),
and by that of their directions (`direction_prior`). The covariance of the path then spans all modes.
"""

import numpy as np

from estimation.channel.incoherent.likelihood import (
    LinkBeams,
    LocalSamples,
    Score,
    likelihood_without,
    log_likelihood_gradient,
    maximise_likelihood,
)
from estimation.channel.model.crb import path_covariance
from estimation.channel.model.direction_prior import direction_log_prior
from scenes.pose import wrap_angle
from scenes.record import FloatArray

LEVEL_STEP_RAD = np.deg2rad(1.0)  # between the searched elevations
REACH_CELLS = 2.0  # of azimuth to either side of the path's own
SCAN_PER_CELL = 4.0  # azimuths per Rayleigh cell: places from which modes are fitted
FAR_BELOW = 30.0  # the path's own place, tempered: no prior brings such a mode back
LEAST_LOG_WEIGHT = -5.0  # relative to the best mode, below which a mode does not count
# Share of a path's power that beam models do not explain: the darkest pairs with a part of it are left out.
MODEL_ERROR = 3e-3
APART = 3.0  # least distance of two modes in standard deviations


def resolve_ambiguous_directions(
    local: LocalSamples, ends: LinkBeams, paths: FloatArray, at: Score
) -> tuple[FloatArray, Score, FloatArray]:
    """Paths (path, parameter) at their likeliest modes over direction, the likelihood there, and the spread.

    The spread (path, place, place) of delay in bins and angles in rad is the second moment of the modes about the
    likeliest one; zero with one mode. A further mode is that of one path alone, or of all ambiguous paths
    together: paths in the same beam pairs share those pairs' phases.
    """
    n, n_places = len(paths), paths.shape[1] - 2
    spread = np.zeros((n, n_places, n_places))
    if ends.tx.n_angles == ends.rx.n_angles == 1:
        return paths, at, spread
    temper = 1 + MODEL_ERROR * np.maximum(at.value - likelihood_without(local, ends, paths, np.arange(n)), 0.0)
    modes = _modes(local, ends, paths, at, temper)
    chosen = [_weights(ends, *mode, factor)[1] for mode, factor in zip(modes, temper, strict=True)]
    together = np.array([places[second] for (places, _), second in zip(modes, chosen, strict=True)])
    if any(second > 0 for second in chosen):
        moved, then, is_near = maximise_likelihood(local, ends, together)
        if is_near and ends.in_sight(moved).all():
            modes = [
                (np.vstack([places, place]), np.append(values, then.value))
                for (places, values), place in zip(modes, moved, strict=True)
            ]
    best = paths.copy()
    for path, ((places, values), factor) in enumerate(zip(modes, temper, strict=True)):
        alone = slice(len(values) - 1) if len(values) > 1 else slice(None)
        best[path] = places[alone][np.argmax(_weights(ends, places[alone], values[alone], factor)[0])]
        weight, _ = _weights(ends, places, values, factor)
        offset = _offset(places, best[path])[:, :n_places]
        spread[path] = np.einsum("r,ra,rb->ab", weight, offset, offset)
    return best, at if (best == paths).all() else log_likelihood_gradient(local, ends, best), spread


def _modes(
    local: LocalSamples, ends: LinkBeams, paths: FloatArray, at: Score, temper: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Places (mode, parameter) of each path, its own first, and log-likelihoods (mode,) of all paths."""
    size = paths.shape[1]
    information = at.information.reshape(len(paths), size, len(paths), size)
    std = np.sqrt(np.einsum("iaia->ia", path_covariance(information)))[:, :-2]
    found = []
    for path in range(len(paths)):
        own, others = paths[[path]], np.delete(paths, path, axis=0)
        places, values = [own[0]], [at.value]
        starts = _starts(ends, own[0])
        if len(starts):
            bright = ends.bright_pairs(np.concatenate([own, starts]), 1 - MODEL_ERROR / 100)
            beside = local.of_pairs(bright)
            beside = beside.with_fixed(ends, others, own[:, 0]) if len(others) else beside
            here = log_likelihood_gradient(beside, ends, own).value
            elsewhere, least = at.value - here, here - FAR_BELOW * temper[path]
        for start in starts:
            mode, then, is_near = maximise_likelihood(beside, ends, start[None], least=least)
            is_apart = (np.abs(_offset(mode, paths[path])[0, :-2]) > APART * std[path]).any()
            if is_near and then.value >= least and is_apart and ends.in_sight(mode).all():
                places.append(mode[0])
                values.append(then.value + elsewhere)
        found.append((np.array(places), np.array(values)))
    return found


def _weights(ends: LinkBeams, places: FloatArray, values: FloatArray, temper: float) -> tuple[FloatArray, int]:
    """Weights (mode,) that add up to one, and the index of the heaviest except the first, 0 if there is none."""
    n = ends.tx.n_angles
    log_weight = values / temper - 2 * places[:, -2]
    log_weight += direction_log_prior(ends.tx, ends.rx, places[:, 1 : 1 + n], places[:, 1 + n : -2])
    weight = np.exp(log_weight - log_weight.max())
    weight[weight < np.exp(LEAST_LOG_WEIGHT)] = 0.0
    second = 1 + int(np.argmax(log_weight[1:])) if len(values) > 1 else 0
    return weight / weight.sum(), second


def _starts(ends: LinkBeams, path: FloatArray) -> FloatArray:
    """Paths (mode, parameter) like one path, at further peaks over elevation of the similarity of magnitudes."""
    starts = [np.zeros((0, len(path)))]
    cells = ends.cells(path[None])[0]
    for manifold, noise_mw, first in (
        (ends.tx, np.ones(ends.tx.n_beams), 1),
        (ends.rx, ends.noise_mw, 1 + ends.tx.n_angles),
    ):
        if manifold.n_angles == 1:
            continue
        own = path[first : first + 2]
        levels = np.arange(*manifold.elevation_range_rad, LEVEL_STEP_RAD)
        turns = own[0] + cells[first] * np.linspace(
            -REACH_CELLS, REACH_CELLS, int(2 * REACH_CELLS * SCAN_PER_CELL) + 1
        )
        angles = np.stack(np.meshgrid(turns, levels), axis=2).reshape(-1, 2)
        magnitude = np.abs(manifold.response(np.vstack([own, angles]))) / np.sqrt(noise_mw)
        norm = np.maximum(np.linalg.norm(magnitude, axis=1), 1e-300)
        likeness = (magnitude[1:] @ magnitude[0] / norm[1:]).reshape(len(levels), len(turns))
        best = likeness.argmax(axis=1) + len(turns) * np.arange(len(levels))
        curve = np.pad(likeness.max(axis=1), 1, constant_values=-np.inf)
        peaks = best[(curve[1:-1] >= curve[:-2]) & (curve[1:-1] >= curve[2:])]
        modes = np.repeat(path[None], len(peaks), axis=0)
        modes[:, first : first + 2] = angles[peaks]
        modes[:, -2] += np.log(norm[0] / norm[1 + peaks])
        starts.append(modes)
    return np.concatenate(starts)


def _offset(paths: FloatArray, reference: FloatArray) -> FloatArray:
    """Parameters of paths (mode, parameter) minus those of another, angles on the circle."""
    offset = paths - reference
    offset[:, 1:-2] = wrap_angle(offset[:, 1:-2])
    return np.asarray(offset)
