"""Comparison of two runs: paired differences with their intervals."""

import math
from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from isac_arena.insight.comparison.difference import PairedDifference
from isac_arena.insight.comparison.names import group_of, name_of
from isac_arena.report.style import ESTIMATE, GHOST, SLAM, TRUTH, legend_below, new_figure, styled

MOST_SHOWN_PERCENT = 150.0
MOST_PERCENT = 1000.0  # larger changes are told as factors
VERDICTS: dict[str, dict[str, Any]] = {
    "better": {"color": ESTIMATE, "marker": "o"},
    "worse": {"color": SLAM, "marker": "s"},
    "different": {"color": "#CC79A7", "marker": "D"},
    "undecided": {"color": GHOST, "marker": "o"},
    "same": {"color": TRUTH, "marker": "o", "markerfacecolor": "white", "markeredgewidth": 1.4},
    "too few": {"color": GHOST, "marker": "X"},
}
MEANING = {"undecided": "undecided: the interval holds 0, or the test does not reject"}
CLIPPED: dict[str, Any] = {"marker": ">", "color": "0.25", "markersize": 5, "linestyle": "none"}


@styled()
def compare_figure(differences: Sequence[PairedDifference], first: str, second: str) -> Figure:
    """Mean difference of every quantity in percent of the first run's mean, with its 95 % interval.

    An interval that exceeds the axis ends in an arrow, and the text gives its limits. Quantities with mean zero
    in the first run have no percentage and are drawn at zero. Quantities without a pair have no row.
    """
    differences = [one for one in differences if one.n_pairs]
    figure = new_figure(9.8, 1.6 + 0.24 * max(len(differences), 1))
    ax = figure.subplots()
    spans = [_percent(one) for one in differences]
    ends = [min(abs(value), MOST_SHOWN_PERCENT) for span in spans for value in span if math.isfinite(value)]
    limit = 1.05 * max([10.0, *ends])
    is_clipped = False
    for row, (one, span) in enumerate(zip(reversed(differences), reversed(spans), strict=True)):
        is_clipped |= _draw_row(ax, row, one, span, limit)
        ax.annotate(
            _text(one, span, limit), (1.025, row), xycoords=("axes fraction", "data"),
            fontsize=7, va="center",
        )  # fmt: skip
    ax.axvline(0, color="0.3", linewidth=0.9, zorder=0)
    ax.set_yticks(range(len(differences)), [_label(one) for one in reversed(differences)], fontsize=7.5)
    ax.set(xlim=(-limit, limit), ylim=(-0.7, len(differences) - 0.3))
    ax.set_xlabel(f"{second} minus {first}, in % of {first}")
    ax.set_title(f"{second} against {first}, 95 % intervals")
    seen = {one.verdict for one in differences}
    handles = [
        Line2D([], [], linestyle="none", markersize=6, label=MEANING.get(verdict, verdict), **look)
        for verdict, look in VERDICTS.items() if verdict in seen
    ]  # fmt: skip
    if is_clipped:
        handles.append(Line2D([], [], label="exceeds the axis", **CLIPPED))
    legend_below(figure, handles, 7)
    return figure


def _draw_row(ax: Any, row: int, one: PairedDifference, span: tuple[float, ...], limit: float) -> bool:
    """Draw interval and mean of one quantity; returns whether they exceed the axis."""
    look = VERDICTS[one.verdict]
    place, *ends = (max(-limit, min(limit, value)) if math.isfinite(value) else math.nan for value in span)
    ax.plot(ends, [row, row], color=look["color"], linewidth=2.0)
    beyond = {math.copysign(limit, value) for value in span if math.isfinite(value) and abs(value) > limit}
    for end in beyond:
        marker = ">" if end > 0 else "<"
        ax.plot(end, row, **{**CLIPPED, "marker": marker, "color": look["color"]}, clip_on=False, zorder=6)
    if abs(place) != limit:
        at = place if math.isfinite(place) else 0.0
        ax.plot(at, row, markersize=6, zorder=5, **look)
    return bool(beyond)


def _percent(one: PairedDifference) -> tuple[float, ...]:
    """Difference and limits of its interval in % of the first run's mean, NaN where there are none.

    All quantities are 0 or more, so they fall by 100 % at most, also where a bootstrap draws more.
    """
    scale = 100 / abs(one.first) if one.first else math.nan
    return tuple(max(scale * value, -100.0) for value in (one.difference, one.low, one.high))


def _text(one: PairedDifference, span: tuple[float, ...], limit: float) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    counts = "" if one.n_first == one.n_second == one.n_pairs else f" of {one.n_first} and {one.n_second}"
    text = f"{one.first:.3g} to {one.second:.3g}{unit}, n = {one.n_pairs}{counts}"
    if any(abs(value) > limit for value in span):
        shown = [value for value in span[1:] if math.isfinite(value)] or [span[0]]
        text += f"; {_changes(shown)}"
    return text.replace("-", "\N{MINUS SIGN}")


def _changes(percents: Sequence[float]) -> str:
    """One change, or both ends of an interval, in one unit: factors where all are large."""
    if min(map(abs, percents)) >= MOST_PERCENT:
        return " to ".join(f"{one / 100:+,.0f} times" for one in percents)
    return " to ".join(f"{one:+,.0f} %" for one in percents)


def _label(one: PairedDifference) -> str:
    wanted = {"lower": " (less is better)", "higher": " (more is better)", "info": ""}[one.direction]
    return f"{group_of(one.key)}: {name_of(one.key)}{wanted}"
