"""What is found goes out and comes back: in the files of a result, and at a later visit."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from benchmarks import public, second_visit
from orthoglide.checking import Check, check
from orthoglide.checking.comparing import verdict_with_changes
from orthoglide.checking.pages import check_files
from orthoglide.checking.states import read_states
from orthoglide.closing import RunOutcome, build_result
from orthoglide.effects import CATALOGUE
from orthoglide.effects.bumps_and_jumps import jumping, travel_bumps, with_free_forms, with_jump
from orthoglide.effects.free_form import FreeForm, Session, free_forms
from orthoglide.effects.free_form_words import confirming_test
from orthoglide.effects.wording import cause_words, confirm_words, difference_words
from orthoglide.explanation.causes import curve_of
from orthoglide.explanation.change import Change
from orthoglide.numerals import MINUS
from orthoglide.parameters import effect_name
from orthoglide.result import Curve
from tests import rig_campaigns as rc
from tests.rig import Rig
from tests.studied import studied
from tests.test_steps import ERRORS, MACHINE, STROKE, one_way, stations

# --- In files ---------------------------------------------------------------------------------

FORMS = free_forms(Session(0.0, 3600.0))
GAPS = [(-0.0166, -0.0092), (0.0, 0.02)]  # metres
JUMPS = [
    with_jump(jump, pause, STROKE)
    for form in FORMS
    for jump in jumping(form)
    for pause in ([(1000.0, 1020.0)] if form.against == "time" else GAPS)
]
BUMPS = travel_bumps([[-0.0871, 0.0, 0.0123]] * 3, CATALOGUE.legs, STROKE)
KEPT = {form.name: form for form in (*FORMS, *JUMPS, *BUMPS) if form.of_machine}


@pytest.mark.parametrize("name", KEPT)
def test_what_is_read_back_says_the_same(name: str) -> None:
    """A step was "the curve drive z travel -16 6to 9 2, number 1", to be an amplitude."""
    form = KEPT[name]
    coefficients = np.zeros(form.kernel.count)
    coefficients[0] = -3.0
    curve = found_curve(form, coefficients)
    names = [*form.effect.motions]
    values = dict(zip(names, (coefficients * form.prior_sd).tolist(), strict=True))
    read_back = with_free_forms(CATALOGUE, names[:1], MACHINE.geometry)
    assert [*map(str, read_back[form.effect.name].motions)] == [*map(str, names)]
    catalogue = read_back.with_shapes(values)
    effect = catalogue[form.effect.name]
    pair = names[0].undirected
    assert cause_words(catalogue, pair, values) == curve.words
    by_number = {parameter.direction: value for parameter, value in values.items()}
    assert effect.amplitude(by_number) == pytest.approx(curve.size, rel=1e-9)
    (member, weights), *others = catalogue.structured_members(effect.name).items()
    assert not others
    assert [curve.size * weight for weight in weights.values()] == pytest.approx([*values.values()])
    assert difference_words(catalogue, member) == f"error that {form.words}"
    assert confirm_words(effect, pair, curve.size) == confirming_test(form, curve.size)
    assert "_" not in difference_words(catalogue, names[0])
    assert "_" not in catalogue.legs.effect_words(effect.name)


def found_curve(form: FreeForm, coefficients: Any) -> Curve:
    return curve_of(form, 1.0, STROKE, coefficients, np.eye(len(coefficients)))


def test_a_sign_is_in_the_sentence_and_in_the_file() -> None:
    """Only the test of a step said which way it goes."""
    for form in (*JUMPS, *BUMPS):
        coefficients = np.zeros(form.kernel.count)
        sizes = []
        for sign in (1.0, -1.0):
            coefficients[0] = sign
            curve = found_curve(form, coefficients)
            assert np.sign(curve.size) == sign
            assert f", by {'+' if sign > 0 else MINUS}" in curve.words
            sizes.append(curve.derived()[f"size_{curve.unit}"])
        assert sizes[0] == -sizes[1] > 0


def test_the_name_of_a_step_keeps_its_travels() -> None:
    said = CATALOGUE.legs.effect_words("drive_z_travel__16_6to_9_2")
    assert said == f"drive z travel {MINUS}16.6 to {MINUS}9.2"


# --- At a later visit -------------------------------------------------------------------------

ROWS = stations(range(-100, 61, 20), 2)
KINDS: dict[str, tuple[Callable[[float], Any], float]] = {
    "step": (lambda v: rc.drive_step(0, v, -0.002), 5e-4),
    "dead spot": (lambda v: one_way(1, v, 0.026), -5e-4),
    "curve of a rail": (lambda v: rc.s_curve(0, 1, v), 1.5e-4),
    "curve of a drive": (lambda v: rc.drive_wave(1, v, 0.12), 4e-4),
    "jump in time": (lambda v: rc.jumping_drive(1, v, 1000.0), 4e-4),
}
AGAIN = "jump in time"
"""It happens at both visits; a calibrated machine stays where it is after the first."""


def visit(kind: str, share: float, seed: int, name: str) -> og.Campaign:
    fault, size = KINDS[kind]
    rig = Rig(errors=ERRORS, extra=(fault(share * size),))
    return public.campaign(rc.simulate(rig, ROWS, np.random.default_rng(seed)), name)


@pytest.fixture(scope="module", params=KINDS)
def first(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A kind, its outcome at the first visit, and the folder of its result."""
    outcome = studied([visit(request.param, 1.0, 9200, "old")], public.machine())
    out = tmp_path_factory.mktemp("visits") / "out"
    build_result(outcome, og.Verdict).report(out)
    return request.param, outcome, out


def later(first: tuple[str, RunOutcome, Path], share: float) -> tuple[Check, RunOutcome]:
    """A later visit by the result and by the calibrated machine of the first."""
    kind, _, out = first
    now = visit(kind, share, 9250, "new")
    return check(out, [now]), studied([now], og.Machine.load(out / "calibrated.toml"))


@pytest.mark.thorough
def test_an_unchanged_machine_is_unchanged(first: Any) -> None:
    found, again = later(first, 1.0)
    assert (found.changes, found.places) == ((), ())
    if first[0] != AGAIN:
        assert (again.word, again.changed, again.located) == ("adequate", (), ())


@pytest.mark.thorough
def test_a_repaired_error_shows_no_more(first: Any) -> None:
    found, again = later(first, 0.0)
    (gone,) = found.gone
    assert gone.name == first[1].located[0].name
    assert (found.changes, found.come, found.resized) == ((), (), ())
    (size,) = found.with_changes.changed
    assert effect_name(size.parameter) in {m.place.effect.name for m in gone.members}
    assert abs(size.after) < 4 * size.sigma < abs(size.before)
    assert found.sentences[0].startswith("what was located before shows no more: ")
    assert found.line.startswith("Changed: what is located.")
    back = check([visit(first[0], 0.0, 9250, "new")], first[2])
    assert [one.name for one in back.come] == [gone.name]
    assert back.sentences[0].startswith("located now, and not before: ")
    assert not again.effects
    assert not again.located


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.5, 2.0])
def test_an_error_that_grew_or_shrank_is_the_one_change(first: Any, share: float) -> None:
    found, again = later(first, share)
    assert not found.places
    (change,) = found.changes
    (located,) = first[1].located
    assert change.parameter.effect in {m.place.effect.name for m in located.members}
    assert change.before == pytest.approx(located.members[0].size, abs=4 * change.sigma)
    assert change.after == pytest.approx(share * change.before, abs=4 * change.sigma)
    assert f"the error that {located.members[0].place.words}" in change.what
    assert [c.parameter for c in found.with_changes.changed] == [str(change.parameter)]
    if first[0] != AGAIN:
        assert not again.effects
        assert all(str(c.parameter).endswith(".size") for c in again.changed)


def test_a_calibrated_machine_is_compared_as_the_one_before() -> None:
    """Its coefficients of a located error had changed, each by itself."""
    form = KEPT["drive.x/travel"]
    name = str(next(iter(form.effect.motions)))
    known = MACHINE.with_effects([form.effect]).with_parameters({"rail_bow.x.y": 1e-4, name: 1e-5})
    readings = visit("step", 0.0, 9300, "visit")
    for state in read_states(readings, readings, known):
        assert state.machine.values == known.values  # as its owner wrote it
    calibrated = known.with_provenance({"verdict": "located"})
    for state in read_states(readings, readings, calibrated):
        assert (state.machine.values, state.machine.posterior.names) == ({}, ())
        assert state.machine.catalogue == MACHINE.catalogue


@pytest.mark.thorough
def test_a_fit_with_a_large_residual_converges() -> None:
    """Five parameters changed by several tolerances: Gauss-Newton's steps alone go to and fro."""
    found = second_visit.run((5, "two-gauges", 11), 7003)
    assert found["word"] != "error"
    for route in second_visit.ROUTES:
        assert {name for one in found[route] for name in one["right"]} >= {"axis_tilt.x.y"}


SWEEP = rc.protocol_rows("sweep")


def wave_visit(fault: Any, seed: int, name: str, zero: float = 0.0) -> og.Campaign:
    errors = {**ERRORS, "joint_offset.y": ERRORS.get("joint_offset.y", 0.0) + zero}
    rig = Rig(errors=errors, extra=(fault,))
    return public.campaign(rc.simulate(rig, SWEEP, np.random.default_rng(seed)), name)


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.0, 2.0])
def test_a_calibrated_wave_is_compared_by_its_size(share: float, tmp_path: Path) -> None:
    """The parts of its trial periods had changed, each by itself."""
    old, new = (
        wave_visit(rc.drive_wave(1, k * 3e-4, 0.06), 41200 + j, f"visit{j}")
        for j, k in enumerate((1.0, share))
    )
    build_result(studied([old], public.machine()), og.Verdict).report(tmp_path / "out")
    found = check([old], [new], tmp_path / "out" / "calibrated.toml")
    if share:
        (change,) = found.changes
        assert change.parameter.effect.startswith("drive_y_waves_")
        assert change.difference == pytest.approx(2.12e-4, abs=3 * change.sigma)
    else:
        (gone,) = found.gone
        assert gone.name.startswith("drive.y/waves@")
        assert not found.changes


@pytest.mark.thorough
@pytest.mark.parametrize("zero", [0.0, 1e-3])
def test_a_repaired_wave_of_a_drive_moves_no_zero(zero: float, tmp_path: Path) -> None:
    """Its level was taken as known: a zero had changed by -0.127 +- 0.008 mm that had not."""
    states = [
        wave_visit(rc.drive_wave(1, size, 0.06), 41200 + k, name, shift)
        for k, (size, name, shift) in enumerate([(3e-4, "old", 0.0), (0.0, "new", zero)])
    ]
    found = check(*([state] for state in states), public.machine())
    offset = next(d for d in found.differences if str(d.parameter) == "joint_offset.y")
    assert [change.parameter for change in found.changes] == [offset.parameter] * bool(zero)
    assert offset.difference == pytest.approx(zero, abs=2 * offset.sigma)
    (tmp_path / "result.json").write_text(str(check_files(found)["result.json"]), "utf-8")
    stored = og.Verdict.load(tmp_path)
    *others, wave = (change.parameter for change in stored.changed)
    assert others == [*map(str, [offset.parameter] * bool(zero))]
    assert wave.startswith("drive_y_waves_60_")
    assert stored.compared == found.sentences
    assert len(pickle.dumps(found)) < 2e6  # with both runs it was 214 MB


@pytest.mark.thorough
def test_the_size_of_a_short_wave_is_as_uncertain_as_its_shape() -> None:
    """A wave between the stations had grown by 0.126 +- 0.003 mm, in truth by 0.212."""
    old, new = (
        wave_visit(rc.drive_wave(1, k * 3e-4, 0.031), 41300 + k, f"visit{k}") for k in (1, 2)
    )
    (change,) = check([old], [new], public.machine()).changes
    assert change.parameter.effect.startswith("drive_y_waves_31_")
    assert change.difference == pytest.approx(2.12e-4, abs=2 * change.sigma)


def test_the_sigma_of_a_size_is_that_of_draws() -> None:
    """A root mean square lacks what readings do not show of a curve. To second order, so that over
    seeds the sigma of curves of chance is up to a third too large.
    """
    rng = np.random.default_rng(41400)
    for form in (form for form in KEPT.values() if not form.of_dial):
        count = form.sampled[1].shape[1]
        for shown in (3.0, 0.3):
            mean, root = shown * rng.standard_normal(count), rng.standard_normal((count, count))
            functions = form.sampled[1]
            if form.is_local or form.against == "time":
                root *= 1e-3  # the largest value stays where it is
            covariance = functions @ root @ root.T @ functions.T / count
            draws = [
                form.size(functions @ (mean + root @ rng.standard_normal(count) / count**0.5))
                for _ in range(400)
            ]
            value = functions @ mean
            error = np.sqrt(np.mean((np.array(draws) - form.size(value)) ** 2))
            assert form.size_sigma(value, covariance) == pytest.approx(error, rel=0.35), form.name


@pytest.mark.thorough
def test_an_alternative_that_the_machine_lacks_is_not_drawn(first: Any) -> None:
    """The size of a located error stood beside a zero, and there was no answer."""
    _, outcome, _ = first
    curve, machine = outcome.located[0].members[0], outcome.request.machine
    shape = curve.place.shape_effect(curve.coefficients)
    catalogue = machine.catalogue.with_effects([shape])
    zero = catalogue.parameter("joint_offset.x")
    sizes = {zero: 1e-4, next(iter(shape.motions)): 1e-4}
    change = Change(sizes, catalogue, "", ("old", "new"), 0.0, 1e-4, 1e-5, 1e-5)
    (drawn,) = verdict_with_changes(outcome, [change]).changed
    assert drawn.members == (zero,)


@pytest.mark.thorough
def test_a_file_that_lacks_a_coefficient_is_compared(first: Any, tmp_path: Path) -> None:
    """A line was deleted by hand, and the program failed."""
    kind, outcome, out = first
    effect = outcome.located[0].members[0].place.effect.name
    lines = (out / "calibrated.toml").read_text("utf-8").splitlines()
    own = [k for k, line in enumerate(lines) if line.startswith(f'"{effect}.')]
    edited = [line for k, line in enumerate(lines) if k != own[-1]]
    (tmp_path / "edited.toml").write_text("\n".join(edited), encoding="utf-8")
    now = visit(kind, 1.0, 9250, "new")
    assert studied([now], og.Machine.load(tmp_path / "edited.toml")).word
