"""Captions of the figures of a sweep. They state only what the finished cases support."""

import re
from collections.abc import Iterable, Iterator

import numpy as np

from isac_arena.report.page.tables import score_title
from isac_arena.report.sweep.figures import axis_lines
from isac_arena.report.sweep.results import LEAST_CASES, SweepResults, groups, point_means

DETECTED = "channel.detected_per_stop"
OF_DETECTED = re.compile(
    r"\.(?:rmse|bias|over_bound|median_db|max_db|nees|coverage95)"
)  # scores of detected paths
OTHER_PATHS = 1.2  # times as many detected paths at one point as at another are other paths


def axis_caption(results: SweepResults, key: str) -> str:
    """Caption of a metric over every axis: the number of cases for each mean, and whether there are intervals."""
    value = results.metrics[key].value
    lines = {axis.name: axis_lines(results, axis) for axis in results.axes}
    counts = [
        int(np.isfinite(value[part.members & members]).sum())
        for axis in results.axes
        for _, members in lines[axis.name]
        for part in groups(axis)
    ]
    counts = [count for count in counts if count]
    sentences = [_means(counts)]
    is_mixed = len(results.axes) > 1 and any(len(found) == 1 for found in lines.values())
    if is_mixed and max(counts, default=0) >= LEAST_CASES:
        sentences.append("Cases at one value also differ in the other axes; the interval includes this.")
    if results.bound(key) is not None:
        of_line = ", in the colour of its line" if any(len(found) > 1 for found in lines.values()) else ""
        sentences.append(f"Dashed: the bound on the same stops{of_line}.")
    return " ".join([*sentences, *_about_detected(results, key)])


def _about_detected(results: SweepResults, key: str) -> Iterator[str]:
    """That errors of detected paths are of other paths at other points, where many more are detected at some."""
    if not key.startswith("channel.") or not OF_DETECTED.search(key) or DETECTED not in results.metrics:
        return
    means = point_means(results, DETECTED)
    low, high = np.nanmin(means, initial=np.inf), np.nanmax(means, initial=0.0)
    if low < high and high > OTHER_PATHS * low:
        yield (
            f"These are errors of detected paths, {low:.3g} to {high:.3g} per stop over the points: where more "
            "weak ones are detected, errors can be larger though no path has become worse."
        )


def pareto_caption(results: SweepResults) -> str:
    """Caption of a trade-off."""
    means = _repeats(results, ", at its mean over the repeats")
    labels = (
        "The front is of points that no other point beats in both scores. They have labels with axis values; "
        "points that coincide share one."
    )
    return f"One dot for each design point{means}. {labels}"


def parallel_caption(results: SweepResults, key: str) -> str:
    """Caption of parallel coordinates; `key` is the metric that colours the lines."""
    means = _repeats(results, " through the means of its repeats")
    return f"One line for each design point{means}, coloured by {score_title(key)}: dark is high."


def _means(counts: Iterable[int]) -> str:
    known = sorted(counts)
    if not known:
        return "No finished case has a value."
    if known[-1] == 1:
        return "One case for each dot, so there are no intervals."
    cases = f"{known[0]}" if known[0] == known[-1] else f"{known[0]} to {known[-1]}"
    if known[-1] < LEAST_CASES:
        return f"Dots: means of {cases} cases each, which are the crosses: too few for an interval."
    interval = "95 % interval of the mean (Student's t), inside the range of the score"
    text = f"Means of {cases} cases each, with the {interval}."
    return text if known[0] >= LEAST_CASES else f"{text} Crosses: cases of means of fewer than {LEAST_CASES}."


def _repeats(results: SweepResults, words: str) -> str:
    """The given words if a design point has several cases, else nothing."""
    return words if len(np.unique(results.point)) < len(results.point) else ""
