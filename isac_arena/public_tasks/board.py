"""The leaderboard of a task: rows in a JSON file, and a static page of them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.campaign.files import write_json, write_text
from isac_arena.public_tasks.grading import UNITS, Grade, interval_over

BOARD, PAGE = "leaderboard.json", "leaderboard.html"
LOSS = {
    "channel": "GOSPA per stop between submitted and true paths; 0 is best",
    "slam": "distance of the position from the truth in m, at most 1 m",
    "contours": "distance between contours and true surfaces in m, at most 0.5 m",
}
STAGES = {"channel": "Channel estimation", "slam": "SLAM", "contours": "Contours"}
TIERS = {
    "pillar": "One pillar in a room", "halls": "Halls", "people": "Halls in which people walk",
}  # fmt: skip
INTERVALS = {
    "scenes": "Intervals hold 95 % of the mean over scenes.",
    "stops": "Intervals hold 95 % of the mean over stops. They do not tell how scenes differ: there are too few.",
    "": "One value has no interval.",
}
BOUND = {
    "slam": " The bound is that of each stop alone, over the stops that have one: methods that solve all stops"
    " together may be better."
}
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 64rem; padding: 0 1rem; color: #1b1b1b }
table { border-collapse: collapse; width: 100% } th, td { padding: .4rem .7rem; text-align: right }
th:nth-child(-n+2), td:nth-child(-n+2) { text-align: left } tr { border-bottom: 1px solid #ddd }
th, td:nth-child(4), td:nth-child(5) { white-space: nowrap }
.bar { position: relative; height: .8rem; width: min(14rem, 18vw); background: #f0f0f0 }
.bar i { position: absolute; height: 100%; background: #9dc3e6 }
.bar b { position: absolute; height: 100%; width: 2px; background: #1f4e79 }
.bound td { color: #666; font-style: italic } code { font-size: .85em; word-break: break-all }
"""


@dataclass(frozen=True)
class BoardRow:
    """A line of the board. `sha256` is the hash of the submitted file, empty for what was made here.

    `low` and `high` are the 95 % interval, None where a single value has none.
    """

    name: str
    kind: str  # submission, baseline or bound
    mean: float
    low: float | None
    high: float | None
    sha256: str = ""

    @classmethod
    def of(cls, name: str, kind: str, found: Grade, sha256: str = "") -> "BoardRow":
        """The line of a grade."""
        low, high = (None if np.isnan(end) else end for end in (found.low, found.high))
        return cls(name, kind, found.mean, low, high, sha256)

    @property
    def interval(self) -> str:
        """The interval in words."""
        return "none" if self.low is None or self.high is None else f"{plain(self.low)} to {plain(self.high)}"


def plain(value: float) -> str:
    """Three digits without exponent."""
    return np.format_float_positional(value, precision=3, fractional=False, trim="-")


def read_board(directory: Path) -> list[BoardRow]:
    """The lines of a task's board; none where nothing was graded."""
    file = directory / BOARD
    if not file.is_file():
        return []
    try:
        rows = [BoardRow(**row) for row in json.loads(file.read_text(encoding="utf-8"))["rows"]]
        return [replace(row, mean=float(row.mean), name=str(row.name)) for row in rows]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file}: damaged ({error}); put it back as it was, or remove it") from error


def enter(directory: Path, about: dict[str, Any], rows: Sequence[BoardRow]) -> list[BoardRow]:
    """Enter lines in the board, in place of those of the same name, and write the page; best first."""
    names = {row.name for row in rows}
    all_rows = sorted(
        [*(row for row in read_board(directory) if row.name not in names), *rows], key=lambda r: r.mean
    )
    write_json(directory / BOARD, {"task": about["name"], "rows": [row.__dict__ for row in all_rows]})
    write_text(directory / PAGE, page(about, all_rows))
    return all_rows


def page(about: dict[str, Any], rows: list[BoardRow]) -> str:
    """The board as HTML, without scripts."""
    largest = max((row.high or row.mean for row in rows), default=1.0) or 1.0
    place, lines = 0, []
    for row in rows:
        place += row.kind != "bound"
        cells = [
            str(place) if row.kind != "bound" else "", escape(row.name), row.kind, plain(row.mean), row.interval,
            _bar(row, largest),
        ]  # fmt: skip
        lines.append(f'<tr class="{row.kind}">{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>')
    stage = about["stage"]
    title = f"{STAGES[stage]}: {TIERS[about['tier']].lower()}"
    size = f"{_count(about['n_scenes'], 'scene')} of {_count(about['n_stops'], 'stop')}"
    over = INTERVALS[interval_over(stage, about["n_scenes"], about["n_stops"])]
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title><style>{STYLE}</style></head><body>
<h1>{title}</h1>
<p>{size}. Mean {LOSS[stage]}. {over}{BOUND.get(stage, "")}</p>
<table><thead><tr><th></th><th>method</th><th>kind</th><th>mean ({UNITS[stage]})</th><th>95 % interval</th>
<th></th></tr></thead><tbody>
{chr(10).join(lines)}
</tbody></table>
<p>The truth was sealed before the first submission. SHA-256 of the seal: <code>{about["seal_sha256"]}</code></p>
</body></html>
"""


def _bar(row: BoardRow, largest: float) -> str:
    """The interval as a bar with a line at the mean, over 0 to `largest`."""
    low, high = (row.mean if end is None else end for end in (row.low, row.high))
    return (
        f'<div class="bar"><i style="left:{100 * low / largest:.1f}%;width:{100 * (high - low) / largest:.1f}%">'
        f'</i><b style="left:{min(99.0, 100 * row.mean / largest):.1f}%"></b></div>'
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
