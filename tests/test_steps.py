"""A drive that steps along its travel: a scale joined of two pieces, a dead spot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import orthoglide as og
from benchmarks import public
from orthoglide.effects.bumps_and_jumps import jumping, with_jump
from orthoglide.effects.free_form import FreeForm, free_forms
from orthoglide.effects.free_form_words import confirming_test
from orthoglide.effects.kernels import Step
from orthoglide.explanation.causes import pool_variants
from orthoglide.explanation.free_form import free_form_columns
from orthoglide.result import Curve
from tests import rig_campaigns as rc
from tests.rig import LEGS, Rig
from tests.studied import studied

MACHINE = og.Machine.nominal()
STROKE = MACHINE.geometry.stroke
ERRORS = {"joint_offset.x": 1.2e-3, "joint_offset.y": -7e-4, "joint_offset.z": 4e-4}


def stations(travels: Sequence[float], visits: int) -> list[rc.Row]:
    """Rows of sweeps along every axis, up and down in turn, so many visits of each station."""
    length = Rig().L * 1e3
    rows: list[rc.Row] = []
    for leg, letter in enumerate(LEGS):
        for repeat in range(1, visits + 1):
            for travel in travels[:: 1 if repeat % 2 else -1]:
                rho = [round(float(np.sqrt(length**2 - travel**2)), 6)] * 3
                rho[leg] = round(length + travel, 6)
                for direction in LEGS.replace(letter, ""):
                    rows.append(
                        {"setup": f"{letter}{direction}", "leg": letter, "direction": direction}
                        | dict(zip(rc.RHO, rho, strict=True))
                        | {"gauge_mm": length / 2, "repeat": repeat, "order": len(rows)}
                        | {"time_s": 20.0 * (len(rows) // 2) + 600 * leg}
                    )
    return rows


def one_way(leg: int, value: float, at: float) -> object:
    """A drive that jumps where it passes a place from smaller travel, and jumps back on the way."""
    return rc._moved(leg, leg, lambda s, near, time: value * (s > at) * (1 + near) / 2)


def form_of(name: str) -> FreeForm:
    """The error with a jump of a name, such as ``drive.x/travel@0to20``."""
    place, _, spot = name.partition("@")
    low, high = (float(travel) * 1e-3 for travel in spot.strip("updown ").split("to"))
    forms = (jump for form in free_forms() for jump in jumping(form))
    jumps = [with_jump(form, (low, high), STROKE) for form in forms if form.name == place]
    (found,) = (jump for jump in jumps if jump.name == name)
    return found


NAMES = ("drive.x/travel@0to20", "drive.y/travel@-5.9to-2.6", "drive.z/approach@-1to0up",
         "drive.z/approach@40to60down")  # fmt: skip


def test_a_calibrated_step_predicts_the_readings_beside_it() -> None:
    """It was two millimetres wide, and an unchanged machine had changed."""
    step = form_of("drive.x/travel@-4.1to-2.6").kernel
    assert isinstance(step, Step)
    ends = np.array([step.start, step.end])
    np.testing.assert_allclose(step.lasting.functions(ends)[0], [0.0, 1.0], atol=1e-12)


def test_words_of_a_step() -> None:
    places = [form_of(name).words.partition(" along its axis ") for name in NAMES[1:]]
    assert {clause for clause, _, _ in places} == {"drive y steps", "drive z steps"}
    assert [place for _, _, place in places] == [
        "between travel −5.9 and −2.6 mm",
        "between travel −1 and 0 mm where it comes from smaller travel",
        "between travel 40 and 60 mm where it comes from larger travel",
    ]
    for size, way in ((5e-4, "away from"), (-5e-4, "toward")):
        test = confirming_test(form_of(NAMES[1]), size)
        assert test.startswith("read a dial on carriage y along its travel every millimetre from −")
        assert test.endswith(f"mm: expect a step of 0.5 mm {way} the origin as travel grows")


def test_the_places_of_one_step_are_one_finding() -> None:
    errors = [form_of(name) for name in (NAMES[0], "drive.x/travel@-10to0", NAMES[1])]
    odds, places = pool_variants(np.array([0.6, 0.2, 0.2]), dict(enumerate(errors)))
    np.testing.assert_allclose(odds, [0.8, 0.0, 0.2])
    assert places == {0: " (from −10 mm to 20 mm)"}


def test_a_step_is_its_mean_over_the_places_where_it_may_be() -> None:
    """Between two stations; what it deviates from there has the variance of a step."""
    u, places = np.linspace(0.0, 0.5, 41), np.linspace(0.0, 0.5, 2001)
    steps = (u > places[:, None]).astype(float)
    mean, deviation = Step(0.0, 0.5, 0.1).functions(u)
    np.testing.assert_allclose(mean, steps.mean(axis=0), atol=1e-3)
    assert np.mean(deviation**2) == pytest.approx(np.mean(steps.var(axis=0)), rel=0.05)
    ends = np.array([-1.0, 0.0, 0.5, 1.0])
    np.testing.assert_allclose(Step(0.0, 0.5, 0.1).functions(ends)[0], [0, 0, 1, 1], atol=1e-15)
    np.testing.assert_allclose(Step(0.0, 0.5, 0.1).functions(ends)[1], 0.0, atol=1e-15)


@pytest.mark.parametrize("name", ["drive.x/travel@-1to-0.6", NAMES[0], "drive.x/approach@0to0.1up"])
@pytest.mark.parametrize("height", [-1e-3, 5e-4, 1e-3])
def test_every_place_beside_a_step_has_a_command(name: str, height: float) -> None:
    """A step in a tenth of a millimetre would leave places that no command reaches, or three do."""
    effect = form_of(name).effect
    machine = MACHINE.with_effects([effect]).with_only({next(iter(effect.motions)): height})
    wanted = np.zeros((81, 3))
    wanted[:, 0] = np.linspace(-0.02, 0.03, 81)
    up = np.ones_like(wanted)
    commands = machine.inverse(wanted, approach=up)
    np.testing.assert_allclose(machine.forward(commands, approach=up), wanted, atol=1e-11)
    assert (np.diff(commands[:, 0]) > 0).all()


def test_steps_are_tried_between_the_stations() -> None:
    rows = stations(range(-100, 61, 20), 2)
    rig = Rig(errors=ERRORS, extra=(rc.drive_step(0, 5e-4, 0.03),))
    fit = og.identify([public.campaign(rc.simulate(rig, rows, np.random.default_rng(9101)))])
    _, found = free_form_columns(fit.problem, fit.x, fit.residuals, np.zeros((len(rows), 0)))
    steps = [form for form in found if form.location_key == "drive.x/travel" and form.jump]
    assert steps[0].name == "drive.x/travel@20to40"
    assert sum(form.chance for form in steps) <= 1.0
    sides = [form.side for form in found if form.location_key == "drive.x/approach" and form.jump]
    assert {*sides} == {1, -1}


def ends_of(step: Curve) -> tuple[float, float]:
    """Travels between which a curve steps, metres."""
    low, high = step.name.partition("@")[2].split("to")
    return float(low) * 1e-3, float(high) * 1e-3


@pytest.fixture(scope="module")
def stepping() -> og.Verdict:
    """A drive that steps by half a millimetre, on a sheet with three visits of each station."""
    rig = Rig(errors=ERRORS, extra=(rc.drive_step(0, 5e-4, -0.002),))
    rows = rc.simulate(rig, stations(range(-100, 61, 10), 3), np.random.default_rng(9102))
    return og.close_loop([public.campaign(rows)], public.machine())


@pytest.mark.thorough
def test_a_step_is_no_set_of_wrong_commands(stepping: og.Verdict) -> None:
    """Up to 72 of 576 readings were set aside, and tilts were named beside the drive."""
    assert (stepping.effects, stepping.blunders) == ((), ())
    (found,) = stepping.located
    step = found.members[0]
    low, high = ends_of(step)
    assert step.name.startswith("drive.x/travel@")
    # The carriage stands 1.2 mm beyond its command.
    assert low <= -3.2e-3 <= high
    assert step.size == pytest.approx(5e-4, rel=0.05)
    assert "Drive x steps along its axis between travel" in " ".join(str(stepping).split())


@pytest.mark.thorough
def test_compensated_commands_are_right_on_both_sides_of_a_step(stepping: og.Verdict) -> None:
    rig = Rig(errors=ERRORS, extra=(rc.drive_step(0, 5e-4, -0.002),))
    wanted = np.zeros((9, 3))
    wanted[:, 0] = np.linspace(-0.06, 0.05, 9)
    commands = og.compensate(stepping.machine, wanted).rho
    error = rig.pose(commands).p - wanted
    assert np.abs(error - error.mean(axis=0)).max() < 1.5e-5


@pytest.mark.thorough
def test_what_is_stated_includes_the_place_of_a_step(stepping: og.Verdict) -> None:
    low, high = ends_of(stepping.located[0].members[0])
    offset, wanted = 1.2e-3 + 2.5e-4, np.zeros((2, 3))  # of the carriage, and half of the step
    wanted[:, 0] = (low + high) / 2 + offset, high + 0.01
    beside = og.compensate(stepping.machine, wanted).shape_sigma[:, 0]
    assert beside[0] > 1.5e-4 > 5e-5 > beside[1]


@pytest.mark.thorough
def test_a_dead_spot_has_its_place_and_direction() -> None:
    rig = replace(Rig(errors=ERRORS), extra=(one_way(1, -5e-4, 0.026),))
    rows = rc.simulate(rig, "sweep", np.random.default_rng(9103))
    verdict = studied([public.campaign(rows)], public.machine())
    (found,) = verdict.located
    assert found.members[0].name == "drive.y/approach@20to40up"
    assert found.members[0].size == pytest.approx(-5e-4, rel=0.1)
