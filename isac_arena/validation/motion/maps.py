"""Maps and poses of the hall with movers, against those of the same hall and walk without."""

from pathlib import Path
from typing import Any

from rich.console import Console

from isac_arena.scoring.metrics.statistics import mean, ratio, rms
from isac_arena.validation.chain.campaigns import ChainOptions, library_campaign
from isac_arena.validation.chain.check import MAPS
from isac_arena.validation.chain.run import failure_row, run_chain
from isac_arena.validation.chain.statistics import LIT_STOPS, chain_stops
from isac_arena.validation.measurement import Measurement, at_most

OUT = Path("out") / "motion"
CAMPAIGN, MAX_PATHS = "campus_arena_busy", 60  # paths as in the file
NOBODY: tuple[tuple[str, Any], ...] = (("scene.targets", []),)


def check_maps(
    seed: int, quick: bool, out: Path = OUT, workers: int | None = None, console: Console | None = None
) -> list[Measurement]:
    """What movers cost pillars and positions; nothing in a quick run.

    `out` keeps the channel estimates: an interrupted run goes on there.
    """
    if quick:
        return []
    options = ChainOptions(max_paths=MAX_PATHS)
    campaigns = [library_campaign(CAMPAIGN, seed, options, changes=changes) for changes in ((), NOBODY)]
    results, failures = run_chain(console or Console(quiet=True), campaigns, out, workers)
    key = f"motion.{CAMPAIGN}"
    rows = [failure_row(key, failures)]
    if failures:
        return rows
    for name, of in MAPS.items():
        busy, empty = (of(result).pillar_iou() for result in results)
        seen = f"{mean(busy):.3f} of {len(busy)} pillars, empty {mean(empty):.3f} of {len(empty)}"
        reason = f"{seen}; lit from {LIT_STOPS} stops each, 0 without a contour"
        rows.append(at_most(f"{key}.{name}.iou_loss", mean(empty) - mean(busy), 0.03, reason))
    of_busy, of_empty = (rms(chain_stops(result.tables.poses).error_m) for result in results)
    reason = f"RMSE {1e3 * of_busy:.2f} mm, empty {1e3 * of_empty:.2f} mm"
    return [*rows, at_most(f"{key}.position_over_empty", ratio(of_busy, of_empty), 1.15, reason)]
