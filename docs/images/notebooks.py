"""Run the notebooks and store their outputs: ``python docs/images/notebooks.py``.

Their cells are plain Python, so that no kernel is needed: what a cell prints, and the value that it
ends with, are stored as Jupyter stores them.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

KINDS = {"_repr_html_": "text/html", "_repr_svg_": "image/svg+xml"}
"""How a value shows itself, the first that it has."""


def run(source: str, names: dict[str, Any]) -> Any:
    """Run a cell and return the value of its last expression, or None."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<cell>", "exec"), names)
    if last is None:
        return None
    return eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)


def lines(text: str) -> list[str]:
    """Return a text as the list of lines that notebooks store."""
    return text.splitlines(keepends=True)


def shown(value: Any) -> dict[str, list[str]]:
    """Return a value by the kinds in which it shows itself."""
    data = {"text/plain": lines(repr(value))}
    for method, kind in KINDS.items():
        if hasattr(value, method):
            return {kind: lines(getattr(value, method)()), **data}
    return data


def outputs(source: str, count: int, names: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a cell prints and ends with, as a notebook stores it."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        value = run(source, names)
    found: list[dict[str, Any]] = []
    if text := printed.getvalue():
        found.append({"output_type": "stream", "name": "stdout", "text": lines(text)})
    if value is not None:
        result = {"output_type": "execute_result", "execution_count": count, "metadata": {}}
        found.append({**result, "data": shown(value)})
    return found


def store(path: Path) -> None:
    """Run a notebook from top to bottom in an empty folder and write it with its outputs."""
    document = json.loads(path.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        code = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
        for count, cell in enumerate(code, start=1):
            cell["execution_count"] = count
            cell["outputs"] = outputs("".join(cell["source"]), count, names)
        os.chdir(ROOT)
    path.write_text(json.dumps(document, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for notebook in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        store(notebook)
        print(f"written: {notebook.relative_to(ROOT)}")
