"""The report page: one self-contained HTML file with interactive plans of a campaign, scores and figures."""

import json
from collections.abc import Mapping
from html import escape
from string import Template
from typing import Any

from isac_arena.report.page.figures import ReportFigure
from isac_arena.report.page.tables import (
    ACCEPTED,
    CHANNEL_COUNTS,
    CONTOURS,
    MAPS,
    POSES,
    SHAPES,
    all_scores_table,
    channel_error_table,
    headline_table,
    legend_text,
    object_table,
    scene_object_table,
    score_table,
)
from isac_arena.report.page.template import PAGE, script_text, style_text
from isac_arena.report.style import figure_html, html_table
from isac_arena.scoring.score import Scores

SECTIONS = {
    "explore": "Explore",
    "channel": "Channel estimation",
    "maps": "Mapping and SLAM",
    "poses": "Receiver state",
    "shapes": "Object shapes",
    "scores": "All scores",
}


def render_report(
    payload: Mapping[str, Any], scores: Scores, figures: Mapping[str, ReportFigure], facts: Mapping[str, str]
) -> str:
    """The report as one self-contained HTML page.

    `payload` is the result of `report_payload`, with the name of the campaign; `facts` (label to text) give the
    settings, seed and versions of the run.
    """
    title = str(payload["name"])
    metrics = scores.metrics
    by_section = {
        section: "\n".join(
            figure_html(one.title, one.png, one.figure, one.caption, one.name)
            for one in figures.values()
            if one.section == section
        )
        for section in ("map", "channel", "pose", "shape")
    }
    return Template(PAGE).substitute(
        title=escape(title),
        style=style_text(),
        script=script_text(),
        campaign=_script_json(payload),
        headline=headline_table(metrics),
        words=legend_text(scores),
        facts=html_table(
            ("", ""), [(escape(label), escape(text).replace("\n", "<br>")) for label, text in facts.items()]
        ),
        channel_counts=score_table(CHANNEL_COUNTS, metrics),
        channel_errors=channel_error_table(scores),
        poses=score_table(POSES, metrics),
        maps=score_table(MAPS, metrics),
        accepted=score_table(ACCEPTED, metrics),
        contours=score_table(CONTOURS, metrics),
        contour_objects=object_table(metrics, "contours"),
        scene_objects=scene_object_table(payload["scene"], scores.tables),
        shapes=score_table(SHAPES, metrics),
        shape_objects=object_table(metrics, "shapes"),
        all_scores=all_scores_table(metrics),
        n_scores=str(len(metrics)),
        contents=_contents(),
        **{f"{section}_figures": text for section, text in by_section.items()},
    )


def _script_json(payload: Mapping[str, Any]) -> str:
    """JSON for a script element: no text in it can end the element."""
    text = json.dumps(payload, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("<", "\\u003c")


def _contents() -> str:
    return " · ".join(f'<a href="#{anchor}">{escape(name)}</a>' for anchor, name in SECTIONS.items())
