"""The path off a contour: specular point, delay, angles and all their derivatives.

At the specular point of a smooth contour the tangent e fulfils e . (a + b) = 0 with unit vectors a and b to TX
and RX. A closed convex contour (`estimation.laws.support`) has one such point on its lit side. Safeguarded Newton
steps from the bisector at its centre find it, and the implicit function theorem gives the derivatives. A wall
mirrors the TX (`estimation.laws.wall`); an edge is a fixed incidence point (IP, `estimation.laws.plane`).
"""

from dataclasses import dataclass

import numpy as np

from estimation.execution import compiled, over_rows
from estimation.laws.plane import Prediction, bisector, bounce_path, tx_row, unit, wrapped
from estimation.laws.support import CIRCLE, CIRCLE_BY_RADIUS, support_terms
from estimation.laws.wall import mirror_path
from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray

EDGE, WALL = 5, 6  # after the closed families
_MAX_ROUNDS = 60
_MAX_CIRCLE_ROUNDS = 12
_CONVERGED_RAD = 1e-9  # Newton steps are quadratic: after a smaller one the error is that of rounding


@dataclass(frozen=True)
class SpecularPaths:
    """Predicted paths off a contour, one for each pair of TX and RX."""

    measured: FloatArray  # (path, 3) range in m with the clock bias, azimuths in the device frames in rad
    by_parameter: FloatArray  # (path, 3, parameter)
    by_rx: FloatArray  # (path, 3, 4) by x, y, heading, bias in m, m, rad, m
    point_m: FloatArray  # (path, xy) the specular points
    normal_rad: FloatArray  # (path,) azimuth of the outward normal there
    is_lit: BoolArray  # (path,) TX and RX on the outer side of the tangent


def predict_reflection(family: int, parameter: FloatArray, tx: FloatArray, rx_state: FloatArray) -> SpecularPaths:
    """Paths by one reflection.

    Parameters
    ----------
    family
        One of the closed families of `estimation.laws.support`, `EDGE` or `WALL`.
    parameter
        (parameter,) of the contour; edge [x, y] in m; wall [azimuth of the normal in rad, offset in m].
    tx
        (path, 3) x and y in m and heading in rad of the TX of each path.
    rx_state
        (path, 4) x and y in m, heading in rad, clock bias in m of the RX of each path.
    """
    # Copies, because arrays of records are read-only, a type of its own to compile for.
    tx, rx_state = np.array(tx, float, order="C"), np.array(rx_state, float, order="C")
    n, m = len(tx), len(parameter)
    measured, by_parameter, by_rx = np.empty((n, 3)), np.empty((n, 3, m)), np.empty((n, 3, 4))
    point, normal, lit = np.empty((n, 2)), np.empty(n), np.empty(n, dtype=np.bool_)
    _predict_paths(family, parameter, tx, rx_state, measured, by_parameter, by_rx, point, normal, lit)
    return SpecularPaths(measured, by_parameter, by_rx, point, normal, lit)


def predict_circle(tx: Pose | FloatArray, state: FloatArray, circle: FloatArray) -> Prediction:
    """Specular path off the lit side of a circle (..., 3), [x, y, radius] in m, in the units of `laws.plane`."""
    return Prediction(*over_rows(_circle_paths, (tx_row(tx), 1), (state, 1), (circle, 1)))


@compiled
def _circle_paths(
    tx: FloatArray, state: FloatArray, circle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, point = len(state), np.empty(2)
    value, by_state, by_circle = np.empty((n, 3)), np.empty((n, 3, 4)), np.empty((n, 3, 3))
    work = path_work(3)
    for i in range(n):
        closed_path(CIRCLE_BY_RADIUS, circle[i], tx[i], state[i], value[i], by_state[i], by_circle[i], point, work)
        value[i, 1], value[i, 2] = wrapped(value[i, 1]), wrapped(value[i, 2])
    return value, by_state, by_circle


@compiled
def _predict_paths(
    family: int,
    parameter: FloatArray,
    tx: FloatArray,
    rx_state: FloatArray,
    measured: FloatArray,
    by_parameter: FloatArray,
    by_rx: FloatArray,
    point: FloatArray,
    normal: FloatArray,
    lit: BoolArray,
) -> None:
    work = path_work(len(parameter))
    for i in range(len(tx)):
        t, r = tx[i, :2], rx_state[i, :2]
        nx, ny = contour_path(
            family, parameter, tx[i], rx_state[i], measured[i], by_rx[i], by_parameter[i], point[i], work
        )
        if family == EDGE:
            normal[i], lit[i] = bisector(point[i, 0], point[i, 1], t, r), True
            continue
        if family == WALL:
            normal[i] = parameter[0]
            nx, ny = np.cos(normal[i]), np.sin(normal[i])
        else:
            normal[i] = np.arctan2(ny, nx)
        depth_t = nx * (t[0] - point[i, 0]) + ny * (t[1] - point[i, 1])
        lit[i] = depth_t > 0 and nx * (r[0] - point[i, 0]) + ny * (r[1] - point[i, 1]) > 0


@compiled
def path_work(n_parameters: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arrays in which `contour_path` and `closed_path` write."""
    return np.zeros(3), np.zeros((2, n_parameters)), np.empty((3, 2))


@compiled
def contour_path(
    family: int,
    parameter: FloatArray,
    tx: FloatArray,
    state: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_parameter: FloatArray,
    point: FloatArray,
    work: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[float, float]:
    """Path off a contour of any family: measurement (3,), derivatives (3, 4) and (3, parameter), IP (2,), written.

    `work` is that of `path_work`. Returns the outward normal of a closed contour, zeros for the others.
    """
    if family == EDGE:
        point[0], point[1] = parameter[0], parameter[1]
        bounce_path(tx, state, point, value, by_state, by_parameter)
        return 0.0, 0.0
    if family == WALL:
        mirror_path(tx, state, parameter, value, by_state, by_parameter, point)
        return 0.0, 0.0
    return closed_path(family, parameter, tx, state, value, by_state, by_parameter, point, work)


@compiled
def closed_path(
    family: int,
    parameter: FloatArray,
    tx: FloatArray,
    state: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_parameter: FloatArray,
    point: FloatArray,
    work: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[float, float]:
    """Path off a closed contour: measurement (3,), derivatives (3, 4) and (3, parameter), IP (2,), all written.

    The path is the single bounce at the specular point x(psi). That point moves with parameters and RX such that
    f = e . (a + b) stays zero: directly at fixed psi, and along the tangent e by the change of psi. `work` is that
    of `path_work`. Returns the outward normal.
    """
    support, slope, by_point = work
    nx, ny = 0.0, 0.0
    if family in (CIRCLE, CIRCLE_BY_RADIUS):
        support_terms(family, parameter, 0.0, support, slope)
        nx, ny = _circle_normal(parameter[0], parameter[1], support[0], tx, state)
    if nx == 0.0 and ny == 0.0:
        psi = specular_normal(family, parameter, tx, state, support, slope)
        nx, ny = np.cos(psi), np.sin(psi)
    point[0] = parameter[0] + support[0] * nx - support[1] * ny
    point[1] = parameter[1] + support[0] * ny + support[1] * nx
    bounce_path(tx, state, point, value, by_state, by_point)
    ax, ay, at = unit(tx[0] - point[0], tx[1] - point[1])
    bx, by, br = unit(state[0] - point[0], state[1] - point[1])
    tilt_a, tilt_b = nx * ay - ny * ax, nx * by - ny * bx
    # Derivatives of f: (e - tilt a) / |a| by the TX, (e - tilt b) / |b| by the RX, minus their sum by the point.
    # The turn of e with psi adds minus the component of a + b along the normal.
    rx, ry = (-ny - tilt_b * bx) / br, (nx - tilt_b * by) / br
    fx, fy = -(-ny - tilt_a * ax) / at - rx, -(nx - tilt_a * ay) / at - ry
    radius = support[0] + support[2]
    fall = radius * (-fx * ny + fy * nx) - (nx * (ax + bx) + ny * (ay + by))
    for j in range(len(parameter)):
        mx, my = 1.0 - j, 1.0 * j  # the point moves as the centre does
        if j > 1:
            mx, my = nx * slope[0, j] - ny * slope[1, j], ny * slope[0, j] + nx * slope[1, j]
        run = -(fx * mx + fy * my) / fall * radius
        # The length is stationary along the tangent (Fermat): only the direct part changes it.
        by_parameter[0, j] = by_point[0, 0] * mx + by_point[0, 1] * my
        for a in (1, 2):
            by_parameter[a, j] = by_point[a, 0] * (mx - run * ny) + by_point[a, 1] * (my + run * nx)
    for a in (1, 2):
        sweep = (by_point[a, 1] * nx - by_point[a, 0] * ny) * radius / fall
        by_state[a, 0] -= sweep * rx
        by_state[a, 1] -= sweep * ry
    return nx, ny


@compiled
def _circle_normal(x: float, y: float, radius: float, t: FloatArray, r: FloatArray) -> tuple[float, float]:
    """Outward normal at the lit specular point of a circle, zeros where Newton steps do not reach it.

    They are those of `specular_normal` on the normal itself: adding a step along the tangent and scaling the sum
    to length 1 turns it by the step to third order, without sines.
    """
    ax, ay, _ = unit(t[0] - x, t[1] - y)
    bx, by, _ = unit(r[0] - x, r[1] - y)
    nx, ny, _ = unit(ax + bx, ay + by)
    for _ in range(_MAX_CIRCLE_ROUNDS):
        px, py = x + radius * nx, y + radius * ny
        ax, ay, at = unit(t[0] - px, t[1] - py)
        bx, by, br = unit(r[0] - px, r[1] - py)
        tilt_a, tilt_b = nx * ay - ny * ax, nx * by - ny * bx
        along_a, along_b = nx * ax + ny * ay, nx * bx + ny * by
        fall = along_a + along_b + radius * (along_a**2 / at + along_b**2 / br)
        if not fall > 0:
            break
        step = (tilt_a + tilt_b) / fall
        nx, ny, _ = unit(nx - step * ny, ny + step * nx)
        if abs(step) < _CONVERGED_RAD:
            return (nx, ny) if along_a > 0 and along_b > 0 else (0.0, 0.0)
    return 0.0, 0.0


@compiled
def specular_normal(
    family: int, parameter: FloatArray, t: FloatArray, r: FloatArray, value: FloatArray, slope: FloatArray
) -> float:
    """Azimuth of the outward normal at the lit specular point of a closed contour.

    e . (a + b) falls with psi over the lit side. So the root is bracketed within a quarter turn of the bisector,
    and bisection replaces Newton steps that leave the bracket. Writes the `support_terms` there.
    """
    psi = bisector(parameter[0], parameter[1], t, r)
    low, high = psi - np.pi / 2, psi + np.pi / 2
    for _ in range(_MAX_ROUNDS):
        support_terms(family, parameter, psi, value, slope)
        nx, ny = np.cos(psi), np.sin(psi)
        x = parameter[0] + value[0] * nx - value[1] * ny
        y = parameter[1] + value[0] * ny + value[1] * nx
        ax, ay, at = unit(t[0] - x, t[1] - y)
        bx, by, br = unit(r[0] - x, r[1] - y)
        tilt_a, tilt_b = nx * ay - ny * ax, nx * by - ny * bx
        tilt = tilt_a + tilt_b
        if tilt > 0:
            low = psi
        else:
            high = psi
        fall = -(nx * (ax + bx) + ny * (ay + by)) - (value[0] + value[2]) * (
            (1 - tilt_a**2) / at + (1 - tilt_b**2) / br
        )
        step = -tilt / fall if fall < 0 else np.inf
        if not low <= psi + step <= high:
            step = (low + high) / 2 - psi
        psi += step
        if abs(step) < _CONVERGED_RAD:
            break
    support_terms(family, parameter, psi, value, slope)
    return float(psi)
