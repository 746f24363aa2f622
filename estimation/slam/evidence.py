"""Log evidence of the modes of one stop: what ranks them, and what tells a line of sight from none."""

from __future__ import annotations

import numpy as np

from estimation.slam.config import SnapshotConfig
from estimation.slam.problem import SnapshotProblem
from estimation.slam.refine import Refined
from scenes.record import FloatArray

_DISTANCES = np.geomspace(0.05, 2.0, 12)  # of the reach


def log_evidence(
    problem: SnapshotProblem, los: int, refined: Refined, config: SnapshotConfig
) -> tuple[FloatArray, FloatArray]:
    """Laplace approximation of the log evidence (mode,), and the covariance (mode, 4, 4) it rests on.

    The likelihood of the paths' delays and angles and of their powers, integrated over the state. `los` is the
    index of the line of sight, -1 for none. A stop has one or has none with the same prior probability, so that
    the modes of all of these compare. States of a clock beyond the credible get minus infinity.
    """
    state = refined.state
    information = refined.information + np.diag(config.prior_std**-2.0)
    evidence = refined.log_likelihood - 0.5 * np.linalg.slogdet(information)[1]
    evidence = evidence - 0.5 * np.sum((state[:, :2] / config.reach_m) ** 2, axis=1)
    # The prior: Gaussian about the TX, any heading, any credible clock.
    evidence = evidence - np.log(2 * config.reach_m**2 * config.max_clock_bias_m)
    evidence = evidence + _log_power(problem, los, state, config)
    if los >= 0:
        # The density of clutter: any two angles, range over its width.
        clutter = (2 * np.pi) ** 2 * config.mixture.clutter_width_m
        evidence = (
            evidence - 0.5 * np.linalg.slogdet(2 * np.pi * problem.covariance[los])[1] + np.log(clutter)
        )
    evidence[np.abs(state[:, 3]) > config.max_clock_bias_m] = -np.inf
    return evidence, np.asarray(np.linalg.inv(information))


def log_clutter(problem: SnapshotProblem, config: SnapshotConfig) -> float:
    """Log evidence of all paths being clutter; the straight line has any length up to twice the reach."""
    distance = config.reach_m * _DISTANCES[:, None]
    length = problem.measured[:, 0] - problem.measured[:, 0].min(initial=np.inf) + distance
    density = config.path_loss.log_density_of_others(problem.power_dbm, length)
    most = density.max()
    share = len(problem) * np.log(config.mixture.clutter_share)
    return float(most + np.log(np.mean(np.exp(density - most))) + share)


def _log_power(problem: SnapshotProblem, los: int, state: FloatArray, config: SnapshotConfig) -> FloatArray:
    """Log density (mode,) of the powers of all paths at the lengths that the clock bias leaves them.

    No path is shorter than the straight line; one that seems to be is false.
    """
    others = np.arange(len(problem)) != los
    distance = np.hypot(state[:, 0], state[:, 1])
    length = np.maximum(problem.measured[others, 0] - state[:, 3, None], distance[:, None])
    density = config.path_loss.log_density_of_others(problem.power_dbm[others], length)
    if los < 0:
        return density
    return density + config.path_loss.log_density(problem.power_dbm[los], distance)
