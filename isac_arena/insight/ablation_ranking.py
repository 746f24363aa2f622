"""Scores of an ablation: how far each hardware impairment moves a campaign, and in which order they rank."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray

NONE, ALL = "none", "all"

# Score, what people call it, unit: the chain from the delays to the shapes.
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
        effects = {
            key: float(value) if np.isfinite(value) else None
            for key, value in zip(EFFECTS, values, strict=True)
        }
        yield {"variant": name, "growth_log2": float(growth), **effects}


def cell(value: float, decimals: int = 3) -> str:
    """A score as it is shown, with as many decimals below 10 and one above."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.{decimals if value < 10 else 1}f}"


def _growth(value: FloatArray, reference: FloatArray) -> float:
    valid = (value > 0) & (reference > 0)
    return float(np.log2(value[valid] / reference[valid]).mean()) if valid.any() else 0.0
