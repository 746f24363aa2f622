"""How the documentation is built as a site: `scripts/docs`."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Any

from isac_arena.scoring.words import words_page
from isac_arena.settings import settings_page
from scenes.record import FIELDS

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("scenes", "sim", "estimation", "isac_arena")

project = "ISAC Arena"
extensions = ["myst_parser", "sphinx.ext.apidoc", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = project
napoleon_google_docstring = False
napoleon_use_ivar = True  # the attributes of a dataclass are its members already
autodoc_mock_imports = ["sionna", "mitsuba", "drjit"]
autodoc_typehints = "description"
autodoc_default_options = {"members": True, "undoc-members": False}
autodoc_preserve_defaults = True
APPLICATION = ("cli", "validation", "report")  # how the commands work, which nobody imports
apidoc_modules = [
    {
        "path": str(ROOT / name),
        "destination": f"api/{name}",
        "separate_modules": True,
        "include_private": False,
        "exclude_patterns": [str(ROOT / "isac_arena" / part) for part in APPLICATION],
    }
    for name in PACKAGES
]
suppress_warnings = ["myst.xref_missing", "misc.highlighting_failure", "ref.python", "toc.not_included"]


def add_fields(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Append what the fields of a record or of a settings model say of themselves to its docstring."""
    rows: list[Any] = []
    if what == "class":
        rows += record_fields(thing) if dataclasses.is_dataclass(thing) else settings_fields(thing)
        if FIELDS in lines:  # the same, for `help`
            del lines[lines.index(FIELDS) :]
    if rows:
        lines += ["", ".. list-table::", "   :widths: auto", ""]
        for row in rows:
            lines += [f"   {'*' if cell is row[0] else ' '} - {cell}" for cell in row]
        lines.append("")
    lines[:] = [line if "``" in line else line.replace("|", "\\|") for line in lines]  # |x| is no substitution


def skip_foreign(app: Any, what: str, name: str, thing: Any, skip: bool, options: Any) -> bool | None:
    """Leave out what a module imports from elsewhere; the arguments of some of it cannot be shown.

    Public names are shown twice, where they are defined and in `isac_arena`, but not in other packages as well.
    """
    home = getattr(thing, "__module__", None) or ""
    page = app.env.temp_data.get("autodoc:module")
    is_alias = page == "scenes.contours" and home.startswith(f"{page}.")
    return True if callable(thing) and (home.partition(".")[0] not in PACKAGES or is_alias) else None


def record_fields(record: Any) -> Any:
    """Name, axes, unit and meaning of every array of a record."""
    for spec in dataclasses.fields(record):
        if "axes" in spec.metadata:
            axes = ", ".join(spec.metadata["axes"]) or "scalar"
            yield (f"``{spec.name}``", f"({axes})", spec.metadata.get("unit") or "1", spec.metadata.get("doc", ""))


def settings_fields(model: Any) -> Any:
    """Name, default and meaning of every field of a settings model."""
    for name, field in getattr(model, "model_fields", {}).items():
        default = "required" if field.is_required() else f"``{field.get_default(call_default_factory=True)!r}``"
        yield f"``{name}``", default if len(default) < 60 else "as below", field.description or ""


def write_pages(app: Any) -> None:
    """Write the pages of all settings and of the words of scores."""
    for name, text in (("settings", settings_page()), ("words", words_page())):
        (ROOT / "docs" / f"{name}.md").write_text(text, encoding="utf-8")


def execute_notebooks(app: Any) -> None:
    """Execute all notebooks, in a process of their own; an error in one ends the build."""
    subprocess.run([sys.executable, str(ROOT / "docs" / "execute_notebooks.py")], check=True)


def setup(app: Any) -> None:
    """Hook into autodoc, and make the pages that are made."""
    app.connect("builder-inited", write_pages)
    app.connect("builder-inited", execute_notebooks)
    app.connect("autodoc-process-docstring", add_fields)
    app.connect("autodoc-skip-member", skip_foreign)
