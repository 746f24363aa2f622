"""The first table of a run: its main scores beside the paper's method and the bound."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.slam.record import SolveStatus
from isac_arena.progress import counted, listed
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import rms
from isac_arena.scoring.record import PoseScores

FEW = 4  # stops, of which one may well make most of a mean square
MOST = 0.5
ENOUGH = "3 single bounces or more"  # `maps.FOUND_POINTS`: fewer do not let an object be found
FOUND_POINTS = 3
IOU_COUNT = "iou.count"
HEADS = ("published", "this run", "bound", "unit")


@dataclass(frozen=True)
class HeadlineRow:
    """A score of this run, and the keys of the same by the paper's method, of its bound, and of the whole count.

    Empty for none. `of` and `kind` name the map and the objects that a mean is over, `count` the score that has
    their number. A row that `may_lack` is left out where nothing has a value.
    """

    label: str
    key: str
    paper: str = ""
    bound: str = ""
    whole: str = ""
    of: str = ""
    kind: str = ""
    count: str = "count"
    may_lack: bool = False


def _pose_row(name: str, field: str, unit: str) -> HeadlineRow:
    label, key = f"Receiver {name} by SLAM, RMSE", f"{field}.rmse_{unit}"
    return HeadlineRow(label, f"slam.{key}", f"published.{key}", f"slam.{field}.bound_{unit}")


def _found_row(kind: str) -> HeadlineRow:
    key = f"mapping.objects_found.{kind}"
    whole = f"scene.visible.{kind}"
    return HeadlineRow(f"{kind.capitalize()}s found by mapping", f"contours.{key}", key, whole=whole)


def _contour_row(label: str, of: str, kind: str, score: str) -> HeadlineRow:
    key, count = f"{of}.{kind}.{score}", IOU_COUNT if score.startswith("iou") else "count"
    return HeadlineRow(label, f"contours.{key}", f"shapes.{key}", of=of, kind=kind, count=count)


HEADLINE = (
    HeadlineRow("Separable paths detected, share", "channel.detection_rate"),
    HeadlineRow("False paths per stop", "channel.false_per_stop"),
    HeadlineRow("Detected paths inside their 95 % regions, share", "channel.coverage95"),
    HeadlineRow("Stops located by SLAM, share", "slam.solved_share", "published.solved_share"),
    _pose_row("position in plan", "position", "m"),
    HeadlineRow(
        "Receiver position in plan by SLAM, median",
        "slam.position.median_m",
        "published.position.median_m",
        "slam.position.bound_median_m",
    ),
    HeadlineRow("Receiver position in plan by SLAM, stated deviation", "slam.position.stated_m"),
    HeadlineRow("Receiver height by SLAM, RMSE", "slam.height.rmse_m", may_lack=True),
    _pose_row("heading", "heading", "deg"),
    _pose_row("clock bias", "clock", "ns"),
    HeadlineRow("Incidence point to surface, mapping, median", "mapping.ip_to_surface.median_m"),
    HeadlineRow("Incidence point to surface, mapping, RMS", "mapping.ip_to_surface.rms_m"),
    HeadlineRow("Incidence point to surface, SLAM, median", "slam.ip_to_surface.median_m"),
    HeadlineRow("Incidence point to surface, SLAM, RMS", "slam.ip_to_surface.rms_m"),
    _found_row("pillar"),
    _found_row("wall"),
    _contour_row("Pillars, seen part, mapping, RMSE", "mapping", "pillar", "seen_rmse.mean_m"),
    _contour_row("Walls, seen part, mapping, RMSE", "mapping", "wall", "seen_rmse.mean_m"),
    HeadlineRow("Contours of the right class, mapping, share", "contours.mapping.class_accuracy"),
    HeadlineRow("False contours, mapping", "contours.mapping.false"),
    HeadlineRow("False contours, SLAM", "contours.slam.false"),
    _contour_row("Pillars, overlap (IoU), mapping", "mapping", "pillar", "iou.mean"),
    _contour_row("Pillars, overlap (IoU), SLAM", "slam", "pillar", "iou.mean"),
    HeadlineRow("Movers in view that are tracked, share", "tracks.found_share"),
    HeadlineRow("Tracks and movers in view, mean GOSPA", "tracks.gospa.mean_m"),
    HeadlineRow("Velocity of tracks, RMSE", "tracks.velocity.rmse_m_s", bound="tracks.velocity.bound_m_s"),
)


def headline(metrics: Sequence[Metric]) -> Iterator[tuple[str, list[Metric | None], str]]:
    """Label, scores (the paper's, of this run, the bound) and unit of every row that the scene has."""
    known = {metric.key: metric for metric in metrics}
    for row in HEADLINE:
        if row.key not in known:  # of a stage that did not run
            continue
        cells = [known.get(key) for key in (row.paper, row.key, row.bound)]
        if row.may_lack and not any(math.isfinite(cell.value) for cell in cells if cell):
            continue
        if (present := next(filter(None, cells), None)) is not None:
            unit = "" if present.unit == "1" else present.unit
            if row.whole in known and math.isfinite(known[row.whole].value):
                unit = f"of {known[row.whole].value:g} that {ENOUGH} meet"
            yield row.label, cells, ", ".join(filter(None, [unit, _members(row, known)]))


def headline_text(metrics: Sequence[Metric]) -> str:
    """The table as text of fixed width."""
    rows: list[tuple[str, ...]] = [("", *HEADS)]
    for label, cells, unit in headline(metrics):
        rows.append((label, *(score_text(cell) for cell in cells), unit))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (
        "  ".join([label.ljust(widths[0]), *map(str.rjust, cells, widths[1:-1]), unit])
        for label, *cells, unit in rows
    )
    return "\n".join(line.rstrip() for line in lines)


def score_text(score: Metric | None) -> str:
    """A score in three digits; a dash where there is none."""
    return f"{score.value:.3g}" if score and math.isfinite(score.value) else "-"


def _members(row: HeadlineRow, known: Mapping[str, Metric]) -> str:
    """How many objects a mean is over; empty for other rows."""
    mean_over = f"{row.of}.{row.kind}.{row.count}"
    keys = f"contours.{mean_over}", f"shapes.{mean_over}"
    ours, published = (known[key].value if key in known else math.nan for key in keys)
    if not ours > 0:
        return ""
    contour = "closed contour" if row.count == IOU_COUNT else "contour"
    other = f" (published: {published:g})" if math.isfinite(published) and published != ours else ""
    seldom = listed(_seldom_met(row, known))
    met = f"; {seldom} of these: fewer than {FOUND_POINTS} single bounces meet it" if seldom else ""
    return f"mean over {counted(int(ours), row.kind)} with a {contour}{other}{met}"


def _seldom_met(row: HeadlineRow, known: Mapping[str, Metric]) -> Iterator[str]:
    """The objects of a mean that too few single bounces meet to be found."""
    before, score = f"scene.single_bounces.{row.kind}.", "iou" if row.count == IOU_COUNT else "hausdorff_m"
    for key, metric in known.items():
        name = key.removeprefix(before)
        shown = known.get(f"contours.{row.of}.{name}.{score}")
        if key.startswith(before) and metric.value < FOUND_POINTS and shown and math.isfinite(shown.value):
            yield name


def bound_note(poses: PoseScores) -> str:
    """What must be known to compare errors of poses with their bounds; empty where nothing is."""
    poses = poses.take("stop", poses.status != SolveStatus.GIVEN)
    return "; ".join(filter(None, [_unbounded_note(poses), _large_bound_note(poses)]))


def _large_bound_note(poses: PoseScores) -> str:
    """The stop that makes most of the mean square of the bounds; empty where none does, and of few stops."""
    known = np.isfinite(poses.position_bound_m)
    square, stops = np.square(poses.position_bound_m[known]), poses.stop[known]
    if len(stops) < FEW or not square.max() > MOST * square.sum():
        return ""
    share = square.max() / square.sum()
    stop = stops[square.argmax()]
    return f"bound: stop {stop} makes {share:.0%} of its mean square; the medians tell the usual stop"


def _unbounded_note(poses: PoseScores) -> str:
    """What the RMSE of poses is over the stops that have a bound, which that of the bound counts alone.

    Empty where all stops have one, or none.
    """
    known = np.isfinite(poses.position_bound_m)
    missing = poses.stop[np.isinf(poses.position_bound_m)].tolist()
    error_m, heading_deg = rms(poses.position_error_m[known]), np.rad2deg(rms(poses.heading_error_rad[known]))
    clock_ns = 1e9 * rms(poses.clock_error_s[known])
    if not (missing and math.isfinite(error_m)):
        return ""
    without = f"without one: stop {listed(missing)} ({len(missing)} of {len(poses.stop)} stops)"
    errors = f"{error_m:.3g} m, {heading_deg:.3g} deg, {clock_ns:.3g} ns"
    return f"bound: {without}; RMSE of this run over the others: {errors}"
