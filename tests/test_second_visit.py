"""A calibrated machine measured again: its file is a prior; verdicts speak of its total error."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from benchmarks import second_visit
from orthoglide.checking import check
from tests.rig import Rig
from tests.rig_campaigns import drive_step, protocol_rows, s_curve, simulate
from tests.studied import studied
from tests.test_checking import delta, probed

SHEET = og.Machine.load(Path(__file__).parent / "data" / "rig" / "machine.toml")
ERRORS = {"joint_offset.x": 8e-4, "joint_offset.y": -5e-4, "leg_length.z": 5e-5}
TILT = "axis_tilt.y.z"


def measured(errors: dict[str, float], seed: int, name: str) -> og.Campaign:
    return campaign_of(Rig(errors=errors, screw_pitch=0.02), seed, name)


def campaign_of(rig: Rig, seed: int, name: str, noise: float = 5e-6) -> og.Campaign:
    rng, step = np.random.default_rng(seed), 2 * noise
    rows = simulate(rig, protocol_rows("sweep"), rng, noise=noise, resolution=step)
    return og.Campaign.from_frame({k: [r[k] for r in rows] for k in rows[0]}, name=name)


@pytest.mark.thorough
def test_what_changed_is_said_first(tmp_path: Path) -> None:
    from orthoglide.report.sentences import claim_text

    first = og.close_loop(measured(ERRORS, 3, "first"), SHEET)
    first.machine.save(tmp_path / "calibrated.toml")
    known = og.Machine.load(tmp_path / "calibrated.toml")
    text = claim_text(og.close_loop(measured({**ERRORS, "backlash.x": 6e-5}, 4, "second"), known))
    between = "Between calibrated.toml and second the backlash of leg x changed from "
    assert text.startswith(between), text
    said = re.match(r"\S+ to ([\d.]+) mm", text.removeprefix(between))
    assert said is not None, text
    assert float(said[1]) == pytest.approx(0.06, abs=0.01)
    assert "Nothing else is wrong" in text


@pytest.mark.thorough
def test_two_strong_faults_are_named_and_the_one_put_right_is_told(tmp_path: Path) -> None:
    """Either alone is no better than a wide background: both were called adequate, the tilt was
    shared out among all that resembles it, and its repair was told with the wrong sign.
    """
    both = {**ERRORS, TILT: 3e-3, "backlash.x": 6e-5}
    first = og.close_loop(measured(both, 1, "first"), SHEET)
    assert first.word == "explained"
    assert {c.name for c in first.effects} in (
        {TILT, "backlash.x"},
        {"rail_tilt.y.z", "backlash.x"},
    )
    assert first.values["backlash.x"] == pytest.approx(6e-5, abs=5e-6)
    first.machine.save(tmp_path / "calibrated.toml")
    known = og.Machine.load(tmp_path / "calibrated.toml")
    again = og.close_loop(measured({**both, TILT: 2e-4}, 2, "second"), known)
    (change,) = again.changed
    assert TILT in (change.parameter, *change.members)
    assert change.before == pytest.approx(3e-3, abs=1e-4)
    assert change.after == pytest.approx(2e-4, abs=3 * change.sigma)
    assert again.word == "adequate"


@pytest.mark.thorough
def test_a_tower_that_leans_since_the_calibration_is_told_in_full(tmp_path: Path) -> None:
    """Four tolerances: it was told by half, and what that left was called the readings' noise."""
    first = og.close_loop([probed("probe", 1)], delta())
    first.machine.save(tmp_path / "calibrated.toml")
    known = og.Machine.load(tmp_path / "calibrated.toml")
    again = og.close_loop([probed("probe", 2, **{"axis_tilt.b.radial": 1.2e-2})], known)
    (change,) = [c for c in again.changed if "axis_tilt.b.radial" in c.members]
    assert change.after - change.before == pytest.approx(1.2e-2, rel=0.15)
    assert again.after.scores.chi2 < 1.5 * again.after.scores.dof


TOWERS = {"axis_offset.a.radial": 5e-4, "axis_offset.b.radial": 8e-4, "axis_offset.c.radial": 5e-4}
"""All displaced by 0.5 mm, b from where it stood."""
BENT = {"plate_bow.bed": 1.5e-4}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("before", "after", "by"),
    [
        ({}, TOWERS, {"axis_offset.radial.common": 5e-4, "plate_bow.bed": 1.5e-4}),
        ({}, BENT, {"axis_offset.radial.common": 5e-4, "plate_bow.bed": 1.5e-4}),
        (BENT, {}, {"axis_offset.radial.common": -5e-4, "plate_bow.bed": -1.5e-4}),
    ],
)
def test_a_plate_that_bent_since_the_calibration_is_in_the_class(
    before: dict[str, float], after: dict[str, float], by: dict[str, float]
) -> None:
    """It was told as one leg's parallelogram, far beyond its sigma, and towers that were displaced
    together as single ones.
    """
    known = og.close_loop([probed("probe", 1, **before)], delta()).machine
    again = studied([probed("probe", 2, **after)], known)
    (change,) = again.changed
    for name, size in by.items():
        assert change.change_by_member[name] == pytest.approx(size, rel=0.25)
    assert change.after - change.before == pytest.approx(by[change.parameter], rel=0.25)
    assert again.word == "adequate"
    legs = [again.values[f"axis_offset.{leg}.radial"] for leg in "abc"]
    moved = [legs[k] - known.values[f"axis_offset.{'abc'[k]}.radial"] for k in range(3)]
    assert np.ptp(moved) < 5e-5  # together, or none of them


@pytest.mark.thorough
def test_a_plate_that_is_as_bent_as_it_was_has_not_changed() -> None:
    for shape in (BENT, {"plate_trefoil.bed.cos": 2.5e-4}):
        known = og.close_loop([probed("probe", 1, **shape)], delta()).machine
        assert og.close_loop([probed("probe", 2, **shape)], known).changed == ()


@pytest.mark.thorough
def test_what_is_left_after_many_changes_at_once_is_told_of_the_new_readings() -> None:
    """Zeros entered and a drive mended in one visit: closed together, dials of the old one were
    blamed for what the two states differ in.
    """
    zeros = {"joint_offset.x": 6e-4, "joint_offset.y": -1.2e-3}
    old = measured({**zeros, "backlash.z": 1.5e-4, TILT: 6e-3}, 7, "old")
    found = check([old], [measured({TILT: 6e-3}, 8, "new")], SHEET)
    assert {d.parameter for d in found.differences if d.changed} == {*zeros, "backlash.z"}
    (left,) = found.verdict.effects
    assert {one.name for one in left.explanations} == {TILT, "rail_tilt.y.z"}
    assert found.verdict.after.scores.rms < 7e-6


@pytest.mark.thorough
def test_what_the_first_sheet_did_not_see_is_no_change(tmp_path: Path) -> None:
    """Dials on the middle of both bars hardly see a width; touched bar by bar it was a change."""
    errors, rng = {**ERRORS, "parallelogram_width.x": 1.5e-4}, np.random.default_rng(6)
    file = tmp_path / "out" / "calibrated.toml"
    og.close_loop(measured(errors, 1, "first"), og.Machine.nominal()).report(str(file.parent))
    bars = [{**r, "bar": b, "setup": f"{r['setup']}-{b}", "order": 2 * r["order"] + b - 1}
            for r in protocol_rows("sweep") for b in (1, 2)]  # fmt: skip
    rows = simulate(Rig(errors=errors, screw_pitch=0.02), bars, rng, noise=5e-6)
    second = og.Campaign.from_frame({k: [r[k] for r in rows] for k in rows[0]}, name="second")
    again = og.close_loop(second, og.Machine.load(file))
    assert not again.changed
    (told,) = (w for w in again.warnings if "parallelogram width" in w)
    assert "nothing shows that it changed" in told
    assert again.values["parallelogram_width.x"] == pytest.approx(1.5e-4, abs=4e-5)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "curve",
    [s_curve(1, 0, 1e-4), drive_step(0, 1.5e-4, at=-0.01)],
)
def test_a_located_curve_that_was_mended_is_what_changed(curve: Any) -> None:
    """Tilts and bows of other legs were told at ten to twenty sigma, each to be put right."""
    states = [
        campaign_of(Rig(errors=ERRORS, screw_pitch=0.02, extra=extra), seed, name)
        for seed, (name, extra) in enumerate((("bent", (curve,)), ("mended", ())))
    ]
    found = check([states[0]], [states[1]], SHEET)
    (gone,) = found.gone
    assert not found.come
    assert not found.changes
    assert found.sentences[0].startswith(
        f"what was located before shows no more: {gone.members[0].place.words}"
    )
    assert found.line.startswith("Changed: what is located.")
    back = check([states[1]], [states[0]], SHEET)
    assert [one.name for one in back.come] == [gone.name]
    assert back.sentences[0].startswith("located now, and not before: ")
    # By what the calibration alone keeps it is told less well, and that is said.
    again = og.close_loop([states[1]], og.close_loop([states[0]], SHEET).machine)
    assert any("run orthoglide check on" in str(note) for note in again.warnings)
    assert not any("from" in change.what.partition("changed")[2] for change in again.changed)


@pytest.mark.thorough
def test_a_place_that_a_poorer_sheet_cannot_show_is_not_gone() -> None:
    """A sheet of three postures names the same curve a bow, or nothing at all."""
    rig = Rig(errors=ERRORS, screw_pitch=0.02, extra=(s_curve(1, 0, 1e-4),))
    rows = simulate(rig, protocol_rows("standard"), np.random.default_rng(1))
    poor = og.Campaign.from_frame({k: [r[k] for r in rows] for k in rows[0]}, name="poor")
    found = check([campaign_of(rig, 0, "rich")], [poor], SHEET)
    assert not found.gone
    assert not found.come
    assert "located" not in found.line.partition(". Verdict")[0]


@pytest.mark.thorough
def test_a_cause_that_was_one_of_several_is_told_by_how_much_it_changed(tmp_path: Path) -> None:
    """Sound bars were said to be 0.74 mm unequal now, and to be put back."""
    hinge = {**ERRORS, "mount_tilt.z.b": -9.7e-3}
    first = og.close_loop(measured(hinge, 1, "first"), SHEET)
    rivals = {r.name for cause in first.effects for r in (*cause.same, *cause.rivals)}
    assert first.word == "ambiguous"
    assert {"mount_tilt.z.b", "bar_mismatch.z"} <= rivals | {c.name for c in first.effects}
    first.machine.save(tmp_path / "calibrated.toml")
    known = og.Machine.load(tmp_path / "calibrated.toml")
    again = studied(measured({**hinge, "mount_tilt.z.b": -3e-4}, 2, "second"), known)
    (note,) = [str(note) for note in again.after.warnings if "run orthoglide check on" in str(note)]
    assert "bar_mismatch.z" in note
    for change in again.changed:
        assert change.change_by_member["mount_tilt.z.b"] == pytest.approx(9.4e-3, rel=0.1)
        assert "changed by" in change.message
    told = " ".join(str(action.words) for action in again.actions)
    assert "put back" not in told
    assert not any("expect" in one.confirm for a in again.actions for one in a.options)


@pytest.mark.thorough
def test_what_did_not_change_says_what_there_was_before() -> None:
    """Where both visits leave the zeros of all legs open together: one was 4.5 sigmas off."""
    record = second_visit.run((1, "two-gauges", 29), 4040)
    (told,) = record["file"]
    assert abs(told["apart"]) < 3
    assert told["by"] == pytest.approx(record["changed"]["joint_offset.z"], abs=6e-5)


@pytest.mark.thorough
def test_a_dial_of_a_micrometre_is_drawn_up_after_a_second_visit() -> None:
    """What is known best is a difference of large numbers, and was no covariance for rounding."""
    errors = {**ERRORS, "rail_bow.x.z": 1.5e-4, "encoder_scale.y": 7e-4}
    fine = replace(SHEET.spec, dial=replace(SHEET.spec.dial, resolution=1e-6, repeatability=5e-7))
    known = og.Machine(fine)
    for seed in (1, 2, 3):
        result = og.close_loop([campaign_of(Rig(errors=errors), seed, f"no{seed}", 5e-7)], known)
        assert result.word in ("adequate", "explained", "ambiguous")
        assert all(np.isfinite(item.gain) for item in result.budget)
        assert result.actions
        known = result.machine
        covariance = known.posterior.covariance
        sd = np.sqrt(np.diag(covariance))
        seen = sd > 0
        unit = (covariance / np.outer(sd, sd).clip(1e-300))[np.ix_(seen, seen)]
        assert np.linalg.eigvalsh(unit).min() > -1e-12
