"""What to do about a machine, and what to measure next."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Literal

import numpy as np

from orthoglide import planning
from orthoglide.accuracy import lack_of_gain
from orthoglide.closing.outcome import RunOutcome
from orthoglide.control import DeltaSizes, withholding_reason
from orthoglide.effects.free_form_words import confirming_test
from orthoglide.effects.plates import PLATE_BOW
from orthoglide.effects.wording import cause_words, confirm_words
from orthoglide.explanation.change import Change
from orthoglide.machine import Machine
from orthoglide.numerals import plain, signed, with_sigma
from orthoglide.observations import Readings
from orthoglide.ordering import ranked
from orthoglide.planning import Suggestion
from orthoglide.result import Action, Cause, Curve, Explanation, Located, Suspect
from orthoglide.result.display import Withheld
from orthoglide.text import MACHINE_OPTION, listed, lower_first

_MOST_RIVALS = 6  # single causes between which readings are proposed; pairs grow by the square


def next_measurements(outcome: RunOutcome) -> tuple[Suggestion, ...]:
    """Return the readings to take next, most useful first; none after ``identify``.

    Readings that distinguish a data fault from a less probable cause come first.
    """
    if not outcome.request.searches:
        return ()
    geometry, posterior = outcome.request.machine.geometry, outcome.posterior
    inconclusive, lack_of_fit = not outcome.stands, outcome.lack_of_fit
    largest = lack_of_fit.by_instrument[:1] if inconclusive else []
    at_residual = [*map(planning.suggest_repeating, largest)]
    first: list[Suggestion] = []
    later: list[Suggestion] = []
    by_place: list[Suggestion] = []
    separating: Iterable[Suggestion] = ()
    if posterior is not None:
        credible_sets = [(c.chosen.probability, c.data) for c in outcome.effects]
        credible_sets += [(c.members[0].probability, c.data) for c in outcome.located]
        for probability, faults in credible_sets:
            if faults:
                visits = first if faults[0].probability > probability else later
                visits.append(planning.suggest_deciding_visits(posterior, faults[0]))
        for located in outcome.located:
            by_place += planning.suggest_separating_located_errors(posterior, located)
        if not geometry.dialled:
            separating = planning.suggest_instruments_for_causes(posterior, outcome.effects)
    if not geometry.dialled:  # sheets of instruments have a placeholder for the machine's file
        option, texts = outcome.request.machine_option, ("reason", "what")
        return tuple(
            replace(s, **{n: getattr(s, n).replace(MACHINE_OPTION, option) for n in texts})
            for s in (*first, *separating, *by_place, *at_residual, *later)
        )
    rival_sets = [(c.chosen, *c.rivals) for c in outcome.effects if c.rivals]
    rivals, pairs = list[tuple[str, Mapping[str, float]]](), list[tuple[int, int]]()
    motions = outcome.after.problem.machine.catalogue.motions
    for rival_set in rival_sets or [outcome.alone[:_MOST_RIVALS]]:  # pairs only within a set
        pairs += combinations(range(len(rivals), len(rivals) + len(rival_set)), 2)
        # Free-form errors, which the catalogue lacks, are nearly the same with every rival.
        rivals += [
            (e.name, {n: v for n, v in e.machine.items() if n in motions}) for e in rival_set
        ]
    separating = planning.next_measurements(outcome.after, rivals, pairs=pairs, directions=())
    narrowing = planning.next_measurements(outcome.before)
    if inconclusive and lack_of_fit.dials_hold_most:
        at_residual = [planning.suggest_tracing(lack_of_fit.by_dial[0], geometry)]
    return (*first, *at_residual, *later, *separating, *by_place, *narrowing)


_FILES_OUTDATED = (
    "numbers and commands from files older than {} are no longer valid: use those of this result"
)
_LOST_MOTION_EXCLUDED = "the stated errors of the tool do not include lost motion: "
_COMPENSATE_CORRECTS = "orthoglide compensate corrects it"
_ALTERNATIVE_TO_ZEROS = "instead of new zeros (not both; the gain is beyond that of the zeros)"
_REPAIR = "Confirm the cause by its test, repair it, and measure again"
_REPAIR_IF_DATA_HOLD = f"If the data prove right: {lower_first(_REPAIR)}"
_TEST_LIKELY = "Test what is likely, but not certain"
_CHECK_SCATTER = (
    "Before more is measured, look for what is loose, or correct the noise that was declared"
)
_GAIN_ROUNDING = 1e-9  # metres: smaller differences of gain are rounding
_MIN_CHANGE = 1e-4  # metres: smaller changes of a size are not named, half a layer of a print
_CORRECT_SIZES = "Correct the sizes by which the controller computes ({}), in the machine file too"
_SET_ENDSTOPS = "set endstops and height by the controller's own calibration"
_MEASURE_FIRST = (
    "No new size is advised yet (expected gain {} mm), as a bowl of the plate{} looks like another "
    "radius: before any size is entered, {}lay a straight edge across the plate and put the gap "
    "under it (0.02 if none is seen) into the machine file, {} under [tolerance]"
)
_MIN_UNCERTAIN_GAIN = 5e-5  # metres: less is not worth a measurement
_MIN_RELATIVE_GAIN = 0.02  # smallest gain worth a line, relative to the tool's error now


def actions(
    outcome: RunOutcome, suggestions: Sequence[Suggestion], sheet: Readings | None
) -> tuple[Action, ...]:
    """Return what to do, largest expected gain first; ``sheet`` has the suggested readings.

    The gain of compensated commands is their gain over the best zeros. Measurements come first if
    the verdict depends on them. Nothing is to be entered or repaired if the verdict warns against
    it or if the firmware's own calibration comes first; measurements then come last.
    """
    measure_first, measurements = _measurement_actions(outcome, suggestions, sheet)
    if outcome.firmware is not None and outcome.firmware.again:
        return (Action("measure", outcome.firmware.again[:-1]), *measurements)
    if withholding_reason(outcome.machine):
        noisy_repeats = outcome.word == "unexplained" and bool(outcome.scattering)
        scatter_checks = [Action("confirm", _CHECK_SCATTER)] * noisy_repeats
        return (*scatter_checks, *_finding_actions(outcome, "confirm"), *measurements)
    sizes, machine = outcome.sizes, outcome.machine
    steps = [*(_size_actions(sizes, machine) if sizes else _zero_actions(outcome))]
    prerequisites = [action for action in steps if action.kind == "measure"]
    steps = [action for action in steps if action.kind != "measure"]
    zeros = any(action.kind == "zeros" for action in steps)
    steps += _finding_actions(outcome, "confirm" if outcome.refuted else "mend", zeros=zeros)
    compensation = _compensation(outcome)
    steps += [compensation] if isinstance(compensation, Action) else []
    steps = ranked(steps, lambda a: a.gain if math.isfinite(a.gain) else 0.0, _GAIN_ROUNDING)
    steps = _state_alternatives(steps)
    steps = [*measurements, *steps] if measure_first else [*steps, *measurements]
    return (*prerequisites, *steps)


def _state_alternatives(steps: list[Action]) -> list[Action]:
    """Return the actions, each alternative stated as one: new zeros and compensated commands
    together would correct the zeros twice, and both are valid only until something is repaired.
    """
    kinds = [action.kind for action in steps]
    has_both, has_repair = {"zeros", "compensate"} <= set(kinds), "mend" in kinds
    reworded = []
    for k, action in enumerate(steps):
        words = action.words
        if action.kind in ("zeros", "compensate"):
            if has_both and action.kind == "compensate":
                words = words.replace("commands:", f"commands {_ALTERNATIVE_TO_ZEROS}:", 1)
            later = not {"zeros", "compensate", "mend"}.isdisjoint(kinds[:k])
            if lead := ", ".join(["or"] * later + ["until something is repaired,"] * has_repair):
                words = f"{lead.capitalize()} {words[:1].lower()}{words[1:]}"
        reworded.append(replace(action, words=words))
    return reworded


def _zero_actions(outcome: RunOutcome) -> Iterator[Action]:
    if outcome.firmware is not None:
        corrections = outcome.firmware.corrections
        if corrections is None:
            yield Action("measure", outcome.firmware.touch)
        if corrections is None or corrections.keep:
            return
        words = f"Enter the numbers for the firmware, {corrections.words}"
        yield Action("zeros", words, corrections.height[0] - corrections.height[1])
        return
    effect_of, numbers = outcome.catalogue.effect_of, outcome.numbers
    takes_zeros = any(effect_of(n).controller == "zero" for n in outcome.machine.spec.parameters)
    now = numbers.expected["now"]
    gain = now.shape - numbers.expected["zeros"].shape
    if takes_zeros and gain > max(_MIN_RELATIVE_GAIN * now.shape, now.shape_sigma):
        drive_zeros = zip(numbers.drives, numbers.zeros_only, strict=True)
        values = ", ".join(f"{d.leg} {plain(zero * 1e3, 3)}" for d, zero in drive_zeros)
        yield Action("zeros", f"Enter new zeros in the controller: {values} mm", gain)


def _size_actions(found: DeltaSizes, machine: Machine) -> Iterator[Action]:
    """Yield the action to correct the numbers by which the controller of a delta computes, or to
    measure what leaves them uncertain.
    """
    geometry, sizes, arms = machine.geometry, list[str](), machine.geometry.L + found.arms
    radius = float(np.hypot(*geometry.centres[:, :2].T).mean())
    if abs(found.radius) > _MIN_CHANGE:
        to = (radius + found.radius) * 1e3
        sizes.append(
            f"radius {signed(found.radius * 1e3, 2)} mm, to {to:.2f} mm, and radius_mm, which "
            f"includes r, to {to + geometry.r * 1e3:.2f} mm"
        )
    if abs(found.arms) > _MIN_CHANGE:
        sizes.append(f"L {signed(found.arms * 1e3, 2)} mm, to {arms * 1e3:.2f} mm")
    legs = [*zip(geometry.leg_names, found.shifts, found.endstops, strict=True)]
    sizes += [
        f"tower {leg} {signed(np.rad2deg(shift / radius), 2)}°"
        for leg, shift, _ in legs
        if abs(shift) > _MIN_CHANGE
    ]
    if not found.advised:
        lengths = machine.spec.measured
        lacking = ["a rod between its holes"] * (lengths.rods is None)
        lacking += ["how far a carriage goes at a command of 100 mm"] * (lengths.travel is None)
        first = f"measure {listed(lacking)} ([measured] of the machine file), and " * bool(lacking)
        if found.gain > _MIN_UNCERTAIN_GAIN and sizes:
            gain = with_sigma(found.gain * 1e3, found.sigma * 1e3)
            rods = " or rods of another length" * (lengths.rods is None)
            yield Action("measure", _MEASURE_FIRST.format(gain, rods, first, PLATE_BOW.name))
        return
    off = [
        f"carriage {leg} stands {abs(offset) * 1e3:.2f} mm {'higher' if offset > 0 else 'lower'}"
        for leg, _, offset in legs
        if abs(offset) > _MIN_CHANGE
    ]
    stand = f" ({listed(off)} than it counts)" * bool(off)
    endstops = f"{_SET_ENDSTOPS}{stand}, and touch the plate again"
    if sizes:
        words = f"{_CORRECT_SIZES.format(', '.join(sizes))}; then {endstops}"
        yield Action("mend", words, found.gain, found.sigma)
    elif off:
        yield Action("zeros", f"{endstops[:1].upper()}{endstops[1:]}", found.gain, found.sigma)


def _finding_actions(
    outcome: RunOutcome, kind: Literal["confirm", "mend"], zeros: bool = False
) -> Iterator[Action]:
    """Yield an action for each cause, located error and change, with the parts to look at.

    ``zeros``: whether new zeros are to be entered, which correct a change of a drive's zero too.
    """
    gains = {i.cause: (i.gain, i.gain_sigma) for i in outcome.budget if not i.rest}
    first = "Confirm before anything is changed"
    effect_of = outcome.catalogue.effect_of
    findings: tuple[Cause | Located, ...] = (*outcome.effects, *outcome.located)
    for finding in findings:
        options = suspects(finding)
        if kind == "confirm":
            yield Action(kind, first, options=options)
        elif finding.loses:
            remark = f"{_LOST_MOTION_EXCLUDED}{_lost_motion_remedy(finding)}"
            yield Action(kind, f"{_REPAIR} ({remark})", options=options)
        else:
            name, plate = finding.name, False
            if isinstance(finding, Located):
                name = finding.in_budget
            else:
                effects = [e.catalogue.effect_of(e.name) for e in finding.explanations]
                plate = any(bool(effect.plate) for effect in effects)
            gain, ambiguous = gains.get(name, (0.0, 0.0)), len(options) + len(finding.data) > 1
            words = _REPAIR_IF_DATA_HOLD if finding.data else _REPAIR
            yield Action(kind, words, *gain, options, ambiguous, ambiguous and plate)
    if outcome.possible and outcome.word != "unexplained":
        options = tuple(map(_suspect, outcome.possible))
        yield Action("confirm", _TEST_LIKELY, options=options)
    for change in outcome.moved:
        outdated = _FILES_OUTDATED.format(change.files[1])
        by_zeros = zeros and effect_of(change.parameter).controller == "zero"
        if kind == "confirm" or change.vague:
            yield Action("confirm", first, options=suspects(change))
        elif abs(change.after) < abs(change.before):
            remainder = " (new zeros correct the remainder)" * by_zeros
            words = f"Confirm the repair{remainder}; {outdated}"
            yield Action("confirm", words, options=suspects(change))
        else:
            unknown = (math.nan, math.nan)
            gain = unknown if change.loses else gains.get(change.parameter, unknown)
            alternative = "enter the new zeros, not both" if by_zeros else "correct for it"
            words = f"Confirm the change. Then put it back, or {alternative}; {outdated}"
            yield Action(kind, words, *gain, options=suspects(change))


def _lost_motion_remedy(finding: Cause | Located) -> str:
    """Return what compensates for lost motion, a clause."""
    if isinstance(finding, Located):
        if not all(curve.place.in_model for curve in finding.members):
            return "neither a controller nor orthoglide compensate corrects all that it may be"
        only_drives = all(curve.place.part == "drive" for curve in finding.members)
    else:
        effects = (e.catalogue.effect_of(e.name) for e in finding.explanations)
        only_drives = all(effect.controller for effect in effects)
    if only_drives:
        return f"a controller's own setting or {_COMPENSATE_CORRECTS}"
    return _COMPENSATE_CORRECTS


def suspects(finding: Cause | Located | Change) -> tuple[Suspect, ...]:
    """Return the parts to look at, for every member of a credible set."""
    if isinstance(finding, Change):
        return tuple(_suspect_of_change(finding, k) for k in range(len(finding.members)))
    if isinstance(finding, Cause):
        return tuple(map(_suspect, finding.explanations))
    return tuple(map(_suspect, finding.members))


def _suspect(one: Explanation | Curve) -> Suspect:
    """Return the part to look at for a cause or a free-form error."""
    if isinstance(one, Curve):
        place = one.place
        return Suspect(place.words, place.look_at, confirming_test(place, one.size))
    return Suspect(one.words, one.look_at, one.confirm)


def _suspect_of_change(change: Change, k: int) -> Suspect:
    """Return the k-th parameter that may have changed, with its value before or after."""
    name = change.members[k]
    effect = change.catalogue.effect_of(name)
    if change.vague and not k:
        return Suspect(change.member_clauses[0], effect.look_at, "")
    if change.vague or name not in change.summed_members:
        return Suspect(f"or instead {change.member_clauses[k]}", effect.look_at, "")
    is_present = change.is_cause or abs(change.after) > abs(change.before)
    when, value = ("now", change.after) if is_present else ("before", change.before)
    words = f"{when}: {cause_words(change.catalogue, name, {name: value})}"
    test = "" if name.member or effect.of_dial else confirm_words(effect, name, value)
    still = " if it is there still" * bool(test and not is_present)
    return Suspect(words, effect.look_at, f"{test}{still}")


def _compensation(outcome: RunOutcome) -> Action | Withheld | None:
    """Return the advice to send compensated commands, or why it is not given.

    ``None`` if they reduce the mean shape error by no more than the best zeros and 2 % of the error
    now, after `identify`, and for a printer.
    """
    if not outcome.request.searches or outcome.firmware is not None:
        return None
    gain, sigma = outcome.compensation_gain
    if gain <= _MIN_RELATIVE_GAIN * outcome.numbers.expected["now"].shape:
        return None
    # Of a probed plate, commands that follow a bowl instead of a wrong radius are wrong too.
    unseen = outcome.sizes.compensation_lack if outcome.sizes else ""
    if reason := lack_of_gain(gain, sigma) or unseen:
        return Withheld("compensate", reason)
    words = (
        f"Send compensated commands: orthoglide compensate path.csv --machine calibrated.toml"
        f"{outcome.request.effects_option} --out commands.csv"
    )
    return Action("compensate", words, gain, sigma)


def not_advised(outcome: RunOutcome) -> tuple[Withheld, ...]:
    """Return what is not advised, with the reason."""
    if reason := withholding_reason(outcome.machine):
        return Withheld("zeros", reason), Withheld("compensate", reason)
    compensation = _compensation(outcome)
    return (compensation,) if isinstance(compensation, Withheld) else ()


def _measurement_actions(
    outcome: RunOutcome, suggestions: Sequence[Suggestion], sheet: Readings | None
) -> tuple[bool, list[Action]]:
    """Return whether the verdict depends on further readings, and the most decisive readings."""
    if not outcome.request.searches:
        text = "Look for the cause of the residual: orthoglide close-loop takes the same files"
        return False, [Action("measure", text)] if outcome.after.sigma_scale > 1 else []
    for suggestion in suggestions:
        if suggestion.aim == "narrow" and sheet is not None:
            text = f"More readings are optional: the report proposes {len(sheet)}"
            if outcome.word == "ambiguous" and any(s.hopeless for s in suggestions):
                text = "No more readings of this kind decide between the causes: do their tests"
            return False, [Action("measure", text)]
        if not suggestion.hopeless:
            text = f"Measure more: {suggestion.what or suggestion.reason}"
            return True, [Action("measure", text)]
    return False, []
