"""Errors at one moment, of all drives alike, of parts by their travel, and of dials by the way that
their plungers came: each is located.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from benchmarks import public
from benchmarks.attribution_cases import Case
from benchmarks.attribution_run import draw
from orthoglide.effects.bumps_and_jumps import with_jump
from orthoglide.effects.dials import common_dial_form, dial_free_forms
from orthoglide.effects.free_form import Session, free_forms
from orthoglide.explanation.causes import pool_variants
from orthoglide.explanation.dial_curves import dial_curve_columns
from orthoglide.explanation.free_form import free_form_columns
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate
from orthoglide.report import result_text
from tests import rig_campaigns as rc
from tests.factors import campaign_of
from tests.rig import LEGS, Rig
from tests.studied import studied

RIG = Rig(errors={"joint_offset.x": 1.2e-3, "joint_offset.y": -7e-4, "joint_offset.z": 4e-4})
ROWS = rc.protocol_rows("sweep", RIG)
MIDDLE = float(np.quantile([row["time_s"] for row in ROWS], 0.4))
OF_Z = float(np.median([r["time_s"] for r in ROWS if r["leg"] == "z"]))

JUMPING = replace(RIG, extra=(rc.jumping_drive(0, 1e-4, MIDDLE),))
KINDS = {
    "all drives warm alike": (
        replace(RIG, extra=(rc.warming_drives(2e-4),)),
        ("drive", None, "time"),
    ),
    "leg's end by travel": (
        replace(RIG, extra_platform=(rc.platform_travel(0, 1, 1e-4),)),
        ("platform", "x", "travel"),
    ),
    "carriage that turns evenly": (
        replace(RIG, extra_turn=(rc.twisting_carriage(0, 1, 8e-5),)),
        ("carriage", "x", "travel"),
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_what_no_catalogue_lists_is_located(kind: str) -> None:
    rig, place = KINDS[kind]
    rows = rc.simulate(rig, ROWS, np.random.default_rng(5))
    verdict = studied([campaign_of(rows)])
    (found, *_) = verdict.located
    first = found.members[0]
    assert (first.part, first.leg, first.against) == place
    assert verdict.effects == ()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("protocol", "rms", "name"),
    [("fine-sweep", 6.0, "bar.x.1/time"), ("two-gauges", 12.0, "bar.x.2/time")],
)
def test_a_loosening_bar_leaves_nothing_to_a_second_cause(
    protocol: str, rms: float, name: str
) -> None:
    """A mismatch of the bars, or a creeping dial, was reported besides, and the tool was no better:
    half of the change was taken for an error that the machine always has.
    """
    drawn = draw(Case("outside", "loosening_bar", protocol, rms, 0), 7001)
    verdict = og.close_loop([public.campaign(drawn.rows)], public.machine(), tcp=drawn.points)
    assert verdict.effects == ()
    (found,) = verdict.located
    assert found.name == name
    assert verdict.tcp["translation"].after_mean < 1e-5  # it was 45 and 72 um


def test_a_slow_change_begins_with_the_session() -> None:
    changes = [e for e in free_forms(Session(0.0, 4000.0)) if e.against == "time"]
    changes += dial_free_forms("s", 0, (0.0, 4000.0), (0.0, 1e-3), True)[:1]
    for form in changes:
        np.testing.assert_allclose(form.kernel.functions(-1.0), 0.0, atol=1e-15)


def test_a_proportional_coupling_of_two_drives_is_in_the_set() -> None:
    """A dial that shows 9 % too much was named alone, with probability 0.99: the free function
    paid for all the shapes that a straight line does not have.
    """
    rng = np.random.default_rng([901, 146])
    errors = {
        f"{family}.{leg}": float(rng.normal(0, sd))
        for family, sd in (("joint_offset", 1e-3), ("leg_length", 5e-5))
        for leg in "xyz"
    }
    coupled = Rig(errors=errors, extra=(rc.cross_coupling(0, 1, 1e-3),)).with_background(rng, 0.015)
    verdict = studied([public.campaign(rc.simulate(coupled, ROWS, rng))], public.machine())
    members = [one for cause in verdict.effects for one in cause.places]
    members += [one for located in verdict.located for one in located.members]
    (found,) = (one for one in members if one.name.startswith("drive.x/command.y"))
    assert found.probability > 0.2
    assert found.description.endswith("in proportion to the command of drive y")
    assert np.polyfit(found.at, found.value, 1)[0] == pytest.approx(1e-3, rel=0.2)


def test_a_carriage_that_turns_in_proportion_to_its_travel_is_in_the_set() -> None:
    """A bent rail and a rail that leans were named, and the tool was moved by both."""
    twisting = replace(RIG, extra_turn=(rc.twisting_carriage(0, 1, -3.5e-5),))
    rows = rc.simulate(twisting, ROWS, np.random.default_rng(5))
    verdict = studied([public.campaign(rows)])
    assert verdict.effects == ()
    (found,) = verdict.located
    assert found.name == "carriage.x.y/travel-line"
    assert (
        found.members[0].description == "the x carriage turns about y in proportion to its travel"
    )
    assert np.polyfit(found.members[0].at, found.members[0].value, 1)[0] == pytest.approx(
        -3.5e-5 / 0.01 / 0.08, rel=0.2
    )


def test_drives_that_warm_alike_are_one_finding() -> None:
    """The steady part of the drift was a second finding, or longer bars."""
    rig = replace(RIG, extra=(rc.warming_drives(1.5e-4),))
    rows = rc.simulate(rig, ROWS, np.random.default_rng(5))
    verdict = studied([public.campaign(rows)])
    assert verdict.effects == ()
    (found,) = verdict.located
    assert found.name == "drive/time"
    assert found.members[0].size == pytest.approx(1.5e-4, rel=0.2)


def test_a_bar_that_snaps_while_another_leg_is_read_is_in_the_set() -> None:
    """A drive was named alone: the time of a bar ended with the readings of its own leg."""
    rig = replace(RIG, extra_length=(rc.snapping_bar(1, 0, 2e-4, OF_Z),))
    rows = rc.simulate(rig, ROWS, np.random.default_rng(5))
    (found,) = studied([campaign_of(rows)]).located
    (bar,) = (m for m in found.members if m.name.startswith("bar.y.1/time@"))
    assert bar.probability > 0.2
    assert bar.size == pytest.approx(2e-4, rel=0.25)


def test_the_moments_of_one_jump_are_one_finding() -> None:
    """They were as many members of the set: six of one bar within two minutes."""
    slow = next(e for e in free_forms(Session(0.0, 4000.0)) if e.name == "bar.y.2/time")
    other = next(e for e in free_forms(Session(0.0, 4000.0)) if e.name == "bar.y.1/time")
    stroke = og.Machine.nominal().geometry.stroke
    pauses = [(at - 10, at + 10) for at in (3010.0, 3030.0, 3050.0, 3500.0)]
    jumps = [with_jump(slow, pause, stroke) for pause in pauses]
    errors = dict(enumerate([slow, *jumps, with_jump(other, pauses[1], stroke)]))
    odds, moments = pool_variants(np.array([0.1, 0.2, 0.4, 0.15, 0.02, 0.03, 0.1]), errors)
    np.testing.assert_allclose(odds, [0.1, 0.0, 0.77, 0.0, 0.0, 0.03, 0.1])
    assert moments == {2: " (from 3010 s to 3050 s)"}


def test_readings_that_follow_within_a_fraction_of_a_second_may_jump() -> None:
    rows = rc.simulate(JUMPING, ROWS, np.random.default_rng(5))
    quick = [row | {"time_s": 0.03 * k} for k, row in enumerate(rows)]
    fit = og.identify([campaign_of(quick)])
    rest = np.random.default_rng(6).normal(size=len(rows))
    _, found = free_form_columns(fit.problem, fit.x, rest, np.zeros((len(rest), 0)))
    names = [place.name for place in found]
    assert sum("drive.x/time@" in name for name in names) >= 2
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("timed", [True, False])
def test_a_machine_that_lost_a_step_is_calibrated_as_it_is_after_it(
    timed: bool, tmp_path: Path
) -> None:
    """The zeros were those from before; without times a dial was turned and a stand was knocked."""
    rows = rc.simulate(JUMPING, ROWS, np.random.default_rng(5))
    readings = campaign_of(rows)
    if not timed:
        readings = replace(readings, time=np.full(len(readings), np.nan))
    verdict = og.close_loop([readings])
    (found,) = verdict.located
    assert found.name.startswith("drive.x/time@" + "order" * (not timed))
    assert re.search(rf"suddenly {'at' if timed else 'after order'} \d+", str(verdict))
    now = Rig(errors={**RIG.errors, "joint_offset.x": RIG.error("joint_offset.x") + 1e-4})
    points = rc.tcp_points(now, 30, np.random.default_rng(1))
    command = np.array([[row[c] for c in rc.RHO] for row in points]) * 1e-3
    true = np.array([[row[f"p_{a}_mm"] for a in "xyz"] for row in points]) * 1e-3
    verdict.machine.save(tmp_path / "now.toml")
    for machine in (verdict.machine, og.Machine.load(tmp_path / "now.toml")):
        error = machine.forward(command) - true
        assert np.abs(error - error.mean(axis=0)).max() < 1.5e-5


def test_causes_are_separated_beside_a_curve_that_the_catalogue_lacks() -> None:
    """A closed loop was refused for want of an effect 'rail_z_y_travel', which it had found."""
    drawn = draw(Case("effect", "rail_bow", "standard", 2.0, 0), 7001)
    verdict = og.close_loop([public.campaign(drawn.rows)], public.machine())
    assert verdict.word == "ambiguous"
    assert "separate" in [s.aim for s in verdict.next_measurements]


def test_a_short_error_of_a_drive_is_no_bar_of_twelve_tolerances() -> None:
    """A bar 1.3 mm too short was named with probability 1.00: a base parameter that went far beyond
    its tolerance paid for its width, but was as probable as one within it.
    """
    drawn = draw(Case("bump", "drive", "sweep", 0.05, 1), 7001)
    verdict = og.close_loop([public.campaign(drawn.rows)], public.machine(), tcp=drawn.points)
    assert verdict.effects == ()
    assert any("fit as well if leg length of leg x" in note for note in verdict.warnings)
    errors = verdict.tcp["translation"]
    assert errors.after_mean < 1.5e-5  # it was 18 um


# -- dials that read by the way that their plungers came: of one dial, and of all of a make ------


def reversed_rows(reversal: dict[str, float], protocol: str = "sweep") -> list[rc.Row]:
    """Offsets, lengths and everything else at a fiftieth, and some dials that lag."""
    rng = np.random.default_rng(11)
    base = {f"joint_offset.{leg}": float(rng.normal(0, 5e-4)) for leg in LEGS}
    base |= {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}
    rig = Rig(errors=base, extra_dial={s: rc.dial_reversal(v) for s, v in reversal.items()})
    return rc.simulate(rig, protocol, rng, background=0.02)


SETUPS = [f"{leg}{axis}-0.5" for leg in LEGS for axis in LEGS if axis != leg]


@pytest.mark.thorough
@pytest.mark.parametrize("size", [0.01, 0.03])
def test_dials_of_one_make_lag_together(size: float) -> None:
    verdict = og.close_loop(campaign_of(reversed_rows(dict.fromkeys(SETUPS, size * 1e-3))))
    assert verdict.word == "located"
    (found,) = verdict.located
    first = found.members[0]
    assert first.name == "dial/approach"
    assert first.value == pytest.approx(-size * 1e-3, abs=2e-6)
    told = json.loads(result_text(verdict))["located"][0]
    assert (told["part"], told["against"], told["leg"], told["setup"]) == (
        "dial", "approach", None, None,
    )  # fmt: skip
    assert told["size_mm"] == pytest.approx(size, abs=2e-3)
    assert "read more or less, depending on the way that their plungers came" in told["words"]
    (action,) = [a for a in verdict.actions if a.options and "plungers" in a.options[0].words]
    assert "gauge block" in action.options[0].confirm
    assert "lost motion" not in action.words


def test_which_way_a_plunger_came() -> None:
    """As the predicted reading moved; not known where moves came between that nobody wrote down."""
    rows = reversed_rows({})
    for k, row in enumerate(rows):
        row["order"] = k
    estimate: Estimate = identify(campaign_of(rows), og.Machine.nominal())
    value = estimate.at.value
    parts, places = dial_curve_columns(estimate.problem, value, estimate.residuals)
    columns = np.hstack(parts)
    at = [p.name for p in places].index("dial.yz-0.5/approach")
    own = np.array([row["setup"] == "yz-0.5" for row in rows])
    start = sum(p.kernel.count for p in places[:at])
    shown = columns[:, start] / places[at].prior_sd
    assert not shown[~own].any()
    expected = np.sign(np.diff(value[own])) / 2
    moved = np.abs(np.diff(value[own])) > 2e-6
    assert moved.sum() > 20
    assert shown[own][1:][moved] == pytest.approx(expected[moved])
    together = columns[:, -1] / places[-1].prior_sd
    assert places[-1].name == common_dial_form((0.0, 1.0)).name == "dial/approach"
    assert together[own] == pytest.approx(shown[own])


def test_a_dial_whose_plunger_came_one_way_shows_no_reversal() -> None:
    names = [p.name for p in dial_free_forms("s", 0, None, (0.0, 1e-3), False)]
    assert names == ["dial.s/reading"]
    assert [p.name for p in dial_free_forms("s", 0, None, (0.0, 1e-3), True)][
        -1
    ] == "dial.s/approach"


# -- jumps between mountings, warm drives, and bumps that a tool shows ----------------------------

PAUSE = 1120.0  # seconds: the middle of the pause in which the dials are taken to the next leg


def test_a_jump_is_likelier_in_a_long_pause() -> None:
    """The moments had equal shares, whether 20 s passed or the dials were taken elsewhere."""
    rng = np.random.default_rng(90006)
    rig = replace(RIG, extra=(rc.jumping_drive(0, -2e-4, PAUSE),))
    fit = og.identify([campaign_of(rc.simulate(rig, ROWS, rng))])
    nothing = np.zeros((len(ROWS), 0))
    _, found = free_form_columns(fit.problem, fit.x, fit.residuals, nothing)
    of_x = [form for form in found if form.name.startswith("drive.x/time@")]
    jumps = {float(np.mean(form.jump or ())): form.chance for form in of_x}
    assert max(jumps, key=lambda moment: jumps[moment]) == PAUSE
    assert jumps[PAUSE] > 5 * min(jumps.values())
    assert sum(jumps.values()) < 1.0


def test_a_step_lost_near_an_end_of_the_session_is_no_knocked_or_noisy_dial() -> None:
    """A jump needed six visible readings on either side, and a dial that was knocked two."""
    rng = np.random.default_rng(72802)
    rows = rc.protocol_rows("standard")
    late = rows[-6]["time_s"] - 10.0  # three postures are left
    rig = replace(RIG, extra=(rc.jumping_drive(0, 3e-4, late),))
    outcome = studied([campaign_of(rc.simulate(rig, rows, rng))], noise=5e-6)
    (found,) = outcome.located
    assert outcome.blunders == ()
    assert any(member.name.startswith("drive.x/time@") for member in found.members)


def tool_rows(rig: Rig, kind: str, seed: int) -> og.Readings:
    """Readings of one instrument at the tool, 40 places in a row, three times over."""
    rng = np.random.default_rng(seed)
    points = rc.tcp_points(rig, 40, rng) * 3
    rho = np.array([[point[c] for c in rc.RHO] for point in points])
    time, ball = 20.0 * np.arange(len(rho)), np.array([0.0, 0.0, -0.25])
    pose = rig.pose(rho * 1e-3, rc.approaches(points), time)
    columns: dict[str, list[Any]] = {}
    for k, command in enumerate(rho):
        for axis in range(3 if kind == "tcp" else 1):
            value = pose.p[k, axis] if kind == "tcp" else np.linalg.norm(pose.p[k] - ball)
            row = dict(zip(rc.RHO, command.tolist(), strict=True)) | {
                "kind": kind, "setup": kind, "direction": "xyz"[axis] if kind == "tcp" else "",
                "time_s": time[k], "repeat": k // 40 + 1,
                "reading_mm": round(1e3 * float(value + rng.normal(0, 5e-6)), 4),
            }  # fmt: skip
            for name, cell in row.items():
                columns.setdefault(name, []).append(cell)
    columns["order"] = list(range(len(columns["kind"])))
    return og.Readings.from_frame(columns, name="case", machine_file=public.machine().spec)


def warming_scales(value: float) -> Any:
    """All drives change their scales alike and evenly, by value in 2400 s."""

    def moved(travel: Any, near: Any, time: Any) -> Any:
        return np.einsum("nl,lj->nlj", travel * value * time[:, None] / 2400, np.eye(3))

    return moved


@pytest.mark.thorough
@pytest.mark.parametrize("what", ["zeros", "scales", "bars"])
def test_drives_that_warm_alike_beside_a_tracker(what: str) -> None:
    """Bars that grow were named alone, and a scale that changes was one that is wrong."""
    extra, errors = [], dict(RIG.errors)
    if what == "zeros":
        extra = [rc.warming_drives(1e-4, 1e4)]
    elif what == "scales":
        extra = [warming_scales(1e-3)]
    else:
        errors |= {f"thermal_drift.{leg}": 1e-7 for leg in LEGS}
    rig = Rig(errors=errors, extra=tuple(extra))
    verdict = studied(tool_rows(rig, "tcp", 90001), public.machine())
    names = {one.name for cause in verdict.effects for one in cause.explanations}
    places = [one.name for cause in verdict.effects for one in cause.places]
    for located in verdict.located:
        names |= set(located.resembling)
        places += [one.name for one in located.members]
    if what == "scales":
        assert not names
        assert set(places) <= {"screw/time", "screw/time-line"}
    else:
        assert {"thermal_drift.common"} <= names
        assert "drive/time-line" in places or "drive/time" in places


@pytest.mark.thorough
def test_a_ball_bar_shows_a_bump_of_a_rail_where_it_is() -> None:
    """It was no member of the set: only dials, which stand long at one travel, had bumps."""
    rig = Rig(errors=RIG.errors, extra=(rc.bump(2, 1, -1e-4, -0.038, 0.008),))
    (found,) = studied(tool_rows(rig, "ballbar", 90003), public.machine()).located
    (bump, *_) = (m for m in found.members if m.name.startswith("rail.z.y/travel@"))
    assert bump.probability > 0.5
    assert bump.size == pytest.approx(-1e-4, rel=0.25)
    assert float(bump.name.partition("@")[2]) == pytest.approx(-38, abs=6)
