"""Execute the notebooks of this folder and write each as a page with its outputs and figures.

`scripts/docs` runs it. The cells are plain Python, so no kernel is needed: the cells of a notebook share one
namespace, and the value of a last expression is shown as Jupyter shows it.
"""

import ast
import contextlib
import io
import json
import sys
import time
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

FOLDER = Path(__file__).parent / "notebooks"


def page(notebook: Path) -> str:
    """The page of a notebook in Markdown; its figures are written beside it."""
    content = json.loads(notebook.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    parts = []
    for index, cell in enumerate(content["cells"]):
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        parts += outputs(source, names, f"{notebook.stem}_{index}")
    where = f"*The notebook is `docs/notebooks/{notebook.name}`; its figures were made with this page.*"
    return "\n\n".join([*parts, where]) + "\n"


def outputs(source: str, names: dict[str, Any], stem: str) -> list[str]:
    """Execute a cell; what it prints, the value of its last expression, and its figures."""
    tree, value, printed = ast.parse(source), None, io.StringIO()
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, stem, "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), stem, "eval"), names)
    shown = [f"```text\n{printed.getvalue().rstrip()}\n```"] if printed.getvalue().strip() else []
    figures = plt.get_fignums()
    if value is not None and not figures:
        html = getattr(value, "_repr_html_", lambda: None)()
        text = f"```text\n{value!r}\n```"
        shown.append(text if html is None else "```{raw} html\n" + html + "\n```")
    for number in figures:
        name = f"{stem}_{number}.png"
        plt.figure(number).savefig(FOLDER / name, dpi=90, bbox_inches="tight")
        shown.append(f"![Figure of the cell above]({name})")
    plt.close("all")
    return shown


def main() -> None:
    """Write all pages."""
    for notebook in sorted(FOLDER.glob("*.ipynb")):
        started = time.perf_counter()
        notebook.with_suffix(".md").write_text(page(notebook), encoding="utf-8")
        sys.stderr.write(f"{notebook.name}: {time.perf_counter() - started:.0f} s\n")


if __name__ == "__main__":
    main()
