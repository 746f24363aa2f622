"""Maximum-likelihood refinement of RX states with the IPs eliminated, by robust re-weighted least squares.

Each single bounce leaves one equation r = 0 (`estimation.geometry.BounceEquation`). To first order r is Gaussian
with variance g' R g, g the gradient of r with respect to the measurement, and r^2 / (g' R g) is the cost of the
path minimised over its IP: minimising the sum over paths refines state and IPs jointly. The line of sight adds
its three residuals. Many states are refined side by side; all arrays start with the axis `state`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import expit, gammaln

from estimation.geometry import bounce_equation, los_jacobian_rx, predict_los, residual
from estimation.slam.config import Mixture
from estimation.slam.problem import SnapshotProblem
from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray

# Weak prior on [x, y, heading, bias], in m, m, rad, m: it only keeps determinants finite.
_PRIOR_STD = np.array([50.0, 50.0, np.pi, 50.0])

# Standard deviations of the angles by which an IP may lie outside the devices' rays.
_FEASIBLE_STDS = 2.0


@dataclass(frozen=True)
class BounceResidual:
    """Residuals of all paths as single bounces, for a batch of states."""

    value_m: FloatArray  # (state, path)
    variance_m2: FloatArray  # (state, path)
    jacobian: FloatArray  # (state, path, 4), per [x, y, heading, bias]
    by_measurement: FloatArray  # (state, path, 3), per [range, departure, arrival]
    is_feasible: BoolArray  # (state, path): the IP lies between the devices' rays


@dataclass(frozen=True)
class Refined:
    """A batch of refined states."""

    state: FloatArray  # (state, 4) in m, m, rad, m
    covariance: FloatArray  # (state, 4, 4)
    log_evidence: FloatArray  # (state,), Laplace approximation


def bounce_residual(problem: SnapshotProblem, state: FloatArray) -> BounceResidual:
    """Residual of the bounce equation, its variance and its Jacobian, for every state and every path."""
    return bounce_terms(problem.tx, problem.measured, problem.covariance, state[:, None])


def bounce_terms(tx: Pose, measured: FloatArray, covariance: FloatArray, state: FloatArray) -> BounceResidual:
    """The same for paths (..., 3) and states (..., 4) that broadcast against each other.

    A bounce is feasible where its IP lies between the devices' rays, up to two standard deviations of the angles:
    where the rays are nearly opposite, as at the line of sight or just behind an obstacle, the place of the IP
    along them is not determined.
    """
    equation = bounce_equation(tx, state[..., 2], measured)
    z = state[..., [0, 1, 3]]
    value = equation.residual_m(z)
    row = equation.row
    from_tx = z[..., :2] - tx.position_m[:2]
    along = from_tx[..., 0] * row[..., 1] - from_tx[..., 1] * row[..., 0]
    length = measured[..., 0] - z[..., 2]
    reach = length * equation.along
    by_measurement = np.stack([-row[..., 2], -(along + reach) / 2, -(along - reach) / 2], axis=-1)
    variance = np.einsum("...i,...ij,...j->...", by_measurement, covariance, by_measurement)
    jacobian = np.stack([row[..., 0], row[..., 1], by_measurement[..., 2], row[..., 2]], axis=-1)
    angle_std = np.sqrt(covariance[..., 1, 1] + covariance[..., 2, 2])
    slack = _FEASIBLE_STDS * angle_std * length * np.abs(row[..., 2])
    feasible = (length > 0) & (np.abs(along) <= np.abs(reach) + slack)
    return BounceResidual(value, np.maximum(variance, 1e-18), jacobian, by_measurement, feasible)


def bounce_log_ratio(residual_m: BounceResidual, mixture: Mixture) -> FloatArray:
    """Log of (single bounce : clutter) odds (state, path); -inf where a bounce is infeasible."""
    freedom = mixture.degrees_of_freedom
    square = residual_m.value_m**2 / residual_m.variance_m2
    peak = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(np.pi * freedom)
    student = peak - 0.5 * np.log(residual_m.variance_m2) - (freedom + 1) / 2 * np.log1p(square / freedom)
    share = mixture.clutter_share
    ratio = student + np.log((1 - share) / share * mixture.clutter_width_m)
    return np.where(residual_m.is_feasible, ratio, -np.inf)


def log_likelihood(
    problem: SnapshotProblem, state: FloatArray, is_los: BoolArray, mixture: Mixture
) -> FloatArray:
    """Log-likelihood (state,) of the paths that are no line of sight, relative to all of them being clutter."""
    ratio = bounce_log_ratio(bounce_residual(problem, state), mixture)
    gain = np.logaddexp(0.0, ratio) + np.log(mixture.clutter_share)
    return np.asarray(gain[:, ~is_los].sum(axis=1))


def refine(
    problem: SnapshotProblem,
    state: FloatArray,
    is_los: BoolArray,
    mixture: Mixture,
    max_iterations: int,
    member: BoolArray | None = None,
) -> Refined:
    """Refine states (state, 4) by damped, re-weighted Gauss-Newton steps.

    Parameters
    ----------
    problem
        The paths; `problem.covariance` weighs them.
    is_los
        (path,) marks the line of sight, at most one.
    member
        (path,) single bounces to use; without it each path counts by its probability of being one.
    """
    bounces = ~is_los if member is None else member & ~is_los
    soft = member is None
    state = state.copy()
    damping = np.full(len(state), 1e-6)
    value, jacobian, weight = _equations(problem, state, is_los, mixture, bounces, soft=soft)
    for _ in range(max_iterations):
        information = _information(jacobian, weight)
        gradient = np.einsum("kai,ka->ki", jacobian, weight * value)
        diagonal = damping[:, None] * np.einsum("kii->ki", information) + _PRIOR_STD**-2.0
        damped = information + diagonal[:, :, None] * np.eye(4)
        step = np.linalg.solve(damped, -gradient[..., None])[..., 0]
        trial = _equations(problem, state + step, is_los, mixture, bounces, soft=soft)
        accepted = np.sum(weight * trial[0] ** 2, axis=1) <= np.sum(weight * value**2, axis=1)
        state = np.where(accepted[:, None], state + step, state)
        value = np.where(accepted[:, None], trial[0], value)
        jacobian = np.where(accepted[:, None, None], trial[1], jacobian)
        weight = np.where(accepted[:, None], trial[2], weight)
        damping = np.where(accepted, damping / 10, np.minimum(damping * 10, 1e6))
        if np.all(np.abs(step) <= 1e-10 * (1 + np.abs(state))):
            break
    weight[:, : len(problem)] = _efficient_weight(problem, state, mixture, bounces, soft=soft)
    information = _information(jacobian, weight) + np.diag(_PRIOR_STD**-2.0)
    evidence = log_likelihood(problem, state, is_los, mixture)
    evidence = evidence + _los_log_ratio(problem, state, is_los, mixture)
    evidence = evidence - 0.5 * np.linalg.slogdet(information)[1]
    return Refined(state, np.asarray(np.linalg.inv(information), float), evidence)


def _equations(
    problem: SnapshotProblem,
    state: FloatArray,
    is_los: BoolArray,
    mixture: Mixture,
    bounces: BoolArray,
    *,
    soft: bool,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """All residuals (state, equation), their Jacobian (state, equation, 4) and weights (state, equation).

    One equation per path as a single bounce, in m, then three whitened ones of the line of sight if there is one.
    Weight of a bounce: inverse variance times Student-t factor, and times the probability of being one where
    `soft`; 0 for what is not among `bounces` (path,).
    """
    bounce = bounce_residual(problem, state)
    freedom = mixture.degrees_of_freedom
    square = bounce.value_m**2 / bounce.variance_m2
    weight = bounces * (freedom + 1) / (freedom + square) / bounce.variance_m2
    if soft:
        weight = weight * expit(bounce_log_ratio(bounce, mixture))
    if not is_los.any():
        return bounce.value_m, bounce.jacobian, weight
    los_value = _los_residual(problem, state, is_los)
    whiten = np.linalg.inv(np.linalg.cholesky(problem.covariance[is_los]))
    los_jacobian = -np.einsum("nab,kbi->knai", whiten, los_jacobian_rx(problem.tx, state))
    return (
        np.concatenate([bounce.value_m, los_value], axis=1),
        np.concatenate([bounce.jacobian, los_jacobian.reshape(len(state), -1, 4)], axis=1),
        np.concatenate([weight, np.ones_like(los_value)], axis=1),
    )


def _efficient_weight(
    problem: SnapshotProblem, state: FloatArray, mixture: Mixture, bounces: BoolArray, *, soft: bool
) -> FloatArray:
    """Information (state, path) per squared metre that a bounce brings under Gaussian errors.

    The inverse variance times the asymptotic efficiency of the Student-t estimate (Huber, Robust Statistics,
    section 3.2), instead of the weights at hand, which depend on the very errors.
    """
    bounce = bounce_residual(problem, state)
    probability = expit(bounce_log_ratio(bounce, mixture)) if soft else 1.0
    efficiency = student_efficiency(mixture.degrees_of_freedom)
    return np.asarray(bounces * probability * efficiency / bounce.variance_m2)


@cache
def student_efficiency(degrees_of_freedom: float) -> float:
    """E[psi']^2 / E[psi^2] of psi(z) = (nu + 1) z / (nu + z^2) for a standard normal z."""
    z = np.linspace(-9.0, 9.0, 4001)
    density = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi) * (z[1] - z[0])
    nu = degrees_of_freedom
    slope = (nu - z**2) / (nu + z**2) ** 2
    return float(np.sum(slope * density) ** 2 / np.sum((z / (nu + z**2)) ** 2 * density))


def _los_residual(problem: SnapshotProblem, state: FloatArray, is_los: BoolArray) -> FloatArray:
    """Whitened residuals (state, 3) of the line of sight."""
    whiten = np.linalg.inv(np.linalg.cholesky(problem.covariance[is_los]))
    difference = residual(problem.measured[is_los], predict_los(problem.tx, state)[:, None])
    return np.asarray(np.einsum("nab,knb->kna", whiten, difference).reshape(len(state), -1))


def _information(jacobian: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(jacobian * weight[..., None], 1, 2) @ jacobian)


def _los_log_ratio(
    problem: SnapshotProblem, state: FloatArray, is_los: BoolArray, mixture: Mixture
) -> FloatArray:
    """Log density (state,) of the line of sight over that of clutter: any two angles, range over its width."""
    if not is_los.any():
        return np.zeros(len(state))
    value = _los_residual(problem, state, is_los)
    covariance = problem.covariance[is_los]
    normalisation = -0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1].sum()
    clutter = np.log((2 * np.pi) ** 2 * mixture.clutter_width_m)
    return np.asarray(normalisation + clutter - 0.5 * np.sum(value**2, axis=1))
