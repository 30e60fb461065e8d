"""The sentences of a report about a closed loop, from the values of its result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from orthoglide.effects.wording import cause_short
from orthoglide.effects.words import toward
from orthoglide.geometry import LEGS
from orthoglide.notes import Note
from orthoglide.numerals import ByUnit, compact, distinct_figures, probability, with_sigma
from orthoglide.observations.approach import APPROACH_NOT_RECORDED, APPROACH_REMEDY
from orthoglide.report.claims import SOMETHING_ELSE_WRONG, claims, claims_text
from orthoglide.report.identified import base_effects, identified_words
from orthoglide.result import Action, Change, Result, Scores
from orthoglide.text import listed, sentence

_HARDLY_FALLS_RATIO = 0.9  # ratio of residuals above which they "hardly" fall
_ZEROS_FIRST_RATIO = (
    1.5  # ratio of residuals without and with new zeros from which the zeros come first
)
_NO_RESIDUAL = 1e-9  # metres: no machine of metal is as good
_CHANCE_LEVEL = 0.01  # probability above which residuals are attributed to noise alone
_MOST_ALONE = 8  # single causes that a sentence names
_MIN_DOF = 2.0  # degrees of freedom below which nothing is tested
_BASE_FITS_P = 0.05  # probability of the residuals of the base model above which they are small
_MIN_EXCLUDED_SHARE = 0.1  # share of excluded readings from which their number is stated
_ROUNDING_RATIO = (
    1.05  # ratio of the noise of a reading to what was declared from which rounding counts
)
_MIN_RELATIVE_SIGMA = 0.1  # relative uncertainty of a gain from which it is stated
_MIN_SIGMA = 5e-5  # millimetres: a smaller uncertainty is none that four decimals show

NOTHING_SHOWN = (
    "These readings show no error at all: either they were computed from a machine without errors, "
    "or the instruments read nothing."
)

MEANINGS: Mapping[str, str] = {
    "adequate": "the base model fits the readings, and no cause was added",
    "diffuse": "small errors of many parts explain the readings, and no single cause was added",
    "explained": "a cause was found, and nothing significant is left",
    "ambiguous": "something was found, but other explanations fit these readings as well",
    "located": "a place was found that no known shape explains, and nothing significant is left",
    "partial": "something was found, and something significant is left",
    "unexplained": "the model does not fit, and no cause explains the difference",
}
"""What the verdict's words mean."""

MEAN_OVER_CAUSES, MEAN_WITH_PLATE = (
    "on average, whichever of these it is",
    "on average, nothing if it is the plate",
)
"""Behind what it gains to put right one of several causes."""


def headline(result: Result) -> str:
    """Return the result in a few sentences: what must be known first, the finding, and its
    evidence.
    """
    if not result.searches:
        return claim_text(result)
    first = "" if result.firmware is None else result.firmware.first
    parts = (result.contradicted, first, claim_text(result), evidence(result))
    return " ".join(text for text in parts if text)


def claim_text(result: Result) -> str:
    """Return what is wrong with the machine, in sentences."""
    changed, more = _change_sentences(result.moved), finding_text(result)
    return " ".join(text for text in ((more, changed) if result.found else (changed, more)) if text)


def finding_text(result: Result) -> str:
    """Return what is wrong apart from changes between files, in sentences."""
    if not result.searches:
        return identified_words(result)
    if result.found:
        more = f" {SOMETHING_ELSE_WRONG}" if result.word == "partial" else ""
        count = len(result.effects) + len(result.located)
        return f"{claims_text(claims(result)[:count])}{more}"
    if result.word == "unexplained":
        text = f"{_unexplained_text(result)}{largest_residual_text(result)}"
        noisy = " ".join(map(sentence, result.scattering))
        against = f"Against what was declared, {text[:1].lower()}{text[1:]}"
        return f"{noisy} {against}" if noisy else text
    if too_few_to_test(result):
        return (
            f"These readings are too few to search for causes: the {base_effects(result)} take up "
            f"nearly all of their information."
        )
    first = _zeros_sentence(result)
    if has_diffuse_errors(result):
        return (
            f"{first}No single cause stands out{' beyond that' if first else ''}: every part is "
            f"off by about {compact(result.left.background, 1)} of its tolerance."
        )
    if result.nominal.rms < _NO_RESIDUAL:
        return NOTHING_SHOWN
    nothing = "Nothing else is" if result.changed or first else "Nothing is"
    base = base_effects(result)
    return f"{first}{nothing} wrong that these readings could show beyond the {base}."


def _zeros_sentence(result: Result) -> str:
    """Return the sentence that zeros or firmware numbers are off, if that is the finding."""
    of_base = [a for a in result.actions if a.kind == "zeros"]
    if result.nominal.rms < _ZEROS_FIRST_RATIO * result.before.scores.rms or not of_base:
        return ""
    if result.firmware is not None and result.firmware.corrections is not None:
        return f"The firmware's numbers are off, {result.firmware.corrections.words}. "
    return f"The zeros of the drives are off. {of_base[0].words}. "


def evidence(result: Result) -> str:
    """Return the evidence for the claim of a closed loop, and the data faults, in sentences."""
    changed = _change_sentences([c for c in result.changed if c not in result.moved])
    return " ".join(
        text for text in (_fit_evidence(result), data_faults_text(result), changed) if text
    )


def _change_sentences(changes: Iterable[Change]) -> str:
    """Return a sentence for each pair of files between which parameters changed."""
    between: dict[str, list[str]] = {}
    for change in changes:
        between.setdefault(change.when, []).append(change.what)
    return " ".join(sentence(f"{when} {'; '.join(what)}") for when, what in between.items())


# --- Of a closed loop -----------------------------------------------------------------------


def _fit_evidence(result: Result) -> str:
    base = base_effects(result)
    corrected = f"With the {base} corrected"
    if result.word == "unexplained":
        return f"{corrected}, {_improvement_text(result)}."
    if result.word == "partial":
        return (
            f"With it in the model, {_improvement_text(result)}, and nothing known explains the rest. "
            f"{_why_significant(result)}{largest_residual_text(result)}"
        )
    if too_few_to_test(result):
        given, before = corrected, result.nominal
        if result.found:
            given, before = "With this in the model", result.start
        after = result.after.scores if result.found else result.before.scores
        return f"{given}, {_improvement_between(before, after)}. Too few readings are left over to judge that."
    given = "With this in the model" if result.found else corrected
    besides = ["this" if result.found else f"the corrected {base}"]
    if result.improved and not result.found:
        besides.append("small errors of everything else")
    if result.shapes_of_plate:
        besides.append("small shapes of the plate")
    head = ""
    if besides[1:]:
        head, given = f"The model contains {listed(besides)}. ", "With them"
    return f"{head}{given}, {_improvement_text(result)}{_comparison_with_noise(result)}.{_single_causes_text(result)}"


def _comparison_with_noise(result: Result) -> str:
    """Whether what is left is the noise: the end of a sentence."""
    of, left = "the readings" if result.request.points else "the dial", ""
    noise, after = result.noise.single_reading, result.after.scores
    if math.isfinite(after.deviation_rms):  # which is no figure of single readings
        left = (
            f". Single readings have a residual of {_residual_and_noise(after.left, noise)[0]} rms"
        )
    what = f"the noise of {of} ({_residual_and_noise(after.left, noise)[1]})"
    if any(w.kind == "side" for w in result.warnings):
        what = "the scatter of repeats, which is noise of the readings or lost motion"
    if result.after.sigma_scale > 1:
        return (
            f"{left}, more than {what}. Each likely explanation fits the readings; their mean, "
            f"which is the calibrated machine, does not quite"
        )
    return f"{left}, consistent with {what}"


def _residual_and_noise(residual: ByUnit, noise: ByUnit) -> tuple[str, str]:
    """Return a residual and the noise that it is compared with, with the same decimals."""
    pairs = [
        (unit, distinct_figures(value, noise.shown[unit])) for unit, value in residual.shown.items()
    ]
    left, right = (" and ".join(f"{two[k]} {unit}" for unit, two in pairs) for k in (0, 1))
    return left, right


def largest_residual_text(result: Result) -> str:
    """Return where the residual is largest: which leg, which direction, at which station."""
    if result.left.shaped > _CHANCE_LEVEL > result.left.p_value:
        return (
            " The plate's own shape would explain it, finer than a bowl or three lobes: touch it "
            "again, turned by 60 degrees (turned_deg of its setup); what turns with it is its own."
        )
    shares = [one.share for one in result.left.mountings]
    if shares and (points := 1 - sum(shares)) > max(shares):
        return f" The residual is largest at the TCP points ({100 * points:.0f} % of it)."
    if result.left.dials_hold_most:
        one = result.left.by_dial[0]
        where = f"on leg {LEGS[one.leg]} read along {LEGS[one.axis]}"
        size = f"the dial is off by up to {compact(abs(one.most) * 1e3, 2)} mm"
        if one.posture:  # else it is off both ways
            size += f", toward {toward(LEGS[one.axis], one.most)} at posture {one.posture}"
        return _largest_part(result, one.share, where, size)
    return "".join(
        _largest_part(
            result, one.share, f"in {one.reads} ({one.setup})",
            f"it is up to {compact(abs(one.most) * 1e3, 2)} {one.unit}, with the tool at "
            f"{one.where[0]} mm",
        )
        for one in result.left.by_instrument[:1]
    )  # fmt: skip


def _largest_part(result: Result, share: float, where: str, size: str) -> str:
    """Return where the residual is largest, and whether no setup has more than twice its share."""
    setups = len(result.left.by_dial) + len(result.left.by_instrument)
    spread = ", so it is spread over the setups" if setups > 1 and share * setups < 2 else ""
    part = f"{100 * share:.0f} % of its squares{spread}"
    return f" The residual is largest {where} ({part}). There {size}."


def _single_causes_text(result: Result) -> str:
    """Return the causes of which each could explain the residual alone, with their sizes."""
    if not result.alone:
        return ""
    several = [one.words for one in result.alone[:_MOST_ALONE]]
    more = len(result.alone) - len(several)
    told = [sentence(several[0]), *(f"Or {words}." for words in several[1:])]
    told += [f"Or {more} more named below."] if more > 0 else []
    return f" If a single cause explains most of it, it is one of these. {' '.join(told)}"


def _residual_within_chance(result: Result) -> bool:
    """Whether only tolerances that are not this machine's would explain so little that is left."""
    return result.left.p_value > _CHANCE_LEVEL


def _unexplained_text(result: Result) -> str:
    """Return that the model does not fit, by how much, and whether more could be said."""
    left = result.after.scores.left
    text = (
        f"The model does not fit: its residual is {left.said()} rms, and the noise of a reading is "
        f"{noise_words(result)}. No single cause explains the difference."
    )
    if _residual_within_chance(result):
        return f"{text} {len(result.readings)} readings are too few to say more."
    if result.possible:
        most = compact(result.possible[0].probability, 2)
        return f"{text} The most probable cause has a probability of only {most}."
    return text


def _why_significant(result: Result) -> str:
    """Return why the residual is significant: by its size, or else by its pattern."""
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


def _improvement_text(result: Result) -> str:
    return _improvement_between(result.start, result.after.scores)


def _improvement_between(before: Scores, after: Scores) -> str:
    averaged = math.isfinite(after.deviation_rms)
    of = "averaged readings and their prediction" if averaged else "readings and prediction"
    return f"the difference between {of} {_rms_change(before, after)}"


def _rms_change(before: Scores, after: Scores) -> str:
    """Return ``falls from 0.3 to 0.01 mm rms``, for lengths and for inclinations."""
    parts, last = [], ""
    for unit, now in after.reported.shown.items():
        was = before.reported.shown[unit]
        verb = "hardly falls" if now > _HARDLY_FALLS_RATIO * was else "falls"
        figures = distinct_figures(was, now)
        text = f"{verb if verb != last else ''} from {' to '.join(figures)} {unit} rms".strip()
        stays = now >= was or figures[0] == figures[1]
        parts.append(f"does not fall, at {figures[1]} {unit} rms" if stays else text)
        last = "" if stays else verb
    return ", and ".join(parts)


def noise_words(result: Result) -> str:
    """Return the noise of a reading, and whether rounding was added to the declared noise."""
    noise, declared = result.noise.single_reading, result.noise.declared
    rounded = result.noise.source != "repeats" and noise.length > _ROUNDING_RATIO * declared
    return f"{noise.said()}{' with the rounding of the readings' if rounded else ''}"


def further_warnings(result: Result) -> list[Note]:
    """Return the warnings that the claim does not already contain."""
    told = result.scattering if result.word == "unexplained" else ()
    return [w for w in result.warnings if w not in told]


# --- Common to page and terminal ----------------------------------------------------------


def gain_words(action: Action, printer: bool) -> tuple[str, str]:
    """Return what an action gains, of a printer or another machine, with its uncertainty, and
    whether that is a mean over causes; empty if unknown.
    """
    if not math.isfinite(action.gain):
        return "", ""
    gain, sigma = max(action.gain, 0.0) * 1e3, action.gain_sigma * 1e3
    uncertain = sigma > max(_MIN_RELATIVE_SIGMA * gain, _MIN_SIGMA)  # not if it is unknown
    size = with_sigma(gain, sigma) if uncertain else compact(gain, 2)
    if printer and action.kind == "zeros":
        return f"the residual of the heights falls by {size} mm", ""
    mean = MEAN_WITH_PLATE if action.plate else MEAN_OVER_CAUSES
    return f"gains {size} mm at the tool", f" {mean}" if action.whichever else ""


def undetected_text(result: Result) -> str:
    """Return the effects that these readings would not show, in sentences; empty for none."""
    told = []
    if hidden := undetected_effects(result):
        taken = listed(result.instruments.values())
        several = "; ".join(f"that {words}" for words in hidden)
        told.append(f"Readings of {taken} cannot detect, at three times the tolerance, {several}.")
    if still := unvaried_effects(result):
        told.append(f"Nothing was varied that would show that {', or that '.join(still)}.")
    return " ".join(told).removesuffix(".")


def undetected_effects(result: Result) -> list[str]:
    """Return the effects that these readings would not show, a clause each."""
    return [f"{words}{_members_in_brackets(members)}" for words, members in result.unseen.effects]


def _members_in_brackets(members: tuple[str, ...]) -> str:
    """Return which parameters of an effect are meant, in brackets; empty for all of them."""
    if not members:
        return ""
    return f" ({members[0] if ' ' in members[0] else 'some of them'})"


def unvaried_effects(result: Result) -> list[str]:
    """Return effects that the readings cannot show because a condition was not varied, a clause
    each.
    """
    unseen, of = result.unseen, result.catalogue
    names = (
        n for n in unseen.unexcited if not of[n].of_dial and n not in _one_sided_effects(result)
    )
    return [cause_short(of, name) for name in names]


def _one_sided_effects(result: Result) -> list[str]:
    """Return the names of effects that are hidden because all approaches were from one side."""
    needs = result.unseen.unvaried.items() if result.unseen.one_sided else ()
    return [name for name, conditions in needs if "approach" in conditions]


_SIDE_REASONS = {
    "fixed": "a probe always comes from above, and sides of distances are not known",
    "same": "every place was approached from the same side, so approach some from the other too",
    "unknown": f"{APPROACH_NOT_RECORDED}: {APPROACH_REMEDY}",
}


def unvaried_words(result: Result) -> str:
    """Return why lost motion cannot be detected, a clause; empty if it can."""
    if not (why := result.unseen.one_sided):
        return ""
    named = "; ".join(
        f"that {cause_short(result.catalogue, n)}" for n in _one_sided_effects(result)
    )
    return f"nor can they detect {named}: {_SIDE_REASONS[why]}"


def data_faults_text(result: Result) -> str:
    """Return the number of data faults, and how many readings were excluded for them."""
    if not (count := len(result.blunders)):
        return ""
    faults = f"{count} fault{'s' if count > 1 else ''} in the data had to be dealt with first"
    if stray := sum(w.kind == "stray" for w in result.warnings):
        faults += f", and {stray} touch{' does' if stray == 1 else 'es do'} not count"
    aside = {row for one in result.blunders if one.excluded for row in one.rows_in_request}
    every = len(result.readings) + len(aside)
    if len(aside) < _MIN_EXCLUDED_SHARE * every:
        return f"{faults}."
    return (
        f"{faults}: {len(aside)} of {every} readings do not count, and nothing is said of what "
        f"they alone would show."
    )


def has_diffuse_errors(result: Result) -> bool:
    """Whether the base alone leaves so much that something small is wrong with everything."""
    return result.improved and result.before.scores.lack_of_fit_p < _BASE_FITS_P


def too_few_to_test(result: Result) -> bool:
    """Whether what was fitted takes up all that the readings say."""
    return result.before.scores.dof < _MIN_DOF or result.after.scores.dof < 1.0


def meaning(result: Result) -> str:
    """Return the meaning of the verdict, a clause; nothing is judged if too few readings remain."""
    if result.word == "adequate" and too_few_to_test(result):
        return "no single cause was added, and too few readings are left over to judge what is left"
    return MEANINGS[result.word]
