"""Figure of a comparison: paired differences of two runs with their intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimation.compare import PairedDifference
from estimation.report.style import ESTIMATE, GHOST, SLAM, legend_below, new_figure, styled

MOST_SHOWN_PERCENT = 150.0
VERDICTS = {
    "better": (ESTIMATE, "o"),
    "worse": (SLAM, "s"),
    "different": ("#CC79A7", "D"),
    "undecided": (GHOST, "o"),
    "same": (GHOST, "|"),
    "too few": (GHOST, "x"),
}


@styled
def compare_figure(differences: Sequence[PairedDifference], first: str, second: str) -> Figure:
    """Mean difference of every quantity in percent of the first run's mean, with its 95 % interval.

    Quantities without a pair are left out; those whose mean is zero in the first run have no percentage and stand
    at zero with their difference written beside them.
    """
    shown = [one for one in differences if one.n_pairs]
    figure = new_figure(9.5, 1.6 + 0.24 * max(len(shown), 1))
    ax = figure.subplots()
    reached = [10.0]
    for row, one in enumerate(reversed(shown)):
        color, marker = VERDICTS[one.verdict]
        scale = 100 / abs(one.first) if one.first else math.nan
        place, *ends = (_clipped(value * scale) for value in (one.difference, one.low, one.high))
        reached += [abs(value) for value in (place, *ends) if math.isfinite(value)]
        ax.plot(ends, [row, row], color=color)
        ax.plot(place if math.isfinite(place) else 0.0, row, marker, color=color, markersize=5)
        text = f"{one.first:.3g} to {one.second:.3g} {_unit(one.unit)}".strip()
        ax.annotate(
            f"{text}, n = {one.n_pairs}", (1.01, row), xycoords=("axes fraction", "data"), fontsize=7,
            va="center",
        )  # fmt: skip
    ax.axvline(0, color="0.3", linewidth=0.9)
    ax.set_yticks(range(len(shown)), [_label(one) for one in reversed(shown)], fontsize=7.5)
    limit = 1.05 * max(reached)
    ax.set(xlim=(-limit, limit), xlabel=f"{second} minus {first}, in % of {first}")
    ax.set_title(f"{second} against {first}, 95 % intervals")
    seen = {one.verdict for one in shown}
    handles = [
        Line2D([], [], color=color, marker=marker, linestyle="none", label=verdict)
        for verdict, (color, marker) in VERDICTS.items() if verdict in seen
    ]  # fmt: skip
    legend_below(figure, handles, 6)
    return figure


def _label(one: PairedDifference) -> str:
    wanted = {"lower": " (less is better)", "higher": " (more is better)", "info": ""}[one.direction]
    return f"{one.key}{wanted}"


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _clipped(percent: float) -> float:
    return max(-MOST_SHOWN_PERCENT, min(MOST_SHOWN_PERCENT, percent)) if math.isfinite(percent) else math.nan
