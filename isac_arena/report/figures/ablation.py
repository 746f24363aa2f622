"""The ablation of a campaign: the effect of each hardware impairment on each score."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from isac_arena.insight.ablation import EFFECTS, NONE, Ablation, score_text
from isac_arena.report.style import new_figure, styled

SHOWN_OCTAVES = (1.0, 4.0)  # the colour scale ends at a factor between 2 and 16 in both directions
DARK_LUMINANCE = 0.45  # text is white on darker cells


@styled()
def ablation_figure(ablation: Ablation) -> Figure:
    """Scores of every variant as a matrix, coloured by their ratio to the campaign without impairments.

    The last column is the mean ratio, by which the variants are ranked.
    """
    reference = ablation.value[ablation.variant.index(NONE)]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.column_stack([np.log2(ablation.value / reference), ablation.growth])
    shown = np.column_stack([ablation.value, 2.0**ablation.growth])
    n_rows, n_columns = ratio.shape
    figure = new_figure(2.6 + 0.85 * n_columns, 1.5 + 0.3 * n_rows)
    ax = figure.subplots()
    ax.grid(visible=False)
    farthest = float(np.max(np.abs(ratio), where=np.isfinite(ratio), initial=0.0))
    limit = float(np.clip(np.ceil(farthest - 1e-9), *SHOWN_OCTAVES))
    image = ax.imshow(np.ma.masked_invalid(ratio), cmap="RdBu_r", vmin=-limit, vmax=limit, aspect="auto")
    ax.set_facecolor("0.9")
    for row, column in np.ndindex(ratio.shape):
        value = float(shown[row, column])
        dark = np.isfinite(ratio[row, column]) and _luminance(image, float(ratio[row, column])) < DARK_LUMINANCE
        text = score_text(value, decimals=2 if column == n_columns - 1 else 3)
        ax.text(column, row, text, ha="center", va="center", fontsize=8, color="white" if dark else "black")
    labels = [f"{label}\n{unit}" for label, unit in EFFECTS.values()]
    ax.set_xticks(range(n_columns), [*labels, "mean\nratio"])
    ax.set_yticks(range(n_rows), ablation.variant)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.axhline(n_rows - 2.5, color="0.3", linewidth=1.0)
    ax.axvline(n_columns - 1.5, color="0.3", linewidth=1.0)
    ax.set_title("RMS errors with each impairment alone", pad=40)
    ticks = np.arange(-limit, limit + 1)
    bar = figure.colorbar(image, ax=ax, ticks=ticks, extend="both" if farthest > limit else "neither", pad=0.02)
    bar.ax.set_yticklabels([f"x {2.0**tick:g}" if tick >= 0 else f"x 1/{2.0**-tick:g}" for tick in ticks])
    bar.set_label("error over that without impairments")
    return figure


def _luminance(image: Any, value: float) -> float:
    """Luminance of a cell, from 0 to 1 (ITU-R BT.709, clause 3.2)."""
    red, green, blue, _ = image.cmap(image.norm(value))
    return float(0.2126 * red + 0.7152 * green + 0.0722 * blue)
