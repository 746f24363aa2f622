"""What stands under the figures of a sweep: said of the cases that there are, no more."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from isac_arena.report.sweep.figures import axis_lines
from isac_arena.report.sweep.results import SweepResults, groups

FEW_CASES = 3  # Student's t makes intervals of so few wider than the figure


def axis_caption(results: SweepResults, key: str) -> str:
    """Under a metric over every axis: of how many cases its means are, and whether they have intervals."""
    value = results.metrics[key].value
    lines = {axis.name: axis_lines(results, axis) for axis in results.axes}
    counts = [
        int(np.isfinite(value[part.members & members]).sum())
        for axis in results.axes
        for _, members in lines[axis.name]
        for part in groups(axis)
    ]
    counts = [count for count in counts if count]
    told = [_means(counts)]
    is_mixed = len(results.axes) > 1 and any(len(found) == 1 for found in lines.values())
    if is_mixed and max(counts, default=0) > 1:
        told.append("Cases at one value differ in the other axes too, and the interval holds that.")
    if results.bound(key) is not None:
        told.append("Dashed: the bound on the same stops.")
    return " ".join(told)


def pareto_caption(results: SweepResults) -> str:
    """Under a trade-off."""
    means = _repeats(results, ", its mean over the repeats")
    return f"A dot per point of the design{means}; on the front with its axis values."


def parallel_caption(results: SweepResults, key: str) -> str:
    """Under parallel coordinates; `key` is the metric that colours the lines."""
    means = _repeats(results, " through the means of its repeats")
    return f"A line per point of the design{means}, coloured by {key}: dark is high."


def _means(counts: Iterable[int]) -> str:
    known = sorted(counts)
    if not known:
        return "No case has measured it."
    if known[-1] == 1:
        return "One case behind each dot, so there are no intervals."
    interval = "with the 95 % interval of the mean (Student's t)"
    if known[0] == known[-1]:
        text = f"Means of {known[0]} cases each, {interval}."
    else:
        text = f"Means of {known[0]} to {known[-1]} cases each, {interval}"
        text += "; a single one has none." if known[0] == 1 else "."
    return f"{text} Of so few it may go on beyond the figure." if known[0] <= FEW_CASES else text


def _repeats(results: SweepResults, words: str) -> str:
    """The words where some point has several cases."""
    return words if len(np.unique(results.point)) < len(results.point) else ""
