"""Maximum-likelihood refinement of RX states with the IPs eliminated, by robust re-weighted least squares.

Each single bounce leaves one equation r = 0 (`estimation.geometry.BounceEquation`). To first order r is Gaussian
with variance g' R g, g the gradient of r with respect to the measurement, and r^2 / (g' R g) is the cost of the
path minimised over its IP: minimising the sum over paths refines state and IPs jointly. The line of sight adds
its three residuals. Many states are refined side by side; all arrays start with the axis `state`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, gammaln

from estimation.geometry import bounce_equation, bounce_fraction, los_jacobian_rx, predict_los, residual
from estimation.slam.config import Mixture
from estimation.slam.problem import SnapshotProblem
from scenes.record import BoolArray, FloatArray

# Weak prior on [x, y, heading, bias], in m, m, rad, m: it only keeps determinants finite.
_PRIOR_STD = np.array([50.0, 50.0, np.pi, 50.0])


@dataclass(frozen=True)
class BounceResidual:
    """Residuals of all paths as single bounces, for a batch of states."""

    value_m: FloatArray  # (state, path)
    variance_m2: FloatArray  # (state, path)
    jacobian: FloatArray  # (state, path, 4), per [x, y, heading, bias]
    is_feasible: BoolArray  # (state, path): the IP lies between the devices' rays


@dataclass(frozen=True)
class Refined:
    """A batch of refined states."""

    state: FloatArray  # (state, 4) in m, m, rad, m
    covariance: FloatArray  # (state, 4, 4)
    log_evidence: FloatArray  # (state,), Laplace approximation


def bounce_residual(problem: SnapshotProblem, state: FloatArray) -> BounceResidual:
    """Residual of the bounce equation, its variance and its Jacobian."""
    measured = problem.measured
    equation = bounce_equation(problem.tx, state[:, 2, None], measured)
    z = state[:, None, [0, 1, 3]]
    value = equation.residual_m(z)
    row = equation.row
    from_tx = z[..., :2] - problem.tx.position_m[:2]
    along = from_tx[..., 0] * row[..., 1] - from_tx[..., 1] * row[..., 0]
    reach = (measured[:, 0] - z[..., 2]) * equation.along
    by_measurement = np.stack([-row[..., 2], -(along + reach) / 2, -(along - reach) / 2], axis=-1)
    variance = np.einsum("kmi,mij,kmj->km", by_measurement, problem.covariance, by_measurement)
    jacobian = np.stack([row[..., 0], row[..., 1], by_measurement[..., 2], row[..., 2]], axis=-1)
    share = bounce_fraction(problem.tx, equation, z, measured[:, 0])
    feasible = (share >= 0) & (share <= 1) & (measured[:, 0] > z[..., 2])
    return BounceResidual(value, np.maximum(variance, 1e-18), jacobian, feasible)


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
    state = state.copy()
    damping = np.full(len(state), 1e-6)
    for _ in range(max_iterations):
        weight = _weight(problem, state, is_los, mixture, bounces, soft=member is None)
        value, jacobian = _residuals(problem, state, is_los)
        information = _information(jacobian, weight)
        gradient = np.einsum("kai,ka->ki", jacobian, weight * value)
        diagonal = damping[:, None] * np.einsum("kii->ki", information) + _PRIOR_STD**-2.0
        damped = information + diagonal[:, :, None] * np.eye(4)
        step = np.linalg.solve(damped, -gradient[..., None])[..., 0]
        trial_value, _ = _residuals(problem, state + step, is_los)
        accepted = np.sum(weight * trial_value**2, axis=1) <= np.sum(weight * value**2, axis=1)
        state = np.where(accepted[:, None], state + step, state)
        damping = np.where(accepted, damping / 10, np.minimum(damping * 10, 1e6))
        if np.all(np.abs(step) <= 1e-12 * (1 + np.abs(state))):
            break
    weight = _weight(problem, state, is_los, mixture, bounces, soft=member is None)
    information = _information(_residuals(problem, state, is_los)[1], weight) + np.diag(_PRIOR_STD**-2.0)
    evidence = log_likelihood(problem, state, is_los, mixture)
    evidence = evidence + _los_log_ratio(problem, state, is_los, mixture)
    evidence = evidence - 0.5 * np.linalg.slogdet(information)[1]
    return Refined(state, np.asarray(np.linalg.inv(information), float), evidence)


def _residuals(
    problem: SnapshotProblem, state: FloatArray, is_los: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """All residuals (state, equation) and their Jacobian (state, equation, 4).

    One equation per path as a single bounce, in m, then three whitened ones of the line of sight if there is one.
    """
    bounce = bounce_residual(problem, state)
    whiten = np.linalg.inv(np.linalg.cholesky(problem.covariance[is_los]))
    difference = residual(problem.measured[is_los], predict_los(problem.tx, state)[:, None])
    los_value = np.einsum("nab,knb->kna", whiten, difference).reshape(len(state), -1)
    los_jacobian = -np.einsum("nab,kbi->knai", whiten, los_jacobian_rx(problem.tx, state))
    return (
        np.concatenate([bounce.value_m, los_value], axis=1),
        np.concatenate([bounce.jacobian, los_jacobian.reshape(len(state), -1, 4)], axis=1),
    )


def _weight(
    problem: SnapshotProblem,
    state: FloatArray,
    is_los: BoolArray,
    mixture: Mixture,
    bounces: BoolArray,
    *,
    soft: bool,
) -> FloatArray:
    """Weight (state, equation) of `_residuals`; 0 for what is not among `bounces` (path,).

    Bounces: inverse variance times Student-t factor, and times the probability of being one where `soft`.
    """
    bounce = bounce_residual(problem, state)
    freedom = mixture.degrees_of_freedom
    square = bounce.value_m**2 / bounce.variance_m2
    weight = bounces * (freedom + 1) / (freedom + square) / bounce.variance_m2
    if soft:
        weight = weight * expit(bounce_log_ratio(bounce, mixture))
    return np.concatenate([weight, np.ones((len(state), 3 * np.count_nonzero(is_los)))], axis=1)


def _information(jacobian: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(jacobian * weight[..., None], 1, 2) @ jacobian)


def _los_log_ratio(
    problem: SnapshotProblem, state: FloatArray, is_los: BoolArray, mixture: Mixture
) -> FloatArray:
    """Log density (state,) of the line of sight over that of clutter: any two angles, range over its width."""
    value, _ = _residuals(problem, state, is_los)
    covariance = problem.covariance[is_los]
    normalisation = -0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1].sum()
    clutter = np.log((2 * np.pi) ** 2 * mixture.clutter_width_m) * len(covariance)
    return np.asarray(normalisation + clutter - 0.5 * np.sum(value[:, len(problem) :] ** 2, axis=1))
