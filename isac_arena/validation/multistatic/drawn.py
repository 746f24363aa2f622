"""What a receiver estimates of several TX of one hall: one pose, a clock bias per TX."""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.plane import range_covariance, state_columns
from estimation.slam.bounds import StopPaths, shared_pose_information, state_covariance, stop_information
from estimation.slam.transmitters import AnyTx, Transmitters, joined_paths
from isac_arena.validation.scenarios import halls
from isac_arena.validation.scenarios.halls import Hall, ScenarioConfig
from isac_arena.validation.scenarios.stops import Scenario, observe_stop
from scenes.pose import Pose
from scenes.record import FloatArray

CLOCK_STD_M = 3.0  # of the clocks of the TX against the first: 10 ns
_FROM_WALL_M = 0.5


@dataclass(frozen=True)
class SharedStop:
    """One stop: what was estimated of each TX, and the true state (3 + tx,) in m, m, rad, m."""

    parts: tuple[Scenario, ...]
    state: FloatArray

    @property
    def estimate(self) -> ChannelEstimate:
        """The paths of all TX."""
        return joined_paths([part.estimate for part in self.parts])

    @property
    def bound_m(self) -> float:
        """Bound of the position from the true single bounces and lines of sight of all TX."""
        covariance = state_covariance(shared_pose_information([_information(part) for part in self.parts]))
        return float(np.sqrt(covariance[0, 0] + covariance[1, 1]))


def draw_shared_stop(rng: np.random.Generator, config: ScenarioConfig, n_tx: int) -> tuple[AnyTx, SharedStop]:
    """A receiver anywhere in a hall of its own that hears `n_tx` TX."""
    hall = halls.draw_hall(rng, config)
    tx = _transmitters(rng, hall, n_tx)
    return _given(tx), _observed(rng, config, hall, tx, halls.draw_state(rng, config, hall), 0)


def draw_shared_walk(
    rng: np.random.Generator, config: ScenarioConfig, n_stops: int, n_tx: int
) -> tuple[AnyTx, list[SharedStop]]:
    """The stops of `halls.draw_walk`, with `n_tx` TX heard at each; a third of the stops in a row see none."""
    walk = halls.draw_walk(rng, config, n_stops)
    tx = _transmitters(rng, walk.hall, n_tx)
    hidden = replace(config, has_los=False)
    stops = [
        _observed(rng, config if clear else hidden, walk.hall, tx, walk.state[stop], stop)
        for stop, clear in enumerate(walk.has_los)
    ]
    return _given(tx), stops


def _transmitters(rng: np.random.Generator, hall: Hall, n_tx: int) -> Transmitters:
    """The TX of the hall, then one at the opposite wall and one at the left."""
    x, y = hall.size_m
    others = [
        Pose(np.array([rng.uniform(0.3, 0.7) * x, _FROM_WALL_M, 0.0]), np.pi / 2),
        Pose(np.array([_FROM_WALL_M, rng.uniform(0.3, 0.7) * y, 0.0]), 0.0),
    ]
    return Transmitters((hall.tx, *others[: n_tx - 1]), np.zeros(n_tx))


def _given(tx: Transmitters) -> AnyTx:
    return tx if len(tx) > 1 else tx.poses[0]


def _observed(
    rng: np.random.Generator, config: ScenarioConfig, hall: Hall, tx: Transmitters, state: FloatArray, stop: int
) -> SharedStop:
    bias_m = state[3] + np.append(0.0, CLOCK_STD_M * rng.standard_normal(len(tx) - 1))
    shared = np.append(state[:3], bias_m)
    parts = [
        observe_stop(rng, config, replace(hall, tx=pose), shared[state_columns(np.array(index))], stop)
        for index, pose in enumerate(tx.poses)
    ]
    return SharedStop(tuple(parts), shared)


def _information(part: Scenario) -> FloatArray:
    """Information (4, 4) on the state from the line of sight and the true single bounces of one TX."""
    covariance = range_covariance(part.estimate.plane_covariance)
    los = next(iter(covariance[part.is_los]), None)
    points, own = part.point_m[part.is_single], covariance[part.is_single]
    return stop_information(part.tx, part.state, StopPaths(points, own, np.full(len(points), -1), los))
