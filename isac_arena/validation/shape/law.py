"""`arena validate shape`: the reflection law itself, its derivatives and its information."""

from collections.abc import Callable

import numpy as np

from estimation.laws.contour import EDGE, WALL, predict_reflection
from estimation.laws.plane import bounce_jacobian_point, lit_normals
from estimation.laws.support import CIRCLE, CLOSED_FAMILY
from estimation.shape.reflection.normals import OrientedPoints, circle_design, residual_covariance
from estimation.shape.reflection.reflections import Reflections
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.monte_carlo import generators
from isac_arena.validation.scenarios.reflections import Errors, draw_circle, draw_edge, lit_pillar, observe
from scenes.pose import wrap_angle
from scenes.record import FloatArray


def check_reflection_information(seed: int, quick: bool) -> list[Measurement]:
    """Information of the direct fit against points with normals; all derivatives against differences."""
    ratios = []
    for rng in generators(seed, 5 if quick else 50):
        contour, true = lit_pillar(draw_circle, rng)
        data, _ = observe(true, Errors(), rng)
        circle = np.array([*contour.center_m, np.log(contour.radius_m)])
        ratios.append(information_ratio(circle, data))
    families = {
        CIRCLE: [],
        CLOSED_FAMILY["ellipse"]: [0.5, -0.3],
        CLOSED_FAMILY["rounded_square"]: [0.2, 0.3],
        CLOSED_FAMILY["support_gp"]: [0.05, -0.04, 0.02, 0.01],
    }
    rng = np.random.default_rng(seed)
    errors = [
        jacobian_error(family, np.array([*draw_edge(rng), np.log(0.4), *shape]), rng)
        for family, shape in families.items()
    ]
    errors += [jacobian_error(EDGE, draw_edge(rng), rng), jacobian_error(WALL, np.array([1.5, -9.0]), rng)]
    spread = float(np.max(np.abs(np.array(ratios) - 1)))
    return [
        at_most("reflection.information.deviation", spread, 0.01, "trace of the bound, worst"),
        at_most("reflection.jacobian.error", max(errors), 1e-7, "4th-order differences", "m or rad"),
    ]


def information_ratio(circle: FloatArray, data: Reflections) -> float:
    """Trace of the bound of points with normals over that of the direct fit, at the true circle, poses exact.

    `circle` is [x, y, log R]; both bounds are those of centre and radius in m.
    """
    paths = predict_reflection(CIRCLE, circle, data.tx, data.rx_state)
    radius = np.exp(circle[2])
    by_circle = paths.by_parameter / np.array([1.0, 1.0, radius])
    direct = np.einsum("nai,nab,nbj->ij", by_circle, np.linalg.inv(data.covariance), by_circle)
    by_point = bounce_jacobian_point(data.tx, data.rx_state, paths.point_m)
    information = np.swapaxes(by_point, 1, 2) @ np.linalg.solve(data.covariance, by_point)
    normal, slope = lit_normals(paths.point_m, data.tx, data.rx_state[:, :2])
    points = OrientedPoints(paths.point_m, np.linalg.inv(information), normal, slope)
    design = circle_design(normal)
    weight = np.linalg.inv(residual_covariance(points, radius))
    oriented = np.einsum("nki,nkl,nlj->ij", design, weight, design)
    return float(np.trace(np.linalg.inv(oriented)) / np.trace(np.linalg.inv(direct)))


def jacobian_error(family: int, parameter: FloatArray, rng: np.random.Generator) -> float:
    """Largest deviation of the derivatives by parameters and RX from differences of fourth order."""
    _, true = lit_pillar(draw_circle, rng)
    tx = np.tile([2.25, 2.5, -np.pi / 2], (len(true.rx), 1))
    rx = np.column_stack([true.rx, np.zeros(len(true.rx))])
    away = np.linalg.norm(rx[:, :2] - parameter[:2], axis=1) > 1.5 if family != WALL else rx[:, 1] > -8.0
    tx, rx = tx[away], rx[away]
    paths = predict_reflection(family, parameter, tx, rx)
    lit = paths.is_lit
    by_parameter = _differences(
        lambda change: predict_reflection(family, parameter + change, tx, rx).measured, len(parameter)
    )
    by_rx = _differences(lambda change: predict_reflection(family, parameter, tx, rx + change).measured, 4)
    pairs = ((by_parameter, paths.by_parameter), (by_rx, paths.by_rx))
    return max(float(np.abs(found - exact)[lit].max(initial=0.0)) for found, exact in pairs)


def _differences(function: Callable[[FloatArray], FloatArray], n: int) -> FloatArray:
    step, columns = 2e-4, []
    for unit in np.eye(n):
        one, two = (function(k * step * unit) - function(-k * step * unit) for k in (1, 2))
        one[:, 1:], two[:, 1:] = wrap_angle(one[:, 1:]), wrap_angle(two[:, 1:])
        columns.append((8 * one - two) / (12 * step))
    return np.stack(columns, axis=-1)
