"""The notebooks are clean sources that import the public API alone; `scripts/docs` executes them."""

import ast
import json
import re
from pathlib import Path

import pytest

import isac_arena
from docs.execute_notebooks import outputs

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
ALLOWED = {"isac_arena", "numpy", "matplotlib", "sklearn", "tempfile"}


def test_all_notebooks_are_in_the_documentation() -> None:
    index = (FOLDER.parent / "index.md").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) == 7 and all(f"notebooks/{notebook.stem}\n" in index for notebook in NOTEBOOKS)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_a_clean_source(notebook: Path) -> None:
    text = notebook.read_text(encoding="utf-8")
    assert "--estimator" not in text  # the old name of --channel
    content = json.loads(text)
    assert content["nbformat"] == 4 and content["cells"][0]["cell_type"] == "markdown"
    code = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    assert code and all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    for cell in code:  # a cell that ends with a drawing prints no axes below its figure
        last = "".join(cell["source"]).splitlines()[-1]
        assert not re.match(r"\w[\w.\[\]]*\.(plot|legend|set)\(.*\)$", last), last
    tree = ast.parse("\n".join("".join(cell["source"]) for cell in code))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            assert {alias.name.partition(".")[0] for alias in node.names} <= ALLOWED
        assert not isinstance(node, ast.ImportFrom)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ia":
            assert node.attr in isac_arena.__all__


def test_the_last_value_of_a_cell_is_shown() -> None:
    names: dict[str, object] = {}
    assert outputs("a = 2\nprint('hello')\na + 1", names, "x") == ["```text\nhello\n```", "```text\n3\n```"]
    with pytest.raises(ZeroDivisionError):
        outputs("1 / 0", names, "x")
