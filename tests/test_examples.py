"""The examples: they run from any folder, and print what the papers print."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from orthoglide import Machine, write_campaign
from orthoglide.observations import protocol

ROOT = Path(__file__).parents[1]
EXAMPLES, TABLES = ROOT / "examples", ROOT / "docs" / "tables"


@pytest.fixture(autouse=True)
def examples_on_the_path(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for folder in (EXAMPLES, TABLES):
        monkeypatch.syspath_prepend(str(folder))
    yield
    for path in (*EXAMPLES.glob("*.py"), *TABLES.glob("*.py")):
        sys.modules.pop(path.stem, None)


def load(name: str) -> ModuleType:
    return importlib.import_module(name)


def run(name: str, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    folder_of = EXAMPLES if (EXAMPLES / name).exists() else TABLES
    command = [sys.executable, str(folder_of / name), *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.thorough(
    except_for=["kinematics.py-inverse problem (3)", "identify_your_csv.py-95 % interval"]
)
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("kinematics.py", "inverse problem (3)"),
        ("published_tables.py", "printed figures agree"),
        ("identify_your_csv.py", "95 % interval"),
    ],
)
def test_scripts_run_from_any_folder(name: str, said: str, tmp_path: Path) -> None:
    done = run(name, tmp_path)
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
    assert not done.stderr
    assert not list(tmp_path.iterdir())


def test_every_difference_is_explained() -> None:
    rows = load("published_tables").compare()
    assert [row for row in rows if not row.agrees] == []
    assert all(row.remark for row in rows)


def test_your_own_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = Machine.nominal().with_parameters({"joint_offset.y": 1.2e-3})
    sheet = protocol("standard")
    rng = np.random.default_rng(0)
    shown = machine.readings(sheet) + 2e-5 * rng.standard_normal(len(sheet))
    path = tmp_path / "mine.csv"
    write_campaign(sheet.with_readings(np.round(shown, 8)), path)
    machine.save(tmp_path / "known.toml")
    example = load("identify_your_csv")
    estimate = example.run(str(path))
    assert estimate.values["joint_offset.y"] == pytest.approx(1.2e-3, abs=3e-4)
    assert "joint_offset.y" in capsys.readouterr().out
    again = example.run(str(path), str(tmp_path / "known.toml"))
    assert again.values == pytest.approx(estimate.values, abs=1e-6)


@pytest.mark.thorough
def test_the_page_of_the_published_experiments_is_not_stale() -> None:
    import re

    number = re.compile(r"[+-]?\d+\.\d+(?:e[+-]?\d+)?")
    page = (ROOT / "docs" / "published-experiments.md").read_text(encoding="utf-8")
    printed = "\n".join(load("published_experiments").markdown()) + "\n"
    assert number.sub("#", printed) == number.sub("#", page)
    # Last digits may differ with the linear algebra of the platform.
    fresh, kept = (np.array(number.findall(text), dtype=float) for text in (printed, page))
    np.testing.assert_allclose(fresh, kept, rtol=0.02, atol=0.006)
