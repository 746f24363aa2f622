"""The clock bias of one stop at given heights: where to start, and steps that raise the evidence of its paths."""

import numpy as np

from estimation.channel.hall.classes import StopStates, stop_states
from estimation.channel.hall.paths import RangedPaths
from estimation.channel.hall.power import StopPowers
from estimation.channel.hall.record import ClassPriors
from estimation.channel.hall.refine import stop_equations
from estimation.channel.hall.search import clock_grid, peaks_of
from scenes.record import FloatArray

N_CLOCKS = 6  # clock biases tried at each stop
CLOCK_STRIDE = 3  # of the grid of clocks, where elevations tell them
LONGEST_STEP_M, SMALLEST_STEP_M = 0.5, 1e-4
LOOSE_STD_M = 100.0  # prior of a step: keeps what is unobservable where it is


def own_clock(
    paths: RangedPaths,
    powers: StopPowers,
    clock_m: float,
    differences_m: FloatArray,
    priors: ClassPriors,
    n_steps: int,
    *,
    by_elevation: bool,
) -> tuple[float, StopStates]:
    """A clock bias after steps that do not lower the evidence of its stop, with the states there."""
    states = stop_states(paths, powers, clock_m, differences_m, priors)
    for _ in range(n_steps):
        part = stop_equations(paths, powers, states, clock_m, differences_m, by_elevation=by_elevation)
        step = part.slope[3] / (part.information[3, 3] + 1 / LOOSE_STD_M**2)
        trial = clock_m + float(np.clip(step, -LONGEST_STEP_M, LONGEST_STEP_M))
        there = stop_states(paths, powers, trial, differences_m, priors)
        if there.evidence <= states.evidence:
            break
        is_settled = abs(trial - clock_m) < SMALLEST_STEP_M
        clock_m, states = trial, there
        if is_settled:
            break
    return clock_m, states


def clocks_by_elevation(
    paths: RangedPaths, powers: StopPowers, differences_m: FloatArray, priors: ClassPriors
) -> FloatArray:
    """The clock biases (start,) in m of largest evidence of a stop with elevations: pairs do not tell those."""
    if not paths.sees_elevation.any():
        return np.empty(0)
    clocks = clock_grid(paths)[::CLOCK_STRIDE]
    score = [stop_states(paths, powers, float(one), differences_m, priors).evidence for one in clocks]
    return clocks[peaks_of(np.array(score))[:N_CLOCKS]]
