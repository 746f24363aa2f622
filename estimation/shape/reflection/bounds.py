"""Bounds of contours seen from several TX: the information of the bundle at known shapes, poses and offsets.

The unknowns are those of `estimation.shape.reflection.bundle` with their priors, and no path is a ghost. The clock
of a TX at a stop is of no other path and is marginalised. What remains, a pose per stop, offsets and objects, is
shared by all TX, so the informations of several TX add up; only the departure offset of each is its own.

The covariance is that of the posterior: the Bayesian Cramer-Rao bound at the true parameters (Van Trees,
"Detection, Estimation and Modulation Theory", part I, section 2.4.3).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.laws.support import CLOSED_FAMILY, support
from estimation.shape.config import ContourConfig
from estimation.shape.kinds.closed import closed_prior
from estimation.shape.reflection.bundle import bundle_paths
from estimation.shape.reflection.bundle_system import LOS, bundle_system
from estimation.shape.reflection.posterior import Prior, with_offsets
from estimation.shape.reflection.reflections import Reflections
from estimation.shape.reflection.search import N_COMMON
from scenes.record import FloatArray

_N_NORMALS = 72  # of an outline, over which errors are averaged


@dataclass(frozen=True)
class KnownContour:
    """A closed contour at its true parameters, of a kind of `CLOSED_FAMILY`."""

    name: str
    kind: str
    parameter: FloatArray  # (parameter,)


@dataclass(frozen=True)
class ContourBounds:
    """Bounds of closed contours, in the order of the objects."""

    center_m: FloatArray  # (object,) root of the summed variance of x and y
    radius_m: FloatArray  # (object,) standard deviation of the mean radius
    outline_m: FloatArray  # (object,) RMS over the outline of the standard deviation along its normal


def link_information(
    objects: Sequence[KnownContour],
    bounces: Sequence[Reflections],
    los: Reflections,
    states: FloatArray,
    config: ContourConfig,
) -> FloatArray:
    """What the paths of one TX tell: information on delay and arrival offset, all objects, then all poses.

    The TX has `bounces` off every object and lines of sight, at true `states` (stop, 4). Its clocks have the
    errors of the survey. The `stop` of a path is the row of its state. What was measured does not matter, only the
    covariances.
    """
    sizes = [N_COMMON + 1, *(len(each.parameter) for each in objects)]
    family = [*(CLOSED_FAMILY[each.kind] for each in objects), LOS]
    data = bundle_paths([*bounces, los], family, sizes, np.arange(len(states)))
    common = np.concatenate([np.zeros(N_COMMON + 1), *(each.parameter for each in objects)])
    found = bundle_system(common, states, data, np.ones(len(family)), -np.inf)
    clock = found.stop[:, 3, 3] + config.survey_std[3] ** -2.0
    by_pose, by_common = found.stop[:, :3, 3], found.cross[:, 3]
    scaled = by_common / clock[:, None]
    pose = found.stop[:, :3, :3] - by_pose[:, :, None] * by_pose[:, None] / clock[:, None, None]
    cross = found.cross[:, :3] - by_pose[:, :, None] * scaled[:, None]
    n, n_poses = len(common), 3 * len(states)
    total = np.zeros((n + n_poses, n + n_poses))
    total[:n, :n] = found.common - by_common.T @ scaled
    total[n:, :n] = cross.reshape(n_poses, n)
    total[:n, n:] = total[n:, :n].T
    rows = n + np.arange(n_poses).reshape(-1, 3)
    total[rows[:, :, None], rows[:, None]] = pose
    departure = _offset_precision(config)[N_COMMON] + total[N_COMMON, N_COMMON]
    rest = np.delete(total, N_COMMON, axis=0)
    shared = rest[:, N_COMMON]
    return np.asarray(np.delete(rest, N_COMMON, axis=1) - np.outer(shared, shared) / departure)


class ContourInformation:
    """Objects, priors and the informations (unknown, unknown) of all TX; any of them together bound the contours.

    Poses are those of a survey with the errors that `config` states.
    """

    def __init__(
        self, objects: Sequence[KnownContour], links: Sequence[FloatArray], config: ContourConfig
    ) -> None:
        self.objects, self.links = tuple(objects), tuple(links)
        priors = [closed_prior(each.kind, each.parameter, config.reflection) for each in objects]
        common = np.concatenate([_offset_precision(config)[:N_COMMON], *map(_precision, priors)])
        survey = config.survey_std[:3] ** -2.0
        n_stops = (len(links[0]) - len(common)) // len(survey)
        self._prior = np.concatenate([common, np.tile(survey, n_stops)])
        sizes = [len(each.parameter) for each in objects]
        self._first = N_COMMON + np.cumsum([0, *sizes])[:-1]
        self._mean = _outline_weights(self.objects)

    def bounds(self, chosen: Sequence[int]) -> ContourBounds:
        """Bounds with the paths of the `chosen` TX."""
        weight = np.zeros(len(self.links))
        weight[list(chosen)] = 1.0
        covariance, found = self._covariance(weight), []
        for first, each, mean in zip(self._first, self.objects, self._mean, strict=True):
            own = covariance[first : first + len(mean), first : first + len(mean)]
            radius_m = np.exp(each.parameter[2]) * np.sqrt(own[2, 2])
            found.append((np.sqrt(own[0, 0] + own[1, 1]), radius_m, np.sqrt(np.sum(own * mean))))
        return ContourBounds(*np.array(found).reshape(-1, 3).T)

    def log_error(self, weight: FloatArray) -> tuple[float, FloatArray]:
        """Mean over the objects of the logarithm of the RMS error of their outlines, and its gradient (tx,).

        The information of a TX counts with its `weight` (tx,). The logarithm is convex in the weights. The
        mean square is tr(V' inv(J) V) with J linear in the weights, and by Cauchy and Schwarz its inverse is the
        minimum of tr(Z' J Z) over all Z with tr(V' Z) = 1: a minimum of linear functions, which is concave.
        """
        covariance = self._covariance(weight)
        inner, value = np.zeros_like(covariance), 0.0
        for first, mean in zip(self._first, self._mean, strict=True):
            rows = slice(first, first + len(mean))
            square = float(np.sum(covariance[rows, rows] * mean))
            value += 0.5 * np.log(square)
            inner[rows, rows] = mean / (2 * square)
        n, outer = len(self.objects), covariance @ inner @ covariance
        return value / n, -np.array([np.sum(outer * link) for link in self.links]) / n

    def _covariance(self, weight: FloatArray) -> FloatArray:
        """Covariance (unknown, unknown) of all unknowns."""
        total = np.diag(self._prior)
        for each in np.flatnonzero(weight):
            total += weight[each] * self.links[each]
        return np.asarray(np.linalg.inv(total))


def _offset_precision(config: ContourConfig) -> FloatArray:
    """Precisions (3,) of the delay offset, the arrival offset, and the departure offset of a TX."""
    return with_offsets(Prior(*3 * [np.zeros(0)]), 1, config.reflection).precision


def _precision(prior: Prior) -> FloatArray:
    """Precisions (parameter,) of a prior, those of flat ones by the variance over their width."""
    return np.where(prior.precision == 0, 12 / prior.flat_width**2, prior.precision)


def _outline_weights(objects: Sequence[KnownContour]) -> list[FloatArray]:
    """Matrices (parameter, parameter) whose product with a covariance is the mean square error of the outline."""
    psi = np.linspace(-np.pi, np.pi, _N_NORMALS, endpoint=False)
    found = []
    for each in objects:
        value, slope = support(CLOSED_FAMILY[each.kind], each.parameter, psi)
        arc = np.maximum(value[:, 0] + value[:, 2], 0.0)
        found.append((slope[:, 0] * (arc / arc.sum())[:, None]).T @ slope[:, 0])
    return found
