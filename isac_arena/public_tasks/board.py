"""The leaderboard of a task: rows in a JSON file, and a static page of them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from isac_arena.campaign.files import write_json, write_text
from isac_arena.public_tasks.grading import UNITS, Grade

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
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 60rem; padding: 0 1rem; color: #1b1b1b }
table { border-collapse: collapse; width: 100% } th, td { padding: .4rem .7rem; text-align: right }
th:nth-child(-n+2), td:nth-child(-n+2) { text-align: left } tr { border-bottom: 1px solid #ddd }
.bar { position: relative; height: .8rem; width: 14rem; background: #f0f0f0 }
.bar i { position: absolute; height: 100%; background: #9dc3e6 }
.bar b { position: absolute; height: 100%; width: 2px; background: #1f4e79 }
.bound td { color: #666; font-style: italic } code { font-size: .85em; word-break: break-all }
"""


@dataclass(frozen=True)
class BoardRow:
    """A line of the board. `sha256` is the hash of the submitted file, empty for what was made here."""

    name: str
    kind: str  # submission, baseline or bound
    mean: float
    low: float
    high: float
    sha256: str = ""

    @classmethod
    def of(cls, name: str, kind: str, found: Grade, sha256: str = "") -> "BoardRow":
        """The line of a grade."""
        return cls(name, kind, found.mean, found.low, found.high, sha256)


def read_board(directory: Path) -> list[BoardRow]:
    """The lines of a task's board; none where nothing was graded."""
    file = directory / BOARD
    if not file.is_file():
        return []
    try:
        return [BoardRow(**row) for row in json.loads(file.read_text(encoding="utf-8"))["rows"]]
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
    largest = max((row.high for row in rows), default=1.0) or 1.0
    place, lines = 0, []
    for row in rows:
        place += row.kind != "bound"
        bar = (
            f'<div class="bar"><i style="left:{100 * row.low / largest:.1f}%;'
            f'width:{100 * (row.high - row.low) / largest:.1f}%"></i>'
            f'<b style="left:{min(99.0, 100 * row.mean / largest):.1f}%"></b></div>'
        )
        lines.append(
            f'<tr class="{row.kind}"><td>{place if row.kind != "bound" else ""}</td><td>{escape(row.name)}</td>'
            f"<td>{row.kind}</td><td>{row.mean:.4g}</td>"
            f"<td>{row.low:.4g} to {row.high:.4g}</td><td>{bar}</td></tr>"
        )
    stage = about["stage"]
    title = f"{STAGES[stage]}: {TIERS[about['tier']].lower()}"
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style></head><body>
<h1>{title}</h1>
<p>{about["n_scenes"]} scenes of {about["n_stops"]} stops. Mean {LOSS[stage]},
with 95 % intervals of the bootstrap over scenes.</p>
<table><thead><tr><th></th><th>method</th><th>kind</th><th>mean ({UNITS[stage]})</th><th>95 % interval</th>
<th></th></tr></thead><tbody>
{chr(10).join(lines)}
</tbody></table>
<p>The truth was sealed before the first submission. SHA-256 of the seal: <code>{about["seal_sha256"]}</code></p>
</body></html>
"""
