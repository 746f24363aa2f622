"""Figures of a sweep: a metric over each axis, trade-offs between two metrics, and parallel coordinates."""

from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, ScalarFormatter

from isac_arena.report.page.tables import score_title
from isac_arena.report.style import BAND_ALPHA, CLUSTER_COLORS, ESTIMATE, GHOST, TRUTH, new_figure, styled
from isac_arena.report.sweep.results import (
    LEAST_CASES,
    Group,
    SweepAxis,
    SweepMetric,
    SweepResults,
    groups,
    interval_ends,
    mean_interval,
    nondominated,
    point_means,
)
from scenes.record import BoolArray, FloatArray, IntArray

MOST_LINES = 5  # with two axes, each value of the other axis has its own line up to this number of values
LONGEST_LABEL = 24
LETTERS_A_LINE = 30
LETTERS_AN_INCH = 16  # of the smallest letters
DECADES_FOR_LOG = 1.5
WIDTH_IN = 10.0  # the page stretches it to its own width
MARGIN, LOG_MARGIN = 0.15, 1.5  # of the vertical axis around the values: a share of their range, a factor
MOST_TICKS = 7
FLOOR = 1e-3  # of the least value: intervals end there, so that a logarithmic axis shows them
MOST_LABELS = 8  # of a front
MOST_TOGETHER = 4  # points whose labels stand at one place
ONE_PLACE = 0.005  # of the range of all points: nearer dots lie on each other
LINE_COLORS = CLUSTER_COLORS
DOUBT = "#C0142B"
PALEST = 0.15  # of the colour map: lighter lines are invisible on white
LABEL_BOX = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}


@styled()
def axis_figure(results: SweepResults, key: str) -> Figure:
    """Mean of a metric over every axis, and its bound if it has one.

    Means of `LEAST_CASES` cases and more have their 95 % interval; of fewer, the cases themselves are drawn.

    There is one panel for each axis. With two axes, each value of the other axis has its own line if there are few
    values. Otherwise the mean is over all values of the other axes. Numeric axes with many values are averaged in
    bins of equal counts.
    """
    metric, bound = results.metrics[key], results.bound(key)
    axes = results.axes
    figure = new_figure(WIDTH_IN, 4.0)
    panels = figure.subplots(1, max(len(axes), 1), squeeze=False, sharey=True)[0]
    for panel, axis in zip(panels, axes, strict=False):
        lines = axis_lines(results, axis)
        for (label, members), color in zip(lines, LINE_COLORS, strict=False):
            _curve(panel, axis, metric, members, color, label)
            if bound is not None:
                _bound_curve(panel, groups(axis), bound, members, color if label else TRUTH)
        if bound is not None:
            panel.get_lines()[-1].set_label("bound, mean")
        is_marked = key.startswith("slam.") and bool(results.is_doubtful.any())
        if is_marked:
            _doubtful_cases(panel, results, axis, metric.value)
        _dress(panel, axis)
        if any(label for label, _ in lines) or bound is not None or is_marked:
            panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)
    _scale(panels[0], drawn_values(results, key))
    panels[0].set_ylabel(_label(metric))
    return figure


@styled()
def pareto_figure(results: SweepResults, first: str, second: str) -> Figure:
    """Two metrics against each other: the mean of every design point, and the points that no other one beats."""
    figure = new_figure(WIDTH_IN, 4.4)
    panel = figure.subplots()
    means = np.column_stack([point_means(results, key) for key in (first, second)])
    front = front_of(results, first, second)
    panel.plot(*means[~front].T, "o", color=GHOST, markersize=4, label="another point is better in both")
    order = np.flatnonzero(front)[np.argsort(means[front][:, 0])]
    panel.plot(*means[order].T, "o-", color=ESTIMATE, markersize=6, label="no other point is better in both")
    known = means[np.isfinite(means).all(axis=1)]
    together = coinciding(means[order], np.ptp(known, axis=0) if len(known) else np.ones(2))
    for members in together[:: max(1, len(together) // MOST_LABELS)]:
        panel.annotate(
            _labels(results, order[members]), means[order[members[0]]], xytext=(6, 5), textcoords="offset points",
            fontsize=7, bbox=LABEL_BOX,
        )  # fmt: skip
    for key, name in ((first, "x"), (second, "y")):
        getattr(panel, f"set_{name}label")(_label(results.metrics[key]))
    panel.margins(0.12)
    panel.legend()
    return figure


def coinciding(points: FloatArray, span: FloatArray) -> list[IntArray]:
    """Rows (member,) of points (point, axis) that a figure shows at one place, in the order of the first of each.

    `span` (axis,) is the range that the figure shows.
    """
    places = np.rint(points / np.where(span > 0, span, 1.0) / ONE_PLACE)
    _, first, place = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return [np.flatnonzero(place.ravel() == one) for one in np.argsort(first)]


def front_of(results: SweepResults, first: str, second: str) -> BoolArray:
    """Mask (point,) of the design points that no other point dominates in the two metrics."""
    sign = {"lower": 1.0, "higher": -1.0, "info": 1.0}
    costs = [sign[results.metrics[key].direction] * point_means(results, key) for key in (first, second)]
    return nondominated(np.column_stack(costs))


@styled()
def parallel_figure(results: SweepResults, keys: Sequence[str]) -> Figure:
    """Parallel coordinates: one line per design point through its axis values and its mean metrics.

    The lines are coloured by the first metric.
    """
    columns = [_axis_column(results, axis) for axis in results.axes]
    columns += [(_label(results.metrics[key]), point_means(results, key), None) for key in keys]
    ends = [_ends(values, labels) for _, values, labels in columns]
    for at, axis in enumerate(results.axes):
        if axis.is_numeric and axis.is_log:
            ends[at] = [(height, f"{10 ** float(text):.3g}") for height, text in ends[at]]
    figure = new_figure(WIDTH_IN, 4.2)
    panel = figure.subplots()
    colour = point_means(results, keys[0])
    known = colour[np.isfinite(colour)]
    scale = Normalize(float(known.min()), float(known.max()))
    heights = np.column_stack([_unit_interval(values) for _, values, _ in columns])
    for height, value in zip(heights, colour, strict=True):
        look = colormaps["viridis_r"](PALEST + (1 - PALEST) * scale(value)) if np.isfinite(value) else "0.8"
        panel.plot(np.arange(len(columns)), height, color=look, linewidth=1.1, alpha=0.8)
    for at, texts in enumerate(ends):
        panel.axvline(at, color="0.3", linewidth=0.9)
        for height, text in texts:
            panel.annotate(
                text, (at, height), xytext=(3, 0), textcoords="offset points", fontsize=7, va="center",
                bbox=LABEL_BOX,
            )  # fmt: skip
    letters = min(LETTERS_A_LINE, int(LETTERS_AN_INCH * WIDTH_IN / len(columns)))
    panel.set_xticks(np.arange(len(columns)), [_wrapped(label, letters) for label, _, _ in columns], fontsize=7)
    panel.set_yticks([])
    panel.grid(visible=False)
    panel.set_ylim(-0.06, 1.06)
    panel.set_xlim(-0.1, len(columns) - 0.5)
    for side in ("left", "bottom"):
        panel.spines[side].set_visible(False)
    return figure


def axis_lines(results: SweepResults, axis: SweepAxis) -> list[tuple[str, BoolArray]]:
    """Name and cases (case,) of every line in the panel of an axis; one line for all cases has no name."""
    everyone = [("", np.ones(len(results.point), bool))]
    others = [other for other in results.axes if other is not axis]
    if len(others) != 1:
        return everyone
    parts = groups(others[0])
    distinct = len({str(value) for value in others[0].values})
    if not 1 < len(parts) <= MOST_LINES or distinct > MOST_LINES:
        return everyone
    return [(f"{others[0].name}: {part.label}", part.members) for part in parts]


def _curve(panel: Any, axis: SweepAxis, metric: SweepMetric, members: BoolArray, color: str, label: str) -> None:
    """Draw the means of the groups of an axis with intervals: a line with a band, or bars for an axis of texts."""
    value = metric.value
    cases_of = [(part.place, value[part.members & members]) for part in groups(axis)]
    rows = np.array(
        [(place, *mean_interval(cases)[::2], *interval_ends(metric.key, cases)) for place, cases in cases_of]
    )
    place, mean, count, lower, upper = rows[np.isfinite(rows[:, 1])].T
    lower, upper = (np.where(count >= LEAST_CASES, end, np.nan) for end in (lower, upper))
    for at, cases in cases_of:
        if 1 < np.isfinite(cases).sum() < LEAST_CASES:
            panel.plot(np.full(len(cases), at), cases, "x", color=color, markersize=4, alpha=0.7)
    known = value[np.isfinite(value)]
    if len(known) and known.min() >= 0:
        lower = np.maximum(lower, FLOOR * known.min())
    if not axis.is_numeric:
        bars = np.stack([mean - lower, upper - mean])
        panel.errorbar(place, mean, bars, fmt="o", color=color, capsize=3, label=label or None)
        return
    panel.plot(place, mean, "o-", color=color, markersize=4, label=label or None)
    panel.fill_between(place, lower, upper, color=color, alpha=BAND_ALPHA, linewidth=0)


def _doubtful_cases(panel: Any, results: SweepResults, axis: SweepAxis, value: FloatArray) -> None:
    """Ring the cases whose poses are far off."""
    for at, part in enumerate(groups(axis)):
        cases = value[part.members & results.is_doubtful]
        label = None if at else "SLAM doubtful"
        look = {"color": DOUBT, "markerfacecolor": "none", "markersize": 9, "markeredgewidth": 1.4, "label": label}
        panel.plot(np.full(len(cases), part.place), cases, "o", **look)


def _bound_curve(panel: Any, parts: Sequence[Group], bound: FloatArray, members: BoolArray, color: str) -> None:
    mean = np.array([mean_interval(bound[part.members & members])[0] for part in parts])
    place = np.array([part.place for part in parts])
    known = np.isfinite(mean)
    panel.plot(place[known], mean[known], "--", color=color, linewidth=1.2)


def drawn_values(results: SweepResults, key: str) -> FloatArray:
    """All means (dot,) that the panels of a metric show, those of its bound, and cases of which there are few."""
    value, bound = results.metrics[key].value, results.bound(key)
    drawn = [
        part.members & members
        for axis in results.axes
        for _, members in axis_lines(results, axis)
        for part in groups(axis)
    ]
    dots = [value[cases] for cases in drawn]
    means = [mean_interval(cases)[0] for cases in dots]
    means += [one for cases in dots if 1 < np.isfinite(cases).sum() < LEAST_CASES for one in cases]
    if key.startswith("slam."):
        means += value[results.is_doubtful].tolist()
    if bound is not None:
        means += [mean_interval(bound[cases])[0] for cases in drawn]
    known = np.array(means, float)
    return np.asarray(known[np.isfinite(known)])


def _scale(panel: Any, means: FloatArray) -> None:
    """Set limits around the means, not the intervals, because intervals of few repeats would fill the figure."""
    if not len(means) or means.min() == means.max():
        return
    low, high = float(means.min()), float(means.max())
    if low > 0 and np.log10(high / low) > DECADES_FOR_LOG:
        panel.set_yscale("log")
        panel.set_ylim(low / LOG_MARGIN, high * LOG_MARGIN)
    else:
        margin = MARGIN * (high - low)
        panel.set_ylim(max(low - margin, -0.02 * high) if low >= 0 else low - margin, high + margin)


def _dress(panel: Any, axis: SweepAxis) -> None:
    panel.set_xlabel(axis.name)
    parts = groups(axis)
    places = [part.place for part in parts]
    if not axis.is_numeric:
        panel.set_xticks(places, [_short(part.label) for part in parts], rotation=20, ha="right")
        panel.margins(x=0.25)
        return
    if axis.is_log:
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter(ScalarFormatter())
        panel.xaxis.set_minor_formatter(NullFormatter())
    if len(places) <= MOST_TICKS and len(set(axis.values)) == len(places):
        panel.set_xticks(places, [part.label for part in parts])
        panel.xaxis.set_minor_locator(NullLocator())
    elif not axis.is_log:
        panel.xaxis.set_major_locator(MaxNLocator(6))


def _axis_column(results: SweepResults, axis: SweepAxis) -> tuple[str, FloatArray, list[str] | None]:
    """Name of an axis, position of every design point, and for an axis of texts the texts at the positions."""
    first = [int(np.flatnonzero(results.point == point)[0]) for point in np.unique(results.point)]
    if axis.is_numeric:
        numbers = np.array([axis.values[index] for index in first], float)
        return axis.name, np.log10(numbers) if axis.is_log else numbers, None
    labels = [part.label for part in groups(axis)]
    return axis.name, np.array([labels.index(str(axis.values[index])) for index in first], float), labels


def _unit_interval(values: FloatArray) -> FloatArray:
    known = values[np.isfinite(values)]
    if not len(known) or np.ptp(known) == 0:
        return np.where(np.isfinite(values), 0.5, np.nan)
    return np.asarray((values - known.min()) / np.ptp(known))


def _ends(values: FloatArray, labels: list[str] | None) -> list[tuple[float, str]]:
    """Heights and labels along a coordinate: its ends, or all texts of an axis of texts."""
    if labels is not None:
        places = np.arange(len(labels)) / max(1, len(labels) - 1) if len(labels) > 1 else np.array([0.5])
        return [(float(place), _short(label)) for place, label in zip(places, labels, strict=True)]
    known = values[np.isfinite(values)]
    if not len(known):
        return []
    if np.ptp(known) == 0:
        return [(0.5, f"{known[0]:.3g}")]
    return [(0.0, f"{known.min():.3g}"), (1.0, f"{known.max():.3g}")]


def _values_at(results: SweepResults, index: int) -> str:
    """The axis values of a design point, by its row among the points."""
    case = int(np.flatnonzero(results.point == np.unique(results.point)[index])[0])
    shown = [axis.values[case] for axis in results.axes]
    return ", ".join(f"{value:.3g}" if isinstance(value, float) else _short(str(value)) for value in shown)


def _labels(results: SweepResults, points: IntArray) -> str:
    """The labels of design points at one place, a line each; of many the first ones and how many more."""
    more = [f"and {len(points) - MOST_TOGETHER} more"] if len(points) > MOST_TOGETHER else []
    return "\n".join([*(_values_at(results, index) for index in points[:MOST_TOGETHER].tolist()), *more])


def _label(metric: SweepMetric) -> str:
    unit = "" if metric.unit == "1" else f" in\N{NO-BREAK SPACE}{metric.unit}"
    return _wrapped(f"{score_title(metric.key)}{unit}")


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_LABEL else "…" + text[-LONGEST_LABEL + 1 :]


def _wrapped(label: str, letters: int = LETTERS_A_LINE) -> str:
    return "\n".join(wrap(label.replace("\n", " "), letters))
