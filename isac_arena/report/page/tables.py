"""Tables of the report: the scores of each table and their readable names."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from typing import Any

import numpy as np

from isac_arena.progress import counted
from isac_arena.report.style import html_table
from isac_arena.scoring.headline import HEADLINE, HEADS, headline
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.record import IpScores, ScoreTables
from isac_arena.scoring.score import Scores
from isac_arena.scoring.stages.maps import found_objects
from isac_arena.scoring.words import explained
from isac_arena.settings import UNITS

SILENT_PARTS = ("scene", "objects", "contour")  # of a dotted name: they say nothing to a reader
MORE_TITLES = {  # of scores that no table of the report shows
    "channel.detection_rate": "Paths: share of the significant separable ones that were detected",
    "channel.delay.over_bound.median": "Paths: delay error over its Cramér-Rao bound, median",
}
PARTS = re.compile(
    r"\.(?:missed|false|ghost_ips|objects_found)\.(?!pillar$|wall$)\w+$"
)  # keys of parts of a count
DIRECTION_MARKS = {"lower": "↓", "higher": "↑", "info": ""}


@dataclass(frozen=True)
class ScoreTable:
    """A table with one row per quantity and one column per group; a key is prefix + row."""

    columns: tuple[tuple[str, str], ...]  # heading, key prefix
    rows: tuple[tuple[str, str], ...]  # label, key without the prefix


CHANNEL_COUNTS = ScoreTable(
    (("value", "channel."),),
    (
        ("Estimated paths per stop", "estimated_per_stop"),
        ("Significant true paths per stop", "significant_per_stop"),
        ("of these, detected, inseparable ones too", "detected_per_stop"),
        ("of these, missed: separable ones alone", "missed_per_stop"),
        ("of the missed, inside the gate of a detected one", "unresolved_per_stop"),
        ("of these, inseparable and not detected", "inseparable_undetected_per_stop"),
        ("Inseparable per stop: too close to others to tell apart", "inseparable_per_stop"),
        ("Weak or diffuse per stop", "weak_per_stop"),
        ("False per stop", "false_per_stop"),
        ("Detection rate of separable ones, line of sight", "los.detection_rate"),
        ("Detection rate of separable ones, single bounce", "single_bounce.detection_rate"),
        ("Detection rate of separable ones, multiple bounce", "multi_bounce.detection_rate"),
        ("Correct LOS decisions, share of stops", "los.decision_accuracy"),
    ),
)

CHANNEL_ERRORS = ScoreTable(
    (("value", "channel."),),
    (
        ("Delay, RMSE", "delay.rmse_ns"),
        ("Delay, bias", "delay.bias_ns"),
        ("Angle of departure, RMSE", "aod.rmse_deg"),
        ("Angle of departure, bias", "aod.bias_deg"),
        ("Angle of arrival, RMSE", "aoa.rmse_deg"),
        ("Angle of arrival, bias", "aoa.bias_deg"),
        ("Power, RMSE", "power.rmse_db"),
        ("Squared error over covariance (NEES / 3), target 1", "nees"),
        ("Coverage of the 95 % region, target 0.95", "coverage95"),
        ("Detected paths, which these two are over", "nees.count"),
    ),
)

POSES = ScoreTable(
    (("all stops", "slam."), ("LOS stops", "slam.los."), ("NLOS stops", "slam.nlos.")),
    (
        ("Stops", "stops"),
        ("Solved, share", "solved_share"),
        ("Position, RMSE", "position.rmse_m"),
        ("Position, median", "position.median_m"),
        ("Position, largest", "position.max_m"),
        ("Height, RMSE", "height.rmse_m"),
        ("Heading, RMSE", "heading.rmse_deg"),
        ("Clock bias, RMSE", "clock.rmse_ns"),
    ),
)

MAPS = ScoreTable(
    (("mapping", "mapping."), ("SLAM", "slam.")),
    (
        ("Incidence points taken as single bounces", "ips"),
        ("of these, off floor or ceiling", "ips_of_floor_or_ceiling"),
        ("of these, true single bounces, share", "ips_from_single_bounce_share"),
        ("of these, clustered, share", "ips_clustered_share"),
        ("Distance to the nearest surface, median", "ip_to_surface.median_m"),
        ("Distance to the nearest surface, RMS", "ip_to_surface.rms_m"),
        ("Distance to the nearest surface, 90 %", "ip_to_surface.p90_m"),
        ("Points of a true single bounce, whose error across the surface is judged", "ip_to_surface.nees.count"),
        ("Their squared error over variance (NEES), target 1", "ip_to_surface.nees"),
        ("Coverage of their 95 % interval across the surface, target 0.95", "ip_to_surface.coverage95"),
        ("Points of a detected single bounce, which have a true incidence point", "ip_position.nees.count"),
        ("Distance of these to it, RMS", "ip_position.rms_m"),
        ("Squared error of these over covariance (NEES / 2), target 1", "ip_position.nees"),
        ("Coverage of the 95 % region of these, target 0.95", "ip_position.coverage95"),
        ("Height error of these, RMS", "ip_height.rms_m"),
        ("Coverage of the 95 % interval of their height, target 0.95", "ip_height.coverage95"),
        ("Clusters", "clusters"),
        ("Ghost clusters", "ghost_clusters"),
        ("Purity of the clusters, mean", "cluster_purity"),
        ("Objects that have a cluster", "objects_found"),
        ("Pillars that have a cluster", "objects_found.pillar"),
        ("Walls that have a cluster", "objects_found.wall"),
    ),
)

SHAPE_ROWS = (
    ("Objects with a contour, which the means are over", "count"),
    ("of these with a closed contour, which the IoU is over", "iou.count"),
    ("Overlap with the true area (IoU)", "iou.mean"),
    ("Hausdorff distance", "hausdorff.mean_m"),
    ("Seen contour, RMSE", "seen_rmse.mean_m"),
    ("Full contour, RMSE", "full_rmse.mean_m"),
    ("Overlap with the lit extent", "extent_iou.mean"),
    ("Coverage of the 95 % interval", "coverage95.mean"),
    ("Coverage of the seen contour", "seen_coverage95.mean"),
)


def _shape_columns(method: str) -> tuple[tuple[str, str], ...]:
    """Pillars and walls of both maps, by the scores of one method: 'shapes' the paper's, 'contours' ours."""
    kinds = (("pillars", "pillar"), ("walls", "wall"))
    maps = (("mapping", "mapping"), ("SLAM", "slam"))
    return tuple(
        (f"{heading}, {label}", f"{method}.{one_map}.{kind}.")
        for heading, kind in kinds
        for label, one_map in maps
    )


SHAPES = ScoreTable(_shape_columns("shapes"), SHAPE_ROWS)
CONTOURS = ScoreTable(_shape_columns("contours"), SHAPE_ROWS)

ACCEPTED = ScoreTable(
    (("mapping", "contours.mapping."), ("SLAM", "contours.slam.")),
    (
        ("Contours accepted", "accepted"),
        ("of these, ghosts", "ghosts"),
        ("of these, phantoms", "phantoms"),
        ("of these, mixed", "mixed"),
        ("Objects found", "objects_found"),
        ("Correct class, share", "class_accuracy"),
        ("Closed outlines against objects, GOSPA of distances 1 - IoU", "scene_gospa"),
    ),
)


@cache
def score_titles() -> dict[str, str]:
    """Readable names of scores by their key, from the tables of the report."""
    tables = {"Paths": (CHANNEL_COUNTS, CHANNEL_ERRORS), "SLAM": (POSES,), "Map": (MAPS,)}
    tables |= {"Published contours": (SHAPES,), "Our contours": (CONTOURS, ACCEPTED)}
    found = dict(MORE_TITLES)
    for name, members in tables.items():
        for table in members:
            for heading, prefix in table.columns:
                of = name if heading in ("value", "all stops") else f"{name}, {heading}"
                found |= {prefix + key: f"{of}: {label[0].lower()}{label[1:]}" for label, key in table.rows}
    found |= {row.paper: f"Published method: {row.label}" for row in HEADLINE if row.paper not in found}
    return found | {row.key: row.label for row in HEADLINE}


def score_title(key: str) -> str:
    """The readable name of a score; the words of its key where no table of the report has it."""
    known = score_titles().get(key)
    return known or in_words(key)


def in_words(name: str) -> str:
    """A dotted key of a score or of a setting in words, without its unit."""
    parts = [part for part in name.split(".") if part not in SILENT_PARTS]
    parts[-1] = parts[-1].removesuffix(next((ending for ending in UNITS if parts[-1].endswith(ending)), ""))
    words = ", ".join(part.replace("_", " ") for part in parts if part)
    return re.sub(r"\b(tx|rx|ip|ips|los|nlos|iou|snr|slam)\b", _abbreviation, words)


def _abbreviation(found: re.Match[str]) -> str:
    return "IoU" if found[0] == "iou" else found[0].upper()


def headline_table(metrics: Sequence[Metric]) -> str:
    """The main scores of a campaign, beside the paper's method and the bound."""
    rows = [(explained(label), *map(_value, cells), explained(unit)) for label, cells, unit in headline(metrics)]
    return html_table(("", *map(explained, HEADS)), rows)


def legend_text(scores: Scores) -> str:
    """The words of the main scores and of all that is doubtful, a line each."""
    return f'<p class="words">{"<br>".join(map(escape, scores.legend))}</p>'


def score_table(table: ScoreTable, metrics: Sequence[Metric]) -> str:
    """A table of chosen scores; rows without any value are omitted."""
    known = {metric.key: metric for metric in metrics}
    rows = []
    for label, suffix in table.rows:
        cells = [known.get(prefix + suffix) for _, prefix in table.columns]
        present = [cell for cell in cells if cell is not None]
        if any(math.isfinite(cell.value) for cell in present):
            rows.append((explained(label), *map(_value, cells), _unit(present[0])))
    return html_table(("", *(explained(heading) for heading, _ in table.columns), "unit"), rows)


def channel_error_table(scores: Scores) -> str:
    """Errors of the detected paths; angles by what they are, cone angles or azimuths."""
    names = scores.tables.paths.angle_names
    rows = []
    for label, key in CHANNEL_ERRORS.rows:
        name = names.get(key.partition(".")[0], "")
        rows.append((label.replace("Angle", name.capitalize()) if name else label, key))
    return score_table(replace(CHANNEL_ERRORS, rows=tuple(rows)), scores.metrics)


def object_table(metrics: Sequence[Metric], method: str) -> str:
    """One row per object that a map shows: the scores of its best contour by 'shapes' or 'contours'."""
    known = {metric.key: metric for metric in metrics}
    columns = (("IoU", "iou"), ("seen RMSE in m", "seen_rmse_m"), ("coverage", "coverage95"))
    suffix = ".hausdorff_m"
    names = [key.split(".", 2)[2][: -len(suffix)] for key in known if _is_object_key(key, method, suffix)]
    rows = []
    for name in names:
        cells = [
            known.get(f"{method}.{one}.{name}.{field}") for one in ("mapping", "slam") for _, field in columns
        ]
        if any(cell is not None and math.isfinite(cell.value) for cell in cells):
            rows.append((escape(name), *map(_value, cells)))
    heads = [f"{label}, {one}" for one in ("mapping", "SLAM") for label, _ in columns]
    return html_table(("object", *map(explained, heads)), rows)


def scene_object_table(scene: Mapping[str, Any], tables: ScoreTables) -> str:
    """One row per object and mesh of a scene, seen or not: the paths that meet it, and whether a contour shows it.

    `scene` is that of the page, see `report_payload`.
    """
    significant, maps = tables.significant, (tables.mapping, tables.slam)
    found = [set(found_objects(one.contours)) for one in maps]
    shown = [set(one.contours.object.tolist()) for one in maps]
    kinds = {one["name"]: one["kind"] for one in scene["objects"]} | {
        one["name"]: "mesh" for one in scene["clutter"]
    }
    rows = []
    for name, kind in kinds.items():
        met = significant.object == name
        counts = met.sum(), len(np.unique(significant.stop[met]))
        of_maps = (
            "found" if name in enough else "too little of it" if name in some else _unshown(one.ips, name)
            for one, enough, some in zip(maps, found, shown, strict=True)
        )
        rows.append((escape(name), escape(kind), *map(str, counts), *of_maps))
    heads = ("object", "kind", "significant single bounces", "from so many stops", "mapping", "SLAM")
    return html_table([*map(explained, heads)], rows)


def _unshown(ips: IpScores, name: str) -> str:
    """Why a map has no contour of an object, as far as its points tell."""
    n_points = int((ips.is_inlier & (ips.object == name)).sum())
    return f"no contour of its {counted(n_points, 'point')}" if n_points else "no point"


def all_scores_table(metrics: Iterable[Metric]) -> str:
    """Every score that has a value, with its key; without counts of causes and kinds that do not occur."""
    rows = [
        (f"<code>{escape(metric.key)}</code>", _value(metric), _unit(metric), DIRECTION_MARKS[metric.direction])
        for metric in metrics
        if math.isfinite(metric.value) and not (metric.value == 0 and PARTS.search(metric.key))
    ]
    return html_table(("key", "value", "unit", "better"), rows)


def _is_object_key(key: str, method: str, suffix: str) -> bool:
    return key.startswith(f"{method}.mapping.") and key.endswith(suffix)


def _value(metric: Metric | None) -> str:
    """Three significant digits, integers without decimals, a dash where there is no value."""
    if metric is None or not math.isfinite(metric.value):
        return "–"
    value = metric.value
    digits = 0 if value == 0 else max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:.{min(digits, 5)}f}"
    if value == round(value) and abs(value) < 1e6:
        text = f"{value:.0f}"
    elif abs(value) < 1e-4:
        text = f"{value:.1e}"
    return text.replace("-", "\N{MINUS SIGN}") if value < 0 else text


def _unit(metric: Metric | None) -> str:
    return "" if metric is None or metric.unit == "1" else explained(metric.unit)
