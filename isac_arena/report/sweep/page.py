"""The report of a sweep as one self-contained HTML page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from string import Template

import numpy as np
from matplotlib.figure import Figure

from isac_arena.report.page.tables import score_title
from isac_arena.report.style import figure_html, html_table, png_bytes
from isac_arena.report.sweep.results import (
    LEAST_CASES,
    Group,
    SweepResults,
    cases_text,
    groups,
    interval_ends,
    mean_interval,
)
from isac_arena.scoring.metrics.metric import is_share
from isac_arena.scoring.words import explained

MARK = "⚠"  # of scores of SLAM with cases whose poses are doubtful
STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #222; background: #fff;
  max-width: 74rem; margin: 0 auto; padding: 1.5rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; margin: 0 0 .4rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-bottom: .2rem; border-bottom: 2px solid #0072b2; }
h3 { font-size: 1rem; margin: 1.4rem 0 .2rem; }
p { max-width: 50rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: .4rem 0 1.2rem; font-variant-numeric: tabular-nums; }
th, td { padding: .22rem .9rem .22rem 0; border-bottom: 1px solid #e3e3e3; text-align: right;
  vertical-align: top; }
th:first-child, td:first-child { text-align: left; }
th { font-weight: 600; border-bottom: 1.5px solid #999; font-size: .82rem; }
.facts td { text-align: left; }
.failed th, .failed td { text-align: left; }
.failed td { font-size: .85rem; }
figure { margin: 1rem 0 1.8rem; break-inside: avoid; }
figure img { width: 100%; height: auto; display: block; }
h2, h3 { break-after: avoid; }
table, tr { break-inside: avoid; }
figcaption { font-size: .87rem; color: #444; max-width: 52rem; margin-top: .3rem; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } }
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>$style</style>
</head>
<body>
<h1>$title</h1>
<div class="facts">$facts</div>
$sections
</body>
</html>
"""


@dataclass(frozen=True)
class SweepFigure:
    """A figure of the page with its caption."""

    title: str
    figure: Figure
    caption: str


def render_sweep(
    title: str, facts: Mapping[str, str], sections: Sequence[tuple[str, Sequence[SweepFigure | str]]]
) -> str:
    """The page: `facts` (label to text) first, then sections of figures and of HTML tables."""
    parts = []
    for heading, items in sections:
        parts.append(f"<h2>{escape(heading)}</h2>")
        parts += [
            figure_html(item.title, png_bytes(item.figure), item.figure, item.caption)
            if isinstance(item, SweepFigure)
            else item
            for item in items
        ]
    return Template(PAGE).substitute(
        title=escape(title),
        style=STYLE,
        facts=html_table(
            [], [[escape(label), escape(text).replace("\n", "<br>")] for label, text in facts.items()]
        ),
        sections="\n".join(parts),
    )


def axis_tables(results: SweepResults, keys: Sequence[str]) -> list[str]:
    """One HTML table per axis: the mean of every metric at each of its values, with its 95 % interval or range."""
    made = []
    for axis in results.axes:
        head = [axis.name, "cases", *(_heading(results, key) for key in keys)]
        rows = []
        for group in groups(axis):
            cells = [_interval(results, key, group) for key in keys]
            rows.append([group.label, cases_text(results, group.members), *cells])
        made.append(f'<h3>{escape(axis.name)}</h3><div class="wide">{table(head, rows)}</div>')
    about = [
        "±, or in brackets for shares, which lie between 0 and 1: the 95 % interval of the mean (Student's t). "
        "After a semicolon: the least and the largest case, where cases are few or the interval says less."
    ]
    if any(len(np.unique(results.point[one.members])) > 1 for axis in results.axes for one in groups(axis)):
        about.append(
            "Cases of several points, which differ in the other axes, are pooled: the interval of their mean has "
            "the spread over these points too, not that over seeds alone."
        )
    if results.is_doubtful.any():
        about.append(
            f"{MARK}: at scores of SLAM, some of the cases are doubtful, in position, heading or clock; see above."
        )
    return [*made, *(f"<p>{sentence}</p>" for sentence in about)]


def table(head: Sequence[str], rows: Sequence[Sequence[str]], style: str = "") -> str:
    """An HTML table of texts, in the given CSS class."""
    return html_table([*map(explained, head)], [[*map(escape, row)] for row in rows], style)


def _heading(results: SweepResults, key: str) -> str:
    metric = results.metrics[key]
    unit = "" if metric.unit == "1" else f" ({metric.unit})"
    return f"{score_title(key)}{unit} {dict(lower='↓', higher='↑').get(metric.direction, '')}".strip()


def _interval(results: SweepResults, key: str, group: Group) -> str:
    """The mean of a group with its interval, or the range of its cases where that says more.

    A mark tells that the poses of a case are far off.
    """
    known = results.metrics[key].value[group.members]
    mean, half, n = mean_interval(known)
    mark = f" {MARK}" if key.startswith("slam.") and results.is_doubtful[group.members].any() else ""
    if n == 0:
        return f"–{mark}"
    if n < LEAST_CASES or (np.nanmin(known) >= 0 and half >= mean):  # then the interval holds what cannot be
        cases = f"; {np.nanmin(known):.3g} to {np.nanmax(known):.3g}" if n > 1 else ""
        return f"{mean:.3g}{cases}{mark}"
    if is_share(key):
        low, high = interval_ends(key, known)
        return f"{mean:.3g} ({low:.3g} to {high:.3g}){mark}"
    return f"{mean:.3g} ± {half:.2g}{mark}"
