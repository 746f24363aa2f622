"""Possible further paths next to known ones: what they explain, and how they shift the known ones."""

from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from estimation.channel.coherent.refine import NEAR_CELLS, Reference, Solution
from estimation.channel.model.cholesky import regular_inverse
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import (
    PathParameters,
    cells_apart,
    gram_matrix,
    manifold_rates,
    response_energies,
    responses,
)
from scenes.record import BoolArray, FloatArray

PROBE_OFFSET = 0.5  # resolution cells between a path and the probes for a second one
LEAST_OWN_SHARE = 0.02  # of a probe's energy that known paths cannot explain: below it, a probe is uninformative
LEAST_SEEN = 1e-3  # of the usual rate on the manifold, below which a parameter is unobservable


def seen_axes(rate: FloatArray) -> BoolArray:
    """Mask (path, parameter) of the axes along which the beams resolve paths, from the `manifold_rates` of all."""
    return np.asarray(rate > LEAST_SEEN * rate.max(axis=0, initial=0.0))


@dataclass(frozen=True)
class ProbeScores:
    """Amplitudes of probes for a further path, in the linear model of all known paths near them.

    Attributes
    ----------
    energy : (probe,) squared norm of the response of a probe
    own : (probe, 2, 2) half the information on real and imaginary amplitude when the known paths may change
    score : (probe, 2) half the gradient over them
    near : (path,) mask of the known paths near the probes
    shift : (probe, 2, near path, parameter) by which the known paths err per amplitude that is left out
    """

    energy: FloatArray
    own: FloatArray
    score: FloatArray
    near: BoolArray
    shift: FloatArray


class KnownPaths:
    """The paths of a solution, against which further ones are tested; `solution` is at the reference's paths."""

    def __init__(self, reference: Reference, solution: Solution) -> None:
        self.reference = reference
        self.solution = solution

    def test(self, probes: PathParameters, near: BoolArray) -> ProbeScores:
        """Scores of probes about one place, where only the known paths `near` (path,) change."""
        at = responses(self.reference.sweep, probes)
        known = self.reference.at
        close = replace(known, tx=known.tx[near], rx=known.rx[near], delay=known.delay[near])
        inner = gram_matrix(at, close)[:, 0]
        scale = self.solution.paths.amplitude[near, None]
        columns = np.concatenate([inner[..., :1], 1j * inner[..., :1], inner[..., 1:] * scale], axis=2)
        cross = np.stack([columns, -1j * columns], axis=1).real
        n_columns = cross.shape[2] * cross.shape[3]
        flat = cross.reshape(len(probes), 2, n_columns)
        information = self.solution.information[near][:, :, near].reshape(n_columns, n_columns)
        shift = flat @ regular_inverse(information)
        energy = response_energies(at)
        value = self.reference.residual_products(at)[:, 0]
        return ProbeScores(
            energy=energy,
            own=energy[:, None, None] * np.eye(2) - shift @ flat.swapaxes(1, 2),
            score=np.stack([value.real, value.imag], axis=1) - shift @ self.solution.slope[near].ravel(),
            near=near,
            shift=shift.reshape(cross.shape)[..., 2:],
        )


def probes_about(
    path: PathParameters, rate: FloatArray, n_axes: int, offsets: tuple[float, ...] = (PROBE_OFFSET,)
) -> PathParameters:
    """Probes at each of some offsets from one path to either side, along one axis and up to `n_axes` at once.

    Axes that the beams do not observe are left out; `rate` (parameter,) is the path's of `manifold_rates`.
    Offsets are in resolution cells.
    """
    seen = np.flatnonzero(rate > LEAST_SEEN * CELL)
    rows = [np.zeros((0, len(rate)))]
    for count in range(1, min(n_axes, len(seen)) + 1):
        for axes in combinations(seen, count):
            signs = np.array(list(product((-1.0, 1.0), repeat=count)))
            row = np.zeros((len(signs), len(rate)))
            row[:, axes] = signs * CELL / rate[list(axes)]
            rows.extend(offset * row for offset in offsets)
    step = np.concatenate(rows)
    return path.take(np.zeros(len(step), int)).moved(step)


def hidden_second_paths(
    reference: Reference, solution: Solution, level: float, about: PathParameters | None = None
) -> PathParameters:
    """The likeliest second paths next to those of the `reference` that explain more than `level`, best first.

    `solution` is at the reference's paths. Probes are half a resolution cell from every path (or from `about`)
    along every axis. The score test counts only the energy that no change of the known paths explains. No two of
    the result are near each other.
    """
    about = solution.paths if about is None else about
    known, found, power = KnownPaths(reference, solution), about.take(slice(0, 0)), np.zeros(0)
    rate = manifold_rates(reference.sweep, about)
    near = cells_apart(solution.paths, about, rate) <= NEAR_CELLS
    for place in range(len(about)):
        probes = probes_about(about.take(np.array([place])), rate[place], 1)
        test = known.test(probes, near[:, place])
        own = test.own + LEAST_OWN_SHARE * test.energy[:, None, None] * np.eye(2)
        weighted = np.linalg.solve(own, test.score[..., None])[..., 0]
        explained = (test.score * weighted).sum(axis=1)
        likely = explained >= level
        found = found.joined(replace(probes, amplitude=weighted @ np.array([1, 1j])).take(likely))
        power = np.append(power, explained[likely])
    return _apart(reference, found.take(np.argsort(-power, kind="stable")))


def _apart(reference: Reference, paths: PathParameters) -> PathParameters:
    """The paths, from the first on, that are near none before."""
    is_near = cells_apart(paths, paths, manifold_rates(reference.sweep, paths)) <= NEAR_CELLS
    kept: list[int] = []
    remaining: BoolArray = np.ones(len(paths), bool)
    while remaining.any():
        kept.append(int(np.argmax(remaining)))
        remaining &= ~is_near[:, kept[-1]]
        remaining[kept[-1]] = False
    return paths.take(np.array(kept, int))
