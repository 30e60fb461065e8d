"""The sheet that is carried to the machine: the page to print, and the CSV beside it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.report.sheet import sheet_page
from tests.rig_campaigns import read_csv
from tests.test_cli import run
from tests.test_report import printed

CELL = re.compile(r"<td[^>]*class=\"([^\"]*)\"[^>]*>(.*?)</td>|<td>(.*?)</td>", re.S)


def written(folder: Path, *words: str) -> Path:
    path = folder / "sheet.csv"
    result = run(*words, "--out", path)
    assert result.exit_code == 0, result.output
    assert "sheet.html: the same rows to print" in result.output or "--quiet" in words
    return path


def test_every_mounting_prints_on_one_page(tmp_path: Path) -> None:
    page = written(tmp_path, "protocol").with_suffix(".html")
    text = page.read_text(encoding="utf-8")
    page.write_text(text.replace("@page {", "@page { size: A4;"), encoding="utf-8")
    assert printed(page) == 1 + text.count('<section class="mounting')


def steps(page: str) -> list[tuple[list[int], bool, list[float], list[bool]]]:
    """Rows of the page: lines of the CSV, is it a move, commands, which boxes are to be filled."""
    found = []
    for kind, row in re.findall(r"<tr( class=\"move\")?>(<td.*?)</tr>", page, re.S):
        cells = CELL.findall(row)
        lines = [int(n) for n in cells[0][1].split(",")]
        commands = [float(plain) for name, _, plain in cells if not name]
        boxes = [name == "box" for name, _, _ in cells if name in ("box", "none")]
        found.append((lines, bool(kind), commands, boxes))
    return found


@pytest.mark.parametrize(
    "words",
    [("protocol", "--kind", "sweep"), ("design", "--count", "12", "--quiet"), ("protocol",)],
    ids=lambda words: " ".join(words),
)
def test_page_and_file_have_the_same_rows_in_the_same_order(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    compare(written(tmp_path, *words))


def compare(path: Path) -> None:
    """A sheet and the page beside it, row by row."""
    rows = read_csv(path)
    shown = steps(path.with_suffix(".html").read_text(encoding="utf-8"))
    assert [line for lines, *_ in shown for line in lines] == list(range(2, len(rows) + 2))
    for lines, move, commands, boxes in shown:
        assert sum(boxes) == (0 if move else len(lines))
        for line in lines:
            row = rows[line - 2]
            assert (row["kind"] == "move") is move
            filed = [row[f"rho_{axis}_mm"] for axis in "xyz"]
            np.testing.assert_allclose(commands, filed, atol=0.5e-3)


def test_a_sheet_has_no_times_that_nobody_took(tmp_path: Path) -> None:
    path = written(tmp_path, "protocol", "--kind", "sweep")
    assert {row["time_s"] for row in read_csv(path)} == {""}
    assert not re.search(r"\d\d:\d\d", path.with_suffix(".html").read_text())
    planned = og.protocol("sweep")
    taken = planned.with_readings(np.where(np.arange(len(planned)) < 2, 1e-3, np.nan))
    og.write_campaign(taken, tmp_path / "half.csv")
    times = [row["time_s"] for row in read_csv(tmp_path / "half.csv") if row["kind"] == "leg"]
    assert "" not in times[:2]
    assert set(times[2:]) == {""}


def test_the_page_speaks_the_controllers_own_coordinates(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(
        'schema = 1\nname = "mill <3>"\n[geometry_mm]\nL = 310.25\nd = 80\nr = 31\n'
        "stroke = [-100.0, 60.0]\n[controller]\nzero_mm = [100, 100, 100]\n"
        "sign = [1, -1, 1]\n"
    )
    path = written(tmp_path, "protocol", "--machine", str(tmp_path / "m.toml"))
    page = path.with_suffix(".html").read_text(encoding="utf-8")
    assert "mill &lt;3&gt;" in page
    assert "as the controller shows them" in page
    assert "joint coordinates" not in page
    row = read_csv(path)[1]
    assert [row[f"travel_{axis}_mm"] for axis in "xyz"] == [100.0] * 3 == steps(page)[1][2]


def test_the_page_says_where_each_dial_stands_and_which_way_it_counts() -> None:
    machine = og.Machine.nominal()
    sheet = og.protocol("standard")
    before, after = sheet.setups[:2], sheet.setups[3:]
    turned = replace(sheet.setups[2], sign=-1, gauge=0.0775625, bar=2)
    page = sheet_page(replace(sheet, setups=(*before, turned, *after)), machine, "s")
    start = page.index(f"<h3>Dial {turned.name}")
    told = page[start : page.index("</ul>", start)]
    assert "On leg y" in told
    assert "bar 2, the one on the −x side" in told
    assert "77.56 mm" in told
    assert "25 %" in told
    assert "grow when the leg moves toward −x; if it falls, write x in column" in told


def test_nothing_is_written_where_one_of_both_stands(tmp_path: Path) -> None:
    (tmp_path / "sheet.html").write_text("mine")
    result = run("protocol", "--out", tmp_path / "sheet.csv")
    assert result.exit_code == 2
    assert "sheet.html" in result.output
    assert [p.name for p in tmp_path.iterdir()] == ["sheet.html"]
