"""Faults of the data are found and named, and physics is not taken for one."""

import csv
import io
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orthoglide.errors import InputError
from orthoglide.explanation import data_faults, ranked_readings
from orthoglide.explanation.alternative_readings import alternative_readings, setups_to_reinterpret
from orthoglide.explanation.corrections import with_exact_size
from orthoglide.explanation.data_faults import (
    DataFindings,
    find_data_faults,
    report_faults,
    without_faults,
)
from orthoglide.explanation.faults import Fault, setups_of
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate, solve
from orthoglide.machine import Machine
from orthoglide.machine_file import Controller
from orthoglide.observations import Campaign, read_campaign
from orthoglide.progress import Step
from orthoglide.report.folder import residual_table
from orthoglide.result import DataFault, DataRival
from orthoglide.verdict import close_loop
from tests import rig_campaigns as rc
from tests.factors import campaign_of
from tests.rig import Rig
from tests.studied import studied

PUBLISHED = Path(__file__).parents[1] / "orthoglide" / "data"
BASE = {"joint_offset.x": 1.2e-3, "joint_offset.y": -0.8e-3, "joint_offset.z": 0.6e-3}
BASE |= {"leg_length.x": 4e-5, "leg_length.z": -6e-5}


@pytest.fixture(scope="module")
def nominal() -> Machine:
    return Machine.nominal()


def rows_of(protocol: str = "sweep", seed: int = 0, rig: Rig | None = None, **errors: float):
    rng = np.random.default_rng(seed)
    own = (rig or Rig()).with_errors(BASE | errors)
    return rc.simulate(own, protocol, rng, background=0.02)


def estimate_of(rows: list[rc.Row], machine: Machine) -> Estimate:
    return identify(campaign_of(rows, machine), machine, method="nested")


def reported(estimate: Estimate, found: DataFindings) -> tuple[DataFault, ...]:
    tables = [factor.readings for factor in estimate.problem.factors]
    return tuple(report_faults(estimate, found.faults, tables))


def found_in(rows: list[rc.Row], machine: Machine) -> tuple[DataFault, ...]:
    estimate = estimate_of(rows, machine)
    return reported(estimate, find_data_faults(estimate))


# -- nothing where there is nothing ----------------------------------------------------------------


@pytest.mark.parametrize("number", [2, 3])
def test_deviations_of_the_published_experiments_have_no_faults(number, nominal):
    """The golden results say so of their readings and of the rig's campaigns."""
    file = PUBLISHED / f"experiment{number}-differences.csv"
    estimate = identify(read_campaign(file, nominal.spec), nominal, method="nested")
    assert find_data_faults(estimate).faults == ()


@pytest.mark.parametrize(
    "errors",
    [
        {},
        {"backlash.x": 1e-4},
        {"gauge_drift.xy-0.5": 1e-7},
        {"gauge_scale.yz-0.5": 0.05},
        {"axis_tilt.y.z": 8e-3, "rail_bow.z.x": 1.6e-4},
    ],
    ids=lambda e: next(iter(e), "clean"),
)
def test_an_effect_is_no_fault(errors, nominal):
    assert found_in(rows_of("standard", seed=7, **errors), nominal) == ()


def test_an_effect_in_no_catalogue_is_no_fault(machine):
    rig = Rig(extra=(rc.warming_drive(1, 1e-4),))
    assert found_in(rows_of("standard", seed=3, rig=rig), machine) == ()


# -- each kind -------------------------------------------------------------------------------------


def posture_of(rows: list[rc.Row], leg: str, label: str) -> int:
    """Its number, as `rc.wrong_command` counts."""
    keys = [(r["leg"], r["posture"]) for r in rows]
    return list(dict.fromkeys(keys)).index((leg, label))


def commanded(leg: str, label: str, drive: int, mm: float) -> Callable[[list[rc.Row]], rc.Fault]:
    """Spoil the command of one posture."""
    return lambda rows: rc.wrong_command(rows, posture_of(rows, leg, label), drive, mm)


def read_in_inches(rows: list[rc.Row]) -> rc.Fault:
    """One dial in inches, with steps of half a thousandth of a millimetre."""
    spoilt, touched = rc.wrong_unit(rows, "yz-0.5", 1 / 25.4)
    for k in touched:
        spoilt[k]["reading_mm"] = round(round(spoilt[k]["reading_mm"] / 5e-4) * 5e-4, 4)
    return rc.Fault(spoilt, touched)


def on_one_visit(rows: list[rc.Row]) -> rc.Fault:
    """A wrong command at one visit of a posture alone."""
    spoilt = [dict(row) for row in rows]
    for row in spoilt[60:62]:
        row["rho_x_mm"] += 10.0
    return rc.Fault(spoilt, [60, 61])


def zeroed_anew(rows: list[rc.Row]) -> rc.Fault:
    """One dial is set to zero before its second and its third repeat."""
    touched = [k for k, row in enumerate(rows) if row["setup"] == "yz-0.5" and row["repeat"] > 1]
    spoilt = [dict(row) for row in rows]
    for k in touched:
        spoilt[k]["reading_mm"] += {2: 0.3, 3: -0.2}[rows[k]["repeat"]]
    return rc.Fault(spoilt, touched)


TILT = {"axis_tilt.y.z": 2e-3}


@dataclass(frozen=True)
class Spoilt:
    """A campaign with one fault, and what is to be found of it."""

    kind: str
    spoil: Callable[[list[rc.Row]], rc.Fault]
    setups: tuple[str, ...]
    said: str = ""
    protocol: str = "standard"
    seed: int = 2
    errors: dict[str, float] = field(default_factory=dict)
    by_nominal: bool = True


FAULTS = {
    "outlier": Spoilt("outlier", lambda r: rc.outlier(r, 20, 0.1), ("yx-0.5",), seed=1),
    "stand": Spoilt("knocked_stand", lambda r: rc.knocked_stand(r, "yz-0.5", -0.5), ("yz-0.5",),
                    "all readings of the setup are 0\\.[45]\\d+ mm lower than before"),
    "sign beside a tilt": Spoilt(
        "sign", lambda r: rc.swapped_sign(r, "zy-0.5"), ("zy-0.5",), "direction -y instead of y",
        errors={"axis_tilt.y.z": 3e-3}, seed=0),
    "labels of one leg": Spoilt(
        "exchanged_labels", lambda r: rc.swapped_labels(r, "yz-0.5", "yx-0.5"),
        ("yz-0.5", "yx-0.5"), by_nominal=False),
    "leg": Spoilt("label", lambda r: rc.wrong_label(r, "yz-0.5", "leg"), ("yz-0.5",),
                  "as those of a dial on leg y that reads along z", seed=0, by_nominal=False),
}  # fmt: skip

MORE_FAULTS = {
    "metres": Spoilt("unit", lambda r: rc.wrong_unit(r, "yz-0.5", 1e-3), ("yz-0.5",), "in metres",
                     protocol="sweep", seed=0, by_nominal=False),
    "inches beside a tilt": Spoilt(
        "unit", read_in_inches, ("yz-0.5",),
        "multiplied by 25.4, so they seem to be in inches", protocol="sweep", errors=TILT,
        by_nominal=False),
    "large hand": Spoilt(
        "turns", lambda r: rc.whole_turns(r, "zx-0.5", 1.0), ("zx-0.5",),
        "a hand that shows 1 mm by each: read the small hand", protocol="sweep", seed=3,
        errors=TILT, by_nominal=False),
    "zeroed": Spoilt("zeroed", zeroed_anew, ("yz-0.5",),
                     "as if the dial had been set to zero anew", protocol="sweep"),
    "command": Spoilt("command", commanded("y", "+20", 0, -10.0), ("yx-0.5", "yz-0.5"),
                      "fit with rho_x = .* mm where", protocol="sweep", errors=TILT),
    "command of one visit": Spoilt(
        "command", on_one_visit, ("xy-0.5", "xz-0.5"), protocol="sweep", by_nominal=False),
}  # fmt: skip


MORE = [pytest.param(what, marks=pytest.mark.thorough) for what in MORE_FAULTS]


@pytest.mark.parametrize("what", [*FAULTS, *MORE])
def test_a_fault_is_found_and_named(what, machine, nominal):
    """Alone or beside an effect, its rows, its setups and what to look at."""
    case = (FAULTS | MORE_FAULTS)[what]
    rows = rows_of(case.protocol, seed=case.seed, **case.errors)
    spoilt, touched = case.spoil(rows)
    estimate = estimate_of(spoilt, nominal if case.by_nominal else machine)
    steps: list[Step] = []
    found = find_data_faults(estimate, steps.append)
    (blunder,) = reported(estimate, found)
    assert [str(step) for step in steps] == [
        "looking for faults of the data", "looking for faults of the data beside 1 found"
    ]  # fmt: skip
    assert (blunder.kind, set(blunder.setups)) == (case.kind, set(case.setups))
    assert found.notes == ()
    if case.kind != "exchanged_labels":
        assert [row for _, row in blunder.rows_in_request] == sorted(touched)
    assert re.search(case.said, blunder.message), blunder.message


def test_a_whole_file_in_inches_is_one_fault(machine):
    """Setup by setup, four were in centimetres and two in inches; then a part was blamed."""
    rows = [dict(row) for row in rows_of("sweep")]
    for row in rows:
        row["reading_mm"] = round(row["reading_mm"] / 25.4, 4)
    (blunder,) = found_in(rows, machine)
    assert (blunder.kind, len(blunder.setups)) == ("unit", 6)
    assert "multiplied by 25.4, so they seem to be in inches" in blunder.message


def test_stuck_dial(machine):
    spoilt, touched = rc.stuck_dial(rows_of("standard"), "yz-0.5")
    (blunder,) = found_in(spoilt, machine)
    assert (blunder.kind, blunder.setups) == ("stuck", ("yz-0.5",))
    assert len({row for _, row in blunder.rows_in_request} ^ set(touched)) <= 1


def test_equal_readings_by_chance_are_no_stuck_dial(machine):
    """Five of 252 were, whose noise is two steps of the dial: a run may begin at any of them."""
    rng = np.random.default_rng([9001, 12])
    errors = {f"joint_offset.{k}": rng.normal(0, 1e-3) for k in "xyz"}
    errors |= {f"leg_length.{k}": rng.normal(0, 3e-5) for k in "xyz"}
    rows = rc.simulate(Rig(errors=errors), "sweep", rng, noise=2e-5)
    assert found_in(rows, machine) == ()


def test_a_wrong_command_at_zero_travel_is_solved_exactly():
    """There a drive's command moves the dials on its own leg to second order only: 313.9 was said
    of 310.25, as each linearisation went a small part of the way.
    """
    rig = Rig(
        errors={f"joint_offset.{k}": v for k, v in zip("xyz", (1.2e-3, -7e-4, 4e-4), strict=True)}
    )
    rows = rc.simulate(rig, "sweep", np.random.default_rng(23))
    for row in rows:
        if (row["leg"], row["posture"], row["repeat"]) == ("x", "+0", 1):
            row["rho_x_mm"] = 330.25
    (blunder,) = close_loop([campaign_of(rows)]).blunders
    (command,) = re.findall(r"fit with rho_x = ([0-9.]+) mm where 330.25 is", blunder.message)
    assert float(command) == pytest.approx(310.25, abs=0.7)


def test_a_wrong_command_beyond_reach_keeps_its_linear_size(machine):
    problem = estimate_of(rows_of("standard"), machine).problem
    fault = Fault("command", np.array([0, 1]), size=0.5, drive=0)
    assert with_exact_size(problem, problem.start, fault, np.full(2, 500.0)) is fault


def test_a_wrong_command_is_told_as_the_controller_has_it(machine):
    judge = Machine(replace(machine.spec, controller=Controller((0.01, 0.0, 0.0), (-1, 1, 1))))
    rows = rows_of("standard", seed=2)
    spoilt, touched = rc.wrong_command(rows, posture_of(rows, "y", "max"), 0, 5.0)
    estimate = estimate_of(spoilt, judge)
    found = find_data_faults(estimate)
    (blunder,), (fault,) = reported(estimate, found), found.faults
    assert (blunder.kind, [row for _, row in blunder.rows_in_request]) == ("command", touched)
    assert fault.drive == 0
    assert fault.size == pytest.approx(-5e-3, abs=1e-4)
    counted = re.search(r"\(the controller's ([\d.]+) where ([\d.]+)\) is written", blunder.message)
    assert counted, blunder.message
    assert float(counted[1]) - float(counted[2]) == pytest.approx(5.0, abs=0.1)
    assert "off at this place" not in blunder.message


def test_a_command_that_is_wrong_by_little_leads_the_set(machine):
    """By 1 mm on a sheet of three postures: an error by travel holds one per cent beside it."""
    rows = rows_of("standard", seed=2)
    spoilt, touched = rc.wrong_command(rows, posture_of(rows, "y", "max"), 0, 1.0)
    verdict = studied(campaign_of(spoilt, machine), machine)
    (found,) = verdict.located
    command = max(found.data, key=lambda rival: rival.probability)
    assert (command.data, len(command.rows)) == ("command", len(touched))
    assert command.probability > 0.8
    assert "fit with rho_x = 304.37 mm where 305.39294 is written" in command.words


@pytest.mark.thorough
def test_who_sets_most_dials_to_zero_anew_does_so_with_all(nominal):
    """Steps of one or two graduations, of which single ones are drift or noise: those of three
    dials were told, and a dial was said to creep.
    """
    rng = np.random.default_rng(0)
    rows = rc.simulate(Rig(errors=BASE), rc.protocol_rows("sweep", repeats=4), rng, background=0.02)
    names = list(dict.fromkeys(row["setup"] for row in rows))
    datum = {
        (name, repeat): round(0.03 * rng.choice([-1, 1]) * rng.uniform(0.5, 1), 2)
        for name in names for repeat in (2, 3, 4)
    }  # fmt: skip
    for row in rows:
        row["reading_mm"] += datum.get((row["setup"], row["repeat"]), 0.0)
    verdict = studied(campaign_of(rows, nominal), nominal)
    (blunder,) = verdict.blunders
    assert (blunder.kind, blunder.setups) == ("zeroed", tuple(names))
    told = re.findall(r"([+−][0-9.]+) mm at repeat", blunder.message)
    for size, step in zip(told, datum.values(), strict=True):
        assert float(size.replace("−", "-")) == pytest.approx(step, abs=0.01)
    assert verdict.word == "adequate"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("by", "errors"), [(1, {"rail_bow.x.z": 1.2e-4}), (-1, {})], ids=["late beside a bow", "early"]
)
def test_readings_a_row_off(by, errors, machine):
    """They were told of the side that places are come to from, as a place in the machine."""
    rows = rc.shifted_rows(rows_of("sweep", seed=4, **errors), "yz-0.5", by).rows
    verdict = studied([campaign_of(rows, machine)], machine)
    (blunder,) = verdict.blunders
    assert (blunder.kind, blunder.setups) == ("shifted", ("yz-0.5",))
    assert f"move them {'up' if by > 0 else 'down'} by one" in blunder.message
    assert not verdict.located


def test_a_label_puts_no_two_dials_at_one_place_at_once(machine):
    """A wrong command at one posture was told of a dial whose place the other one takes."""
    problem = estimate_of(rows_of("standard"), machine).problem
    (setup,) = (k for k, s in enumerate(problem.setups) if s.name == "xy-0.5")
    labels = [
        fault
        for fault in alternative_readings(problem, setups_to_reinterpret(problem, []))
        if fault.relabels
    ]
    tried = {f.label for f in labels if f.kind == "label" and setups_of(problem, f) == [setup]}
    assert tried == {(1, 0), (1, 2), (2, 0), (2, 1)}


def test_only_misreadings_that_may_still_win_are_searched(machine, monkeypatch):
    searched, search = [], ranked_readings.posterior_at_base_fit
    monkeypatch.setattr(
        ranked_readings, "posterior_at_base_fit", lambda fit: searched.append(fit) or search(fit)
    )
    (found,) = found_in(rc.wrong_unit(rows_of("standard", seed=2), "yz-0.5").rows, machine)
    assert found.kind == "unit"
    assert len(searched) == 1  # five were, of which four came far behind by one factorisation


def test_a_misreading_that_no_explanation_makes_likely_enough_is_not_searched(machine, monkeypatch):
    """Units that shrink the readings of one setup until little is left to explain were searched
    three times in each round; their prior odds exceed what any explanation gains.
    """
    searched, search = [], ranked_readings.posterior_at_base_fit
    monkeypatch.setattr(
        ranked_readings, "posterior_at_base_fit", lambda fit: searched.append(fit) or search(fit)
    )
    knocked = rc.knocked_stand(rows_of(), "xz-0.5", -0.5).rows
    found = found_in(rc.swapped_sign(knocked, "zx-0.5").rows, machine)
    assert {fault.kind for fault in found} == {"knocked_stand", "sign"}
    assert len(searched) == 1


def test_readings_with_a_misreading_corrected_are_searched_once(machine, monkeypatch):
    """They were searched as the misreading's alternative, and again in the next round."""
    searched, search = [], ranked_readings.posterior_at_base_fit
    for module in (ranked_readings, import_module("orthoglide.explanation.full_posterior")):
        monkeypatch.setattr(
            module, "posterior_at_base_fit", lambda fit: searched.append(fit) or search(fit)
        )
    (found,) = found_in(rc.wrong_unit(rows_of("standard", seed=2), "yz-0.5").rows, machine)
    assert found.kind == "unit"
    keys = [(fit.x.tobytes(), fit.problem.measured.tobytes()) for fit in searched]
    assert len(keys) == len(set(keys)) == 2


@pytest.mark.thorough
def test_a_label_that_explains_no_change_of_other_setups_is_not_searched(machine, monkeypatch):
    """Three labels were searched in full, to be behind by 56 log units, as other dials show what
    changed too.
    """
    ranked, rank = [], ranked_readings._rank

    def recorded(*given: Any) -> list[tuple[float, Fault]]:
        ranked.append((given[-1], found := rank(*given)))  # after what the odds must exceed
        return found

    monkeypatch.setattr(ranked_readings, "_rank", recorded)
    errors = {"joint_offset.x": 8e-4, "axis_tilt.x.y": 2e-3}
    changed = {"joint_offset.x": 1.1e-3, "axis_tilt.x.y": 5e-4, "axis_tilt.z.x": 1e-3}
    plan, visits = rc.protocol_rows("sweep"), list[Campaign]()
    for k, there in enumerate((errors, changed)):
        rng = np.random.default_rng(4 + k)
        rows = rc.simulate(Rig().with_errors(there), plan, rng, noise=5e-6, background=0.02)
        visits.append(replace(campaign_of(rows, machine), name=f"visit-{k}"))
    findings = find_data_faults(identify(visits, machine, method="nested"))
    assert {"joint_offset.x", "axis_tilt.x.y"} <= {str(c.parameter) for c in findings.changes}
    assert not findings.faults
    (without_changes,) = (found for least, found in ranked if least > 0)
    assert without_changes == []


def test_readings_too_many_to_be_compared_with_misreadings_are_noted(machine, monkeypatch):
    fit = estimate_of(rows_of("standard", seed=2), machine)
    assert find_data_faults(fit).notes == ()
    monkeypatch.setattr(data_faults, "MOST_RANKED_READINGS", len(fit.problem.measured) - 1)
    (note,) = find_data_faults(fit).notes
    assert note.startswith("wrong signs, units and labels")


def test_a_search_that_ends_before_it_has_settled_says_so(machine, monkeypatch):
    fit = estimate_of(rc.swapped_sign(rows_of("standard", seed=2), "yz-0.5").rows, machine)
    monkeypatch.setattr(data_faults, "_ROUNDS", 1)
    (note,) = find_data_faults(fit).notes
    assert note.startswith("the search for data faults stopped after round 1 before it had settled")


# -- what is told, and what is left ----------------------------------------------------------------


def test_the_message_names_the_place_and_scores_tell_what_it_cost(tmp_path, nominal):
    path = tmp_path / "monday.csv"
    rc.write_csv(rc.outlier(rows_of("standard"), 20, 0.5).rows, path)
    campaign = read_campaign(path, nominal.spec)
    estimate = identify(campaign, nominal, method="nested")
    found = find_data_faults(estimate)
    (blunder,) = reported(estimate, found)
    assert blunder.message.startswith("monday.csv, line 22, setup 'yx-0.5', posture max: ")
    assert "measure this place again" in blunder.message
    assert blunder.files == {path.name: (22,)}
    again = solve(without_faults(estimate.problem, found.faults), method="nested")
    assert blunder.rms_with == pytest.approx(estimate.scores.rms, rel=1e-6)
    assert blunder.rms_without < 0.3 * blunder.rms_with
    assert len(again.residuals) == len(estimate.residuals) - 1
    # The noise is that of the repeats, without those of the setup with the slip.
    typical = estimate.problem.noise.typical
    assert again.problem.noise.typical == pytest.approx(typical, rel=0.05)


MISREAD: dict[str, tuple[Callable[[list[rc.Row]], rc.Fault], dict[str, Any]]] = {
    "sign": (lambda rows: rc.swapped_sign(rows, "yz-0.5"), {"size": -1.0}),
    "unit": (lambda rows: rc.wrong_unit(rows, "yz-0.5", 1e-3), {"size": 1e3}),
    "label": (lambda rows: rc.wrong_label(rows, "yz-0.5", "direction"), {"label": (1, 2)}),
    "exchanged_labels": (lambda rows: rc.swapped_labels(rows, "yx-0.5", "yz-0.5"), {"size": 1.0}),
    "shifted": (lambda rows: rc.shifted_rows(rows, "yz-0.5", 1), {"size": 1.0}),
}


@pytest.mark.parametrize("kind", MISREAD)
def test_misread_rows_are_fitted_as_corrected(kind, machine):
    """They were excluded, and with them what no other dial saw of the machine."""
    spoil, size = MISREAD[kind]
    rows = rows_of("standard")
    spoilt, touched = spoil(rows)
    problem = estimate_of(spoilt, machine).problem
    lost = touched[-1:] if kind == "shifted" else []
    fault = Fault(kind, np.array(touched), **size)
    assert not fault.excluded
    (factor,) = without_faults(problem, [fault]).factors
    kept = [k for k in range(len(rows)) if k not in lost]
    assert factor.readings.line.tolist() == [k + 2 for k in kept]
    legs = ["xyz"[factor.readings.setups[k].leg] for k in factor.setup]
    directions = ["xyz"[axis] for axis in factor.readings.axis]
    assert legs == [rows[k]["leg"] for k in kept]
    assert directions == [rows[k]["direction"] for k in kept]
    np.testing.assert_allclose(factor.measured * 1e3, [rows[k]["reading_mm"] for k in kept])


def test_residuals_say_which_readings_were_corrected(machine):
    """Their signs were those of no row of the file, and nothing said so."""
    rows, _ = rc.swapped_sign(rows_of("standard"), "yz-0.5")
    verdict = close_loop([campaign_of(rows, machine)], machine)
    table = list(csv.DictReader(io.StringIO(residual_table(verdict))))
    assert {row["setup"] for row in table if row["corrected"] == "sign"} == {"yz-0.5"}
    assert {row["corrected"] for row in table if row["setup"] != "yz-0.5"} == {""}
    assert not any(row["set_aside"] for row in table)


def test_a_fault_of_many_lines_is_told_with_all():
    drift = DataRival("drifted", tuple(range(116, 156)), 0.9, "a.csv, 40 lines from 116: ...")
    assert drift.brief.endswith("in a.csv, lines 116 to 155")
    assert replace(drift, rows=(116,)).brief.endswith("in a.csv, line 116")


def test_a_change_since_a_calibration_is_as_free_without_the_faulty_rows(machine):
    """One slip narrowed its prior to a tolerance, which pulled it towards the earlier value."""
    calibrated = estimate_of(rows_of(), machine).machine
    moved = {"joint_offset.x": BASE["joint_offset.x"] + 4e-3}
    rows = rc.outlier(rows_of(seed=4, **moved), 20, 0.5).rows
    read = estimate_of(rows, calibrated)
    assert [str(change.parameter) for change in read.changes] == list(moved)
    clean = without_faults(read.problem, [Fault("outlier", np.array([20]))])
    widths = {str(u.name): u.prior_width for u in read.problem.unknowns}
    assert widths["joint_offset.x"] == 10.0
    assert {str(u.name): u.prior_width for u in clean.unknowns} == widths


def test_a_campaign_of_faults_alone_is_refused_for_its_own(machine):
    every = [campaign_of(rows_of("standard", seed=k), machine, f"visit-{k}") for k in (1, 2)]
    problem = identify(every, machine, method="nested").problem
    first, whole = Fault("outlier", np.array([3])), Fault("scatter", np.arange(54, 108), 1e-3)
    with pytest.raises(
        InputError, match=r"all 54 rows of visit-2 are faulty.* \(visit-2, 54 lines"
    ):
        without_faults(problem, [first, whole])


@pytest.mark.parametrize("evidence", [0.0, 2.0])
def test_a_fit_without_changes_is_searched_once(
    monkeypatch: pytest.MonkeyPatch, evidence: float
) -> None:
    """Where no repeats show the noise, it was searched to compare it, and then again."""
    fit: Any = SimpleNamespace(problem=SimpleNamespace(repeat_count=0))
    unchanged: Any = SimpleNamespace(evidence=1.0)
    stubs = {
        "likeliest_changes": lambda _: [SimpleNamespace(log_odds_against=0.0)],
        "with_changes_separate": lambda *_: None,
        "fit_nested": lambda _: "separate",
        "posterior_at_base_fit": lambda _: unchanged,
        "posterior_with_corrected_commands": lambda base, known: (
            SimpleNamespace(evidence=evidence) if base == "separate" else known
        ),
    }
    for name, stub in stubs.items():
        monkeypatch.setattr(data_faults, name, stub)
    changes, _, posterior, at_hand = data_faults._beside_changes(fit, None)
    assert (at_hand if changes else posterior) is unchanged
    assert bool(changes) is (evidence > unchanged.evidence)
