"""The cases of a sweep: points of the design, each with its resolved campaign and scene."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.load import (
    SceneSource,
    campaign_path,
    changed_campaign,
    read_scene_source,
    without_library_paths,
)
from isac_arena.sweep.config import AxisConfig, SweepConfig
from scenes.memory import ask_memory
from scenes.record import FloatArray
from scenes.toml_config import ConfigError, read_toml

CASE_BYTES = 16_000  # of a case while it is planned: its settings, its names and its place
MOST_POINTS, MOST_CASES = 20_000, 100_000  # so that a plan takes seconds: 0.5 ms a point, 0.05 ms a case
ALIASES = {"estimator": "functions.channel.function"}  # a short name of an axis
Point = tuple[Any, ...]  # one value per axis
# What a case runs and scores: the whole chain, the same with channel estimates kept, or no more than the channel
Stages = Literal["all", "all_kept", "channel"]


@dataclass(frozen=True)
class Case:
    """One campaign of a sweep: its place in the design and all its inputs."""

    point: int  # index of the design point
    repeat: int
    values: Point
    config: CampaignConfig
    scene: SceneSource
    stop_every: int
    stages: Stages = "all"


def count_points(config: SweepConfig) -> int:
    """Number of points of the design, without making them."""
    sizes = [len(axis.values) if axis.values is not None else axis.count or 2 for axis in config.axes]
    if config.design == "grid":
        return math.prod(sizes)
    return (config.n_points or 1) if config.n_points or not sizes else max(sizes)


def ask_cases(config: SweepConfig, n_repeats: int) -> None:
    """Raise `ConfigError` where the cases are too many, `MemoryLimitError` where they do not fit into the memory.

    Both name the fields to change.
    """
    n_points = count_points(config)
    fields = ["n_points"] if config.n_points else [_size_field(axis) for axis in config.axes]
    fields += ["repeats"] if n_repeats > 1 else []
    change, what = " and ".join(fields) or "repeats", f"a plan of {n_points} points x {n_repeats} repeats"
    ask_memory(CASE_BYTES * n_points * n_repeats, what, change)
    if n_points > MOST_POINTS or n_points * n_repeats > MOST_CASES:
        raise ConfigError(
            f"{change}: {what}: a sweep has at most {MOST_POINTS} points and {MOST_CASES} cases; divide it"
        )


def _size_field(axis: AxisConfig) -> str:
    return f"axes.{axis.field}.{'count' if axis.values is None else 'values'}"


def design_points(config: SweepConfig) -> list[Point]:
    """Value of every axis at every point of the design, in a fixed order.

    Raises `ConfigError` where the axes of a list differ in length.
    """
    axes = config.axes
    if config.design == "grid":
        return list(product(*(_listed(axis) for axis in axes)))
    if config.design == "list":
        columns = [_listed(axis) for axis in axes]
        lengths = sorted({len(column) for column in columns})
        if len(lengths) > 1:
            raise ConfigError(
                f"axes: a list needs as many values on every axis, not {lengths[0]} and {lengths[-1]}"
            )
        return list(zip(*columns, strict=True)) if columns else [()]
    rng, n = np.random.default_rng(config.design_seed), config.n_points or 1
    if config.design == "latin_hypercube" and axes:
        from scipy.stats import qmc  # noqa: PLC0415  (slow to import)

        shares = qmc.LatinHypercube(len(axes), rng=rng).random(n)
    else:
        shares = rng.random((n, len(axes)))
    return [tuple(_drawn(axis, float(share)) for axis, share in zip(axes, row, strict=True)) for row in shares]


def make_cases(
    source: str, config: SweepConfig, points: Sequence[Point], repeats: Sequence[int]
) -> Iterator[Case]:
    """The cases of the given repeats of every point.

    `source` is the sweep file, beside which a relative base is looked up. The seed of a case is that of its
    campaign plus the repeat, so all points share their random numbers.

    Raises `ConfigError`, one line naming the axis and the value, where a case is no valid campaign.
    """
    base = base_path(source, config)
    document = read_toml(base)
    scene_of = cache(read_scene_source)
    for index, point in enumerate(points):
        fields = [ALIASES.get(axis.field, axis.field) for axis in config.axes]
        changes = dict(zip(fields, point, strict=True))
        try:
            campaign, scene = changed_campaign(document, base, changes.items(), scene_of)
        except ConfigError as error:
            changed = ", ".join(f"{field} = {value}" for field, value in changes.items()) or "the base"
            told = str(error)
            if any(field in told for field in changes):  # no fault of the base
                told = told.removeprefix(f"{base}: ")
            raise ConfigError(without_library_paths(f"{source}: case {changed}: {told}")) from error
        for repeat in repeats:
            seeded = campaign.model_copy(update={"seed": campaign.seed + repeat})
            yield Case(index, repeat, point, seeded, scene, config.stop_every)


def base_path(source: str, config: SweepConfig) -> Path:
    """The file of the base campaign; a relative path is looked up beside the sweep file."""
    path = campaign_path(config.base)
    return Path(source).parent / path if config.base.endswith(".toml") else path


def _listed(axis: AxisConfig) -> list[Any]:
    if axis.values is not None:
        return axis.values
    return [_drawn(axis, float(share)) for share in np.linspace(0, 1, axis.count or 2)]


def _drawn(axis: AxisConfig, share: float) -> Any:
    """The value at a share in [0, 1] of the axis: of its range, or of its list of values."""
    if axis.values is not None:
        return axis.values[min(int(share * len(axis.values)), len(axis.values) - 1)]
    ends: FloatArray = np.array([axis.low, axis.high], float)
    low, high = np.log(ends) if axis.log else ends
    value = low + share * (high - low)
    value = float(np.clip(np.exp(value) if axis.log else value, *ends))
    return round(value) if axis.integer else value
