"""The sentences of a report, from the values of its result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from orthoglide.effects.wording import cause_short
from orthoglide.effects.words import toward
from orthoglide.geometry import LEGS
from orthoglide.notes import Note
from orthoglide.numerals import compact, distinct_figures, probability, with_sigma
from orthoglide.observations.approach import APPROACH_NOT_RECORDED, APPROACH_REMEDY
from orthoglide.report.claims import found_text
from orthoglide.report.rows import base_effects, improvement_words, unseen_effects_text
from orthoglide.result import Action, Change, Result
from orthoglide.text import listed, lower_first, sentence

_ZEROS_FIRST_RATIO = 1.5  # residuals without over with new zeros from which the zeros come first
_NO_RESIDUAL = 1e-9  # metres: residuals that no real machine attains
_CHANCE_LEVEL = 0.01  # probability above which residuals are attributed to noise alone
_MOST_ALONE = 8  # single causes that a sentence names
_MIN_DOF = 2.0  # degrees of freedom below which nothing is tested
_BASE_FITS_P = 0.05  # probability of the residuals of the base model above which they are small
_MIN_EXCLUDED_SHARE = 0.1  # share of excluded readings from which their number is stated
_ROUNDING_RATIO = 1.05  # noise of a reading over the declared noise from which rounding is stated
_MIN_RELATIVE_SIGMA = 0.1  # relative uncertainty of a gain from which it is stated
_SQUARES = "{:.0f} % of the sum of squares"
_MIN_SIGMA = 5e-5  # millimetres: smallest uncertainty that four decimals show

NOTHING_SHOWN = (
    "These readings show no error at all: either they were computed from a machine without errors, "
    "or the instruments read nothing."
)

MEANINGS: Mapping[str, str] = {
    "adequate": "the base model fits the readings, and no cause was added",
    "diffuse": "small errors of many parts explain the readings, and no single cause was added",
    "explained": "a cause was found, and nothing significant is left",
    "ambiguous": "something was found, but other explanations fit these readings as well",
    "located": "a part moves in a way that no known cause describes, and nothing significant is "
    "left",
    "partial": "something was found, and something significant is left",
    "unexplained": "the model does not fit, and no cause explains the difference",
}
"""Meaning of each verdict, a clause."""

_NO_ACTION = "No correction is advised: none would clearly improve the tool."

NOT_VARIED = (
    "Approach, load, temperature or time did not vary as needed, or the machine file lacks a value "
    "(such as a screw's pitch)"
)
"""Why effects cannot show, a clause."""

MEAN_OVER_CAUSES = "on average, whichever of these it is"
MEAN_WITH_PLATE = "on average, nothing if it is the plate"
"""Words after the expected gain of correcting one of several causes."""


def headline(result: Result) -> str:
    """Return contradictions, the add-on's advice, the finding and its evidence, in sentences."""
    first = "" if result.firmware is None else result.firmware.first
    return _joined(result.contradicted, first, claim_text(result), evidence(result))


def _joined(*texts: str) -> str:
    return " ".join(filter(None, texts))


def claim_text(result: Result) -> str:
    """Return what is wrong with the machine, in sentences."""
    changed, finding = _change_sentences(result.moved), finding_text(result)
    return _joined(finding, changed) if result.found else _joined(changed, finding)


def finding_text(result: Result) -> str:
    """Return the finding without changes between files, in sentences."""
    if result.found:
        return found_text(result)
    if result.word == "unexplained":
        text = f"{_unexplained_text(result)}{largest_residual_text(result)}"
        noisy = " ".join(map(sentence, result.scattering))
        return f"{noisy} Against what was declared, {lower_first(text)}" if noisy else text
    if too_few_to_test(result):
        return (
            f"These readings are too few to say more: the {base_effects(result)} take up nearly "
            f"all of their information."
        )
    first = _zeros_sentence(result)
    if result.possible:
        cause, *others = result.possible
        if others:
            together = compact(sum(one.probability for one in result.possible), 2)
            rivals = f"{len(others)} other cause{'s' * (len(others) > 1)}"
            return f"{first}Perhaps {cause.words}, or {rivals}: their probability is {together}."
        return (
            f"{first}Perhaps {cause.words}: its probability is {compact(cause.probability, 2)}, "
            f"too low for a correction."
        )
    if result.word == "diffuse":
        return (
            f"{first}No single cause stands out{' beyond that' if first else ''}: every part is "
            f"off by about {compact(result.left.background, 1)} of its tolerance."
        )
    if result.nominal.rms < _NO_RESIDUAL:
        return NOTHING_SHOWN
    again = result.firmware is not None and result.firmware.again
    more = " else" if result.changed or first or result.contradicted or again else ""
    base = base_effects(result)
    text = f"{first}Nothing{more} is wrong that these readings could show beyond the {base}"
    if (p := result.before.scores.lack_of_fit_p) < _BASE_FITS_P:  # unusual, but not significant
        unusual = f"noise alone leaves as much with probability {probability(p)}"
        text += f"; the residual is larger than usual ({unusual})"
    return f"{text}."


def _zeros_sentence(result: Result) -> str:
    """Return the sentence that zeros or firmware numbers are off, if that is the finding."""
    sizes = [a for a in result.actions if a.kind == "mend" and not a.options]
    of_base = [a for a in result.actions if a.kind == "zeros"] or sizes
    is_finding = result.nominal.rms >= _ZEROS_FIRST_RATIO * result.before.scores.rms
    # Beside the planes that lists of touches have of their own, endstops leave no residual.
    if not of_base or not (is_finding or (result.firmware and not result.possible)):
        return ""
    if result.firmware is not None and result.firmware.corrections is not None:
        return f"The firmware's numbers are off, {result.firmware.corrections.words}. "
    what = "controller computes with wrong sizes" if sizes else "zeros of the drives are off"
    return f"The {what}. {of_base[0].words}. "


def evidence(result: Result) -> str:
    """Return the evidence for the claim, and the data faults, in sentences."""
    changed = _change_sentences([c for c in result.changed if c not in result.moved])
    unseen = "" if result.searches else unseen_effects_text(result)
    return _joined(_fit_evidence(result), unseen, data_faults_text(result), changed)


def _change_sentences(changes: Iterable[Change]) -> str:
    """Return a sentence for each pair of files between which parameters changed."""
    between: dict[str, list[str]] = {}
    for change in changes:
        between.setdefault(change.when, []).append(change.what)
    return " ".join(sentence(f"{when} {'; '.join(what)}") for when, what in between.items())


def _fit_evidence(result: Result) -> str:
    base, improvement = base_effects(result), improvement_words(result.start, result.after.scores)
    several = len(result.effects) + len(result.located) > 1
    findings = "these findings" if several else "this finding"
    added = result.found and result.searches  # what `identify` finds is among the base effects
    condition = f"With {findings} in the model" if added else f"With the {base} corrected"
    if result.word == "unexplained":
        return f"{condition}, {improvement}."
    if result.word == "partial":
        return (
            f"{condition}, {improvement}, and nothing known explains the rest. "
            f"{_why_significant(result)}{largest_residual_text(result)}"
        )
    if too_few_to_test(result):
        if not result.found:
            improvement = improvement_words(result.nominal, result.before.scores)
        return f"{condition}, {improvement}. Too few readings are left over to judge that."
    contents = [findings if added else f"the corrected {base}"]
    if result.improved and not result.found:
        contents.append("small errors of everything else")
    if result.shapes_of_plate:
        contents.append("small shapes of the plate")
    if contents[1:]:
        condition = f"The model contains {listed(contents)}. With them"
    comparison = _comparison_with_noise(result)
    return f"{condition}, {improvement}{comparison}.{_single_causes_text(result)}"


def _comparison_with_noise(result: Result) -> str:
    """Return whether the residual exceeds the noise: the end of a sentence."""
    source = "the readings" if result.request.points else "the dial"
    residual, noise = result.after.scores.left.shown, result.noise.single_reading.shown
    figures = [(unit, distinct_figures(rms, noise[unit])) for unit, rms in residual.items()]
    rms_text, noise_text = (" and ".join(f"{f[k]} {unit}" for unit, f in figures) for k in (0, 1))
    single, reference = "", f"the noise of {source} ({noise_text})"
    if math.isfinite(result.after.scores.deviation_rms):  # which is no figure of single readings
        single = f". Single readings have a residual of {rms_text} rms"
    if any(w.kind == "side" for w in result.warnings):
        reference = "the scatter of repeats, which is noise of the readings or lost motion"
    if result.after.sigma_scale > 1:
        is_larger = any(float(said) > float(of_noise) for _, (said, of_noise) in figures)
        compared = f"more than {reference}"
        if not is_larger:
            compared = f"consistent with {reference}, but averages of repeats are off by more"
        return (
            f"{single}, {compared}. Each likely explanation fits the readings; their mean, which "
            f"is the calibrated machine, does not quite"
        )
    return f"{single}, consistent with {reference}"


def largest_residual_text(result: Result) -> str:
    """Return where the residual is largest: the leg, the direction and the station."""
    if result.left.shaped > _CHANCE_LEVEL > result.left.p_value:
        return (
            " The plate's own shape would explain it, finer than a bowl, a saddle or three lobes: "
            "touch it again, turned by 60 degrees (turned_deg of its setup); what turns with it is "
            "its own."
        )
    shares = [one.share for one in result.left.mountings]
    if shares and (points := 1 - sum(shares)) > max(shares):
        return f" The residual is largest at the TCP points ({_SQUARES.format(100 * points)})."
    if result.left.dials_hold_most:
        one = result.left.by_dial[0]
        where = f"on leg {LEGS[one.leg]} read along {LEGS[one.axis]}{_file_words(result, one.file)}"
        size = f"the dial is off by up to {compact(abs(one.most) * 1e3, 2)} mm"
        if one.posture:  # else another station's residual is as large
            size += f", toward {toward(LEGS[one.axis], one.most)} at posture {one.posture}"
        return _largest_part(result, one.share, where, size)
    for one in result.left.by_instrument[:1]:
        size = f"it is up to {compact(abs(one.most) * 1e3, 2)} {one.unit}"
        size += f", with the tool at {one.where[0]} mm"
        where = f"in {one.reads} ({one.setup}){_file_words(result, one.file)}"
        return _largest_part(result, one.share, where, size)
    return ""


def _file_words(result: Result, file: str) -> str:
    """Return the file of a residual; empty where there is one file only."""
    return f" in {file}" if len({one.file for one in result.left.mountings}) > 1 else ""


def _largest_part(result: Result, share: float, where: str, size: str) -> str:
    """Return where the residual is largest, and whether it is spread evenly over the setups."""
    setups = len(result.left.by_dial) + len(result.left.by_instrument)
    spread = ", so it is spread over the setups" if setups > 1 and share * setups < 2 else ""
    part = f"{_SQUARES.format(100 * share)}{spread}"
    return f" The residual is largest {where} ({part}). There {size}."


def _single_causes_text(result: Result) -> str:
    """Return the causes that could each explain the residual alone, with their sizes."""
    if not result.alone:
        return ""
    first, *others = (one.words for one in result.alone[:_MOST_ALONE])
    text = " ".join([f"{first}.", *(f"Or {words}." for words in others)])
    if (more := len(result.alone) - _MOST_ALONE) > 0:
        text += f" Or {more} more named below."
    return f" If a single cause explains most of the residual, it is one of these: {text}"


def _unexplained_text(result: Result) -> str:
    """Return that the model does not fit, the size of the residual, and the most probable cause."""
    cause = " No single cause explains the difference." if result.searches else ""
    chance = probability(min(result.left.p_value, result.after.scores.lack_of_fit_p))
    text = (
        f"The model does not fit: its residual is {result.after.scores.left.said()} rms, and the "
        f"noise of a reading is {noise_words(result)}; noise leaves as much with probability "
        f"{chance}.{cause}"
    )
    if result.left.p_value > _CHANCE_LEVEL:  # only tolerances of other machines would explain it
        return f"{text} {len(result.readings)} readings are too few to say more."
    if result.possible:
        most = compact(result.possible[0].probability, 2)
        return f"{text} The most probable cause has a probability of only {most}."
    return text


def _why_significant(result: Result) -> str:
    """Return why the residual is significant: by its size or by its pattern."""
    noise, left = result.noise.single_reading, result.after.scores.left
    whose = "the noise of one" if result.request.points else "the dial's noise"
    if any(left.shown[unit] > of_one for unit, of_one in noise.shown.items()):
        of_one = noise_words(result)
        return f"The residual of single readings is {left.said()} rms, where {whose} is {of_one}."
    if math.isnan(result.left.p_value):
        return "What was found does not predict the readings that it was found by."
    return (
        f"The residual of single readings ({left.said()} rms) is no larger than {whose} of "
        f"{noise_words(result)}. It is significant by its pattern over setups and postures, which "
        f"noise alone shows with probability {probability(result.left.p_value)}."
    )


def noise_words(result: Result) -> str:
    """Return the noise of a reading, and whether it contains more rounding than was declared."""
    noise, declared = result.noise.single_reading, result.noise.declared
    rounded = result.noise.source != "repeats" and noise.length > _ROUNDING_RATIO * declared
    return f"{noise.said()}{' with the rounding of the readings' if rounded else ''}"


def further_warnings(result: Result) -> list[Note]:
    """Return the warnings that the claim does not already contain."""
    in_claim = result.scattering if result.word == "unexplained" else ()
    return [w for w in result.warnings if w not in in_claim]


# --- Common to page and terminal ----------------------------------------------------------


def gain_words(action: Action, printer: bool) -> tuple[str, str]:
    """Return the gain of an action with its uncertainty, and whether it is a mean over causes;
    empty if unknown. ``printer``: whether the machine is a printer with a firmware.
    """
    if not math.isfinite(action.gain):
        return "", ""
    gain, sigma = max(action.gain, 0.0) * 1e3, action.gain_sigma * 1e3
    uncertain = sigma > max(_MIN_RELATIVE_SIGMA * gain, _MIN_SIGMA)  # false if it is nan
    size = with_sigma(gain, sigma) if uncertain else compact(gain, 2)
    if printer and action.kind == "zeros":
        return f"the residual of the heights falls by {size} mm", ""
    mean = MEAN_WITH_PLATE if action.plate else MEAN_OVER_CAUSES
    return f"gains {size} mm at the tool", f" {mean}" if action.whichever else ""


def undetected_text(result: Result) -> str:
    """Return the effects that these readings would not show, in sentences; empty for none."""
    texts = []
    if hidden := undetected_effects(result):
        used = listed(result.instruments.values())
        clauses = "; ".join(f"that {words}" for words in hidden)
        texts.append(
            f"Readings of {used} cannot detect, even at three times the tolerance, {clauses}."
        )
    if unvaried := unvaried_effects(result):
        texts.append(f"{NOT_VARIED}, to show that {', or that '.join(unvaried)}.")
    return " ".join(texts).removesuffix(".")


def undetected_effects(result: Result) -> list[str]:
    """Return the effects that these readings would not show, a clause each, with the parameters
    concerned in brackets unless it is all of them.
    """
    return [
        words + (f" ({members[0] if ' ' in members[0] else 'some of them'})" if members else "")
        for words, members in result.unseen.effects
    ]


def unvaried_effects(result: Result) -> list[str]:
    """Return effects that cannot show because a condition was not varied, a clause each."""
    catalogue, one_sided = result.catalogue, _one_sided_effects(result)
    names = (n for n in result.unseen.unexcited if n not in one_sided and not catalogue[n].of_dial)
    return [cause_short(catalogue, name) for name in names]


def _one_sided_effects(result: Result) -> list[str]:
    """Return the names of effects that are hidden because all approaches were from one side."""
    needs = result.unseen.unvaried.items() if result.unseen.one_sided else ()
    return [name for name, conditions in needs if "approach" in conditions]


_SIDE_REASONS = {
    "fixed": "a probe always comes from above, and how distances are approached is not known",
    "same": "every place was approached from the same side, so approach some from the other too",
    "unknown": f"{APPROACH_NOT_RECORDED}: {APPROACH_REMEDY}",
}


def unvaried_words(result: Result) -> str:
    """Return why lost motion cannot be detected, a clause; empty if it can."""
    if not (reason := result.unseen.one_sided):
        return ""
    effects = (cause_short(result.catalogue, name) for name in _one_sided_effects(result))
    clauses = "; ".join(f"that {words}" for words in effects)
    return f"nor can they detect {clauses}: {_SIDE_REASONS[reason]}"


def data_faults_text(result: Result) -> str:
    """Return the number of data faults, and how many readings were excluded for them."""
    if not (count := len(result.blunders)):
        return ""
    faults = f"{count} data fault{'s were' if count > 1 else ' was'} corrected or set aside first"
    if stray := sum(w.kind == "stray" for w in result.warnings):
        faults += f", and {stray} touch{' does' if stray == 1 else 'es do'} not count"
    excluded = {row for one in result.blunders if one.excluded for row in one.rows_in_request}
    total = len(result.readings) + len(excluded)
    if len(excluded) < _MIN_EXCLUDED_SHARE * total:
        return f"{faults}."
    return (
        f"{faults}: {len(excluded)} of {total} readings do not count, and nothing is said of what "
        f"they alone would show."
    )


def no_action_text(result: Result) -> str:
    """Return that nothing is advised; empty if anything is, or if corrections are withheld."""
    if result.actions or any(one.kind == "zeros" for one in result.withheld):
        return ""
    return _NO_ACTION


def too_few_to_test(result: Result) -> bool:
    """Whether the fitted parameters leave too few degrees of freedom for a test."""
    return result.before.scores.dof < _MIN_DOF or result.after.scores.dof < 1.0


def meaning(result: Result) -> str:
    """Return the meaning of the verdict, a clause, or that too few readings remain for one."""
    if result.word == "adequate" and too_few_to_test(result):
        return "no single cause was added, and too few readings are left over to judge what is left"
    if result.word == "unexplained" and not result.searches:
        return "the model does not fit, and no cause was searched for"
    return MEANINGS[result.word]
