"""The error budget as waterfalls: from all of an error down to what is left, part by part."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from estimation.budget.attribution import Attribution, root
from estimation.budget.record import OUTCOMES, REST, TOTAL, Budget
from estimation.report.style import ESTIMATE, GHOST, TRUTH, legend_below, new_figure, styled

WORSE = "#E69F00"
ROW_IN, MARGIN_IN, WIDTH_IN = 0.36, 0.85, 5.9
TITLES = {"pose": "Receiver position", "shape": "The paper's contours", "contour": "Our contours"}
KINDS = {"stages": "truth in place of a stage", "physics": "physics switched off"}
RESTS = {"stages": "all by truth", "physics": "the estimators alone"}
WIDEST = (-60.0, 160.0)  # % of the mean square to which whiskers are shown; bars are shown whole


@dataclass(frozen=True)
class _Bar:
    """One row: a bar from `start` to `end`, its interval, all in % of the whole, and what is said of it."""

    name: str
    start: float
    end: float
    interval: tuple[float, float]
    color: str
    text: str


@styled
def budget_figure(budget: Budget) -> Figure:
    """A waterfall per outcome and kind of budget, in shares of the mean square error.

    Bars run from the whole error at the top down to the rest. Whiskers are 95 % intervals over stops or objects
    and over the order of the parts, drawn about the end that moves. The text gives share, interval and the root of
    the part's mean square.
    """
    outcomes = [name for name in TITLES if any(key[0] == name for key in budget.attribution)]
    kinds = [name for name in KINDS if any(key[1] == name for key in budget.attribution)]
    bars = {key: list(_bars(found, key[1])) for key, found in budget.attribution.items()}
    rows = [max(len(bars[outcome, kind]) for kind in kinds) for outcome in outcomes]
    height = ROW_IN * sum(rows) + MARGIN_IN * len(outcomes) + 0.3
    figure = new_figure(WIDTH_IN * len(kinds), height)
    ratios = [ROW_IN * count + MARGIN_IN for count in rows]
    grid = figure.subplots(len(outcomes), len(kinds), squeeze=False, height_ratios=ratios)
    for line, outcome, count in zip(grid, outcomes, rows, strict=True):
        for ax, kind in zip(line, kinds, strict=True):
            _draw(ax, bars[outcome, kind], count)
            ax.set_title(f"{TITLES[outcome]}, {KINDS[kind]}", loc="left")
            ax.set_xlabel(f"% of the mean square error over the {OUTCOMES[outcome][1]}s")
    figure.suptitle(_title(budget), x=0.01, ha="left", fontsize=9, color="0.35")
    colors = {
        "all errors": TRUTH,
        "without this part it falls": ESTIMATE,
        "it grows": WORSE,
        "what is left": GHOST,
    }
    legend_below(figure, [Patch(color=color, label=label) for label, color in colors.items()], len(colors))
    return figure


def _bars(found: Attribution, kind: str) -> Iterator[_Bar]:
    """The rows from all errors to the rest; parts that cannot matter, downstream of the error, are left out."""
    scale = 100 / found.total if found.total else 0.0
    spread = (scale * found.total_low, scale * found.total_high)
    yield _Bar(TOTAL, 0.0, scale * found.total, spread, TRUTH, _metres(found.total))
    level = scale * found.total
    for index, part in enumerate(found.part):
        share, low, high = scale * found.contribution[index], 100 * found.low[index], 100 * found.high[index]
        if share == 0 and not (low < 0 or high > 0):
            continue
        end = level - share
        text = f"{_percent(share, low, high)}   {_metres(found.contribution[index])}"
        color = ESTIMATE if share >= 0 else WORSE
        yield _Bar(str(part), level, end, (level - high, level - low), color, text)
        level = end
    rest = scale * found.rest
    span = (100 * found.rest_low, 100 * found.rest_high)
    name = f"{REST}: {RESTS[kind]}"
    yield _Bar(name, 0.0, rest, span, GHOST, f"{_percent(rest, *span)}   {_metres(found.rest)}")


def _draw(ax: Any, bars: list[_Bar], n_rows: int) -> None:
    ends = np.array([[bar.start, bar.end] for bar in bars])
    whiskers = np.clip([bar.interval for bar in bars[1:]], *WIDEST)
    low = min(float(ends.min()), float(np.nanmin(whiskers, initial=0.0)))
    high = max(float(ends.max()), float(np.nanmax(whiskers, initial=0.0)), 1.0)
    limits = low - 0.03 * (high - low), high + 0.03 * (high - low)
    for row, bar in enumerate(bars):
        left, right = sorted((bar.start, bar.end))
        ax.barh(row, right - left, left=left, height=0.62, color=bar.color)
        if row and np.isfinite(bar.interval).all():
            _whisker(ax, row, bar.interval, limits)
        if row < len(bars) - 2:
            ax.plot([bar.end, bar.end], [row, row + 1], color="0.6", linewidth=0.7, zorder=0)
        ax.text(1.015, row, bar.text, transform=ax.get_yaxis_transform(), va="center", fontsize=8)
    ax.axvline(0, color="0.4", linewidth=0.8)
    ax.set_xlim(*limits)
    ax.set_ylim(n_rows - 0.4, -0.6)
    ax.set_yticks(range(len(bars)), [bar.name for bar in bars])
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")


def _whisker(ax: Any, row: int, interval: tuple[float, float], limits: tuple[float, float]) -> None:
    """An interval with a light edge, to be seen on any bar; an end beyond the axis has no cap."""
    shown = np.clip(interval, *limits)
    for color, width in (("white", 3.2), ("0.1", 1.2)):
        ax.plot(shown, [row, row], color=color, linewidth=width, solid_capstyle="butt")
        for end, inside in zip(shown, np.equal(shown, interval), strict=True):
            if inside:
                ax.plot([end, end], [row - 0.13, row + 0.13], color=color, linewidth=width)


def _percent(share: float, low: float, high: float) -> str:
    if not np.isfinite([low, high]).all():
        return f"{_whole(share)} %"
    return f"{_whole(share)} % ({_whole(low)} to {_whole(high)})"


def _whole(value: float) -> str:
    return f"{round(value)}".replace("-", "\N{MINUS SIGN}")


def _metres(mean_square: float) -> str:
    value = round(float(root(mean_square)), 3)
    return f"{value or 0.0:.3f} m".replace("-", "\N{MINUS SIGN}")


def _title(budget: Budget) -> str:
    counts = [(len(budget.stops), "stop"), (len(budget.objects), "object"), (budget.repeats, "repeat")]
    words = [f"{count} {name}{'' if count == 1 else 's'}" for count, name in counts]
    whiskers = "whiskers: 95 % interval of where a bar ends, without a cap where it goes on"
    return f"{budget.campaign}: {', '.join(words)}; RMS errors in m; {whiskers}"
