"""A defect that one station sees: of the machine or of the data, and nothing is thrown away."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks.blunders import Case, judge
from orthoglide.effects.bumps_and_jumps import travel_bumps
from orthoglide.effects.free_form import FreeForm
from orthoglide.explanation.corrections import with_faults_corrected
from orthoglide.explanation.fault_columns import command_derivatives
from orthoglide.explanation.faults import Fault, fault_message
from orthoglide.prediction import MeasurementModel
from tests import rig_campaigns as rc
from tests.factors import campaign_of, problem_of
from tests.rig import Rig
from tests.studied import studied

RIG2 = Path(__file__).parent / "data" / "rig2"


@pytest.fixture(scope="module")
def bumpy() -> og.Verdict:
    """A rail with a bump of 0.1 mm at one station."""
    return og.close_loop([og.read_campaign(RIG2 / "c4.csv")])


def test_a_bump_and_a_wrong_command_stand_in_one_set(bumpy: og.Verdict) -> None:
    assert (bumpy.word, bumpy.blunders) == ("ambiguous", ())
    (found,) = bumpy.located
    first = found.members[0]
    assert (first.leg, first.part, first.direction) == ("x", "rail", "z")
    assert first.name.endswith("@-50")
    assert first.size == pytest.approx(1e-4, rel=0.2)
    outlier, command = sorted(found.data, key=lambda rival: len(rival.rows))
    assert (outlier.data, command.data) == ("outlier", "command")
    assert set(outlier.rows) == {20, 28, 48, 56, 76, 84}  # the dial that reads along z
    assert set(command.rows) == {19, 20, 27, 28, 47, 48, 55, 56, 75, 76, 83, 84}
    odds = sum(m.probability for m in found.members)
    odds += outlier.probability + command.probability
    assert odds == pytest.approx(1.0, abs=0.05)


def test_the_sentence_names_all_three(bumpy: og.Verdict) -> None:
    text = " ".join(str(bumpy).split())
    assert "toward z at travel −50 mm and nowhere else, by +0.1 mm" in text
    fault = "fault of the data:"
    assert text.startswith(
        f"A {fault} another command than the one written in c4.csv, line 19 and 11 more. Or"
    )
    assert (
        f"Or a {fault} one dial that reads wrong at one place in c4.csv, line 20 and 5 more."
        in text
    )
    assert "These readings cannot tell which." in text


def test_the_posture_and_its_neighbours_are_read_again(bumpy: og.Verdict) -> None:
    assert bumpy.actions[0].kind == "measure"
    assert "the posture of line 19 and the nearest postures once more" in bumpy.actions[0].words
    sheet = bumpy.next_sheet
    assert sheet is not None
    travel = (sheet.command[:, 0] - og.Machine.nominal().geometry.L) * 1e3
    assert np.isclose(travel, -50, atol=0.5).any()
    assert len(np.unique(np.round(travel, 0))) > 1


def test_a_calibrated_machine_keeps_its_bump(bumpy: og.Verdict, tmp_path: Path) -> None:
    out = tmp_path / "out"
    bumpy.report(out)
    again = og.Machine.load(out / "calibrated.toml")
    place = _bump(-0.05).effect.name
    assert any(str(name).startswith(place) for name in again.values)
    L = og.Machine.nominal().geometry.L
    at, far = np.array([[L - 0.05, L, L]]), np.array([[L + 0.03, L, L]])
    sound = again.with_parameters({n: 0.0 for n in again.values if str(n).startswith(place)})
    moved = [np.linalg.norm(again.forward(rho) - sound.forward(rho)) for rho in (at, far)]
    assert moved[0] > 1e-8  # a rail's error across moves the leg, and the tool hardly
    assert moved[1] < 1e-6 * moved[0]


def test_a_wide_bump_of_a_rail_is_no_curve_of_the_dial() -> None:
    """Too wide for a bump and too narrow for a smooth path: a curve of the dial was likelier."""
    errors = {"joint_offset.x": 1.2e-3, "joint_offset.y": -7e-4, "joint_offset.z": 4e-4}
    rig = Rig(errors=errors, extra=(rc.bump(2, 1, -1.2e-4, -0.05, 0.032),))
    rows = rc.simulate(rig, "sweep", np.random.default_rng(1), background=0.015)
    verdict = og.close_loop([campaign_of(rows)])
    (found,) = verdict.located
    on_rail = [m for m in found.members if (m.leg, m.part, m.direction) == ("z", "rail", "y")]
    assert sum(m.probability for m in on_rail) > 0.9
    assert found.members[0].size == pytest.approx(-1.2e-4, rel=0.15)
    assert "within 64 mm of travel −50 mm and nowhere else" in " ".join(str(verdict).split())


def _bump(at: float) -> FreeForm:
    """Of the x rail toward z, the narrowest."""
    machine, travel = og.Machine.nominal(), [[at], [], []]
    geometry = machine.geometry
    bumps = travel_bumps(travel, machine.catalogue.legs, geometry.stroke, geometry.scale)
    return next(bump for bump in bumps if bump.location_key == "rail.x.z/travel")


def test_one_dial_off_at_one_place_at_every_visit_is_no_exchange() -> None:
    """On a nearly nominal machine other labels fit readings with a corrected command as well."""
    sheet = og.protocol("standard")
    setup, station = 5, 37
    offsets = {"joint_offset.x": 1e-5, "joint_offset.y": -1e-5, "joint_offset.z": 2e-5}
    given = og.simulate(og.Machine.nominal().with_parameters(offsets), sheet, noise=5e-6, seed=4)
    same = (given.setup == setup) & (given.command == given.command[station]).all(axis=1)
    spoilt = given.with_readings(given.reading + 3e-4 * same)
    verdict = studied([spoilt], noise=5e-6)
    rivals = [rival for located in verdict.located for rival in located.data]
    kinds = {fault.kind for fault in verdict.blunders} | {rival.data for rival in rivals}
    assert kinds <= {"command", "outlier"}
    words = [fault.message for fault in verdict.blunders] + [rival.words for rival in rivals]
    assert any("'zy-0.5' alone reads 0.3 mm too much here, at each of 3 visits" in w for w in words)


def test_a_command_mistyped_at_one_of_three_visits_is_no_drift() -> None:
    sheet = og.protocol("standard")
    offsets = {"joint_offset.x": 4e-4, "joint_offset.y": -8e-4, "joint_offset.z": 1.2e-3}
    worn = og.Machine.nominal().with_parameters(offsets)
    last = (sheet.repeat == 3) & (np.array(sheet.posture) == "max") & (sheet.leg == 0)
    command = sheet.command.copy()
    command[last, 0] -= 3e-3
    driven = og.simulate(worn, replace(sheet, command=command), noise=5e-6, seed=2)
    verdict = studied([replace(driven, command=sheet.command)], noise=5e-6)
    (fault,) = verdict.blunders
    assert (verdict.word, fault.kind, len(fault.rows_in_request)) == (
        "adequate",
        "command",
        last.sum(),
    )


def test_a_corrected_command_explains_what_it_changed() -> None:
    """At zero travel a drive moves the dials on its own leg to second order only: there a wrong
    command explained nothing once it was corrected, and waves of the drive took its place.
    """
    errors = {"joint_offset.x": 1.2e-3, "joint_offset.y": -7e-4, "joint_offset.z": 4e-4}
    rows = rc.simulate(Rig(errors=errors), "sweep", np.random.default_rng(1))
    wrong = [k for k, r in enumerate(rows) if (r["leg"], r["posture"]) == ("y", "+0")]
    for k in wrong:
        rows[k]["rho_y_mm"] += 10.0
    fit = og.identify([campaign_of(rows)])
    fault = Fault("command", np.array(wrong), -1e-2, drive=1)
    corrected, values = with_faults_corrected(fit.problem, [fault]), fit.problem.values(0, fit.x)
    model = fit.problem.machine.model
    written, right = (
        MeasurementModel(p.campaigns[0]).predict(model, values) for p in (fit.problem, corrected)
    )
    change = (right - written)[wrong]
    slopes = command_derivatives(corrected, fit.x, right, [fault])[wrong, 1]
    assert slopes * fault.size == pytest.approx(change, abs=1e-12)
    at_corrected = command_derivatives(corrected, fit.x, right)[wrong, 1]
    assert np.abs(at_corrected * fault.size).max() < 0.3 * np.abs(change).max()


@pytest.mark.thorough
def test_a_large_wrong_command_is_compared_where_it_is_corrected() -> None:
    """One dial of the posture was said to read wrong: about the command as written, 10 mm are far
    from linear, so that the other dial contradicted them.
    """
    record = judge(Case("worn", "command, less worn", 10.0, 0), 90001)
    assert record["right_size"]
    assert record["right_rows"]


def test_a_bump_that_is_visited_from_both_sides_is_no_certain_command() -> None:
    """Both visits agreed, and the wrong command alone was named, corrected and called adequate."""
    rig = Rig(extra=(rc.bump(0, 1, 1e-4, -0.025),))
    rows = rc.protocol_rows("sweep", repeats=1)
    rows = rc.simulate(rig, rows, np.random.default_rng(2), background=0.015)
    outcome = studied([campaign_of(rows)], noise=5e-6)
    assert (outcome.word, outcome.blunders) == ("ambiguous", ())
    (found,) = outcome.located
    assert "rail.x.y/travel@-25" in {member.name for member in found.members}
    assert {rival.data for rival in found.data} == {"command", "outlier"}


def test_a_bump_that_two_dials_of_one_direction_read_is_located() -> None:
    """They read each posture once, and a command of 0.2 mm too much was named, as a fault."""
    rig = Rig(extra=(rc.bump(0, 2, -1e-4, -0.025),))
    once = dict[tuple[object, ...], rc.Row]()
    for row in rc.protocol_rows("two-gauges", repeats=1):
        once.setdefault((row["setup"], *(row[c] for c in rc.RHO)), row)
    simulated = rc.simulate(rig, [*once.values()], np.random.default_rng(3), background=0.015)
    outcome = studied([campaign_of(simulated)], noise=5e-6)
    assert outcome.blunders == ()
    (found,) = outcome.located
    assert found.members[0].name == "rail.x.z/travel@-25"


@pytest.mark.parametrize("repeats", [1, 2])
def test_a_fault_of_what_was_visited_once_is_said_to_be_that(repeats: int) -> None:
    """A bump of a rail had been taken for a wrong command, or for a noisy dial, without a word."""
    machine, rng = og.Machine.nominal(), np.random.default_rng(0)
    rows = rc.simulate(Rig(), rc.protocol_rows("standard", repeats=repeats), rng)
    campaign = campaign_of(rows, machine)
    problem = problem_of(machine, [campaign], ["joint_offset"])
    of_leg = campaign.leg == 0
    at_max = np.flatnonzero(of_leg & (np.array(campaign.posture) == "max"))
    of_dial = np.flatnonzero(of_leg & (campaign.axis == 1))
    for fault in (Fault("command", at_max, 1e-3, drive=0), Fault("noisy", of_dial, 4.0)):
        said = "; nothing here was visited twice" in fault_message(problem, fault)
        assert said == (repeats == 1)
