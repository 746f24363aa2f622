"""The methods of the project as submissions to a task, and the bound."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.channel.estimate import estimate_channel
from estimation.channel.record import EstimateStatus, empty_estimate
from estimation.slam.stops import published_poses
from isac_arena.campaign.chain.inputs import known_receiver, unsolved_poses
from isac_arena.campaign.chain.maps import make_map
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.exchange.path_columns import Columns
from isac_arena.public_tasks.grading import FARTHEST_M, Grade, channel_tables, with_interval
from isac_arena.public_tasks.making import SealedScene, Stage
from isac_arena.public_tasks.submissions import COLUMNS
from isac_arena.scoring.config import DEFAULT_GATE
from scenes.record import FloatArray, empty_record

RMS_TO_MEAN = np.sqrt(np.pi) / 2  # of the length of a circular Gaussian error


@dataclass(frozen=True)
class Baseline:
    """A method of the project: its name, and the fields of the campaign that choose it."""

    name: str
    fields: dict[str, Any]


BASELINES: dict[Stage, tuple[Baseline, ...]] = {
    "channel": (
        Baseline("ours (auto)", {"channel": {"method": "auto"}}),
        Baseline("incoherent maximum likelihood", {"channel": {"method": "incoherent"}}),
        Baseline("paper's method (beam powers)", {"channel": {"method": "power"}}),
    ),
    "slam": (
        Baseline("ours (all stops together)", {}),
        Baseline("ours (each stop alone)", {"trajectory": {"method": "single"}}),
        Baseline("published snapshot SLAM", {"trajectory": {"method": "single"}, "slam": {"method": "reference"}}),
    ),
    "contours": (
        Baseline("ours (reflection law)", {}),
        Baseline("paper's method (Gaussian process)", {"contours": {"method": "paper_gp"}}),
        Baseline("convex hull", {"contours": {"method": "convex_hull"}}),
        Baseline("random matrix", {"contours": {"method": "random_matrix"}}),
    ),
}


def baseline_rows(stage: Stage, scenes: list[SealedScene], method: Baseline) -> Columns:
    """The submission of a method, made from observations alone."""
    rows = [row for number, sealed in enumerate(scenes) for row in _rows(stage, sealed, number, method)]
    table = np.array(rows, float).reshape(-1, len(COLUMNS[stage]))
    return {name: table[:, place] for place, name in enumerate(COLUMNS[stage])}


def _rows(stage: Stage, sealed: SealedScene, number: int, method: Baseline) -> Iterator[tuple[float, ...]]:
    config = _changed(sealed.config, method.fields)
    if stage == "channel":
        for truth in sealed.truths:
            found = estimate_channel(sealed.run.sweep(truth), config=config.channel).reported
            values = (found.delay_s, found.aod_azimuth_rad, found.aoa_azimuth_rad, found.power_dbm)
            for row in zip(*values, strict=True):
                yield (number, truth.stop, *row)
        return
    run = replace(sealed, config=config).run
    if stage == "slam":
        is_published = config.slam.method == "reference"
        poses = (
            published_poses(sealed.channel, run.tx, config.slam) if is_published else run.locate(sealed.channel)[0]
        )
        for stop, place in zip(poses.stop, poses.position_m, strict=True):
            if np.isfinite(place).all():
                yield (number, stop, *place)
        return
    result = make_map(config, sealed.channel, run.tx, known_receiver(sealed.truths))
    for contour, points in enumerate(_outlines(result)):
        for point in points:
            yield (number, contour, *point)


def _outlines(result: MapResult) -> list[FloatArray]:
    found = result.contours
    return [
        np.concatenate([points, points[:1]]) if closed else points
        for points, closed in zip(found.contour_m, found.is_closed, strict=True)
    ]


def _changed(config: CampaignConfig, fields: dict[str, Any]) -> CampaignConfig:
    changes = {name: getattr(config, name).model_copy(update=values) for name, values in fields.items()}
    return config.model_copy(update=changes)


def bound(stage: Stage, scenes: list[SealedScene]) -> Grade | None:
    """The grade of errors at their Cramer-Rao bounds, on average; None for contours, which have none."""
    losses: dict[Stage, Callable[[SealedScene], FloatArray]] = {"channel": _channel_bound, "slam": _slam_bound}
    if stage not in losses:
        return None
    found = [one[np.isfinite(one)] for one in (losses[stage](sealed) for sealed in scenes)]
    return with_interval([one for one in found if len(one)]) if any(map(len, found)) else None


def _channel_bound(sealed: SealedScene) -> FloatArray:
    """GOSPA with every separable significant path found, at the bounds of its parameters."""
    empty = [empty_estimate(truth.stop, "none", EstimateStatus.NO_PATHS, "") for truth in sealed.truths]
    paths = channel_tables(sealed, empty).significant
    std = (
        np.column_stack([paths.delay_bound_s, paths.aod_bound_rad, paths.aoa_bound_rad]) / DEFAULT_GATE.half_width
    )
    square = np.minimum(np.mean(np.square(std), axis=1), 1.0)
    used = paths.is_separable & np.isfinite(square)
    return np.array([np.sqrt(square[used & (paths.stop == truth.stop)].sum()) for truth in sealed.truths])


def _slam_bound(sealed: SealedScene) -> FloatArray:
    """Mean distance of a position at the bound of its stop alone; NaN where separable paths do not fix it."""
    unsolved = unsolved_poses([truth.stop for truth in sealed.truths])
    nothing = replace(empty_record(MapResult), poses=unsolved)
    scores = sealed.run.score(sealed.truths, CampaignResults(tuple(sealed.channel), (), nothing, nothing))
    bound_m = scores.tables.poses.position_bound_m
    return np.asarray(np.minimum(RMS_TO_MEAN * bound_m, FARTHEST_M["slam"]))
