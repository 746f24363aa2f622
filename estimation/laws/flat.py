"""The path by way of a horizontal surface, floor or ceiling, as the level path that it would be in the plan.

`estimation.laws.level` sees paths from above as over upright surfaces. A path that bounces once off a horizontal
surface looks too long there, and with horizontal beams its azimuths are too near the boresight. Where the height
of the surface is known, the place of the bounce is not needed to see such a path from above: two legs share its
length, and their shares follow from its directions. The plan path that comes out obeys the law of a level bounce.
"""

import numpy as np

from estimation.execution import compiled
from estimation.laws.plane import FEASIBLE_STDS, bounce_gap_path, wrapped
from estimation.laws.raised import cone_azimuth
from scenes.record import FloatArray

TURNS, NEWTON_STEPS = 4, 3  # legs and azimuths in turns; the plan length from the legs
LEAST_COSINE = 0.05  # of half the turn of a path: nearly straight ones do not tell the place of their bounce
LEAST_LEG_M = 0.01


@compiled
def flat_path(
    tx: FloatArray,
    state: FloatArray,
    measured: FloatArray,
    height_m: float,
    difference_m: float,
    boresight_rad: FloatArray,
    plan: FloatArray,
    slope: FloatArray,
) -> None:
    """Level measurement `plan` (3,) of a path off a surface, and its `slope` (3,) by what was seen, both written.

    `height_m` is that of the surface over the receiver; the rest is as for `estimation.laws.raised.raised_path`.
    """
    up_tx, up_rx = height_m - difference_m, height_m
    seen_m = max(measured[0] - state[3], LEAST_LEG_M)
    length = np.sqrt(seen_m**2 + difference_m**2)
    east, north = state[0] - tx[0], state[1] - tx[1]
    plan_m = np.sqrt(max(length**2 - (abs(up_tx) + abs(up_rx)) ** 2, LEAST_LEG_M))
    plan[1], plan[2], slope[:] = measured[1], measured[2], 1.0
    turns = wrapped(measured[1] - boresight_rad[0]), wrapped(measured[2] - boresight_rad[1])
    sines, cosines = (np.sin(turns[0]), np.sin(turns[1])), (np.cos(turns[0]), np.cos(turns[1]))
    for _ in range(TURNS):
        departure, arrival = tx[2] + plan[1], state[2] + plan[2]
        middle, half = (departure + arrival) / 2, (arrival - departure) / 2
        cosine = np.cos(half)
        if abs(cosine) < LEAST_COSINE:
            cosine = -LEAST_COSINE if cosine < 0 else LEAST_COSINE
        gap = (east * np.cos(middle) + north * np.sin(middle)) / cosine
        for _ in range(NEWTON_STEPS):
            leg_tx, leg_rx = max((plan_m + gap) / 2, LEAST_LEG_M), max((plan_m - gap) / 2, LEAST_LEG_M)
            slant_tx, slant_rx = np.sqrt(leg_tx**2 + up_tx**2), np.sqrt(leg_rx**2 + up_rx**2)
            by_plan = (leg_tx / slant_tx + leg_rx / slant_rx) / 2
            plan_m = max(plan_m - (slant_tx + slant_rx - length) / by_plan, LEAST_LEG_M)
        slope[0] = seen_m / length / by_plan
        for end in range(2):
            if np.isnan(boresight_rad[end]):
                continue
            cosine = (leg_tx / slant_tx if end == 0 else leg_rx / slant_rx) * length / seen_m
            plan[1 + end], across = cone_azimuth(boresight_rad[end], cosines[end], sines[end] / cosine)
            slope[1 + end] = abs(cosines[end] / (cosine * across))
    plan[0] = plan_m + state[3]


@compiled
def flat_log_densities(
    tx: FloatArray,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    height_m: FloatArray,
    difference_m: FloatArray,
    boresight_rad: FloatArray,
) -> FloatArray:
    """Log density (height, path) of the ranges of paths (path, 3), their directions given, by way of surfaces.

    A height of NaN stands for an upright surface. -inf where a path leads away from its end.
    """
    result = np.full((len(height_m), len(measured)), -np.inf)
    plan, slope, by_state, by = np.empty(3), np.ones(3), np.empty(4), np.empty(3)
    for i in range(len(measured)):
        for h in range(len(height_m)):
            if np.isnan(height_m[h]):
                plan[:], slope[:] = measured[i], 1.0
            else:
                flat_path(
                    tx[i], state[i], measured[i], height_m[h], difference_m[i], boresight_rad[i], plan, slope
                )
            gap, along, reach = bounce_gap_path(tx[i], state[i], plan, by_state, by)
            variance, spread = 0.0, 0.0
            for a in range(3):
                for b in range(3):
                    part = slope[a] * covariance[i, a, b] * slope[b]
                    variance += by[a] * part * by[b]
                    spread += part if a > 0 and a == b else 0.0
            slack = FEASIBLE_STDS * np.sqrt(spread) * (plan[0] - state[i, 3]) * abs(by_state[3])
            if plan[0] <= state[i, 3] or abs(along) > abs(reach) + slack:
                continue
            variance = max(variance, 1e-18)
            by_range = max(abs(by[0]) * slope[0], 1e-6)
            result[h, i] = -0.5 * gap**2 / variance - 0.5 * np.log(2 * np.pi * variance) + np.log(by_range)
    return result
