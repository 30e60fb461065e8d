"""Every figure shown to people against its value in SI; millimetres beside milliradians."""

from __future__ import annotations

import csv
import io
import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.closing import RunOutcome, build_result, compute_outcome
from orthoglide.effects import CATALOGUE
from orthoglide.effects.wording import confirm_words, value_words
from orthoglide.fit import Estimate
from orthoglide.machine import Machine
from orthoglide.mechanism.tree import load
from orthoglide.numerals import compact
from orthoglide.observations import Readings, concatenated
from orthoglide.planning.sheets import instrument_sheet
from orthoglide.report import report_files, result_text
from orthoglide.report.rows import parameter_rows, score_rows
from orthoglide.report.sentences import headline
from orthoglide.result import Request
from orthoglide.verdict import Verdict, run
from tests.studied import studied

RIG = Path(__file__).parent / "data" / "rig"


@pytest.mark.parametrize(
    ("name", "value", "told", "expected"),
    [
        ("thermal_growth.y", 3e-6, "grow by 3 µm a metre and kelvin", "30 µm a metre longer"),
        ("thermal_drift.z", -2e-8, "shrink by 72 µm a metre and hour", "72 µm a metre shorter"),
        ("gauge_drift.a", 1e-8, "0.036 mm an hour", "grow by 0.036 mm"),
    ],
)
def test_what_time_and_warmth_do_is_said_alike_in_every_sentence(
    name: str, value: float, told: str, expected: str
) -> None:
    parameter = CATALOGUE.parameter(name, ("a",))
    assert told in value_words(CATALOGUE[parameter.effect], parameter, value)
    assert expected in confirm_words(CATALOGUE[parameter.effect], parameter, value)


def test_a_misfit_is_as_large_as_its_largest_entry_whatever_its_sign() -> None:
    tree = load()
    residual = np.linspace(1e-6, 2e-6, 21)
    names = list(tree.rows)
    for name in names:
        residual[tree.rows[name].start] = -3e-4 * (1 + names.index(name))
    assert tree.by_loop(residual) == pytest.approx({n: 3e-4 * (1 + names.index(n)) for n in names})


# -- a whole result -------------------------------------------------------------------------------


@cache
def found() -> og.Verdict:
    return build_result(closed(), og.Verdict)


@cache
def closed() -> RunOutcome:
    """An identification of lengths, angles, ratios and speeds."""
    machine = og.Machine.load(RIG / "machine.toml")
    free = ["joint_offset", "leg_length", "axis_tilt", "gauge_drift", "gauge_scale"]
    campaign = og.read_campaign(RIG / "rig-2.csv", machine.spec)
    return compute_outcome(Request("identify", (campaign,), machine, free=tuple(free)))


def test_values_sigmas_and_tolerances_share_one_unit() -> None:
    """Against the estimate in SI and the machine file's own numbers."""
    after = found().after
    si = {"mm": 1e-3, "rad": 1.0, "1": 1.0, "mm/s": 1e-3}
    written = {"joint_offset": 2.0, "leg_length": 0.1, "axis_tilt": 2e-3}
    written |= {"gauge_drift": 5e-5, "gauge_scale": 0.02}
    rows, table = parameter_rows(found()), found().columns
    tolerances = dict(zip(table["parameter"], table["tolerance"], strict=True))
    assert {r.unit for r in rows} == set(si)
    told = json.loads(result_text(found()))["parameters"]
    assert set(told) == {r.name for r in rows} == set(after.names)
    for row in rows:
        unit, places = si[row.unit], len(row.sigma.partition(".")[2])
        half = 0.51 * 10.0**-places
        assert tolerances[row.name] == pytest.approx(written[row.name.split(".")[0]])
        assert row.tolerance == compact(tolerances[row.name])
        assert float(row.value.replace("−", "-")) * unit == pytest.approx(
            after.values[row.name], abs=half * unit
        )
        assert float(row.sigma) * unit == pytest.approx(after.sigmas[row.name], abs=half * unit)
        entry = told[row.name]
        assert entry["value"] * unit == pytest.approx(after.values[row.name], rel=1e-6)
        assert entry["sigma"] * unit == pytest.approx(after.sigmas[row.name], rel=1e-6)
        assert entry["unit"] == row.unit


def test_keys_in_millimetres_hold_millimetres() -> None:
    told, after = json.loads(result_text(found())), closed().after
    assert told["noise_mm"] == pytest.approx(after.problem.noise.typical * 1e3)
    for side, scores in (("after", after.scores), ("nominal", after.nominal)):
        for key in ("rms", "deviation_rms", "max", "cv_rms"):
            value = getattr(scores, key)
            if np.isfinite(value):
                assert told[side][f"{key}_mm"] == pytest.approx(value * 1e3, rel=1e-6)
    assert 0.003 < told["noise_mm"] < 0.03  # a dial with divisions of 0.01


# -- dials, tracker and level in one campaign ------------------------------------------------------


MACHINE = Machine.nominal()
ERRORS = {"joint_offset.x": 8e-4, "joint_offset.y": -5e-4}


def tool(*kinds: str, errors: dict[str, float] = ERRORS) -> Readings:
    """Places of the tool that instruments read once."""
    sheets = [instrument_sheet(MACHINE, kind) for kind in kinds]
    firsts = [
        sheet.subset(
            np.sort(np.unique([*sheet.stations.T, sheet.axis], axis=1, return_index=True)[1])
        )
        for sheet in sheets
    ]
    return og.simulate(MACHINE.with_parameters(errors), concatenated(firsts), noise=2e-6, seed=11)


TWISTED = {**ERRORS, "mount_tilt.x.a": 0.012}


@cache
def with_level() -> RunOutcome:
    """A hinge that hardly moves the tool, and turns the platform."""
    return studied([tool("tcp", "incline", errors=TWISTED)], MACHINE)


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
    level = tool("incline", errors={"joint_offset.x": 5e-4})
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
