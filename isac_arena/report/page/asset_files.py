"""Script and style sheet of the report page, kept beside this module as plain files."""

from __future__ import annotations

from importlib.resources import files

FOLDER = "assets"
SCRIPTS = (  # in this order
    "base", "state", "figure", "tables", "panzoom", "plan", "stop", "object", "budget", "main",
)  # fmt: skip
STYLES = ("report", "figures")


def script_text() -> str:
    """The page's script: all parts in one scope of their own."""
    parts = "\n".join(_asset(f"{name}.js") for name in SCRIPTS)
    return f'(() => {{\n"use strict";\n{parts}}})();'


def style_text() -> str:
    """The page's style sheet."""
    return "\n".join(_asset(f"{name}.css") for name in STYLES)


def _asset(name: str) -> str:
    return files("isac_arena.report.page").joinpath(FOLDER, name).read_text(encoding="utf-8")
