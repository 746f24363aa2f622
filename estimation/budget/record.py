"""The budget of a campaign: its final errors taken apart by stages and by physics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.budget.attribution import Attribution, attribute, root
from estimation.budget.outcome import FinalErrors
from estimation.budget.stages import Groups, Part

# Receiver positions, the paper's contours and ours: field of the final errors, and what the bootstrap draws.
OUTCOMES: Mapping[str, tuple[str, str]] = {
    "pose": ("pose_error_m", "stop"),
    "shape": ("shape_error_m", "object"),
    "contour": ("contour_error_m", "object"),
}
REST, TOTAL = "rest", "all errors"
Variants = Mapping[frozenset[Part], Sequence[FinalErrors]]  # final errors of every repeat by coalition


@dataclass(frozen=True)
class Budget:
    """Attributions in m^2 by outcome (of `OUTCOMES`) and by what was replaced ('stages', 'physics')."""

    campaign: str
    stops: tuple[int, ...]
    objects: tuple[str, ...]
    repeats: int
    attribution: Mapping[tuple[str, str], Attribution]


def take_apart(variants: Variants, groups: Groups, rng: np.random.Generator) -> dict[str, Attribution]:
    """The attribution of every outcome that has units; squared errors are averaged over the repeats first."""
    found = {}
    for outcome, (name, _) in OUTCOMES.items():
        squared = {
            parts: np.mean([np.square(getattr(errors, name)) for errors in repeats], axis=0)
            for parts, repeats in variants.items()
        }
        if len(squared[frozenset()]):
            found[outcome] = attribute(squared, groups, rng)
    return found


def table_rows(budget: Budget) -> Iterator[dict[str, str | float | None]]:
    """One row per outcome, budget and part, then the rest, then the total they add up to.

    `share` is of the total mean square, with the interval of that share (of the total: of the total itself);
    `rms_m` is the root of the contribution, with its sign.
    """
    for (outcome, kind), found in budget.attribution.items():
        about: dict[str, str | float | None] = {"outcome": outcome, "budget": kind}
        total = found.total or np.nan
        for index, part in enumerate(found.part):
            yield about | {
                "part": str(part),
                **_shares(found.contribution[index] / total, found.low[index], found.high[index]),
                "rms_m": _finite(root(found.contribution[index])),
                "alone_rms_m": _finite(root(found.alone[index])),
                "first_rms_m": _finite(root(found.first[index])),
                "last_rms_m": _finite(root(found.last[index])),
            }
        blank = dict.fromkeys(("alone_rms_m", "first_rms_m", "last_rms_m"))
        rest = _shares(found.rest / total, found.rest_low, found.rest_high)
        yield about | {"part": REST, **rest, "rms_m": _finite(root(found.rest)), **blank}
        whole = _shares(found.total / total, found.total_low / total, found.total_high / total)
        yield about | {"part": TOTAL, **whole, "rms_m": _finite(root(found.total)), **blank}


def _shares(value: float, low: float, high: float) -> dict[str, float | None]:
    return {"share": _finite(value), "share_low": _finite(low), "share_high": _finite(high)}


def _finite(value: float | np.ndarray) -> float | None:
    return float(value) if np.isfinite(value) else None
