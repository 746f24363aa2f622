"""The common style of figures (colours for colour-blind readers, light axes, sizes in inches) and HTML pages."""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from io import BytesIO
from typing import Any

from matplotlib import rcParams
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.patches import Polygon

from scenes.record import FloatArray

TRUTH = "#222222"
ESTIMATE = "#0072B2"
MAPPING = "#0072B2"
SLAM = "#D55E00"
GHOST = "#8A8A8A"
BAND_ALPHA = 0.2

# Okabe and Ito (2008) without black and yellow, which are hard to see as points on white.
CLUSTER_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
CLUSTER_MARKERS = ("o", "s", "^", "D", "v", "P")

STYLE = {
    "axes.axisbelow": True,
    "axes.edgecolor": "0.4",
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}
DOTS_PER_INCH = 130
PIXELS_PER_INCH = 86  # on a page: the widest figure fills it, and all figures have the same letter size


@contextmanager
def styled() -> Iterator[None]:
    """Decorator: the function draws in this style and ignores the user's settings.

    Only the settings of the style are put back. `matplotlib.rc_context` would put back all of them, also what a
    notebook sets while its first figure is made, and later figures would not be shown.
    """
    before = {name: rcParams[name] for name in STYLE}
    rcParams.update(STYLE)
    try:
        yield
    finally:
        rcParams.update(before)


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure with automatic layout, outside of any plotting state."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def fixed_figure(width_in: float, height_in: float, **margins: float) -> Figure:
    """An empty figure with given margins and gaps: automatic layout takes as long as drawing does."""
    figure = Figure(figsize=(width_in, height_in))
    figure.subplots_adjust(**margins)
    return figure


def fill_area(ax: Any, outline_m: FloatArray, **look: Any) -> None:
    """Fill a polygon (point, xy) on axes with limits of their own: `Axes.fill` spends its time on limits."""
    ax.add_artist(Polygon(outline_m, **look))


def cluster_look(cluster: int) -> dict[str, Any]:
    """Colour and marker of a cluster; the marker changes after each cycle of colours."""
    return {
        "color": CLUSTER_COLORS[cluster % len(CLUSTER_COLORS)],
        "marker": CLUSTER_MARKERS[cluster // len(CLUSTER_COLORS) % len(CLUSTER_MARKERS)],
    }


def legend_below(figure: Figure, handles: list[Any], columns: int) -> Legend:
    """One legend for the whole figure, below the axes."""
    where = "lower center" if figure.get_layout_engine() is None else "outside lower center"
    return figure.legend(handles=handles, loc=where, ncols=columns)


@styled()
def png_bytes(figure: Figure) -> bytes:
    """The figure as a PNG file; equal figures give equal bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]], style: str = "") -> str:
    """An HTML table, in the CSS class `style`; heads and cells are HTML."""
    head = "".join(f"<th>{cell}</th>" for cell in heads)
    body = "\n".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    kind = f' class="{style}"' if style else ""
    return f"<table{kind}>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"


def figure_html(title: str, png: bytes, figure: Figure, caption: str, name: str = "") -> str:
    """A figure as an HTML element with the PNG file inside; `name` is its anchor on the page."""
    data = b64encode(png).decode("ascii")
    width = round(PIXELS_PER_INCH * float(figure.get_size_inches()[0]))
    anchor = f' id="{escape(name)}"' if name else ""
    return (
        f'<figure{anchor}><img alt="{escape(title)}" width="{width}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>{escape(title)}.</b> {escape(caption)}</figcaption></figure>"
    )
