"""HTML elements of the report pages: tables, and figures with captions."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape

from matplotlib.figure import Figure

PIXELS_PER_INCH = 86  # the widest figure fills the page, and all figures have the same letter size


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
