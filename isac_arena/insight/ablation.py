"""Ablation: one campaign with each hardware impairment alone, with all and with none, and their ranking."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.signal.hardware.config import ImpairmentsConfig
from sim.truth import Truth

NONE, ALL = "none", "all"

# Score, label, unit: the chain from the delays to the shapes.
EFFECTS: Mapping[str, tuple[str, str]] = {
    "channel.delay.rmse_ns": ("ToA", "ns"),
    "channel.aod.rmse_deg": ("AoD", "deg"),
    "channel.aoa.rmse_deg": ("AoA", "deg"),
    "slam.position.rmse_m": ("position", "m"),
    "slam.heading.rmse_deg": ("heading", "deg"),
    "mapping.ip_to_surface.rms_m": ("map", "m"),
    "shapes.mapping.pillar.full_rmse.mean_m": ("shape", "m"),
}


@dataclass(frozen=True)
class Ablation:
    """Scores of the variants of a campaign, the strongest single impairment first, then all and none.

    `value` is (variant, effect) in the units of `EFFECTS`, NaN where a score could not be measured; `growth`
    (variant,) is the mean over the effects of log2(value / value without impairments).
    """

    variant: tuple[str, ...]
    value: FloatArray
    growth: FloatArray


def variants(impairments: ImpairmentsConfig) -> dict[str, ImpairmentsConfig]:
    """Impairment settings by name: none, each that is on alone, all; `ValueError` where none is on."""
    names = impairments.switched_on
    if not names:
        raise ValueError("impairments: all are off, at least one must be on, as in campus_arena_hardware")
    return {NONE: ImpairmentsConfig(), **{name: impairments.only(name) for name in names}, ALL: impairments}


def score_variants(
    config: CampaignConfig, scene: Scene, truths: Sequence[Truth], done: Callable[[str], None] | None = None
) -> Ablation:
    """Run the campaign once per variant on the same paths and random numbers, and rank the variants.

    `truths` holds the traced paths of the stops; their clock biases are set per variant. `done` gets the name
    of every finished variant.
    """
    rows: dict[str, list[float]] = {}
    for name, impairments in variants(config.impairments).items():
        variant = config.model_copy(update={"impairments": impairments})
        scores = CampaignRun(variant, scene, paths=truths).scores()
        rows[name] = [scores.value(key) for key in EFFECTS]
        if done is not None:
            done(name)
    return ranked(rows)


def ranked(rows: Mapping[str, Sequence[float]]) -> Ablation:
    """The variants in order of their effect, all and none last."""
    value = {name: np.asarray(row, float) for name, row in rows.items()}
    growth = {name: _growth(row, value[NONE]) for name, row in value.items()}
    single = sorted((name for name in rows if name not in (NONE, ALL)), key=lambda name: -growth[name])
    names = (*single, ALL, NONE)
    return Ablation(names, np.array([value[n] for n in names]), np.array([growth[n] for n in names]))


def table_rows(ablation: Ablation) -> Iterator[dict[str, str | float | None]]:
    """One row per variant: its name, growth and every effect by its score key; None where not measured."""
    for name, growth, values in zip(ablation.variant, ablation.growth, ablation.value, strict=True):
        finite = [float(value) if np.isfinite(value) else None for value in values]
        effects = dict(zip(EFFECTS, finite, strict=True))
        yield {"variant": name, "growth_log2": float(growth), **effects}


def score_text(value: float, decimals: int = 3) -> str:
    """The text of a score: `decimals` below 10, one decimal above."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.{decimals if value < 10 else 1}f}"


def _growth(value: FloatArray, reference: FloatArray) -> float:
    valid = (value > 0) & (reference > 0)
    return float(np.log2(value[valid] / reference[valid]).mean()) if valid.any() else 0.0
