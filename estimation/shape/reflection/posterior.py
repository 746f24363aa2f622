"""Maximum a posteriori fit of one contour to delays and angles, with common offsets and a ghost component.

A path belongs to the contour with probability 1 - q; its errors are Gaussian with its covariance plus, to first
order, that of its RX pose. Otherwise it is a ghost, uniform over a window. Unknowns are the parameters of the
contour, one delay offset, one arrival offset and one departure offset per session. Levenberg-Marquardt finds the
minimum on the path-weighted normal equations (the expectation-maximisation bound). Covariance and evidence are
those of Laplace.
"""

from dataclasses import dataclass

import numpy as np

from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.reflections import Reflections
from estimation.shape.reflection.search import CHI2_MEDIAN, N_COMMON, GhostMixture, search_posterior, weigh_starts
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray

_FIXED_STD = 1e-7
_MAX_REFRESHES = 4


@dataclass(frozen=True)
class Prior:
    """Independent priors: Gaussian, or flat over a width where the precision is 0.

    A flat prior counts in the evidence as the Gaussian of the same peak density, so that paths without
    information on a parameter do not change the evidence.
    """

    mean: FloatArray  # (parameter,)
    precision: FloatArray  # (parameter,)
    flat_width: FloatArray  # (parameter,) of the flat ones

    def log_density(self, value: FloatArray) -> FloatArray:
        """Log density (...) at parameters (..., parameter)."""
        flat = self.precision == 0
        norm = np.log(self.precision[~flat] / (2 * np.pi)).sum() / 2 - np.log(self.flat_width[flat]).sum()
        return np.asarray(norm - 0.5 * (value - self.mean) ** 2 @ self.precision)

    @property
    def evidence_precision(self) -> FloatArray:
        """Precision (parameter,), for flat priors that of the Gaussian of the same peak density."""
        flat = self.precision == 0
        return np.where(flat, 2 * np.pi / np.where(flat, self.flat_width, 1.0) ** 2, self.precision)


@dataclass(frozen=True)
class Optimum:
    """The most likely contour with its offsets, Laplace covariance and evidence."""

    parameter: FloatArray  # (parameter,)
    offset: FloatArray  # (2 + session,) delay in m, arrival, departure of each session in rad
    covariance: FloatArray  # (parameter + 2 + session, ...) of parameter and offset together
    log_evidence: float
    inlier: FloatArray  # (path,) probability of belonging to the contour

    @property
    def parameter_covariance(self) -> FloatArray:
        """Covariance (parameter, parameter) with the offsets unknown."""
        m = len(self.parameter)
        return self.covariance[:m, :m]


def maximise_posterior(
    family: int,
    start: FloatArray,
    prior: Prior,
    data: Reflections,
    config: ReflectionConfig,
    refreshes: int = _MAX_REFRESHES,
) -> Optimum | None:
    """The local maximum of the posterior from `start` (parameter,); None where the information is singular.

    Far from the optimum all paths would be ghosts: the covariances are then enlarged at first and reduced step
    by step. The contribution of the pose errors to the path covariances is constant during a search; searches
    are repeated with the new contribution until the result stays the same, at most `refreshes` times.
    """
    m, full = len(start), with_offsets(prior, data.n_sessions, config)
    value = full.mean.copy()
    value[:m] = start
    added = (full.mean, full.precision, full.evidence_precision)
    evidence, covariance, inlier, is_regular = search_posterior(
        family, m, value, *added, data.arrays, _mixture(data, config), refreshes
    )
    if not is_regular:
        return None
    return Optimum(value[:m], value[m:], covariance, float(full.log_density(value)) + evidence, inlier)


def best_start(
    family: int, starts: FloatArray, prior: Prior, data: Reflections, config: ReflectionConfig
) -> FloatArray:
    """The start, of (start, parameter), with the highest posterior density at zero offsets.

    The covariances are scaled so that the start with the least median error has the expected median error.
    """
    square, log_norm = weigh_starts(
        family, starts, np.zeros(N_COMMON + data.n_sessions), data.arrays, _mixture(data, config)
    )
    scale = max(np.median(square, axis=1).min() / CHI2_MEDIAN, 1.0)
    log_inlier = log_norm - 1.5 * np.log(scale) - 0.5 * square / scale
    density = np.logaddexp(log_inlier, config.log_ghost_density).sum(axis=1)
    density += prior.log_density(starts)
    return np.asarray(starts[np.argmax(np.nan_to_num(density, nan=-np.inf))])


def path_agreement(family: int, found: Optimum, data: Reflections) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distances (path,) of paths from what a fitted contour with its offsets predicts.

    Also their log densities (path,): of two paths as near, the more precise one has the higher density. The
    covariances of paths and poses count, that of the contour does not. Sessions without paths in the fit get
    its mean departure offset.
    """
    n_known = len(found.offset) - N_COMMON
    missing = np.full(max(data.n_sessions - n_known, 0), found.offset[N_COMMON:].mean())
    offset = np.concatenate([found.offset, missing])
    mixture = GhostMixture(0.0, -np.inf, data.has_exact_poses)
    square, log_norm = weigh_starts(family, found.parameter[None], offset, data.arrays, mixture)
    return square[0], log_norm[0] - 0.5 * square[0]


def with_offsets(prior: Prior, n_sessions: int, config: ReflectionConfig) -> Prior:
    """The prior of the parameters of a contour, then those of the delay, arrival and departure offsets."""
    std = np.array(
        [
            1e-9 * SPEED_OF_LIGHT_M_S * config.delay_offset_std_ns,
            np.deg2rad(config.aoa_offset_std_deg),
            *n_sessions * [np.deg2rad(config.aod_offset_std_deg)],
        ]
    )
    precision = np.maximum(std, _FIXED_STD) ** -2.0
    return Prior(
        np.concatenate([prior.mean, np.zeros(len(std))]),
        np.concatenate([prior.precision, precision]),
        np.concatenate([prior.flat_width, np.ones(len(std))]),
    )


def _mixture(data: Reflections, config: ReflectionConfig) -> GhostMixture:
    return GhostMixture(config.log_path_share, config.log_ghost_density, data.has_exact_poses)
