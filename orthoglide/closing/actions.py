"""What to do about a machine, and what to measure next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, Literal

from orthoglide.control import withholding_reason
from orthoglide.effects.wording import cause_words, confirm_words
from orthoglide.explanation import Cause, Curve, Explanation, Located
from orthoglide.explanation.change import Change
from orthoglide.numerals import plain, with_sigma
from orthoglide.ordering import ranked
from orthoglide.result import Action, Suspect, Withheld
from orthoglide.text import MACHINE_OPTION

if TYPE_CHECKING:
    from orthoglide.closing.outcome import RunOutcome
    from orthoglide.planning import Suggestion

_FILES_OUTDATED = (
    "numbers and commands from files older than {} are no longer valid: use those of this result"
)
_LOST_MOTION_EXCLUDED = "the stated errors of the tool do not include lost motion: "
_COMPENSATE_CORRECTS = "orthoglide compensate makes up for it"
_DIAL_REVERSAL_TEST = (
    "read one gauge block twice, first after a shorter block and then after a longer one: the two "
    "readings should differ by {}"
)
_ALTERNATIVE_TO_ZEROS = "instead of new zeros (not both; the gain is beyond that of the zeros)"
_REPAIR = "Confirm the cause by its test, repair it, and measure again"
_CHECK_SCATTER = (
    "Before more is measured, look for what is loose, or correct the noise that was declared"
)
_MOST_RIVALS = 6  # between which readings are proposed
_GAIN_ROUNDING = 1e-9  # metres: differences of gain below are rounding
_MIN_SIGMAS = 2.0  # standard deviations by which a gain must exceed nothing
_MIN_RELATIVE_GAIN = 0.02  # of the tool's error now: a setting that gains less is not worth a line


def actions(closed: RunOutcome) -> tuple[Action, ...]:
    """Return what to do, in the order of the expected gain.

    The gain of compensated commands is what they gain beyond the best zeros. Measurements come
    first if the verdict depends on them. Nothing is to be entered or mended if the verdict warns
    against it, or if the firmware's own calibration comes first; measurements then come last.
    """
    decides, told = _measurement_actions(closed)
    if closed.firmware is not None and closed.firmware.again:
        return (Action("measure", closed.firmware.again[:-1]), *told)
    if withholding_reason(closed.machine):
        scatters = closed.word == "unexplained" and bool(closed.scattering)
        noisy = [Action("confirm", _CHECK_SCATTER)] * scatters
        return (*noisy, *_finding_actions(closed, "confirm"), *told)
    zeros = list(_zero_actions(closed))
    done = [*zeros, *_finding_actions(closed, "mend", bool(zeros)), *_compensation_actions(closed)]
    done = ranked(
        done, lambda action: action.gain if math.isfinite(action.gain) else 0.0, _GAIN_ROUNDING
    )
    done = _state_alternatives(done)
    return (*told, *done) if decides else (*done, *told)


def _state_alternatives(done: list[Action]) -> list[Action]:
    """Return actions of which alternatives say so: new zeros and compensated commands together
    would correct the zeros twice, and both hold only until something is repaired.
    """
    kinds = [action.kind for action in done]
    both, mended = {"zeros", "compensate"} <= set(kinds), "mend" in kinds
    told = []
    for k, action in enumerate(done):
        words = action.words
        if action.kind in ("zeros", "compensate"):
            if both and action.kind == "compensate":
                words = words.replace("commands:", f"commands {_ALTERNATIVE_TO_ZEROS}:", 1)
            later = not {"zeros", "compensate", "mend"}.isdisjoint(kinds[:k])
            if lead := ", ".join(["or"] * later + ["until something is repaired"] * mended):
                lead = f"{lead[:1].upper()}{lead[1:]}{',' * mended}"
                words = f"{lead} {words[:1].lower()}{words[1:]}"
        told.append(replace(action, words=words))
    return told


def _zero_actions(closed: RunOutcome) -> Iterator[Action]:
    numbers, expected = closed.numbers, closed.numbers.expected
    if closed.firmware is not None:
        found = closed.firmware.corrections
        if found is None:
            yield Action("measure", closed.firmware.touch)
        if found is None or found.keep:
            return
        words = f"Enter the numbers for the firmware, {found.words}"
        yield Action("zeros", words, found.height[0] - found.height[1])
        return
    of = closed.catalogue.effect_of
    known = any(of(name).controller == "zero" for name in closed.machine.spec.parameters)
    gain = expected["now"].shape - expected["zeros"].shape
    now = expected["now"]
    if known and gain > max(_MIN_RELATIVE_GAIN * now.shape, now.shape_sigma):
        named = zip(numbers.drives, numbers.zeros_only, strict=True)
        values = ", ".join(f"{d.leg} {plain(zero * 1e3, 3)}" for d, zero in named)
        yield Action("zeros", f"Enter new zeros in the controller: {values} mm", gain)


def _finding_actions(
    closed: RunOutcome, kind: Literal["confirm", "mend"], zeros: bool = False
) -> Iterator[Action]:
    """Yield causes, located errors and changes, each with the parts to look at and its gain.

    New ``zeros`` to be entered correct a change of a drive's zero too.
    """
    found = [item for item in closed.budget if not item.rest]
    gains = {item.cause: (item.gain, item.gain_sigma) for item in found}
    what = {"confirm": "Confirm before anything is changed", "mend": _REPAIR}
    claims: tuple[Cause | Located, ...] = (*closed.effects, *closed.located)
    for one in claims:
        name = one.name if isinstance(one, Cause) else one.in_machine(closed.catalogue)[0]
        options = suspects(one)
        if kind == "mend" and not may_be_lost_motion(one):
            gain = gains.get(name, (0.0, 0.0))
            several = len(options) > 1
            yield Action(
                kind, what[kind], *gain, options, several, several and _may_be_plate_shape(one)
            )
        else:
            lost = f" ({_LOST_MOTION_EXCLUDED}{_lost_motion_remedy(one)})" if kind == "mend" else ""
            yield Action(kind, f"{what[kind]}{lost}", options=options)
    of = closed.catalogue.effect_of
    for change in closed.moved:
        again = _FILES_OUTDATED.format(change.files[1])
        of_zero = zeros and of(change.parameter).controller == "zero"
        if kind == "confirm" or change.vague:
            yield Action("confirm", what["confirm"], options=suspects(change))
        elif abs(change.after) < abs(change.before):
            rest = " (new zeros correct the remainder)" * of_zero
            words = f"Confirm the repair{rest}; {again}"
            yield Action("confirm", words, options=suspects(change))
        else:
            gain = (math.nan, math.nan)
            gain = gain if may_be_lost_motion(change) else gains.get(change.parameter, gain)
            instead = "enter the new zeros, not both" if of_zero else "correct for it"
            words = f"Confirm the change. Then put it back, or {instead}; {again}"
            yield Action(kind, words, *gain, options=suspects(change))


def may_be_lost_motion(found: Cause | Located | Change) -> bool:
    """Return whether it may be lost motion, which the expected errors of the tool exclude."""
    if isinstance(found, Located):
        return any(curve.place.loses for curve in found.members)
    one = found.chosen if isinstance(found, Cause) else found
    names = found.members if isinstance(found, Change) else found.parameters
    return any("approach" in one.catalogue.effect_of(name).needs for name in names)


def _lost_motion_remedy(found: Cause | Located) -> str:
    """Return what compensates for lost motion, a clause."""
    if isinstance(found, Located):
        if not all(curve.place.in_model for curve in found.members):
            return "neither a controller nor orthoglide compensate makes up for all that it may be"
        drives = all(curve.place.part == "drive" for curve in found.members)
    else:
        each = (e.catalogue.effect_of(e.name) for e in found.explanations)
        drives = all(effect.controller for effect in each)
    if drives:
        return f"a controller's own setting makes up for it, or {_COMPENSATE_CORRECTS}"
    return _COMPENSATE_CORRECTS


def _may_be_plate_shape(found: Cause | Located) -> bool:
    """Return whether it may be a shape of a plate."""
    if isinstance(found, Located):
        return False
    return any(bool(e.catalogue.effect_of(e.name).plate) for e in found.explanations)


def suspects(found: Cause | Located | Change) -> tuple[Suspect, ...]:
    """Return the parts to look at, for every member of a credible set."""
    if isinstance(found, Change):
        return tuple(_suspect_of_change(found, k) for k in range(len(found.members)))
    if isinstance(found, Cause):
        return tuple(Suspect(e.words, e.look_at, confirmation_test(e)) for e in found.explanations)
    return tuple(
        Suspect(c.place.words, c.place.look_at, located_error_test(c)) for c in found.members
    )


def _suspect_of_change(change: Change, k: int) -> Suspect:
    """Return the k-th of the parameters that may have changed, with its value before or after."""
    name = change.members[k]
    effect = change.catalogue.effect_of(name)
    if change.vague and not k:
        return Suspect(change.what_without_alternatives, effect.look_at, "")
    if change.vague or name not in change.summed_members:
        return Suspect(f"or instead {change.member_clauses[k]}", effect.look_at, "")
    now = change.is_cause or abs(change.after) > abs(change.before)
    value = change.after if now else change.before
    said = f"{'now' if now else 'before'}: {cause_words(change.catalogue, name, {name: value})}"
    test = "" if name.member or effect.of_dial else confirm_words(effect, name, value)
    return Suspect(
        said, effect.look_at, test if now or not test else f"{test} if it is there still"
    )


def located_error_test(curve: Curve) -> str:
    """Return the test that shows lost motion of a located error; empty for other errors."""
    place, size = curve.place, curve.size_words
    if place.of_dial:
        return _DIAL_REVERSAL_TEST.format(size) if place.depends_on_approach else ""
    leg = place.names.legs[place.leg]
    where = {
        "drive": f"carriage {leg} along its travel",
        "rail": f"carriage {leg} along {place.direction}",
        "platform": f"the end of leg {leg} at the platform along {place.direction}",
    }.get(place.part)
    if not place.loses or where is None:
        return ""
    where = place.names.in_layout_words(where)
    if place.against == "approach":
        return (
            f"set a dial on {where} and come to one place from smaller and from larger travel of "
            f"{leg}: expect {size} between the two"
        )
    return (
        f"set a dial on {where}, approach one place after a long way in one direction, then again "
        f"with a reversal just before it: the two readings should differ by up to {size}"
    )


def confirmation_test(one: Explanation) -> str:
    """Return the test that confirms a cause, with the reading to expect.

    It is empty for several parameters that are not those of one leg and one cause.
    """
    effect = one.catalogue.effect_of(one.name)
    named = [one.catalogue.parameter(n) for n in one.parameters]
    # Of parameters that each campaign has for itself, the last campaign's.
    values = {p.plain: one.values[n] for p, n in zip(named, one.parameters, strict=True)}
    first, *more = values
    pair = effect.paired and len({p.leg for p in values}) == 1
    if first.member or (more and not pair):
        return ""
    value = math.hypot(*values.values()) if more else values[first]
    campaign = named[-1].campaign if len({p.campaign for p in named}) > 1 else ""
    return confirm_words(effect, first, value) + f" (as in {campaign})" * bool(campaign)


def _compensation_actions(closed: RunOutcome) -> Iterator[Action]:
    gain, sigma = closed.compensation_gain
    if worth_compensating(closed) and gain > _MIN_SIGMAS * sigma:
        words = (
            f"Send compensated commands: orthoglide compensate path.csv --machine calibrated.toml"
            f"{closed.request.effects_option} --out commands.csv"
        )
        yield Action("compensate", words, gain, sigma)


def worth_compensating(closed: RunOutcome) -> bool:
    """Return whether compensated commands reduce the mean shape error further than the best zeros
    do, by more than 2 % of the error now. False after `identify` and for a printer's firmware.
    """
    if not closed.request.searches or closed.firmware is not None:
        return False
    gain, _ = closed.compensation_gain
    return gain > _MIN_RELATIVE_GAIN * closed.numbers.expected["now"].shape


def not_advised(closed: RunOutcome) -> tuple[Withheld, ...]:
    """Return what is not advised, with the reason."""
    kinds: tuple[Literal["zeros", "compensate"], ...] = ("zeros", "compensate")
    if why := withholding_reason(closed.machine):
        return tuple(Withheld(kind, why) for kind in kinds)
    gain, sigma = closed.compensation_gain if worth_compensating(closed) else (0.0, 0.0)
    if gain <= 0 or gain > _MIN_SIGMAS * sigma:
        return ()
    size = with_sigma(gain * 1e3, sigma * 1e3)
    return (
        Withheld("compensate", f"its expected gain, {size} mm, is below two standard deviations"),
    )


def _measurement_actions(closed: RunOutcome) -> tuple[bool, list[Action]]:
    """Return whether the verdict depends on further readings, and the readings that decide most."""
    if not closed.request.searches:
        text = "Look for the cause of the residual: orthoglide close-loop takes the same files"
        return False, [Action("measure", text)] if closed.after.sigma_scale > 1 else []
    sheet = closed.next_sheet
    for one in closed.next_measurements:
        if one.aim == "narrow" and sheet is not None:
            text = f"More readings are optional: the report proposes {len(sheet)}"
            if closed.word == "ambiguous" and any(s.hopeless for s in closed.next_measurements):
                text = "No more readings of this kind decide between the causes: do their tests"
            return False, [Action("measure", text)]
        if not one.hopeless:
            return True, [Action("measure", f"Measure more: {one.what or one.reason}")]
    return False, []


def next_measurements(closed: RunOutcome) -> tuple[Suggestion, ...]:
    """Return the readings to take next, most useful first."""
    option = closed.request.machine_option
    return tuple(
        replace(
            one,
            reason=one.reason.replace(MACHINE_OPTION, option),
            what=one.what.replace(MACHINE_OPTION, option),
        )
        for one in _suggestions(closed)
    )


def _suggestions(closed: RunOutcome) -> tuple[Suggestion, ...]:
    """Return the suggestions, in which the machine's file is still the placeholder ``MACHINE``.

    Readings that tell a data fault from a less probable cause precede all others.
    """
    from orthoglide import planning

    geometry, follow = closed.request.machine.geometry, not closed.stands
    left = closed.lack_of_fit
    again = tuple(map(planning.suggest_repeating, left.by_instrument[:follow]))
    known = closed.posterior
    sets = [(one.chosen.probability, one.data) for one in closed.effects]
    sets += [(one.members[0].probability, one.data) for one in closed.located]
    likely: list[Suggestion] = []
    others: list[Suggestion] = []
    for probability, faults in sets:
        if faults and known is not None:
            visits = likely if faults[0].probability > probability else others
            visits.append(planning.suggest_deciding_visits(known, faults[0]))
    parts = [
        s for one in closed.located if known for s in planning.suggest_separating_places(known, one)
    ]
    if not geometry.dialled:
        apart = (
            () if known is None else planning.suggest_instruments_for_causes(known, closed.effects)
        )
        return (*likely, *apart, *parts, *again, *others)
    several = [(c.chosen, *c.rivals) for c in closed.effects if c.rivals]
    several = several or [tuple(closed.alone[:_MOST_RIVALS])]
    rivals, pairs = list[tuple[str, Mapping[str, float]]](), list[tuple[int, int]]()
    for each in several:  # rivals for one cause are not told from rivals for another
        pairs += combinations(range(len(rivals), len(rivals) + len(each)), 2)
        rivals += [(e.name, e.machine) for e in each]
    apart = planning.next_measurements(closed.after, rivals, pairs=pairs, directions=())
    more = planning.next_measurements(closed.before)
    if follow and left.dials_hold_most:
        again = tuple(planning.suggest_tracing(rest, geometry) for rest in left.by_dial[:1])
    return (*likely, *again, *others, *apart, *parts, *more)
