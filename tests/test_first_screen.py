"""The first screen of the page: part, direction and size, what the tool loses, and what to do."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from orthoglide.closing import RunOutcome, build_result, fill
from orthoglide.closing.drawing import picture
from orthoglide.effects import CATALOGUE, Catalogue, catalogue_of
from orthoglide.effects.free_form import free_forms
from orthoglide.effects.wording import cause_short
from orthoglide.explanation.change import Change
from orthoglide.layout import LinearDelta
from orthoglide.numerals import ByUnit
from orthoglide.parameters import Parameter
from orthoglide.report.claims import probability_words
from orthoglide.report.page import budget, render_template
from orthoglide.report.rows import _rms_change
from orthoglide.report.sentences import _comparison_with_noise, finding_text
from orthoglide.report.terminal import action_lines
from orthoglide.result import Action, BudgetItem, Cause, Explanation, Suspect
from orthoglide.verdict import Verdict
from tests.test_report import closed_of, screen
from tests.tiers import in_turn

DELTA = catalogue_of(LinearDelta.names)


def explained(name: str, value: float, catalogue: Catalogue, probability: float) -> Explanation:
    """A cause as the search would have found it, of a made-up size."""
    return Explanation(
        name, (name,), probability, {name: value}, {name: abs(value) / 20}, catalogue
    )


@cache
def base() -> RunOutcome:
    """Something to put made-up causes into; its own numbers are the ones identified."""
    closed = closed_of("rig")
    closed.numbers  # noqa: B018  computed once for all copies
    return closed


def made_up(
    word: str,
    *causes: Cause,
    changed: tuple[Change, ...] = (),
    budget: tuple[BudgetItem, ...] = (),
    drawn: bool = False,
) -> Verdict:
    """A verdict with causes of any layout; only those of the Orthoglide can be ``drawn``."""
    request = replace(base().request, command="close-loop")
    closed = replace(base(), request=request, word=word, effects=causes, changed=changed)
    kept: dict[str, Any] = {
        "numbers": base().numbers, "budget": budget, "identified": base().identified,
        "compensation_gain": base().compensation_gain,
    }  # fmt: skip
    closed.__dict__.update(kept)
    # The words of a cause follow from the catalogue of its own machine.
    with patch.object(fill, "next_measurements", return_value=()):
        if drawn:
            return replace(build_result(closed, Verdict), effects=causes)
        undrawn = replace(picture(base()), options=())
        with patch.object(fill, "picture", return_value=undrawn):
            return replace(build_result(closed, Verdict), effects=causes)


def item(name: str, **values: Any) -> BudgetItem:
    """An item of the error budget."""
    known = BudgetItem(
        name, cause_short(CATALOGUE, name), (name,), 1e-3, 1e-5, "rad", 2.0, 1.0,
        ByUnit(1e-5, float("nan")), 1e-4, 1e-6, 1e-4, 1e-6, 1e-4, 1e-6, 0.5,
    )  # fmt: skip
    return replace(known, **values)


SIZE = r"([\d.]+) (mm|mrad|%|µm)"
TOWARD = r"toward (the outside|the centre|the counter-clockwise side|the clockwise side|−?[xyz])"
# How a reader finds leg, way and size of each effect: independent of what writes the sentences.
READ = {
    "joint_offset": rf"zero of drive (?P<leg>\w) is {SIZE} too far (?P<way>out|in)\b",
    "encoder_scale": rf"drive (?P<leg>\w) moves {SIZE} (?P<way>more|less) than commanded",
    "screw_error": rf"drive (?P<leg>\w) runs {SIZE} ahead and behind",
    "backlash": rf"drive (?P<leg>\w) has {SIZE} of lost motion(?P<way> with the wrong sign)?",
    "drive_compliance": rf"drive (?P<leg>\w) (?P<way>gives way|moves against the load) by {SIZE}",
    "axis_offset": rf"the (?P<leg>\w) rail stands {SIZE} beside its place, (?P<way>{TOWARD})",
    "axis_tilt": rf"the (?P<leg>\w) carriage is out of square (?P<way>{TOWARD}) by {SIZE}",
    "rail_tilt": rf"the (?P<leg>\w) rail leans (?P<way>{TOWARD}) by {SIZE}",
    "rail_torsion": rf"the (?P<leg>\w) rail is twisted: .*? turns by {SIZE} about it, "
    rf"(?P<way>counter-clockwise|clockwise)",
    "rail_bow": rf"the (?P<leg>\w) rail is bent: its middle stands {SIZE} (?P<way>{TOWARD})",
    "mount_tilt": rf"first hinge of leg (?P<leg>\w) is turned by {SIZE} about (?P<axis>[^,]+|\w, "
    rf"[^,]+), (?P<way>right-handed|left-handed|counter-clockwise|clockwise)",
    "leg_length": rf"bars of leg (?P<leg>\w) are {SIZE} (?P<way>longer|shorter)",
    "bar_mismatch": rf"bar 1 of leg (?P<leg>\w) is {SIZE} (?P<way>longer|shorter) than bar 2",
    "parallelogram_width": rf"link of leg (?P<leg>\w) at the platform is {SIZE} "
    rf"(?P<way>wider|narrower)",
    "thermal_growth": rf"bars of leg (?P<leg>\w) (?P<way>grow|shrink) by {SIZE} a metre",
    "thermal_drift": rf"bars of leg (?P<leg>\w) (?P<way>grow|shrink) by {SIZE} a metre",
    "gauge_direction": rf"dial of (?P<leg>\w+) is turned by {SIZE} .*?(?P<way>right|left)-handed",
    "gauge_scale": rf"dial of (?P<leg>\w+) shows {SIZE} (?P<way>more|less)",
    "gauge_drift": rf"stand of (?P<leg>\w+) creeps: its reading (?P<way>grows|falls) by {SIZE}",
    "part_size": rf"distances in (?P<leg>\w+) {SIZE} (?P<way>longer|shorter)",
    "pillar_width": rf"distances in (?P<leg>\w+) are all {SIZE} too (?P<way>long|short)",
    "plate_bow": rf"plate of (?P<leg>\w+) is a (?P<way>bowl|dome): its rim stands {SIZE}",
    "plate_ring": rf"plate of (?P<leg>\w+) has a (?P<way>hollow|ridge) {SIZE} (?:deep|high) all",
    "plate_saddle": rf"plate of (?P<leg>\w+) is a saddle: its rim stands {SIZE} high toward "
    rf"(?P<way>\d+) degrees",
    "plate_trefoil": rf"plate of (?P<leg>\w+) has three lobes {SIZE} high at its rim, "
    r"one of them toward (?P<way>\d+) degrees",
}
# Of an effect that declares no words: its sentence, its side and a sign.
PLAIN = rf"(?:on leg|in setup) (?P<leg>\w+) .*?(?P<way>(?:{TOWARD}, )?by [+−]?){SIZE}"
UP = {"out", "more", "gives way", "right", "right-handed", "long", "longer", "wider", "grow",
      "grows", "bowl", "hollow", "counter-clockwise"}  # fmt: skip
SCALES = {"mm": 1e-3, "mrad": 1e-3, "%": 1e-2, "µm": 1e-6}
# Said for an hour, or from one end of the stroke to the other.
PER = {"thermal_drift": 1 / 3600, "gauge_drift": 1 / 3600, "rail_torsion": 0.5}
UNSIGNED = {"screw_error"}  # an amplitude
OUTWARD = {"the outside": "radial", "the counter-clockwise side": "tangential"}
INWARD = {"the centre": "radial", "the clockwise side": "tangential"}


def every(catalogue: Catalogue) -> list[Parameter]:
    dials = [e for e in catalogue.values() if e.of_dial]
    return [*catalogue.parameters, *(p for e in dials for p in e.parameters(("left",)))]


# What the parts of a delta are called, turned back into those of an Orthoglide.
PARTS = (
    (r"(?<!of )\btower (\w) (stands|leans|is)\b", r"the \1 rail \2"),
    (r"\btower (\w)\b", r"leg \1"),
    (r"\brods?\b", "bars"), (r"\bbars (\d)\b", r"bar \1"), (r"\beffector\b", "platform"),
)  # fmt: skip


def read(text: str, effect: str) -> tuple[str, str, float]:
    """Part, way and size that a sentence gives, the way as a sign and a direction."""
    for pattern, word in PARTS:
        text = re.sub(pattern, word, text, flags=re.IGNORECASE)
    found = re.search(READ.get(effect, PLAIN), text, re.IGNORECASE)
    assert found, text
    groups = [g for g in found.groups() if g is not None]
    unit = next(g for g in groups if g in SCALES)
    size = float(groups[groups.index(unit) - 1]) * SCALES[unit] * PER.get(effect, 1.0)
    return found["leg"], (found.groupdict().get("way") or "").removeprefix("toward "), size


def points(way: str, p: Parameter, value: float) -> bool:
    """Whether a way is the parameter's, with the sign of its value."""
    if p.effect in UNSIGNED:
        return True
    if p.effect not in READ:
        sides = {"radial": "the outside, ", "tangential": "the counter-clockwise side, "}
        side = sides.get(p.direction, f"{p.direction}, " if p.direction in {"x", "y", "z"} else "")
        sign = "" if CATALOGUE.effect_of(p).paired else "+−"[value < 0]
        return way == f"{side}by {sign}"
    if p.effect == "backlash":
        return bool(way) == (value < 0)
    if count := {"plate_saddle": 2, "plate_trefoil": 3}.get(p.effect):
        phase = np.deg2rad(count * float(way)) - (np.pi / 2 if p.direction == "sin" else 0)
        return bool(np.cos(phase) * np.sign(value) > 0.99)
    if p.effect == "rail_bow":  # u^2 - 1 is negative between the ends
        value = -value
    if p.direction in {"x", "y", "z"}:
        return way == ("−" if value < 0 else "") + p.direction
    if p.direction in {"radial", "tangential"}:
        return (OUTWARD if value > 0 else INWARD).get(way) == p.direction
    return (way in UP) == (value > 0)


@pytest.mark.parametrize(
    ("catalogue", "name", "sign"),
    [
        pytest.param(c, *pair.values, marks=pair.marks, id="-".join([made, *map(str, pair.values)]))
        for made, c in (("orthoglide", CATALOGUE), ("delta", DELTA))
        for pair in in_turn(every(c), [1, -1], group=lambda name: name.effect)
    ],
)
def test_a_reader_finds_part_direction_and_size(
    catalogue: Catalogue, name: Parameter, sign: int
) -> None:
    """Of the cause and of its rival, which has the other sign and half the size."""
    value = sign * 2.5 * catalogue.effect_of(name).tolerance_si
    chosen = explained(name, value, catalogue, 0.6)
    rival = explained(name, -value / 2, catalogue, 0.38)
    text = screen(made_up("ambiguous", Cause(chosen, (rival,), ())))
    if catalogue is DELTA and name.leg:
        assert not re.search(
            r"\b(rails?|bars?|platform|legs?)\b", text.partition("The tool now")[0]
        )
    first, _, other = text.partition(". 60 % likely")
    assert "One of these, which these readings cannot tell apart" in first
    assert "38 % likely" in other
    for said, expected in ((first, value), (other, -value / 2)):
        part, way, size = read(said, name.effect)
        assert part == (name.setup or name.leg)
        assert points(way, name, expected)
        assert size == pytest.approx(abs(expected), rel=0.06)


@pytest.mark.parametrize(
    ("name", "sign"), in_turn(CATALOGUE.parameters, [1, -1], group=lambda name: name.effect)
)
def test_a_reader_finds_what_changed_in_words_on_the_drawing_and_in_what_to_do(
    name: Parameter, sign: int
) -> None:
    """Of what is new, and of what was put right; a cause found tells of its own change."""
    effect, value = CATALOGUE.effect_of(name), 2.5 * sign * CATALOGUE.effect_of(name).tolerance_si
    new = Change(
        {name: value}, CATALOGUE, "", ("calibrated.toml", "second"), 0.0, value,
        abs(value) / 20, abs(value) / 20, 9.0,
    )  # fmt: skip
    for change, state in ((new, "Now"), (replace(new, before=value, after=0.0), "Before")):
        verdict = made_up("adequate", changed=(change,), drawn=True)
        text = screen(verdict)
        said = re.search(
            r"Between calibrated.toml and second the .* changed from (\S+) to (\S+)", text
        )
        assert said
        was, now = (float(v.replace("−", "-")) * effect.unit.spoken.si for v in said.groups())
        assert now - was == pytest.approx(change.after - change.before, rel=0.1)
        assert "more than 99 % sure" in text
        assert "Nothing else is wrong" in text
        (option,) = verdict.picture.options
        assert verdict.picture.first == (0,)
        assert all(mark.leg == "xyz".index(name.leg) for mark in option.marks)
        size = re.match(rf"changed by {SIZE}", option.marks[0].label)
        assert size or name.effect in ("drive_compliance", "thermal_drift", "thermal_growth")
        assert f"changed by {size[1]}" in verdict.picture.svg() if size else option.marks
        _, _, do = text.partition("What to do")
        assert ("put it back, or " if state == "Now" else "Confirm the repair") in do
        assert "from files older than second are no longer valid" in do
        _, _, option_text = do.partition(f"{state}: ")
        part, way, told = read(option_text, name.effect)
        assert part == name.leg
        assert points(way, name, value)
        assert told == pytest.approx(abs(value), rel=0.06)
        assert ("if it is there still" in option_text) == (state == "Before")
    cause = Cause(explained(name, value, CATALOGUE, 1.0), (), ())
    twice = made_up("explained", cause, changed=(new,))
    assert not twice.moved
    assert screen(twice).count("changed from") == 1


def test_how_sure_it_is_counts_all_names_of_a_cause() -> None:
    one = explained("axis_tilt.y.z", 2.4e-3, CATALOGUE, 0.49)
    twin = explained("rail_tilt.y.z", 2.4e-3, CATALOGUE, 0.49)
    text = screen(made_up("explained", Cause(one, (), (twin,))))
    assert "98 % sure, its size 2.40 ± 0.24 mrad (95 %)" in text
    assert "readings and tool are the same either way" in text
    assert "cannot tell" not in text
    assert [probability_words(p) for p in (0.999, 0.93, 0.512)] == [
        "more than 99 % sure", "93 % sure", "51 % likely",
    ]  # fmt: skip


# --- The tool, and what to do ---------------------------------------------------------------


@pytest.mark.parametrize(("name", "loses"), [("backlash.x", True), ("rail_bow.x.z", False)])
def test_lost_motion_of_the_catalogue_is_said_to_be_left_out_too(name: str, loses: bool) -> None:
    one = explained(name, 2e-4, CATALOGUE, 1.0)
    text = screen(made_up("explained", Cause(one, (), ())))
    assert ("Lost motion is left out" in text) == loses


def test_a_place_in_the_budget_has_its_own_words_and_nothing_rounds_to_less_than_zero() -> None:
    """`rail.x.y/travel` is of one leg, not of all."""
    place = next(p for p in free_forms() if p.name == "rail.x.y/travel")
    assert cause_short(CATALOGUE.with_effects([place.effect]), place.effect.name) == place.words
    less = item("axis_tilt", gain=-1e-9, share=-1e-6)
    verdict = made_up("explained", budget=(less,))
    page = render_template("sections/budget.html.j2", data=budget(verdict), result=verdict)
    assert not re.search(r">−0(\.0+)?\b", page)
    assert '"gain, % of the error now">0%<' in page


def test_a_cause_that_is_a_whole_family_gains_its_own_not_what_the_rest_of_it_gains() -> None:
    """Both have the family's name: 0.2 um stood beside a cause of 0.175 mm, behind all else."""
    tilt, rest = ("axis_tilt.x.z", "axis_tilt.y.z"), ("axis_tilt.x.y",)
    cause = Explanation(
        "axis_tilt", tilt, 1.0, dict.fromkeys(tilt, 9e-3), dict.fromkeys(tilt, 1e-5),
        CATALOGUE,
    )  # fmt: skip
    found = item("axis_tilt", members=tilt, gain=1.75e-4)
    left = replace(found, members=rest, gain=2.2e-6, rest=True)
    verdict = made_up("explained", Cause(cause, (), ()), budget=(found, left))
    (action,) = (a for a in verdict.actions if a.kind == "mend")
    assert action.gain == found.gain
    assert not action.whichever
    first, second = (words for _, words in budget(verdict)["rows"])
    assert second == f"{first}: the others of its kind"


def test_the_gain_of_one_of_several_causes_is_said_to_be_that() -> None:
    chosen, rival = (
        explained(name, 2e-3, CATALOGUE, 0.5) for name in ("axis_tilt.y.z", "rail_tilt.y.z")
    )
    verdict = made_up("ambiguous", Cause(chosen, (rival,), ()), budget=(item(chosen.name),))
    said = "gains 0.1 mm at the tool on average, whichever of these it is"
    assert any(said in line for line in action_lines(verdict))
    assert "gains 0.1 mm at the tool on average, whichever of these it is" in screen(verdict)


@pytest.mark.parametrize(
    ("now", "said"),
    [
        (3e-6, "falls from 0.005 to 0.003 mm rms"),
        (4.9e-6, "hardly falls from 0.0050 to 0.0049 mm rms"),
        (5e-6, "does not fall: it is 0.0050 mm rms"),
        (6e-6, "does not fall: it is 0.006 mm rms"),
    ],
)
def test_what_does_not_fall_is_not_said_to_fall(now: float, said: str) -> None:
    """It had hardly fallen, from 0.005 to 0.006 mm."""
    was, is_now = (SimpleNamespace(reported=ByUnit(v, float("nan"))) for v in (5e-6, now))
    assert _rms_change(was, is_now) == said  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("residual", "said"),
    [(0.0071, "more than the noise"), (0.0058, "consistent with the noise"),
     (0.0056, "consistent with the noise")],
)  # fmt: skip
def test_what_is_not_larger_is_not_said_to_be_more(residual: float, said: str) -> None:
    """Of single readings; averages of repeats may be off by more all the same."""
    scores = SimpleNamespace(left=SimpleNamespace(shown={"mm": residual}), deviation_rms=1e-6)
    result = SimpleNamespace(
        request=SimpleNamespace(points=()), warnings=(),
        noise=SimpleNamespace(single_reading=SimpleNamespace(shown={"mm": 0.0058})),
        after=SimpleNamespace(scores=scores, sigma_scale=1.2),
    )  # fmt: skip
    text = _comparison_with_noise(result)  # type: ignore[arg-type]
    assert f", {said} of the dial (0.00" in text
    assert ("averages of repeats are off by more" in text) == (said[:4] != "more")


def test_a_question_on_where_to_look_ends_its_sentence() -> None:
    """What is looked at may be a question; the test that follows is a sentence of its own."""
    suspects = (Suspect("the rail leans", "its seat: does it give?", "set a dial: expect 1 mm"),
                Suspect("the rail leans", "its seat: does it give?", ""))  # fmt: skip
    asked = SimpleNamespace(actions=[Action("mend", "Look", options=suspects)])
    lines = list(action_lines(asked))  # type: ignore[arg-type]
    assert lines[1:] == [
        "   - The rail leans: look at its seat: does it give? Set a dial: expect 1 mm.",
        "   - The rail leans: look at its seat: does it give?",
    ]


@pytest.mark.parametrize("word", ["adequate", "diffuse"])
def test_small_errors_of_every_part_are_found_by_the_verdict_that_says_so_alone(word: str) -> None:
    """*Adequate* stood above "every part is off by about 0.02 of its tolerance"."""
    found = made_up(word)
    scores = replace(found.before.scores, lack_of_fit_p=0.004 if word == "adequate" else 0.002)
    text = finding_text(replace(found, before=replace(found.before, scores=scores), possible=()))
    assert ("every part is off by about" in text) == (word == "diffuse")
    chance = "noise alone leaves as much with probability 0.004"
    unusual = f"; the residual is larger than usual ({chance})."
    nothing = "wrong that these readings could show beyond the joint offsets and leg lengths"
    assert (f"{nothing}{unusual}" in text) == (word == "adequate")
