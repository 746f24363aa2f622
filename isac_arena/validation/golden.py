"""Golden campaigns: small campaigns whose scores are kept, so that every change of a result is seen."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.files import write_text
from isac_arena.campaign.load import campaign_path, campaign_scene, resolve_campaign
from isac_arena.campaign.results import MemoryResults
from isac_arena.scoring.metrics.metric import Metric
from scenes.scene import Scene
from scenes.toml_config import read_text, read_toml
from sim.truth import Truth

NUDGES = 4  # runs with paths moved by rounding, when golden scores are made
NUDGE = 1e-6  # of gain and delay: ten times single precision, far below the noise
SPREAD_FACTOR = 5.0  # tolerance over the largest change that a nudge makes
LEAST_RELATIVE, LEAST_ABSOLUTE = 1e-3, 1e-9  # where no nudge changes anything


@dataclass(frozen=True)
class Deviation:
    """A golden score that a run does not reproduce."""

    campaign: str
    key: str
    golden: float
    found: float  # NaN where it is missing or could not be measured
    tolerance: float


def check_file(file: Path) -> list[Deviation]:
    """Run the campaign of a golden file once; return the scores out of tolerance, in the order of the file."""
    content = read_golden(file)
    found = {metric.key: metric.value for metric in run_golden(content)}
    return list(deviations_of(file.stem, content["metrics"], found))


def deviations_of(name: str, kept: Sequence[dict[str, Any]], found: dict[str, float]) -> Iterator[Deviation]:
    """Golden scores (`kept`: key, value, tolerance) that `found` does not reproduce; new scores do not count."""
    for row in kept:
        value = found.get(row["key"], math.nan)
        if not abs(value - row["value"]) <= row["tolerance"]:
            yield Deviation(name, row["key"], row["value"], value, row["tolerance"])


def remake_file(file: Path) -> None:
    """Run the campaign of a golden file and write its scores and their tolerances into it."""
    content = read_golden(file)
    nudged = [run_golden(content, nudge=seed) for seed in range(1, NUDGES + 1)]
    rows = golden_rows(run_golden(content), nudged)
    write_text(file, golden_text({**content, "metrics": rows}))


def golden_text(content: dict[str, Any]) -> str:
    """A golden file with a line per score, so that what changed is seen line by line."""
    head = {name: content[name] for name in ("campaign", "settings", "stops")}
    rows = ",\n".join(f"  {json.dumps(row)}" for row in content["metrics"])
    return f'{json.dumps(head)[:-1]}, "metrics": [\n{rows}\n]}}\n'


def golden_rows(metrics: Sequence[Metric], nudged: Sequence[Sequence[Metric]]) -> list[dict[str, Any]]:
    """Scores with tolerances: how far rounding can move each, with a margin.

    Other processors and linear algebra libraries round sums differently. A decision near its threshold then
    changes, and every score that depends on it changes by far more than rounding. So the campaign runs again with
    all paths moved by a few roundings. A score that cannot be measured in all of these runs is not kept.
    """
    others = [{metric.key: metric.value for metric in run} for run in nudged]
    rows = []
    for metric in metrics:
        values = [metric.value, *(other[metric.key] for other in others)]
        if not all(math.isfinite(value) for value in values):
            continue
        spread = max(abs(value - metric.value) for value in values)
        floor = LEAST_RELATIVE * abs(metric.value) + LEAST_ABSOLUTE
        about = {name: getattr(metric, name) for name in ("key", "value", "unit", "direction")}
        rows.append({**about, "tolerance": float(f"{max(SPREAD_FACTOR * spread, floor):.3g}")})
    return rows


def run_golden(content: dict[str, Any], nudge: int | None = None) -> tuple[Metric, ...]:
    """All scores of the campaign of a golden file; with the seed `nudge`, rounding moves its paths first."""
    config, scene = golden_campaign(content)
    run = CampaignRun(config, scene, stops=content["stops"])
    truths = list(run.truths())
    if nudge is not None:
        rng = np.random.default_rng(nudge)
        truths = [_nudged(truth, rng) for truth in truths]
    with threadpool_limits(limits=1):
        return replace(run, paths=truths, results=MemoryResults()).scores().metrics


def golden_campaign(content: dict[str, Any]) -> tuple[CampaignConfig, Scene]:
    """Settings and scene of a golden file: a campaign of the library with the tables of `settings` over it."""
    path = campaign_path(content["campaign"])
    document = read_toml(path)
    for name, table in content["settings"].items():
        document[name] = {**document.get(name, {}), **table}
    config, scene_file = resolve_campaign(document, path)
    return config, campaign_scene(config, scene_file)


def read_golden(file: Path) -> dict[str, Any]:
    """The content of a golden file; `ValueError`, one line, where it is none."""
    try:
        content = json.loads(read_text(file))
        missing = [name for name in ("campaign", "settings", "stops", "metrics") if name not in content]
    except (ValueError, TypeError) as error:
        raise ValueError(f"{file}: no golden file ({error})") from error
    if missing:
        raise ValueError(f"{file}: no golden file ('{missing[0]}' is missing)")
    return dict(content)


def _nudged(truth: Truth, rng: np.random.Generator) -> Truth:
    """The truth of a stop with gains and delays of its paths moved by about ten single-precision roundings."""
    paths = truth.paths
    gain = paths.gain * (1 + NUDGE * rng.standard_normal(len(paths)))
    delay_s = paths.delay_s * (1 + NUDGE * rng.standard_normal(len(paths)))
    return replace(truth, paths=replace(paths, gain=gain, delay_s=delay_s))
