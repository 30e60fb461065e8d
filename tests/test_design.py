"""Designs and next measurements: formulas against numpy, expectations and proposals on the rig."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ncx2

import orthoglide as og
from benchmarks.delta_readings import measured as read_by
from benchmarks.delta_truth import machine as delta
from orthoglide.closing import next_measurements as suggested
from orthoglide.effects import CATALOGUE
from orthoglide.errors import InputError
from orthoglide.fit import Estimate, Problem, solve, with_free
from orthoglide.observations import Campaign, protocol
from orthoglide.planning import (
    aliasing,
    design,
    detectable_rows,
    next_measurements,
    observability,
    repeats_needed,
    smallest_effects,
    suggest_separating_located_errors,
)
from orthoglide.planning.designs import Observability
from orthoglide.planning.detectable import noncentrality, required_separation
from orthoglide.planning.linear import CombinationPrecision, LinearReadings, RivalSeparation
from orthoglide.planning.sheets import reading_pool
from tests.factors import problem_of
from tests.rig import Rig
from tests.rig_campaigns import APPROACH, read_csv, s_curve, simulate, write_csv
from tests.rig_delta import DeltaRig
from tests.studied import studied
from tests.test_cli import run

RIG = Path(__file__).parent / "data" / "rig"
TEXT = {"setup", "leg", "direction", "posture", "bar", "kind"}


def measured(machine, rig, rows, seed, name="a") -> Campaign:
    made = simulate(rig, rows, np.random.default_rng(seed), placement=machine.spec.dial.placement)
    return Campaign.from_frame(pd.DataFrame(made), name=name, machine_file=machine.spec)


def base_problem(machine, campaigns):
    return problem_of(machine, campaigns, CATALOGUE.base)


def refit(problem: Problem, names: list[str]) -> Estimate:
    return solve(with_free(problem, names), method="nested")


def as_numbers(rows):
    """Rows as the rig takes them."""
    return [{k: v if k in TEXT or v == "" else float(v) for k, v in r.items()} for r in rows]


# -- the pool ------------------------------------------------------------------------------------


# -- one step at a time is exact -----------------------------------------------------------------


@pytest.fixture(scope="module")
def readings(machine) -> LinearReadings:
    pool = reading_pool(machine.geometry)
    pool = pool.subset(pool.setup % 4 == 0)
    return LinearReadings.of(machine, pool, ("joint_offset.x", "joint_offset.y", "axis_tilt.x.y"))


def some_rows(readings, seed=0):
    rng = np.random.default_rng(seed)
    setups = rng.choice(len(readings.campaign.setups), 3, replace=False)
    rows = [int(k) for s in setups for k in rng.choice(readings.rows_by_setup[s], 4, replace=False)]
    return sorted([*rows, rows[1], rows[1]])  # one station three times


def stepwise(readings, criterion, rows):
    """The criterion once rows have been taken one by one, mounting by mounting."""
    for setup in dict.fromkeys(int(readings.campaign.setup[k]) for k in rows):
        own = [k for k in rows if readings.campaign.setup[k] == setup]
        for i in range(1, len(own)):
            steps = readings.continuing_steps(setup, own[:i])
            place = int(np.flatnonzero(steps.rows[:, 1] == own[i])[0])
            criterion = criterion.with_step(steps, place)
    return criterion


def test_rivals_are_as_far_apart_as_least_squares_says(readings):
    rng = np.random.default_rng(3)
    predicted = rng.normal(0, 2e-5, (len(readings.campaign), 2))
    both = replace(readings, columns=np.hstack([readings.columns, predicted]))
    spread = [np.diag([1.0, 2.0, 0.5]), np.diag([0.3, 0.1, 4.0])]
    rows = some_rows(readings)
    after = stepwise(both, RivalSeparation.before(spread, [(0, 1)]), rows)
    W, e = both.information(rows), np.array([1.0, -1.0])
    normal = np.linalg.inv(np.mean(spread, axis=0)) + W[:3, :3]
    toward = W[:3, 3:] @ e
    left = e @ W[3:, 3:] @ e - toward @ np.linalg.solve(normal, toward)
    assert after.chi2 == pytest.approx([left], rel=1e-5)
    steps = both.next_steps(rows, 4)
    for k in (0, len(steps.rows) // 2, len(steps.rows) - 1):
        risen = after.with_step(steps, k).value - after.value
        assert after.gains(steps)[k] == pytest.approx(risen, rel=1e-6)


# -- observability -------------------------------------------------------------------------------


def test_indices_are_those_of_the_definitions():
    J = np.random.default_rng(0).normal(size=(30, 5)) @ np.diag([1.0, 2.0, 5.0, 0.1, 3.0])
    found = Observability.of_jacobian(J, 30)
    s = np.sqrt(np.linalg.eigvalsh(J.T @ J))[::-1]
    assert found.indices["O1"] == pytest.approx(np.prod(s) ** (1 / 5) / np.sqrt(30))
    assert found.indices["O2"] == pytest.approx(s[-1] / s[0])
    assert found.indices["O2"] == pytest.approx(1 / np.linalg.cond(J))
    assert found.indices["O3"] == pytest.approx(s[-1])
    assert found.indices["O4"] == pytest.approx(s[-1] ** 2 / s[0])
    assert found.indices["O5"] == pytest.approx(1 / np.sum(1 / s))
    assert found.rank == 5
    unseen = Observability.of_jacobian(np.ones((4, 2)), 4)
    assert (unseen.rank, set(unseen.indices.values())) == (1, {0.0})


# -- designs -------------------------------------------------------------------------------------


def test_a_d_optimal_design_beats_random_ones_and_the_protocol(machine):
    found = design(machine, CATALOGUE.base, 24)
    assert len(found.campaign) == 24
    pool = reading_pool(machine.geometry)
    names = found.names
    everything = LinearReadings.of(machine, pool, names)
    start = CombinationPrecision(1e-4 * np.eye(len(names)), np.eye(len(names)))
    rng = np.random.default_rng(1)
    mountings = len(found.campaign.setups)
    random = []
    for _ in range(20):
        setups = rng.choice(len(pool.setups), mountings, replace=False)
        rows = [
            int(k)
            for s in setups
            for k in rng.choice(everything.rows_by_setup[s], 24 // mountings, replace=False)
        ]
        random.append(start.with_rows(everything, rows).value - start.value)
    assert found.value > max(random) + 3
    standard = observability(machine, protocol("standard"), CATALOGUE.base)
    assert found.indices.indices["O1"] > standard.indices["O1"]


@pytest.mark.parametrize(
    ("families", "count", "word"),
    [
        (["gauge_scale"], 12, "mounting"),
        (["joint_offset"], 1, "whole number from 2 to 500. A single reading"),
        (["joint_offset"], 2000, "2000 readings cannot be chosen: give a whole number"),
        (["thermal_growth"], 12, "leave it out"),
    ],
)
def test_what_no_design_can_serve_is_refused(machine, families, count, word):
    with pytest.raises(InputError, match=word):
        design(machine, families, count)


# -- waves between the stations ------------------------------------------------------------------


@pytest.mark.parametrize("stroke", [(-0.1, 0.06), (-0.04, 0.03), (-0.3, 0.2), (-0.12, 0.12)])
def test_no_wave_of_a_drive_is_a_curve_at_the_stations_of_the_sweep(stroke):
    made = og.Machine(og.MachineFile(geometry=og.Geometry(L=1.0, stroke=stroke)))
    sweep = protocol("sweep", made.geometry)
    assert aliasing(made, sweep) == ()
    # At even steps a wave as long as two stations, and its fractions, is one.
    rho = sweep.command
    even = made.geometry.zero + np.round((rho - made.geometry.zero) / 0.02) * 0.02
    told = aliasing(made, replace(sweep, command=even))
    assert [text.split()[6] for text in told] == ["x", "y", "z"]
    period = float(re.search(r"a wave of ([\d.]+) mm", told[0])[1]) * 1e-3
    travel = np.unique(np.round(even[sweep.leg == 0, 0], 6))
    turn = 2 * np.pi * travel / period
    powers = (travel[:, None] / np.ptp(travel)) ** np.arange(3)
    left = [
        np.linalg.norm(w - powers @ np.linalg.lstsq(powers, w, rcond=None)[0])
        for w in (np.sin(turn + phase) for phase in np.linspace(0, np.pi, 181))
    ]
    assert min(left) < 0.05 * np.sqrt(len(travel) / 2)


# -- accuracy and repeats ------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["TCP", "joint_offset.x"])
def test_repeats_are_the_fewest_that_reach_the_accuracy(machine, what):
    def needed(wanted):
        return repeats_needed(machine, protocol("standard"), CATALOGUE.base, what, wanted)

    once = needed(1.0)
    assert once.repeats == 1
    found = needed(0.4 * once.sigma + 0.6 * once.floor)
    assert found.repeats > 2
    assert once.floor < found.sigma <= found.wanted
    assert needed(found.sigma * (1 + 1e-9)).repeats == found.repeats
    assert needed(found.sigma * (1 - 1e-9)).repeats > found.repeats
    assert "out of reach" in str(needed(0.9 * once.floor))
    # It was "out of reach" with less than that "with any number".
    hardly = str(needed((1 + 1e-6) * once.floor))
    assert "takes more than 1000 visits" in hardly
    assert "out of reach" not in hardly


def test_sigma_with_the_protocols_repeats_is_that_of_the_identification(machine):
    campaign = measured(machine, Rig(), "standard", 4)
    estimate = og.identify(campaign, machine, method="nested")
    sigma = estimate.sigmas["joint_offset.x"] / estimate.sigma_scale
    found = repeats_needed(machine, campaign, CATALOGUE.base, "joint_offset.x", 1.02 * sigma)
    assert found.repeats == 3
    with pytest.raises(InputError, match="not identified"):
        repeats_needed(machine, campaign, CATALOGUE.base, "axis_tilt.x.y", 1e-3)


# -- the smallest effects ------------------------------------------------------------------------


def test_power_is_that_of_the_noncentral_distribution():
    square, threshold = 9.0, 4.0
    nc = noncentrality(square, threshold)
    limit = (2 * threshold + np.log(1 + square)) * (1 + square) / square
    assert ncx2.sf(limit, 1, nc) == pytest.approx(0.95, abs=1e-6)
    rng = np.random.default_rng(0)
    distance = required_separation()
    worse = distance**2 + 2 * distance * rng.standard_normal(200_000)
    assert np.mean(worse > 4) == pytest.approx(0.95, abs=0.005)


def test_a_precise_level_hides_nothing_that_distances_show():
    """It shows the small errors of a sound machine, which raised the threshold of all effects."""
    instruments = {"distance": og.Instrument(0.0, 2e-5), "incline": og.Instrument(0.0, 5e-5)}
    layout = og.LinearDelta((0.14,) * 3, tool=(0.0, 0.0, -0.04))
    geometry = og.Geometry(0.272, 0.05, 0.032, (-0.02, 0.26), layout)
    delta = og.Machine(replace(og.Machine.of(geometry).spec, instruments=instruments))

    def found_from(*kinds: str) -> float:
        told = smallest_effects(delta, og.tool_sheets(delta, kinds))
        return next(s.detectable for s in told.smallest if s.name == "rail_tilt.a.radial")

    assert found_from("distance", "incline") < 1.15 * found_from("distance")


def test_effects_with_one_signature_are_never_named(machine):
    told = {s.name: s for s in smallest_effects(machine, protocol("sweep")).smallest}
    same = told["axis_tilt.y.z"]
    assert same.nearest == "rail_tilt.y.z"
    assert np.isinf(same.nameable)
    bow = told["rail_bow.x.y"]
    assert bow.detectable <= bow.nameable < np.inf
    seen = smallest_effects(machine, protocol("standard"))
    rows = detectable_rows(seen)
    assert "never" in "\n".join(rows)
    assert any("bar mismatch of leg x is most like " in row for row in rows)
    assert "mount tilt (x.a, y.a, z.a)" in rows[-1]


# -- what to measure next ------------------------------------------------------------------------

EFFECT = {"bar_mismatch.x": 4e-4}
RIVALS = ("bar_mismatch.x", "axis_offset.zx.antisymmetric")


@pytest.fixture(scope="module")
def ambiguous(machine):
    campaign = measured(machine, Rig(errors=EFFECT), "standard", 2)
    problem = base_problem(machine, [campaign])
    fits = {name: refit(problem, [name]) for name in RIVALS}
    return campaign, fits


def test_suggested_readings_separate_what_the_protocol_could_not(machine, ambiguous):
    campaign, fits = ambiguous
    before = fits[RIVALS[1]].scores.chi2 - fits[RIVALS[0]].scores.chi2
    assert abs(before) < 4
    (found,) = next_measurements(fits[RIVALS[0]], [*fits.items()], count=16, directions=())
    assert found.aim == "separate"
    assert len([row for row in found.rows if row["kind"] == "leg"]) <= 16
    assert all("reading_mm" not in row for row in found.rows)
    # Either may be the truth; the gain is that of the less telling case.
    rose = {}
    for true, wrong in (RIVALS, RIVALS[::-1]):
        rig = Rig(errors=fits[true].problem.values(0, fits[true].x))
        chi2 = []
        for seed in range(6):
            new = measured(machine, rig, as_numbers(found.rows), seed, "next")
            problem = base_problem(machine, [campaign, new])
            chi2.append([refit(problem, [name]).scores.chi2 for name in (true, wrong)])
        rise = np.array(chi2)[:, 1] - np.array(chi2)[:, 0]
        assert np.mean(rise > 4) == 1.0
        rose[true] = rise.mean() - (fits[wrong].scores.chi2 - fits[true].scores.chi2)
    assert min(rose.values()) == pytest.approx(found.gain**2, rel=0.25)


def test_a_shift_of_the_whole_machine_is_said_to_be_out_of_sight(machine):
    campaign = measured(machine, Rig(errors={"axis_offset.z.x": 3e-4}), "standard", 1)
    problem = base_problem(machine, [campaign])
    fits = {n: refit(problem, [n]) for n in ("axis_offset.z.x", "axis_offset.y.x")}
    values = {n: f.values[n] for n, f in fits.items()}
    assert values["axis_offset.z.x"] == pytest.approx(-values["axis_offset.y.x"], rel=0.02)
    (found,) = next_measurements(fits["axis_offset.z.x"], [*fits.items()], directions=())
    assert found.aim == "none"
    assert found.rows == ()
    assert "but for a translation of 0.3" in found.reason


def test_rivals_given_by_values_may_have_parameters_that_the_fit_has_not(machine):
    """They were projected on the fit's parameters, and were one machine to every reading."""
    campaign = measured(machine, Rig(errors={"axis_tilt.y.z": 1e-3}), "sweep", 1)
    fit = og.identify(campaign, machine, method="nested")
    rivals = [(name, fit.values | {name: 1e-3}) for name in ("axis_tilt.y.z", "bar_mismatch.x")]
    (found,) = next_measurements(fit, rivals, directions=())
    assert found.aim == "separate"
    assert found.gain > 2


def test_a_mount_tilt_is_a_bar_mismatch_to_every_dial(machine):
    campaign = measured(machine, Rig(errors={"bar_mismatch.z": 3e-4}), "standard", 1)
    problem = base_problem(machine, [campaign])
    fits = {n: refit(problem, [n]) for n in ("bar_mismatch.z", "mount_tilt.z.b", "rail_bow.z.x")}
    found = next_measurements(fits["bar_mismatch.z"], [*fits.items()], count=8, directions=())
    assert [s.aim for s in found] == ["separate", "none"]
    assert "the z rail is bent in the direction of x" in found[0].reason
    assert "the two bars of leg z differ in length" in found[1].reason
    assert not re.search(r"[a-z]_[a-z]|\w\.\w\.\w", "".join(s.reason for s in found))


def test_a_weak_direction_narrows_as_predicted(machine):
    campaign = measured(machine, Rig(), "standard", 3)
    estimate = og.identify(campaign, machine, method="nested")
    weak = estimate.weak[0]
    (found,) = next_measurements(estimate, (), count=12, directions=[weak])
    assert found.aim == "narrow"
    assert found.gain > 1.1
    new = measured(machine, Rig(), as_numbers(found.rows), 5, "next")
    both = og.identify([campaign, new], machine, method="nested")

    def sigma(fit):
        d = np.array([weak.parameters.get(n, 0.0) for n in fit.names])
        return np.sqrt(d @ fit.covariance @ d) / fit.sigma_scale

    assert sigma(estimate) / sigma(both) == pytest.approx(found.gain, rel=0.03)


# -- sheets are driven as they are written --------------------------------------------------------


def driven(machine, rig, sheet_file, seed) -> Campaign:
    """A sheet gone through row by row: where each axis comes from is what the order makes of it."""
    asked = read_csv(sheet_file)
    rows = [{k: v for k, v in row.items() if k not in APPROACH} for row in asked]
    done = simulate(rig, rows, np.random.default_rng(seed), placement=machine.spec.dial.placement)
    for row, shown in zip(asked, done, strict=True):
        row["reading_mm"] = "" if row.get("kind") == "move" else shown["reading_mm"]
    write_csv(asked, sheet_file)
    return og.read_campaign(sheet_file, machine.spec)


def test_a_design_filled_in_row_by_row_gives_the_verdict(machine, tmp_path):
    rig = Rig(errors={"backlash.y": 1e-4})
    found = design(machine, ("backlash", "axis_tilt"), 32)
    og.write_campaign(found.campaign, tmp_path / "design.csv")
    campaign = driven(machine, rig, tmp_path / "design.csv", 2)
    assert len(campaign) == 32
    verdict = og.close_loop([campaign], machine)
    assert verdict.word in ("explained", "ambiguous")
    assert [e.name for e in verdict.effects] == ["backlash.y"]
    assert verdict.after.values["backlash.y"] == pytest.approx(1e-4, rel=0.3)


# -- the command ---------------------------------------------------------------------------------


def test_the_command_writes_a_sheet_and_compares(tmp_path, machine):
    out = tmp_path / "sheet.csv"
    arguments = ["--machine", str(RIG / "machine.toml"), "--count", "12", "--out", str(out)]
    done = run("design", *arguments, "--want", "TCP=0.003")
    assert done.exit_code == 0, done.output
    assert len(og.read_campaign(out, machine.spec, require_readings=False)) == 12
    for word in (
        "standard",
        " design",
        "O1, all unknowns",
        "sigma 0.003 mm of TCP (tolerances as priors) takes",
    ):
        assert word in done.output
    assert run("design", "--want", "TCP").exit_code == 2


# -- located errors that readings cannot separate --------------------------------------------------


TRUE = "rail.x.z/travel"
OFF = {"joint_offset.x": 8e-4, "leg_length.y": 5e-5}
BENT = Rig(errors=OFF, extra=(s_curve(0, 2, 4e-5),))


@cache
def located(seed: int) -> Any:
    """A sweep of a machine with a rail bent like an S, and what the search left of it."""
    machine = og.Machine.load(RIG / "machine.toml")
    campaign = measured(machine, BENT, "sweep", seed)
    return machine, campaign, studied([campaign], machine)


def proposed(outcome: Any) -> list[Any]:
    return [s for s in suggested(outcome) if s.aim == "separate"]


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [6, 7])
def test_the_readings_proposed_for_a_class_of_places_leave_the_true_one(
    seed: int, tmp_path: Path
) -> None:
    """Nothing was proposed. At the second seed the true place is not the likeliest at first."""
    machine, campaign, closed = located(seed)
    (found,) = closed.located
    assert TRUE in {c.place.name for c in found.members}
    assert len(found.members) > 1
    (one,) = proposed(closed)
    assert all(f'"{c.place.words}"' in one.reason for c in found.members)
    assert one.gain > 2
    og.write_campaign(one.campaign, tmp_path / "next.csv")
    new = driven(machine, BENT, tmp_path / "next.csv", 1000 + seed)
    assert len(new) <= 12
    after = studied([campaign, new], machine)
    (left,) = after.located
    assert (left.name, left.members[0].probability > 0.9) == (TRUE, True)
    assert after.effects == ()


def class_of(closed: Any, *names: str) -> Any:
    """A class of other places in the place of the one found."""
    (found,) = closed.located
    places = {p.name: p for p in closed.posterior.linearised.free_form_errors}
    return replace(found, members=tuple(SimpleNamespace(name=n, place=places[n]) for n in names))


def test_places_that_no_reading_parts_are_said_to_be_such() -> None:
    _, _, closed = located(6)
    still = "drive.z/approach", "bar.y.1/approach"  # neither does anything here
    (one,) = suggest_separating_located_errors(closed.posterior, class_of(closed, *still))
    assert (one.hopeless, one.rows) == (True, ())
    assert " cannot be separated by dials on the legs: all " in one.reason
    gone = "dial.xz-0.5/time", "dial.xz-0.5/reading"
    (one,) = suggest_separating_located_errors(closed.posterior, class_of(closed, *gone))
    assert (one.hopeless, one.rows) == (True, ())
    assert "cannot be separated by new readings" in one.reason


def test_a_dial_is_told_from_a_rail_by_another_dial() -> None:
    _, _, closed = located(6)
    (one,) = suggest_separating_located_errors(
        closed.posterior, class_of(closed, TRUE, "dial.xz-0.5/reading")
    )
    assert one.aim == "separate"
    assert one.reason.endswith("; take another dial for them than before")


@pytest.mark.thorough
def test_places_of_a_delta_are_parted_by_what_one_may_own() -> None:
    rig = DeltaRig(bends={"a": lambda s: (5e-5 * np.sin(2 * np.pi * s / 0.2), 0.0, 0.0)})
    rng = np.random.default_rng(3)
    points = read_by(rig, rng, machine=delta(), instrument="tool coordinates")
    verdict = og.close_loop([points], delta())
    (found,) = verdict.located
    rail, drive = (c.description for c in found.members)
    told = [s for s in verdict.next_measurements if "errors apart" in s.reason]
    assert len(told) > 1
    assert all(
        f'it separates "{rail}" from "{drive}", by ' in s.reason and s.gain > 3 for s in told
    )
    assert not any(s.hopeless for s in told)
    assert not [s for s in told if "plate" in s.reason]  # it may have any shape
