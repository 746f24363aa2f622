"""`arena validate slam`: derivatives of all measurement models, and the law in space against that in the plane."""

from dataclasses import replace

import numpy as np

from estimation.laws import plane, space
from estimation.laws.contour import predict_circle
from estimation.laws.wall import predict_walls
from estimation.slam.bounds import StopPaths, stop_bound
from estimation.slam.snapshot.refine import bounce_terms
from estimation.slam.space.bounds import SpatialPaths, spatial_bound
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.stops import draw_stop
from isac_arena.validation.slam.trials import CLEAN, Case, jacobian_rows
from scenes.pose import Pose

IN_SPACE = replace(CLEAN, in_space=True)


def check_jacobians(seed: int, quick: bool) -> list[Measurement]:
    """Every model's derivative in the plane against central differences."""
    scenario = draw_stop(np.random.default_rng(seed + 3), CLEAN)
    tx, x, point = scenario.tx, scenario.state, scenario.point_m[scenario.is_single]
    measured = plane.predict_bounce(tx, x, point)
    covariance = np.tile(CLEAN.covariance, (len(point), 1, 1))
    walls, circle = np.array([[0.4, 9.0], [2.1, -7.0]]), np.array([3.0, -6.0, 0.4])
    one, two = predict_walls(tx, x, walls[:1]), predict_walls(tx, x, walls)
    pillar, terms = predict_circle(tx, x, circle), bounce_terms(tx, measured, covariance, x)
    by_point = plane.bounce_jacobian_point(tx, x, point[0])
    by_rx = plane.bounce_jacobian_rx(tx, x, point)
    cases: dict[str, Case] = {
        "bounce_state": (lambda s: plane.predict_bounce(tx, s, point), x, by_rx),
        "bounce_point": (lambda q: plane.predict_bounce(tx, x, q), point[0], by_point),
        "los_state": (lambda s: plane.predict_los(tx, s), x, plane.los_jacobian_rx(tx, x)),
        "equation_state": (lambda s: bounce_terms(tx, measured, covariance, s).value_m, x, terms.jacobian),
        "wall_state": (lambda s: predict_walls(tx, s, walls[:1]).value, x, one.by_state),
        "wall_line": (lambda w: predict_walls(tx, x, w.reshape(1, 2)).value, walls[0], one.by_landmark),
        "double_state": (lambda s: predict_walls(tx, s, walls).value, x, two.by_state),
        "double_lines": (lambda w: predict_walls(tx, x, w.reshape(2, 2)).value, walls.ravel(), two.by_landmark),
        "circle_state": (lambda s: predict_circle(tx, s, circle).value, x, pillar.by_state),
        "circle": (lambda c: predict_circle(tx, x, c).value, circle, pillar.by_landmark),
    }
    return jacobian_rows("jacobian", cases)


def check_space_jacobians(seed: int, quick: bool) -> list[Measurement]:
    """Every derivative in space against central differences, away from any solution."""
    rng = np.random.default_rng(seed + 24)
    scenario = draw_stop(rng, IN_SPACE)
    tx, x, point = scenario.tx, scenario.state, scenario.point_m[scenario.is_single]
    measured = space.predict_bounce(tx, x, point) + rng.normal(size=(len(point), 5)) * 0.05
    by_state = space.bounce_equations(tx, x, measured).by_state
    by_measurement = space.bounce_equations(tx, x, measured[0]).by_measurement
    by_point = space.bounce_jacobian_point(tx, x, point[0])
    cases: dict[str, Case] = {
        "bounce_state": (lambda s: space.predict_bounce(tx, s, point), x, space.bounce_jacobian_rx(tx, x, point)),
        "bounce_point": (lambda q: space.predict_bounce(tx, x, q), point[0], by_point),
        "los_state": (lambda s: space.predict_los(tx, s), x, space.los_jacobian_rx(tx, x)),
        "equations_state": (lambda s: space.bounce_equations(tx, s, measured).value_m, x, by_state),
        "equations_measurement": (
            lambda y: space.bounce_equations(tx, x, y).value_m, measured[0], by_measurement
        ),
    }  # fmt: skip
    return jacobian_rows("space.jacobian", cases)


def check_space_plane(seed: int, quick: bool) -> list[Measurement]:
    """Everything in one horizontal plane: prediction, equation and bound are those of the plane."""
    rng = np.random.default_rng(seed + 23)
    predicted, equation, peb = [], [], []
    for _ in range(20):
        tx = Pose(np.array([*rng.uniform(-2, 2, 2), 1.8]), rng.uniform(-3, 3))
        state = np.array([*rng.uniform(-6, 6, 2), 1.8, rng.uniform(-3, 3), rng.uniform(-5, 15)])
        point = np.column_stack([rng.uniform(-9, 9, (6, 2)), np.full(6, 1.8)])
        flat = state[[0, 1, 3, 4]]
        measured = space.predict_bounce(tx, state, point)
        predicted.append(np.abs(measured[:, :3] - plane.predict_bounce(tx, flat, point[:, :2])).max())
        shifted = measured + rng.normal(size=measured.shape) * [0.3, 0.05, 0.05, 0.0, 0.0]
        two = space.bounce_equations(tx, state, shifted).value_m
        one = plane.bounce_equation(tx, flat[2], shifted[:, :3]).residual_m(flat[[0, 1, 3]])
        equation.append(np.abs(np.abs(two) - np.column_stack([np.abs(one), np.zeros(6)])).max())
        covariance = np.tile(IN_SPACE.covariance, (6, 1, 1))
        found, _ = spatial_bound(tx, state, SpatialPaths(point, covariance, covariance[0]))
        planar = covariance[:, :3, :3]
        expected, _ = stop_bound(tx, flat, StopPaths(point[:, :2], planar, np.full(6, -1), planar[0]))
        peb.append(abs(found.plan_m / float(expected.position_m) - 1))
    key, same = "space.plane", "the same formula: rounding"
    return [
        at_most(f"{key}.prediction_deviation", max(predicted), 1e-12, same, "m, rad"),
        at_most(f"{key}.equation_deviation_m", max(equation), 1e-12, same, "m"),
        at_most(f"{key}.peb_deviation", max(peb), 1e-6, "the same bound, by other matrices"),
    ]
