"""The budget of a campaign: its final errors attributed to stages and to physics."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from isac_arena.insight.budget.attribution import Attribution, attribute, signed_root
from isac_arena.insight.budget.outcome import FinalErrors
from isac_arena.insight.budget.stages import Groups, Part

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


def attributions(variants: Variants, groups: Groups, rng: np.random.Generator) -> dict[str, Attribution]:
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

    `mean_square_m2` is the contribution, `rms_m` its root with its sign. `share` is of the total, with its
    interval (of the total: of the total itself), None where it has no meaning: `objection` gives the reason.
    `effect` is the change of the error without the part; empty where there are no shares.
    """
    for (outcome, kind), found in budget.attribution.items():
        about: dict[str, Any] = {"outcome": outcome, "budget": kind, "objection": found.objection}
        total = np.nan if found.objection else found.total
        for index, part in enumerate(found.part):
            yield about | {
                "part": str(part),
                **_parts(found.contribution[index], total, found.low[index], found.high[index]),
                "effect": "" if found.objection else str(found.effect[index]),
                "alone_rms_m": _finite(signed_root(found.alone[index])),
                "first_rms_m": _finite(signed_root(found.first[index])),
                "last_rms_m": _finite(signed_root(found.last[index])),
            }
        blank = {"effect": "", **dict.fromkeys(("alone_rms_m", "first_rms_m", "last_rms_m"))}
        yield about | {"part": REST, **_parts(found.rest, total, found.rest_low, found.rest_high), **blank}
        spread = found.total_low / total, found.total_high / total
        yield about | {"part": TOTAL, **_parts(found.total, total, *spread), **blank}


def _parts(mean_square: float, total: float, low: float, high: float) -> dict[str, float | None]:
    """A mean square in m^2, its root, and its share with interval; no shares of a total of NaN."""
    share = mean_square / total
    return {
        "share": _finite(share),
        "share_low": _finite(low) if np.isfinite(share) else None,
        "share_high": _finite(high) if np.isfinite(share) else None,
        "mean_square_m2": _finite(mean_square),
        "rms_m": _finite(signed_root(mean_square)),
    }


def _finite(value: float | np.ndarray) -> float | None:
    return float(value) if np.isfinite(value) else None
