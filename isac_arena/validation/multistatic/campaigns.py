"""`arena validate multistatic`: the scores of `campus_arena_three` by the sweep engine, whole runs alone."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from isac_arena.scoring.metrics.statistics import mean, ratio, rms
from isac_arena.validation.chain.campaigns import ChainOptions, library_campaign
from isac_arena.validation.chain.check import MAPS
from isac_arena.validation.chain.run import ChainResult, failure_row, run_chain
from isac_arena.validation.chain.statistics import LIT_STOPS, ChainObjects, pooled_stops
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import band_rows
from scenes.record import BoolArray, FloatArray

OUT = Path("out") / "multistatic"
CAMPAIGN, MAX_PATHS, STOP_EVERY = "campus_arena_three", 80, 3  # paths as in the file; 15 of 45 stops
IOU = {"mapping": 0.85, "slam": 0.80}
COVERAGE = (0.93, 0.97)
OVER_BOUND = 1.5


def check_campaigns(
    seed: int,
    quick: bool,
    trials: int = 1,
    out: Path = OUT,
    workers: int | None = None,
    console: Console | None = None,
) -> list[Measurement]:
    """The Campus Arena with three TX and diffuse paths, `trials` seeds pooled; nothing in a quick run.

    `out` keeps the channel estimates: an interrupted run goes on there.
    """
    if quick:
        return []
    options = ChainOptions(max_paths=MAX_PATHS)
    campaigns = [library_campaign(CAMPAIGN, seed + k, options, STOP_EVERY) for k in range(trials)]
    results, failures = run_chain(console or Console(quiet=True), campaigns, out, workers)
    key = f"multistatic.{CAMPAIGN}"
    rows = [failure_row(key, failures)]
    if not results:
        return rows
    for name, of in MAPS.items():
        iou, coverage = _seen_from_several(results, [of(result) for result in results])
        seen = f"{len(iou)} pillars that two TX or more light from {LIT_STOPS} stops each"
        rows.append(at_least(f"{key}.{name}.pillar_iou", mean(iou), IOU[name], f"{seen}; 0 without a contour"))
        rows += band_rows(f"{key}.{name}.coverage95", mean(coverage), COVERAGE, 0.0, False, "of bands, where seen")
    stops = pooled_stops(results)
    over = ratio(rms(stops.error_m), rms(stops.bound_m))
    thermal = "RMSE over the joint bound of thermal noise; diffuse paths are not in the bound"
    return [
        *rows,
        at_most(f"{key}.position_over_bound", over, OVER_BOUND, thermal),
        at_least(f"{key}.solved", stops.solved(), 0.98, f"of {len(stops.error_m)} stops"),
    ]


def _seen_from_several(
    results: Sequence[ChainResult], objects: Sequence[ChainObjects]
) -> tuple[FloatArray, FloatArray]:
    """IoU and coverage (pillar,) of the pillars that two TX or more light."""
    chosen = [
        (one.kind == "pillar") & _lit_by_several(result) for result, one in zip(results, objects, strict=True)
    ]
    iou, coverage = (
        np.concatenate([getattr(one, name)[rows] for one, rows in zip(objects, chosen, strict=True)])
        for name in ("iou", "coverage")
    )
    return iou, coverage


def _lit_by_several(result: ChainResult) -> BoolArray:
    """The objects (object,) that significant single bounces of two TX or more meet at enough stops."""
    paths = result.tables.significant
    names = [item.name for item in result.scene.objects]
    n_stops = np.array(
        [
            [len(np.unique(paths.stop[(paths.object == name) & (paths.tx == tx)])) for tx in np.unique(paths.tx)]
            for name in names
        ]
    )
    return np.asarray((n_stops >= LIT_STOPS).sum(axis=1) >= 2)
