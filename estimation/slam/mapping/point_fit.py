"""Incidence points (IPs) of single bounces, and their information on the receiver, in the plane and in space.

The reflection law is an argument: the module `estimation.laws.plane` (points of 2, states of 4, measurements of 3
components) or `estimation.laws.space` (3, 5, 5).
"""

from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from estimation.inference.least_squares import Attempt, Schedule, minimise
from scenes.record import FloatArray

_MAX_ITERATIONS = 30
_TOLERANCE = 1e-9  # of J: a fit that gains less has converged, far below the noise of any path
Tx_contra = TypeVar("Tx_contra", contravariant=True)  # the TX: a `scenes.pose.Pose`, or rows of it


class ReflectionLaw(Protocol[Tx_contra]):
    """Interface of the modules of the reflection law; arrays broadcast over leading axes."""

    def predict_bounce(self, tx: Tx_contra, state: FloatArray, point_m: FloatArray, /) -> FloatArray:
        """Measurement of the single bounce at each IP."""

    def bounce_jacobian_point(self, tx: Tx_contra, state: FloatArray, point_m: FloatArray, /) -> FloatArray:
        """Its derivative by the IP."""

    def bounce_jacobian_rx(self, tx: Tx_contra, state: FloatArray, point_m: FloatArray, /) -> FloatArray:
        """Its derivative by the RX state."""

    def los_jacobian_rx(self, tx: Tx_contra, state: FloatArray, /) -> FloatArray:
        """Derivative of the line of sight's measurement by the RX state."""

    def residual(self, measured: FloatArray, predicted: FloatArray, /) -> FloatArray:
        """Measured minus predicted, angles wrapped."""

    def start_point(self, tx: Tx_contra, state: FloatArray, measured: FloatArray, /) -> FloatArray:
        """Start position of the IP; the IP itself for paths without noise."""


def fit_points(
    law: ReflectionLaw[Tx_contra],
    tx_pose: Tx_contra,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Minimise J of equation (4) for all paths at once, by damped Gauss-Newton from the midpoint start.

    Parameters
    ----------
    state
        (path, state) RX state of each path, in m and rad.
    measured, covariance
        (path, m) and (path, m, m) in m and rad.

    Returns
    -------
    point_m, cost
        (path, point) and (path,): the IPs and J at the minimum.
    """
    weight = np.asarray(np.linalg.inv(covariance), float)

    def located(point: FloatArray) -> _Located:
        difference = law.residual(measured, law.predict_bounce(tx_pose, state, point))
        return _Located(point, difference, _quadratic(difference, weight))

    def attempt(at: _Located, damping: FloatArray) -> Attempt[_Located]:
        jacobian = law.bounce_jacobian_point(tx_pose, state, at.point)
        gradient = np.einsum("nai,nab,nb->ni", jacobian, weight, at.difference)
        information = np.swapaxes(jacobian, 1, 2) @ weight @ jacobian
        trace = damping * np.einsum("nii->n", information)
        damped = information + trace[:, None, None] * np.eye(at.point.shape[-1])
        trial = located(at.point + np.linalg.solve(damped, gradient[..., None])[..., 0])
        return Attempt(trial, at.cost, trial.cost)

    schedule = Schedule(_MAX_ITERATIONS, first=1e-9, largest=1.0, absolute=0.0, relative=_TOLERANCE)
    point, _, cost = minimise(located(law.start_point(tx_pose, state, measured)), attempt, schedule)
    return point, cost


class _Located(NamedTuple):
    point: FloatArray  # (path, point)
    difference: FloatArray  # (path, m)
    cost: FloatArray  # (path,)


def point_covariance(
    law: ReflectionLaw[Tx_contra],
    tx_pose: Tx_contra,
    state: FloatArray,
    point_m: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Covariance (path, point, point) of the IPs with the RX state exact, and their sensitivity to the state.

    The covariance is inv(J' inv(R) J); unobservable directions get a huge, finite variance. The sensitivity is
    (path, point, state).
    """
    weight = np.linalg.inv(covariance)
    jacobian = law.bounce_jacobian_point(tx_pose, state, point_m)
    weighted = np.swapaxes(jacobian, 1, 2) @ weight
    information = weighted @ jacobian
    floor = 1e-12 * np.einsum("nii->n", information)
    conditional = np.linalg.inv(information + floor[:, None, None] * np.eye(point_m.shape[-1]))
    return conditional, -conditional @ weighted @ law.bounce_jacobian_rx(tx_pose, state, point_m)


def joint_covariance(conditional: FloatArray, sensitivity: FloatArray, state_covariance: FloatArray) -> FloatArray:
    """Covariance (path, point, point) of the IPs where the states have covariances (..., state, state)."""
    return np.asarray(conditional + sensitivity @ state_covariance @ np.swapaxes(sensitivity, 1, 2))


def state_information(
    law: ReflectionLaw[Tx_contra],
    tx: Tx_contra,
    state: FloatArray,
    point_m: FloatArray,
    covariance: FloatArray,
    los_covariance: FloatArray | None,
) -> FloatArray:
    """Fisher information (state, state) of one receiver state (state,), the IPs (path, point) marginalised.

    `covariance` (path, m, m) is of the single bounces, `los_covariance` (m, m) of the line of sight, None without.
    """
    information = np.zeros((len(state), len(state)))
    if len(point_m):
        weight = np.linalg.inv(covariance)
        by_rx = law.bounce_jacobian_rx(tx, state, point_m)
        by_point = law.bounce_jacobian_point(tx, state, point_m)
        cross = np.swapaxes(by_rx, 1, 2) @ weight @ by_point
        own = np.swapaxes(by_point, 1, 2) @ weight @ by_point
        lost = cross @ np.linalg.pinv(own, hermitian=True) @ np.swapaxes(cross, 1, 2)
        information += (np.swapaxes(by_rx, 1, 2) @ weight @ by_rx - lost).sum(axis=0)
    if los_covariance is not None:
        by_rx = law.los_jacobian_rx(tx, state)
        information += by_rx.T @ np.linalg.inv(los_covariance) @ by_rx
    return information


def point_bound(
    law: ReflectionLaw[Tx_contra],
    tx: Tx_contra,
    state: FloatArray,
    point_m: FloatArray,
    covariance: FloatArray,
    state_covariance: FloatArray,
) -> FloatArray:
    """Bound (path,) in m of the position of each IP (path, point), with the uncertainty of the state.

    Infinite where the state has no bound.
    """
    if not len(point_m):
        return np.zeros(0)
    if not np.isfinite(state_covariance).all():
        return np.full(len(point_m), np.inf)
    rows = np.tile(state, (len(point_m), 1))
    conditional, sensitivity = point_covariance(law, tx, rows, point_m, covariance)
    joint = joint_covariance(conditional, sensitivity, state_covariance)
    return np.asarray(np.sqrt(np.einsum("nii->n", joint)))


def _quadratic(difference: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("na,nab,nb->n", difference, weight, difference))
