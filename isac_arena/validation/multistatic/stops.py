"""`arena validate multistatic`: poses from one, two and three TX against their joint bounds."""

import time
from dataclasses import replace
from functools import partial

import numpy as np

from estimation.slam.config import TrajectoryConfig
from estimation.slam.record import SolveStatus
from estimation.slam.stops import run_slam
from estimation.slam.walk.trajectory import run_trajectory
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.validation.benches.timing import peak_bytes
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import generators, rms_ratio
from isac_arena.validation.multistatic.drawn import SharedStop, draw_shared_stop, draw_shared_walk
from isac_arena.validation.slam.trials import CLEAN, GAUSSIAN, MAPPING, MATCHED, MAX_PEB_M, OURS
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import FloatArray

CLUTTERED = replace(CLEAN, n_paths=9, outlier_share=0.3)


def check_stops(seed: int, quick: bool) -> list[Measurement]:
    """Stops alone with Gaussian errors: position errors over the bound, and their stated covariances."""
    rows = []
    for n_tx in (1, 2, 3):
        square, bound, nees = [], [], []
        for rng in generators(seed, 40 if quick else 400, n_tx):
            tx, stop = draw_shared_stop(rng, GAUSSIAN, n_tx)
            poses, _ = run_slam([stop.estimate], tx, MATCHED, MAPPING)
            if poses.status[0] == SolveStatus.FAILED or stop.bound_m > MAX_PEB_M:
                continue
            error = _error(poses.position_m[0], poses.heading_rad[0], poses.tx_clock_bias_s[0], stop)
            square.append(float(error[:2] @ error[:2]))
            bound.append(stop.bound_m)
            scale = np.append(np.ones(3), np.full(n_tx, SPEED_OF_LIGHT_M_S))
            nees.append(squared_mahalanobis(error[None], poses.covariance * np.outer(scale, scale))[0])
        ratio = rms_ratio(np.array(square), np.array(bound))
        key = f"multistatic.stops.{n_tx}tx"
        rows.append(at_most(f"{key}.rmse_over_bound", ratio, 1.5, "position RMSE over the joint bound"))
        rows.append(at_most(f"{key}.nees", np.mean(nees) / (3 + n_tx), 1.3, "errors as large as stated have 1"))
    return rows


def check_hidden(seed: int, quick: bool) -> list[Measurement]:
    """Stops without line of sight to any of two TX, a third of the paths no single bounce: how many are solved."""
    solved, close = [], []
    for rng in generators(seed, 50 if quick else 300, 7):
        tx, stop = draw_shared_stop(rng, replace(CLUTTERED, has_los=False), 2)
        poses, _ = run_slam([stop.estimate], tx, OURS, MAPPING)
        solved.append(poses.status[0] != SolveStatus.FAILED)
        close.append(bool(np.hypot(*(poses.position_m[0] - stop.state[:2])) < 1.0))
    key = "multistatic.hidden"
    return [
        at_least(f"{key}.solved_share", np.mean(solved), 0.98, "no line of sight to any TX"),
        at_least(f"{key}.right_share", np.mean(close), 0.95, "solved within 1 m"),
    ]


def check_walks(seed: int, quick: bool) -> list[Measurement]:
    """Walks with 30 % outliers: each TX makes them better, and takes its share of the time."""
    rmse: dict[int, float] = {}
    seconds: dict[int, float] = {}
    for n_tx in (1, 2, 3):
        errors = []
        for rng in generators(seed, 2 if quick else 12, 20):
            tx, walk = draw_shared_walk(rng, CLUTTERED, 15 if quick else 30, n_tx)
            estimates = [stop.estimate for stop in walk]
            started = time.process_time()
            poses, _, _ = run_trajectory(estimates, tx, OURS, TrajectoryConfig(), MAPPING)
            seconds[n_tx] = seconds.get(n_tx, 0.0) + time.process_time() - started
            errors.append(poses.position_m - np.array([stop.state[:2] for stop in walk]))
        rmse[n_tx] = float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))
    key = "multistatic.walks"
    return [
        at_most(f"{key}.3tx.rmse_m", rmse[3], 0.5, "no walk in a wrong mode", "m"),
        at_most(f"{key}.2tx_over_1tx", rmse[2] / rmse[1], 1.0, "a second TX must help"),
        at_most(f"{key}.3tx_over_2tx", rmse[3] / rmse[2], 1.0, "a third TX must help"),
        at_most(f"{key}.time", seconds[3] / seconds[1] / 3, 1.5, "of three TX over three times that of one"),
    ]


def check_memory(seed: int, quick: bool) -> list[Measurement]:
    """Most memory that SLAM of a walk takes, over the number of TX."""
    peak = {}
    for n_tx in (1, 1, 3):  # the first loads compiled code
        tx, walk = draw_shared_walk(next(iter(generators(seed, 1, 21))), CLUTTERED, 8 if quick else 30, n_tx)
        estimates = [stop.estimate for stop in walk]
        peak[n_tx] = peak_bytes(partial(run_trajectory, estimates, tx, OURS, TrajectoryConfig(), MAPPING))
    reason = "of three TX over three times that of one; new arrays alone"
    return [at_most("multistatic.walks.memory", peak[3] / peak[1] / 3, 1.5, reason)]


def _error(position_m: FloatArray, heading_rad: float, clock_s: FloatArray, stop: SharedStop) -> FloatArray:
    """Errors (3 + tx,) of a state in m, m, rad, m."""
    error = np.array([*position_m, heading_rad, *(SPEED_OF_LIGHT_M_S * clock_s)]) - stop.state
    error[2] = wrap_angle(error[2])
    return np.asarray(error)
