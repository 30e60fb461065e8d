"""Sheets of a delta say where its controller sends the tool, as its owner would type it.

What a row means is computed here from the controller's three spheres, by hand.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import orthoglide as og
from orthoglide.errors import FileError
from orthoglide.machine import Machine
from orthoglide.observations import Readings, campaign_text, read_readings
from orthoglide.planning import tool_sheets
from tests.klipper_files import simulated_cfg
from tests.rig_delta import DeltaRig
from tests.test_cli import run
from tests.test_tool_readings import SPEC

MACHINE, NOMINAL = Machine(SPEC), DeltaRig()
PLACE, SECOND = ("x_mm", "y_mm", "z_mm"), ("x2_mm", "y2_mm", "z2_mm")
ALL = ("tcp", "plate", "distance", "ballbar", "incline")

Row = dict[str, str]


def sent(p: np.ndarray, radius: float = NOMINAL.radius - NOMINAL.r) -> np.ndarray:
    """Travel ``(3,)`` of the carriages from mechanical zero for a place, by three spheres."""
    angle, arm = np.deg2rad(NOMINAL.angles), NOMINAL.L
    towers = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    far = np.sum((towers - p[:2]) ** 2, axis=1)
    return np.asarray(p[2] + np.sqrt(arm**2 - far) - np.sqrt(arm**2 - radius**2))


def sheet(*kinds: str, machine: Machine = MACHINE) -> list[Row]:
    given = tool_sheets(machine, kinds)
    text = campaign_text(given, machine.spec, commands_as_places=True)
    return list(csv.DictReader(io.StringIO(text)))


def written(path: Path, rows: list[Row]) -> Path:
    names = list(rows[0])
    lines = [",".join(names), *(",".join(row[n] for n in names) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def read(path: Path, rows: list[Row], *, done: bool = True) -> Readings:
    (found,) = read_readings(written(path, rows), SPEC, require_readings=done)
    return found


@pytest.mark.thorough(except_for=["plate"])
@pytest.mark.parametrize("kind", ALL)
def test_a_row_is_where_the_controller_sends_the_tool(kind: str, tmp_path: Path) -> None:
    rows = sheet(kind)
    assert not any(name.startswith("travel") for name in rows[0])
    found = read(tmp_path / "sheet.csv", rows, done=False)
    taken = [row for row in rows if row["kind"] == kind]
    for names, commands in ((PLACE, found.command), (SECOND, found.second)):
        if names[0] not in rows[0]:
            continue
        for row, command in zip(taken, commands, strict=True):
            p = np.array([float(row[name] or 0) for name in names]) * 1e-3
            assert np.abs(p * 1e4 - np.round(p * 1e4)).max() < 1e-6  # tenths of a millimetre
            np.testing.assert_allclose(command, sent(p), rtol=0, atol=1e-9)


def test_a_plate_is_filled_in_by_the_height_of_its_touch(tmp_path: Path) -> None:
    """Towers further out are told with their sign, from what the controller shows."""
    off = 4e-4
    wide = DeltaRig(radius=NOMINAL.radius + off)
    rows = sheet("plate")
    assert {(row["z_mm"], row["reading_mm"]) for row in rows} == {("", "0")}
    for row in rows:
        x, y = (float(row[name]) * 1e-3 for name in PLACE[:2])

        def above(z: float, x: float = x, y: float = y) -> float:
            p = np.array([x, y, z])
            return float(wide.pose(sent(p), p)[0][2])

        row["z_mm"] = f"{brentq(above, -0.01, 0.01, xtol=1e-9) * 1e3:.6f}"
    campaign = read(tmp_path / "filled.csv", rows)
    fit = og.identify([campaign], MACHINE, noise=1e-6)
    told = [fit.values[f"axis_offset.{leg}.radial"] for leg in "abc"]
    assert np.mean(told) == pytest.approx(off, abs=0.05 * off)
    assert fit.scores.rms < 1e-6


def test_places_are_not_mixed_with_travel_and_are_within_reach(tmp_path: Path) -> None:
    row = next(row for row in sheet("tcp") if row["kind"] == "tcp")
    both = row | {f"travel_{leg}_mm": "0" for leg in "abc"}
    with pytest.raises(FileError, match="has travel_a_mm and x_mm, and they disagree"):
        read(tmp_path / "both.csv", [both])
    with pytest.raises(FileError, match=r"line 2: x_mm, y_mm, z_mm is a place that no arm reaches"):
        read(tmp_path / "far.csv", [row | {"x_mm": "900", "reading_mm": "1"}])


def test_a_printer_is_sent_by_its_own_numbers(tmp_path: Path) -> None:
    """Numbers of the firmware, not of the nominal machine: one arm is told a millimetre longer."""
    text = simulated_cfg(NOMINAL).replace("arm_length: 345.000000", "arm_length: 346.000000", 1)
    (tmp_path / "printer.cfg").write_text(text)
    imported = og.import_printer(tmp_path / "printer.cfg").machine
    kinematics = imported.kinematics
    assert kinematics is not None
    p = np.array([[0.05, -0.03, 0.01]])
    angle, arm = np.deg2rad(NOMINAL.angles), np.array([0.346, 0.345, 0.345])
    towers = 0.163 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    heights = p[0, 2] + np.sqrt(arm**2 - np.sum((towers - p[0, :2]) ** 2, axis=1))
    zero = np.sqrt(np.round(arm.mean(), 6) ** 2 - 0.163**2)
    np.testing.assert_allclose(kinematics.travel(p)[0], heights - zero, rtol=0, atol=1e-12)
    np.testing.assert_allclose(kinematics.places(kinematics.travel(p)), p, rtol=0, atol=1e-12)


def test_the_command_says_how_to_fill_a_sheet_in(tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    MACHINE.save(path)
    given = ("--machine", path, "--out", tmp_path / "sheet.csv")
    done = run("design", "--owns", "plate,incline", *given)
    told = " ".join(done.output.split())
    assert "Send the tool to x_mm, y_mm, z_mm, with its numbers as they are." in told
    assert "a probe on a plate: go down until it touches and write the height" in told
    assert "reading_mrad is the tool's turn about the direction, right-handed" in told


@pytest.mark.parametrize(
    ("distances", "told"),
    [((0.0, 60.0), "a distance must be above 0"), ((0.06, 0.09), "millimetres, not metres")],
)
def test_distances_that_cannot_be_are_refused(
    distances: tuple[float, float], told: str, tmp_path: Path
) -> None:
    rows = [row for row in sheet("distance") if row["kind"] == "distance"][:2]
    rows = [row | {"reading_mm": str(value)} for row, value in zip(rows, distances, strict=True)]
    with pytest.raises(FileError, match=told):
        read(tmp_path / "sheet.csv", rows)
