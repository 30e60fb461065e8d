"""Verdicts hold for what they tell: no word of them contradicts the table below it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks.public import tcp_points
from orthoglide.closing import build_result, compute_outcome
from orthoglide.effects import CATALOGUE
from orthoglide.effects.free_form import FreeForm, Session, free_forms
from orthoglide.effects.free_form_place import Dependence, Part
from orthoglide.effects.free_form_words import confirming_test
from orthoglide.effects.kernels import Level
from orthoglide.effects.wording import cause_short
from orthoglide.explanation import credible_sets, full_posterior, posterior_lack_of_fit
from orthoglide.explanation.causes import CredibleSets, curve_of, fitted_beyond_tolerance
from orthoglide.explanation.lack_of_fit import SIGNIFICANT
from orthoglide.fit import assemble, solve
from orthoglide.fit.notes import notes
from orthoglide.numerals import compact, plain
from orthoglide.report.sentences import headline
from orthoglide.result import Request
from tests import rig_campaigns as rc
from tests.factors import campaign_of
from tests.rig import LEGS, Rig
from tests.studied import studied

NOTHING = CredibleSets()


def swept(rig: Rig, seed: int = 3) -> og.Campaign:
    rng = np.random.default_rng(seed)
    base = {f"joint_offset.{leg}": float(rng.normal(0, 5e-4)) for leg in LEGS}
    base |= {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}
    rows = rc.simulate(rig.with_errors(base), "sweep", rng, background=0.015)
    return campaign_of(rows)


@pytest.mark.thorough
def test_a_verdict_and_its_table_agree() -> None:
    """Two places far apart fit, the base of each elsewhere: their mean had fitted as neither does.

    Drive x goes wrong by the square of what drive y is told, which a dial's curve imitates.
    """

    def bent(travel: np.ndarray, approach: np.ndarray, time: np.ndarray) -> np.ndarray:
        moved = np.zeros((len(travel), 3, 3))
        moved[:, 0, 0] = 3e-4 * (travel[:, 1] / 0.1) ** 2  # of 6e-4 the sweep tells them apart
        return moved

    verdict = studied(swept(Rig(extra=(bent,))))
    assert verdict.word == "located"
    members = verdict.located[0].members  # the mean is over all of them
    assert len(members) > 1
    assert verdict.after.scores.lack_of_fit_p > SIGNIFICANT
    about, curves = verdict.posterior.linearised, verdict.after.problem.free_form_nuisances
    groups = {group.name: group for group in verdict.posterior.mixture.linear.groups}
    for member in (one for one in members if one.probability > 0.1):
        own = about.rows.columns(groups[member.name].coefficients)
        off = own - curves.columns @ np.linalg.lstsq(curves.columns, own, rcond=1e-12)[0]
        assert np.abs(off).max() < 1e-12


def test_bars_of_one_wrong_length_are_a_cause_beside_drives_that_move_too_little(
    machine: og.Machine,
) -> None:
    """All rods cut 0.8 mm long, eight tolerances: with dials on the legs both fit alike."""
    rig = Rig().with_errors({f"leg_length.{leg}": 8e-4 for leg in LEGS})
    rows = rc.simulate(rig, "sweep", np.random.default_rng(1), background=0.0)
    outcome = studied(campaign_of(rows, machine), machine)
    assert outcome.word == "ambiguous"
    (cause,) = outcome.effects
    size = {one.name: one.values.get(one.name) for one in cause.explanations}
    assert {"encoder_scale.common", "leg_length.common"} <= set(size)
    assert size["leg_length.common"] == pytest.approx(8e-4, rel=0.3)


def test_a_fitted_part_far_beyond_its_tolerance_is_a_finding(machine: og.Machine) -> None:
    """It was *adequate*, and beneath that 9.2 times its tolerance; zeros are set."""
    rig = Rig().with_errors({"joint_offset.x": 7e-3, "leg_length.y": 9e-4})
    rows = rc.simulate(rig, "two-gauges", np.random.default_rng(4), background=0.0)
    outcome = compute_outcome(Request("identify", (campaign_of(rows, machine),), machine))
    assert outcome.word == "explained"
    assert [cause.name for cause in outcome.effects] == ["leg_length.y"]
    said = [note for note in notes(outcome.after) if note.kind == "tolerance"]
    assert [note.partition(" is ")[0] for note in said] == [
        "joint offset of leg x",
        "leg length of leg y",
    ]
    result = build_result(outcome, og.Verdict)
    assert headline(result).startswith("The bars of leg y are 0.9")
    assert "With the joint offsets and leg lengths corrected" in headline(result)
    (zeros,) = (action for action in result.actions if action.kind == "zeros")
    assert f"{zeros.words}." in headline(result)
    uncertain = replace(outcome.after, covariance=4e-7 * np.eye(len(outcome.after.names)))
    assert not fitted_beyond_tolerance(uncertain)
    (note,) = (note for note in notes(uncertain) if note.startswith("leg length"))
    assert "of 0.1 mm (± 0.63 mm, so it may be within three times the tolerance)" in note


@pytest.mark.parametrize("as_points", [True, False])
def test_zeros_that_points_confirm_are_advised_although_they_contradict_the_cause(
    as_points: bool, machine: og.Machine
) -> None:
    """A rail was bent when the dials read it, and is straight where the tool is measured."""
    rng = np.random.default_rng(2)
    errors = {"joint_offset.x": -1e-4, "joint_offset.y": -9e-4, "joint_offset.z": -2.5e-3}
    bent = Rig().with_errors(errors | {"rail_bow.x.z": 4e-4})
    read = campaign_of(rc.simulate(bent, "standard", rng, background=0.015), machine)
    straight = Rig().with_errors(errors)
    points = tcp_points(rc.tcp_points(straight, 30, rng))
    held = campaign_of(rc.simulate(straight, "standard", rng), machine)
    result = og.close_loop(read, machine, **({"tcp": points} if as_points else {"holdout": held}))
    assert [cause.name for cause in result.effects] == ["rail_bow.x.z"]
    assert "so do not act on it before it is confirmed. But they confirm the new zeros" in (
        headline(result)
    )
    kinds = [action.kind for action in result.actions]
    assert "zeros" in kinds
    assert "confirm" in kinds
    assert not {"mend", "compensate"} & {*kinds}
    assert not result.withheld
    # The numbers are of the machine with the zeros alone, and an export gives the same.
    assert {name.partition(".")[0] for name in result.machine.values} == {"joint_offset"}
    advised = next(action.words for action in result.actions if action.kind == "zeros")
    for zeros_only in (True, False):
        for drive in og.controller_numbers(result.machine, zeros_only=zeros_only).drives:
            assert f"{drive.leg} {plain(drive.new_zero * 1e3, 3)}" in advised
    assert result.machine.values["joint_offset.z"] == pytest.approx(-2.5e-3, abs=2e-5)


@pytest.mark.thorough
def test_zeros_of_which_one_is_wrong_are_not_confirmed(machine: og.Machine) -> None:
    """The zero of z was set anew before the tool was measured."""
    rng = np.random.default_rng(2)
    errors = {"joint_offset.x": -5e-4, "joint_offset.y": -9e-4, "joint_offset.z": 7e-4}
    bent = Rig().with_errors(errors | {"rail_bow.x.z": 4e-4})
    read = campaign_of(rc.simulate(bent, "standard", rng, background=0.015), machine)
    straight = Rig().with_errors(errors | {"joint_offset.z": 0.0})
    result = og.close_loop(read, machine, tcp=tcp_points(rc.tcp_points(straight, 30, rng)))
    assert "contradict this result" in headline(result)
    assert "zeros" in [one.kind for one in result.withheld]
    assert "zeros" not in [action.kind for action in result.actions]


def test_a_place_that_is_more_probable_than_not_is_told(machine: og.Machine) -> None:
    """Only causes with a name were, and of such a place the verdict said nothing."""
    rng = np.random.default_rng([9300, 2])
    errors = {f"joint_offset.{leg}": float(rng.normal(0, 5e-4)) for leg in LEGS}
    rig = Rig(errors=errors, extra=(rc.drive_step(2, float(rng.uniform(0.4, 1.2)) * 1.2e-4),))
    outcome = studied(
        campaign_of(rc.simulate(rig, "sweep", rng, background=0.015), machine), machine
    )
    assert not outcome.found
    (place,) = outcome.possible
    assert place.name.startswith("drive.z/travel")
    assert 0.5 < place.probability < 0.9
    result = build_result(outcome, og.Verdict)
    assert "Perhaps drive z " in headline(result)
    assert f"its probability is {compact(place.probability, 2)}" in headline(result)
    (action,) = (action for action in result.actions if action.kind == "confirm")
    assert "drive z" in action.options[0].words
    (possible,) = result.possible
    assert possible.after.rms < result.before.scores.rms


def test_a_cause_that_is_one_of_several_is_told() -> None:
    """None of them is more probable than not, and together they are."""
    rig = Rig().with_errors({"bar_mismatch.y": 2e-4})
    rows = rc.simulate(rig, "sweep", np.random.default_rng(1), background=0.0)
    verdict = og.close_loop(campaign_of(rows))
    assert verdict.word == "diffuse"
    chances = [one.probability for one in verdict.possible]
    assert sum(chances[:-1]) < 0.5 < sum(chances)
    others = f"or 1 other cause: their probability is {compact(sum(chances), 2)}."
    assert re.search(rf"Perhaps .*, {others}", headline(verdict))
    (test,) = (one for one in verdict.actions if one.kind == "confirm")
    assert len(test.options) == len(chances)


def test_warmth_between_repeats_takes_nothing_of_the_means() -> None:
    """Its effects move the readings of one station apart: they had been taken off the degrees of
    freedom of the stations' means, and 1e-15 stood beside a chi2 below its degrees.
    """
    rng = np.random.default_rng([3, 5])
    rows = rc.protocol_rows("standard", repeats=3)
    block = np.cumsum([0, *(np.diff([row["repeat"] for row in rows]) != 0)])
    for row, k in zip(rows, block, strict=True):
        row["time_s"] += 3600.0 * int(k)  # a rest between repeats
    level = 20 + rng.normal(0, 4, block[-1] + 1)
    growth = {f"thermal_growth.{leg}": float(rng.uniform(0.5, 1.5) * 1e-5) for leg in LEGS}
    base = {f"joint_offset.{leg}": float(rng.normal(0, 5e-4)) for leg in LEGS}
    warm = rc.simulate(
        Rig(errors=base | growth), rows, rng, background=0.02,
        temperature=lambda t: level[np.asarray(t // 3600, dtype=int)],
    )  # fmt: skip
    machine = og.Machine.load(Path(__file__).parent / "data" / "rig" / "machine.toml")
    after = studied(campaign_of(warm), machine).after.scores
    assert after.chi2 > 1.3 * after.dof or after.lack_of_fit_p > 0.05


def test_what_is_not_told_explains_nothing() -> None:
    """A machine with one clear cause leaves nothing once it is told, and much if it were not,
    unless the machine that is handed out has it all the same.
    """
    campaign = swept(Rig(errors={"axis_tilt.y.z": 2e-3}))
    machine = og.Machine.nominal()
    known = full_posterior(solve(assemble([campaign], machine, machine.catalogue.base)))
    found = credible_sets(known)
    assert "axis_tilt.y.z" in found.names
    assert posterior_lack_of_fit(known, NOTHING).p_value > 0.01
    known.__dict__["after"] = known.before  # as if the mean did not fit
    told, untold = posterior_lack_of_fit(known, found), posterior_lack_of_fit(known, NOTHING)
    assert told.p_value > 0.01
    assert untold.p_value < 1e-6
    assert untold.with_unreported == pytest.approx(told.p_value, rel=0.5)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [59, 170, 213])
def test_zeros_far_off_beside_noise_of_one_chance_in_a_hundred(seed: int) -> None:
    """What was left by chance kept the tolerances, ten of which no explanation could be weighed
    at: *unexplained*.
    """
    nominal, rng = og.Machine.nominal(), np.random.default_rng([0, seed])
    names = [f"{effect}.{leg}" for effect in ("joint_offset", "leg_length") for leg in "xyz"]
    errors = {n: nominal.tolerance(n) * float(rng.uniform(-10, 10)) for n in names}
    campaign = og.simulate(nominal.with_parameters(errors), "standard", noise=5e-6, seed=seed)
    verdict = studied(campaign, nominal)
    assert 1e-4 < verdict.before.scores.lack_of_fit_p < 0.01
    assert verdict.word == "adequate"
    for name in names[:3]:
        assert verdict.after.values[name] == pytest.approx(errors[name], abs=6e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("value", [0.0, 8.15e-3])
def test_readings_that_are_all_alike_are_no_sound_machine(value: float) -> None:
    sheet = og.protocol("standard")
    verdict = og.close_loop(sheet.with_readings(np.full(len(sheet), value)))
    assert verdict.word == "adequate"
    assert headline(verdict).startswith("These readings show no error at all: either")


@pytest.mark.parametrize(
    ("part", "axis", "against", "spot"),
    [
        ("drive", "a", "approach", "carriage y along its travel and come to one place"),
        ("rail", "b", "approach", "carriage y along z and come to one place"),
        ("rail", "b", "reversal", "carriage y along z, approach one place after a long way"),
    ],
)
def test_lost_motion_of_a_place_comes_with_the_test_that_shows_it(
    part: Part, axis: str, against: Dependence, spot: str
) -> None:
    place = FreeForm(part, 1, axis, against, kernel=Level())
    said = confirming_test(place, 5e-5)
    assert said.startswith(f"set a dial on {spot}")
    assert " 0.05 mm" in said
    assert confirming_test(replace(place, against="travel"), 5e-5) == ""


def test_an_error_at_a_negative_travel_keeps_its_sign() -> None:
    assert CATALOGUE.legs.effect_words("rail_x_z_travel__50") == "rail x z travel \N{MINUS SIGN}50"


def test_patterns_about_different_axes_have_different_words() -> None:
    names = [f"mount_tilt.{axis}.common" for axis in "ab"]
    assert len({cause_short(CATALOGUE, name) for name in names}) == 2


def test_a_size_that_grows_with_the_travel_says_where_it_is_reached() -> None:
    """The displacement by a scale is zero at mechanical zero, and most at the ends."""
    form = next(f for f in free_forms(Session(0.0, 3600.0)) if f.part == "screw" and f.leg >= 0)
    count = form.kernel.count
    curve = curve_of(form, 0.9, (-0.1, 0.06), np.ones(count), np.eye(count))
    assert curve.words.endswith(f"{curve.size_words} half a stroke from mechanical zero")
    largest = compact(np.abs(curve.value).max() * 1e3, 2)  # as it counts from the start
    assert curve.words_with_measure.endswith(f"{largest} mm half a stroke from mechanical zero")
