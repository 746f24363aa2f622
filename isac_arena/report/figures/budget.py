"""The error budget as waterfalls: from the whole error down to the rest, part by part."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from isac_arena.insight.budget.attribution import NOTHING, Attribution, signed_root
from isac_arena.insight.budget.record import OUTCOMES, REST, TOTAL, Budget
from isac_arena.report.style import ESTIMATE, GHOST, TRUTH, legend_below, new_figure, styled

WORSE = "#E69F00"
ROW_IN, MARGIN_IN, WIDTH_IN = 0.36, 1.0, 6.6
TITLES = {"pose": "Receiver position", "shape": "Published contours", "contour": "Our contours"}
KINDS = {"stages": "truth in place of a stage", "physics": "physics switched off"}
RESTS = {"stages": "all stages true", "physics": "estimators alone"}
SQUARE_CM = 1e4  # in a square metre
PALE = 0.4
WIDEST = (-60.0, 160.0)  # % of the mean square to which whiskers are shown; bars are shown whole


@dataclass(frozen=True)
class _Bar:
    """One row: a bar from `start` to `end` and its interval, in % of the whole or in cm^2, and its text."""

    name: str
    start: float
    end: float
    interval: tuple[float, float]
    color: str
    text: str
    is_decided: bool = True


@styled()
def budget_figure(budget: Budget) -> Figure:
    """A waterfall per outcome and kind of budget, in shares of the mean square error.

    Bars run from the whole error at the top down to the rest. Whiskers are 95 % intervals over stops or objects
    and over the order of the parts, drawn around the end of a bar. Bars of parts whose interval contains zero are
    pale. The text gives share, interval and the root of the part's mean square. Where shares are meaningless, the
    bars are in cm^2 without intervals, and the axis label gives the reason.
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
            ax.set_xlabel(_axis_label(budget.attribution[outcome, kind], OUTCOMES[outcome][1]))
    figure.suptitle(_title(budget), x=0.01, ha="left", fontsize=9, color="0.35")
    colors = {
        "all errors": TRUTH,
        "the error decreases without this part": ESTIMATE,
        "it increases": WORSE,
        "rest": GHOST,
    }
    handles = [Patch(color=color, label=label) for label, color in colors.items()]
    if any(not bar.is_decided for found in bars.values() for bar in found):
        handles.append(Patch(color=ESTIMATE, alpha=PALE, label="undecided: the interval contains 0"))
    legend_below(figure, handles, len(handles))
    return figure


def _axis_label(found: Attribution, unit: str) -> str:
    if found.objection:
        return f"mean square error over the {unit}s in cm²\nno shares: {found.objection}"
    return f"% of the mean square error over the {unit}s"


def _bars(found: Attribution, kind: str) -> Iterator[_Bar]:
    """The rows from all errors to the rest, without parts that have no effect, such as stages after the error."""
    has_shares = not found.objection
    scale = 100 / found.total if has_shares else SQUARE_CM
    width = 100.0 if has_shares else np.nan  # scale of the intervals, which exist for shares only
    spread = (scale * found.total_low, scale * found.total_high)
    yield _Bar(TOTAL, 0.0, scale * found.total, spread, TRUTH, _metres(found.total))
    level = scale * found.total
    for index, part in enumerate(found.part):
        size, low, high = (scale * found.contribution[index], width * found.low[index], width * found.high[index])
        is_small = abs(found.contribution[index]) <= NOTHING * found.total
        if found.effect[index] == "none" or (is_small and not has_shares):
            continue
        end = level - size
        text = _metres(found.contribution[index])
        text = f"{_percent(size, low, high)}   {text}" if has_shares else text
        color = ESTIMATE if size >= 0 else WORSE
        is_decided = found.effect[index] != "undecided" or not has_shares
        yield _Bar(str(part), level, end, (level - high, level - low), color, text, is_decided)
        level = end
    rest, text = scale * found.rest, _metres(found.rest)
    span = (width * found.rest_low, width * found.rest_high)
    text = f"{_percent(rest, *span)}   {text}" if has_shares else text
    yield _Bar(f"{REST}: {RESTS[kind]}", 0.0, rest, span, GHOST, text)


def _draw(ax: Any, bars: list[_Bar], n_rows: int) -> None:
    ends = np.array([[bar.start, bar.end] for bar in bars])
    whiskers = np.clip([bar.interval for bar in bars[1:]], *WIDEST)
    low = min(float(ends.min()), float(np.nanmin(whiskers, initial=0.0)))
    high = max(float(ends.max()), float(np.nanmax(whiskers, initial=0.0))) or 1.0
    limits = low - 0.03 * (high - low), high + 0.03 * (high - low)
    for row, bar in enumerate(bars):
        left, right = sorted((bar.start, bar.end))
        ax.barh(row, right - left, left=left, height=0.62, color=bar.color, alpha=1.0 if bar.is_decided else PALE)
        if row and np.isfinite(bar.interval).all():
            _whisker(ax, row, bar.interval, limits)
        if row < len(bars) - 2:
            ax.plot([bar.end, bar.end], [row, row + 1], color="0.6", linewidth=0.7, zorder=0)
        ax.text(1.015, row, bar.text, transform=ax.get_yaxis_transform(), va="center", fontsize=9)
    ax.axvline(0, color="0.4", linewidth=0.8)
    ax.set_xlim(*limits)
    ax.set_ylim(n_rows - 0.4, -0.6)
    ax.set_yticks(range(len(bars)), [bar.name for bar in bars])
    ax.tick_params(axis="y", length=0, labelsize=9)
    ax.grid(visible=False, axis="y")


def _whisker(ax: Any, row: int, interval: tuple[float, float], limits: tuple[float, float]) -> None:
    """Draw an interval with a light edge, visible on every bar; an end beyond the axis has no cap."""
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
    value = float(signed_root(mean_square))
    text = f"{1e3 * value:.2g} mm" if 1e-9 < abs(value) < 0.01 else f"{round(value, 3) or 0.0:.3f} m"
    return text.replace("-", "\N{MINUS SIGN}")


def _title(budget: Budget) -> str:
    counts = [(len(budget.stops), "stop"), (len(budget.objects), "object"), (budget.repeats, "repeat")]
    words = [f"{count} {name}{'' if count == 1 else 's'}" for count, name in counts]
    whiskers = "; whiskers: 95 % interval of the end of a bar, without a cap where it exceeds the axis"
    has_shares = any(not found.objection for found in budget.attribution.values())
    return f"{budget.campaign}: {', '.join(words)}; roots of mean squares{whiskers if has_shares else ''}"
