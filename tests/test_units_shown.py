"""Every figure shown to people against its value in SI, worked out by hand."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from orthoglide.closing import RunOutcome, build_result, compute_outcome
from orthoglide.effects import CATALOGUE, catalogue_of
from orthoglide.effects.wording import confirm_words, size_words, value_words
from orthoglide.layout import LinearDelta
from orthoglide.mechanism.tree import load
from orthoglide.numerals import compact
from orthoglide.report import result_text
from orthoglide.report.rows import parameter_rows
from orthoglide.result import Request

RIG = Path(__file__).parent / "data" / "rig"

# Effect: a value in SI, and how its size is said.
SIZES = {
    "joint_offset": (4e-4, "0.4 mm"),
    "encoder_scale": (3e-3, "0.3 %"),
    "screw_error": (5e-5, "0.05 mm"),
    "backlash": (6e-5, "0.06 mm"),
    "drive_compliance": (5e-7, "0.5 µm a newton"),
    "axis_offset": (-2.5e-3, "2.5 mm"),
    "axis_tilt": (2e-3, "2 mrad (0.2 mm over 100 mm)"),
    "rail_tilt": (-4e-4, "0.4 mrad (0.04 mm over 100 mm)"),
    "rail_bow": (1e-4, "0.1 mm"),
    "mount_tilt": (7e-3, "7 mrad"),
    "leg_length": (-3e-5, "0.03 mm"),
    "bar_mismatch": (2e-3, "2 mm"),
    "parallelogram_width": (1e-3, "1 mm"),
    "thermal_growth": (3e-6, "3 µm a metre and kelvin"),
    "thermal_drift": (2e-8, "72 µm a metre and hour"),
    "gauge_direction": (0.02, "20 mrad"),
    "gauge_scale": (-0.015, "1.5 %"),
    "gauge_drift": (1e-8, "0.036 mm an hour"),
    "plate_bow": (-2e-4, "0.2 mm"),
    "plate_saddle": (-3e-4, "0.3 mm"),
    "plate_trefoil": (3e-4, "0.3 mm"),
}


def test_every_size_is_said_in_its_unit() -> None:
    assert all(e.words.size is None for n, e in CATALOGUE.items() if n not in SIZES)
    every = dict(catalogue_of(LinearDelta.names)) | dict(CATALOGUE)
    for name, (value, said) in SIZES.items():
        assert size_words(every[name], value) == said
        assert size_words(every[name], -value) == said


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
