"""Dials, tracker and level in one campaign: what is told of each is in its own unit and share."""

import csv
import io
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orthoglide.closing import RunOutcome, build_result
from orthoglide.fit import Estimate
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.observations import Readings
from orthoglide.report import report_files, result_text
from orthoglide.report.rows import score_rows
from orthoglide.report.sentences import headline
from orthoglide.result import Request
from orthoglide.verdict import Verdict, close_loop, run
from tests.studied import studied

MACHINE = Machine.nominal()
ERRORS = {"joint_offset.x": 8e-4, "joint_offset.y": -5e-4}


def tool(
    kinds: tuple[str, ...], noise: float = 2e-6, odd: float = 0.0, errors: dict[str, float] = ERRORS
) -> Readings:
    """Places read by a tracker along all axes, or by a level about two, or touched; odd ones."""
    rng = np.random.default_rng(11)
    high = [1.0, 1.0, 0.0 if "plate" in kinds else 1.0]
    rho = MACHINE.inverse(rng.uniform(-0.05, 0.05, (24, 3)) * high)
    truth = MACHINE.with_parameters(errors)
    pose, rows = truth.pose(rho), []
    turn = 0.5 * (pose.R[:, [2, 0, 1], [1, 2, 0]] - pose.R[:, [1, 2, 0], [2, 0, 1]])
    for kind in kinds:
        seen = {"tcp": pose.p, "incline": turn, "plate": pose.p[:, 2:]}[kind]
        for k, j in np.ndindex(len(rho), {"tcp": 3, "incline": 2, "plate": 1}[kind]):
            value = seen[k, j] + noise * rng.standard_normal() + odd * rng.choice([-1, 1])
            way = "" if kind == "plate" else "xyz"[j]
            rows.append((kind, kind, way, *rho[k] * 1e3, value * 1e3, kind == "incline"))
    names = ("kind", "setup", "direction", "rho_x_mm", "rho_y_mm", "rho_z_mm")
    frame = {name: [row[k] for row in rows] for k, name in enumerate(names)}
    frame["reading_mm"] = ["" if row[7] else row[6] for row in rows]
    if "incline" in kinds:
        frame["reading_mrad"] = [row[6] if row[7] else "" for row in rows]
    return Readings.from_frame(frame, name="tool")


TWISTED = {**ERRORS, "mount_tilt.x.a": 0.012}


@cache
def with_level() -> RunOutcome:
    """A hinge that hardly moves the tool, and turns the platform."""
    return studied([tool(("tcp", "incline"), errors=TWISTED)], MACHINE)


def left_of(closed: RunOutcome, of: str, stage: Estimate) -> float:
    (points,) = (f.readings for f in closed.after.problem.tool_factors)
    return float(np.sqrt(np.mean(stage.residuals[points.of_kind(of)] ** 2)) * 1e3)


@pytest.mark.thorough
def test_millimetres_and_milliradians_are_told_apart() -> None:
    closed, verdict = with_level(), build_result(with_level(), Verdict)
    before, after = closed.before, closed.after
    mm, mrad = (
        [left_of(closed, kind, stage) for stage in (before, after)] for kind in ("tcp", "incline")
    )
    assert mrad[0] > 50 * mrad[1]
    told = json.loads(result_text(verdict))
    for side, k in (("before", 0), ("after", 1)):
        assert told[side]["rms_mm"] == pytest.approx(mm[k])
        assert told[side]["rms_mrad"] == pytest.approx(mrad[k])
        assert told[side]["cv_rms_mrad"] < 2 * mrad[k]
        assert told[side]["max_mrad"] < 4 * mrad[k]
    assert told["noise_mm"] == pytest.approx(0.01)
    assert told["noise_mrad"] == pytest.approx(0.02)
    assert all("readings_rms_mrad" in item for item in told["budget"])
    said = rf"from [\d.]+ to {mm[1]:.3f} mm rms, and (falls )?from {mrad[0]:.3f} to [\d.]+ mrad rms"
    assert re.search(said, headline(verdict))
    rows = {row.what: row for row in score_rows(verdict)}
    assert float(rows["residuals, rms, mrad"].before) == pytest.approx(mrad[0], abs=1e-3)
    assert float(rows["largest residual, mm"].after) < 4 * mm[1]
    assert f"{mrad[1]:.4f} mrad" in repr(after)
    assert f"{mm[1]:.4f} mm" in repr(after)


def test_what_readings_do_not_see_is_said() -> None:
    """A level sees no zeros: an offset of 0.5 mm was told as nominal to 0.02 mm."""
    level = tool(("incline",), errors={"joint_offset.x": 5e-4})
    said = headline(run(Request("identify", (level,), MACHINE)))
    assert "These readings do not see the joint offsets" in said
    assert "consistent with the noise of the readings (0.020 mrad)" in said


@pytest.mark.thorough
def test_residuals_stand_under_their_units() -> None:
    closed = with_level()
    (points,) = (f.readings for f in closed.after.problem.tool_factors)
    files = report_files(build_result(closed, Verdict))
    table = list(csv.DictReader(io.StringIO(files["residuals.csv"])))
    assert [row["kind"] for row in table] == list(points.kind)
    residuals = closed.after.residuals * 1e3
    for row, left, reading in zip(table, residuals, points.reading * 1e3, strict=True):
        own, other = ("mrad", "mm") if row["kind"] == "incline" else ("mm", "mrad")
        assert float(row[f"residual_after_{own}"]) == pytest.approx(left, abs=1e-6)
        # A tracker's frame is turned to the machine before it is fitted.
        assert float(row[f"reading_{own}"]) == pytest.approx(reading, abs=2e-6)
        figures = [v for k, v in row.items() if k.endswith(f"_{other}") and not k.startswith("rho")]
        assert set(figures) == {""}
        assert row["direction"] in set("xyz")


def quiet(verdict: Verdict) -> list[Note]:
    return [note for note in verdict.after.warnings if note.kind == "quiet"]


def test_an_instrument_beside_others_is_asked_about_by_itself() -> None:
    given = tool(("tcp", "incline"), 1e-5)
    small = np.where(given.of_kind("incline"), given.reading / 57.3, given.reading)
    (note,) = quiet(close_loop([replace(given, reading=small)], MACHINE))
    assert "setup 'incline'" in note
