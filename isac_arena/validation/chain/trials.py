"""`arena validate chain`: SLAM alone, with paths made from the truth of some rooms of ideal hardware.

The paths are traced without diffuse scattering. Their bounds are those of the campaign's link.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import TrajectoryConfig
from isac_arena.campaign.chain.inputs import significance
from isac_arena.campaign.driver import CampaignRun
from isac_arena.scoring.link_view import link_view
from isac_arena.scoring.metrics.statistics import maximum, rms
from isac_arena.scoring.record import PathKind, PoseScores
from isac_arena.scoring.stages.poses import pose_bounds, score_poses
from isac_arena.scoring.true_stop import TrueStop, significant_alone, true_stop
from isac_arena.validation.chain.campaigns import ChainOptions, room_campaign
from isac_arena.validation.chain.statistics import GROSS_M, ChainStops, chain_stops
from isac_arena.validation.measurement import InfoTable, Measured, Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import band_rows, generators
from isac_arena.validation.scenarios.drawn_estimates import drawn_estimate
from isac_arena.validation.scenarios.random_halls import TX_SECTOR_DEG
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray
from sim.config import PropagationConfig

UNEQUAL_ROOMS = (1, 5, 9, 13)  # 3, 2, 4 and 1 beam elevations
MIXED_ROOMS = (0, 1, 12, 13)  # equal and unequal heights in turn: 1, 3, 4 and 1 elevations
N_QUICK_STOPS = 4
EXACT_M, SOLVED = 1e-6, 0.99
FACTORS = {"quarter": 0.25, "fourfold": 4.0}  # of the stated covariances
NEES, RMSE_OVER_RIGHT = (0.8, 1.3), 1.15


@dataclass(frozen=True)
class TracedRoom:
    """A room with its stops prepared for scoring, significant paths only."""

    run: CampaignRun
    stops: tuple[TrueStop, ...]

    def located(self, channel: Sequence[ChannelEstimate], chosen: Sequence[BoolArray] = ()) -> PoseScores:
        """The receiver states that SLAM finds from channel estimates, and their bounds.

        Bounds are those from the `chosen` paths (path,) of each stop, by default from all.
        """
        poses, _ = self.run.locate(channel)
        truths = [stop.truth for stop in self.stops]
        chosen = chosen or [np.ones(len(stop.significant), bool) for stop in self.stops]
        bounding = [
            replace(stop, significant=stop.significant[rows], covariance=stop.covariance[rows])
            for stop, rows in zip(self.stops, chosen, strict=True)
        ]
        return score_poses(
            np.array([truth.stop for truth in truths]),
            [truth.rx_pose for truth in truths],
            np.array([truth.clock_bias_s for truth in truths]),
            np.array([bool((stop.origin.kind == PathKind.LOS).any()) for stop in self.stops]),
            poses,
            pose_bounds(self.run.scene, [[stop] for stop in bounding]),
        )


def check_exact_paths(seed: int, quick: bool) -> list[Measurement]:
    """Lines of sight and single bounces without errors, at unequal heights, each stop alone: the exact positions.

    A walk has a prior of its motion, which exact paths do not remove.
    """
    parts = []
    for room in UNEQUAL_ROOMS[:1] if quick else UNEQUAL_ROOMS:
        traced = traced_room(seed, room, quick, is_walk=False)
        level = [_is_level(traced, stop) for stop in traced.stops]
        channel = [drawn_estimate(stop, chosen=rows) for stop, rows in zip(traced.stops, level, strict=True)]
        parts.append(chain_stops(traced.located(channel, level)))
    stops = ChainStops.joined(parts)
    key, reason = "chain.exact_paths", f"of {stops.is_known.sum()} stops that their paths determine"
    return [
        at_most(f"{key}.position_m", maximum(stops.error_m[stops.is_known]), EXACT_M, f"largest {reason}", "m"),
        at_least(f"{key}.solved", stops.solved(), SOLVED, reason),
    ]


def check_wrong_covariances(seed: int, quick: bool) -> Measured:
    """Separable paths with errors drawn from their joint bound, and covariances that are wrong by 4 either way."""
    rooms = [traced_room(seed, room, quick) for room in (MIXED_ROOMS[:1] if quick else MIXED_ROOMS)]
    right = _drawn_stops(rooms, seed, 1.0)
    rows, table = [], [_table_row("right", right)]
    for name, factor in FACTORS.items():
        found, key = _drawn_stops(rooms, seed, factor), f"chain.covariances.{name}"
        reason = f"stated covariances are the bounds times {factor:g}"
        rows += band_rows(f"{key}.nees", found.normalised_nees, NEES, 0.0, False, reason)
        ratio = rms(_capped(found)) / rms(_capped(right))
        over = f"errors of at most {GROSS_M:g} m, which stands for unsolved stops as well"
        rows.append(at_most(f"{key}.rmse_over_right", ratio, RMSE_OVER_RIGHT, over))
        table.append(_table_row(name, found))
    columns = ("covariances", "stops", "solved", "RMSE m", "over bound", "NEES/4")
    return Measured(rows, (InfoTable("SLAM from drawn paths", columns, tuple(table)),))


def traced_room(seed: int, room: int, quick: bool, *, is_walk: bool = True) -> TracedRoom:
    """A room without diffuse paths; a quick one has few stops. Without `is_walk` each stop is solved alone."""
    case = room_campaign(seed, room, ChainOptions()).case
    config = case.config.model_copy(update={"propagation": PropagationConfig(diffuse_samples=0)})
    if not is_walk:
        config = config.model_copy(update={"trajectory": TrajectoryConfig(method="single")})
    run = CampaignRun(config, case.scene.build(config), stops=range(N_QUICK_STOPS) if quick else None)
    view, limits = link_view(config, run.link, run.scene), significance(config, run.link)
    prepare = partial(true_stop, tx_pose=run.scene.tx, limits=limits, view=view)
    stops = (prepare(truth, power_dbm=run.true_power_dbm(truth)) for truth in run.truths())
    return TracedRoom(run, tuple(significant_alone(stop) for stop in stops))


def _is_level(traced: TracedRoom, stop: TrueStop) -> BoolArray:
    """The significant paths (path,) that are a line of sight or a single bounce off an upright face.

    Bounces off the top of an object are no such paths: their plan lengths are others. Those that
    leave outside the TX sector are left out: near and behind its panel mirror images look alike.
    """
    tx_m, rx_m = traced.run.scene.tx.position_m, stop.truth.rx_pose.position_m
    is_los, vertex_m = stop.origin.kind == PathKind.LOS, stop.origin.vertex_m
    plan_m = np.linalg.norm(vertex_m - tx_m[:2], axis=1) + np.linalg.norm(vertex_m - rx_m[:2], axis=1)
    length_m = SPEED_OF_LIGHT_M_S * (stop.parameters[:, 0] - stop.truth.clock_bias_s)
    is_upright = np.abs(np.hypot(plan_m, tx_m[2] - rx_m[2]) - length_m) < EXACT_M
    is_inside = np.abs(stop.parameters[:, 1]) < np.deg2rad(TX_SECTOR_DEG / 2)
    return np.asarray((is_los | is_upright) & is_inside)


def _drawn_stops(rooms: Sequence[TracedRoom], seed: int, factor: float) -> ChainStops:
    """The stops of all rooms; the errors are the same for every factor."""
    parts = []
    for index, traced in enumerate(rooms):
        draws = zip(traced.stops, generators(seed, len(traced.stops), index), strict=True)
        channel = [drawn_estimate(stop, rng, stated_factor=factor) for stop, rng in draws]
        parts.append(chain_stops(traced.located(channel)))
    return ChainStops.joined(parts)


def _capped(stops: ChainStops) -> np.ndarray:
    return np.minimum(np.nan_to_num(stops.error_m, nan=np.inf), GROSS_M)


def _table_row(name: str, stops: ChainStops) -> tuple[str | float, ...]:
    solved = str(int(stops.is_solved.sum()))
    return name, str(len(stops.error_m)), solved, rms(stops.error_m), stops.over_bound, stops.normalised_nees
