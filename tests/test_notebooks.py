"""The notebooks run from top to bottom, and every value that a cell ends with shows itself.

Their cells are plain Python, so that no kernel is needed to run them here.
"""

from __future__ import annotations

import ast
import json
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
run = runpy.run_path(str(ROOT / "docs" / "images" / "notebooks.py"))["run"]


def cells(path: Path, kind: str) -> list[str]:
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document["nbformat"] == 4
    return ["".join(c["source"]) for c in document["cells"] if c["cell_type"] == kind]


def test_there_are_three() -> None:
    assert [p.stem for p in NOTEBOOKS] == [
        "identify_and_diagnose", "plan_and_rehearse", "your_own_effect",
    ]  # fmt: skip


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_is_kept_with_its_outputs(path: Path) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    code = [c for c in document["cells"] if c["cell_type"] == "code"]
    remedy = "without outputs: python docs/images/notebooks.py"
    assert [c["execution_count"] for c in code] == list(range(1, len(code) + 1)), remedy
    for cell in code:
        last = ast.parse("".join(cell["source"])).body[-1]
        ends = any(o["output_type"] == "execute_result" for o in cell["outputs"])
        assert ends <= isinstance(last, ast.Expr), remedy
    assert any(c["outputs"] for c in code), remedy
    assert cells(path, "markdown")[0].startswith("# ")


def shown(path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the cells of a notebook end with, as a notebook shows it."""
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {"__name__": "__main__"}
    found = []
    for source in cells(path, "code"):
        value = run(source, names)
        if value is not None:
            rich = next((getattr(value, n) for n in ("_repr_html_", "_repr_svg_")
                         if hasattr(value, n)), None)  # fmt: skip
            found.append(rich() if rich else repr(value))
    return found


@pytest.mark.thorough
def test_identify_and_diagnose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    values = shown(NOTEBOOKS[0], tmp_path, monkeypatch)
    said = capsys.readouterr().out
    assert "off by 0.0" in said
    told = "The path of the y carriage is out of square toward z by 2.5 mrad"
    assert sum(told in value for value in values) == 1
    # The verdict and three figures; the causes stand in words, with what else they could be.
    assert sum("<svg" in value for value in values) == 4
    assert sum("out of square toward z" in v and "or rail_tilt.y.z>" in v for v in values) == 1
    assert sum("<table" in value for value in values) == 4


@pytest.mark.thorough
def test_plan_and_rehearse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    values = shown(NOTEBOOKS[1], tmp_path, monkeypatch)
    said = capsys.readouterr().out
    assert "found from" in values[1]
    assert "6 campaigns of 54 readings" in said
    assert "<table" in values[0]
    assert [p.name for p in tmp_path.iterdir()] == ["sheet.csv"]


@pytest.mark.thorough
def test_your_own_effect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    values = shown(NOTEBOOKS[2], tmp_path, monkeypatch)
    said = capsys.readouterr().out
    assert "rail_sag.x.z" in said
    alone, causes, named = values
    assert "The path of the x carriage leaves its line toward z" in alone
    assert "<Cause rail_sag.x.z: on leg x the rail sags between its feet toward z" in causes
    assert "<svg" in named
    assert "the rail sags between its feet" in named
    assert "rail_sag.x.z" in named
    assert not list(tmp_path.iterdir())
