"""The side that the tool's instruments' places are come to from: in sheets, files and verdicts."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings, campaign_text, read_readings
from orthoglide.observations.tables import repeat_steps
from orthoglide.planning import tool_sheets
from tests.rig import Rig
from tests.rig_delta import DeltaRig
from tests.test_tool_readings import SPEC

Row = dict[str, str]
LOST, NOISE = 1.5e-4, 1e-5
COMMANDS = {"abc": "travel_{}_mm", "xyz": "rho_{}_mm"}
SPECS = {"abc": SPEC, "xyz": Machine.nominal().spec}


def sheet_text(legs: str, kinds: tuple[str, ...] = ("tcp",)) -> str:
    """The sheet that ``design --owns`` writes."""
    machine = Machine(SPECS[legs])
    return campaign_text(tool_sheets(machine, kinds), machine.spec)


def rows_of(text: str) -> list[Row]:
    return list(csv.DictReader(text.splitlines()))


def travel_of(rows: list[Row], legs: str) -> np.ndarray:
    """Travel from mechanical zero ``(n, 3)``, metres."""
    own = "travel_{}_mm" if "travel_x_mm" in rows[0] else COMMANDS[legs]
    shown = np.array([[float(row[own.format(leg)]) for leg in legs] for row in rows]) * 1e-3
    return shown - (Rig().L if own.startswith("rho") else 0.0)


def last_moves(travel: np.ndarray) -> np.ndarray:
    """Directions ``(n, 3)`` that each drive moved in last, row by row; 0 before it moved."""
    found, last = np.zeros_like(travel), np.zeros(3)
    for k in range(1, len(travel)):
        step = travel[k] - travel[k - 1]
        last = np.where(np.abs(step) > 1e-6, np.sign(step), last)
        found[k] = last
    return found


def filled(rows: list[Row], legs: str, lost: float, seed: int) -> list[Row]:
    """Rows read by a tracker on the independent machine, whose last leg loses motion."""
    travel, noise = travel_of(rows, legs), np.random.default_rng(seed)
    sides, zero, at = last_moves(travel), 6e-4, np.zeros((len(rows), 3))
    if legs == "abc":
        rig = DeltaRig(errors={"joint_offset.a": zero})
        for k, (own, side) in enumerate(zip(travel, sides, strict=True)):
            at[k] = rig.pose(own - [0.0, 0.0, lost / 2 * side[2]], at[k - 1])[0]
    else:
        loose = Rig(errors={"joint_offset.x": zero, "backlash.z": lost})
        at = loose.pose(travel + loose.L, sides).p
    return [
        row | {"reading_mm": f"{(p['xyz'.index(row['direction'])] + NOISE * e) * 1e3:.7f}"}
        if row["kind"] == "tcp"
        else row
        for row, p, e in zip(rows, at, noise.standard_normal(len(rows)), strict=True)
    ]


def without(rows: list[Row], start: str, *, blank: bool = False) -> list[Row]:
    """Rows without columns of a name that begins so, or with these empty."""
    if blank:
        return [{n: "" if n.startswith(start) else c for n, c in row.items()} for row in rows]
    return [{n: c for n, c in row.items() if not n.startswith(start)} for row in rows]


def written(path: Path, rows: list[Row]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def read(path: Path, spec: MachineFile) -> Readings:
    (found,) = read_readings(path, spec)
    return found


@pytest.mark.parametrize("legs", ["abc", "xyz"])
def test_a_sheet_of_the_tool_says_the_side_that_its_rows_lead_to(legs: str, tmp_path: Path) -> None:
    """Gone through row by row, moves included; without the columns the file says the same."""
    rows = rows_of(sheet_text(legs, ("tcp", "ballbar", "incline")))
    sides = last_moves(travel_of(rows, legs))
    kinds = [row["kind"] for row in rows]
    begins = [row["kind"] for k, row in enumerate(rows) if row["setup"] not in
              {earlier["setup"] for earlier in rows[:k]}]  # fmt: skip
    assert set(begins) == {"move"}
    assert [int(row["order"]) for row in rows] == list(range(1, len(rows) + 1))
    told = [[float(row[f"approach_{leg}"] or 0) for leg in legs] for row in rows]
    of_readings = [k for k, kind in enumerate(kinds) if kind != "move"]
    np.testing.assert_array_equal(np.array(told)[of_readings], sides[of_readings])
    bare = [row | {"reading_mm": "0", "reading_mrad": "0"} for row in without(rows, "approach_")]
    found = read(written(tmp_path / "bare.csv", bare), SPECS[legs])
    np.testing.assert_array_equal(found.approach, sides[of_readings])
    assert len(found.moves) == kinds.count("move")


@pytest.mark.thorough(except_for=["abc"])
@pytest.mark.parametrize("legs", ["abc", "xyz"])
def test_places_of_a_sheet_are_visited_again_from_the_same_side(legs: str) -> None:
    """Repeats enough to say what the instrument scatters by, as circles cross at six places."""
    tracker, bar = tool_sheets(Machine(SPECS[legs]), ["tcp", "ballbar"])
    assert len(repeat_steps(tracker)) == 18
    assert len(repeat_steps(bar)) == 6
    assert min((tracker.approach > 0).mean(), (tracker.approach < 0).mean()) > 0.3


def circled(legs: str, lost: float, seed: int) -> list[Row]:
    """Two circles that cross, gone through without moves, their sides not told."""
    rows = [row for row in rows_of(sheet_text(legs)) if row["kind"] != "move"]
    return without(filled(rows, legs, lost, seed), "approach_", blank=True)


@pytest.mark.thorough
def test_lost_motion_that_passes_for_noise_is_not_ruled_out(tmp_path: Path) -> None:
    """It was *adequate*, the noise of the readings, and lost motion was nowhere named."""
    file = written(tmp_path / "april.csv", circled("abc", LOST, 81))
    verdict = og.close_loop([file], Machine(SPEC))
    assert verdict.word == "adequate"
    told = " ".join(str(verdict).split())
    assert "consistent with the noise of" not in told
    assert "noise of the readings or lost motion" in told
    assert "that the drives have lost motion: the side of approach is not recorded" in told
    assert "approach_* is empty" in told
    assert "so lost motion passes for the noise of its repeats" in told
    verdict.report(tmp_path / "out")
    kept = json.loads((tmp_path / "out" / "result.json").read_text())
    assert {f"backlash.{leg}" for leg in "abc"} <= set(kept["invisible"])
    assert "that the drives have lost motion" in (tmp_path / "out" / "report.html").read_text()
    told_sides = filled(rows_of(sheet_text("abc")), "abc", 0.0, 81)
    sound = og.close_loop([written(tmp_path / "sound.csv", told_sides)], Machine(SPEC))
    assert "lost motion" not in str(sound)
    assert "consistent with the noise of the readings" in " ".join(str(sound).split())
