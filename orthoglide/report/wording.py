"""A result in words: the sentences that it begins with, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from orthoglide.effects.wording import parameter_words
from orthoglide.effects.words import toward
from orthoglide.geometry import LEGS
from orthoglide.numerals import compact, decimals_for, probability, signed, told_apart
from orthoglide.parameters import Parameter
from orthoglide.report.phrases import (
    NOTHING_SHOWN,
    a_little,
    dealt_with,
    listed,
    none_left_over,
    sentence,
)
from orthoglide.result import Cause, Change, Result, Scores

_HARDLY = 0.95  # of the deviations before: a fit that leaves more has not helped
_SLIGHT = 0.9  # the same of a cause that was added
_MATTERS = 1.5  # times what the base leaves: so much more without it makes it the first to be said
_NONE = 1e-9  # metres: no machine of metal is as good
_UNSEEN = 0.9  # of its tolerance: a value known no better than this is known from that alone
_CHANCE = 0.01  # of what is left: noise alone leaves as much often enough
_MOST_ALONE = 8
_MOST_NAMED = 2
_MOST_RIVALS = 2

BESIDES = "Something else is wrong as well."
"""Behind what was found, where it does not explain all."""


def headline(result: Result) -> str:
    """The result in a few sentences: what must be known first, what is wrong, and by what."""
    if not result.searches:
        return claim(result)
    first = "" if result.firmware is None else result.firmware.first
    return " ".join(text for text in (first, claim(result), evidence(result)) if text)


def claim(result: Result) -> str:
    """What is wrong, for somebody with a spanner in hand."""
    changed, more = _changed(result.moved), standing(result)
    return " ".join(text for text in ((more, changed) if result.found else (changed, more)) if text)


def standing(result: Result) -> str:
    """What is wrong but for what changed."""
    if not result.searches:
        return f"{_found(result)} {_gain(result)}; {_rest(result)}."
    if result.found:
        more = f" {BESIDES}" if result.word == "partial" else ""
        return f"{_causes(result)}{more}"
    if result.word == "unexplained":
        text = f"{_nothing_explains(result)}{where_left(result)}"
        noisy = " ".join(map(sentence, result.scattering))
        against = f"Against what was declared, {text[:1].lower()}{text[1:]}"
        return f"{noisy} {against}" if noisy else text
    if none_left_over(result):
        return (
            f"These readings are too few to look for causes with: the "
            f"{effects_named(result)} take up nearly all that they say, and too few are "
            f"left over to tell what the rest comes from."
        )
    first = _to_enter(result)
    if a_little(result):
        return (
            f"{first}No single cause stands out{' beyond that' if first else ''}: everything is "
            f"off by a little, about {compact(result.left.background, 1)} of its tolerance."
        )
    if result.nominal.rms < _NONE:
        return NOTHING_SHOWN
    nothing = "Nothing else is" if result.changed or first else "Nothing is"
    base = effects_named(result)
    return f"{first}{nothing} wrong that these readings could show beyond the {base}."


def _to_enter(result: Result) -> str:
    """What the numbers of a controller or a firmware are off by, where that is what is wrong."""
    of_base = [a for a in result.actions if a.kind == "zeros"]
    if result.nominal.rms < _MATTERS * result.before.scores.rms or not of_base:
        return ""
    if result.firmware is not None and result.firmware.corrections is not None:
        return f"The firmware's numbers are off, {result.firmware.corrections.words}. "
    return f"The zeros of the drives are off. {of_base[0].words}. "


def evidence(result: Result) -> str:
    """What speaks for the claim of a closed loop, and what had to be dealt with first."""
    changed = _changed([c for c in result.changed if c not in result.moved])
    return " ".join(text for text in (_weighed(result), dealt_with(result), changed) if text)


def _changed(changes: Iterable[Change]) -> str:
    """A sentence for each pair of files."""
    between: dict[str, list[str]] = {}
    for change in changes:
        between.setdefault(change.when, []).append(change.what)
    return " ".join(sentence(f"{when} {'; '.join(what)}") for when, what in between.items())


# --- Of a closed loop -----------------------------------------------------------------------


def _weighed(result: Result) -> str:
    base = effects_named(result)
    if result.word == "unexplained":
        why = "" if _too_few(result) else f" {_why_significant(result)}"
        return f"With the {base} set right, {_fall(result)}.{why}"
    if result.word == "partial":
        return (
            f"With it in the model, {_fall(result)}, and nothing known explains the rest. "
            f"{_why_significant(result)}{where_left(result)}"
        )
    if result.found:
        given = "this in the model"
    else:
        more = "all of it" if a_little(result) else "small errors of everything else"
        given = f"the {base} set right" + f" and {more} in the model" * result.improved
    if result.shapes_of_plate:
        given += " and small shapes of the plate's own"
    if none_left_over(result):
        return f"With {given}, {_fall(result)}, and too few readings are left over to judge that."
    of = "the dial" if not result.request.points else "the readings"
    what = f"the noise of {of}"
    if any(w.kind == "side" for w in result.warnings):
        what = "what repeats scatter by: noise of the readings, or lost motion of the machine"
    if result.after.sigma_scale > 1:
        what = (
            f"more than {what}: what is likely fits them, each by itself, and their mean, which "
            f"the calibrated machine has, not quite"
        )
    return f"With {given}, {_fall(result)}, which is {what}.{_alone(result)}"


def where_left(result: Result) -> str:
    """Where what nothing explains lives: which leg, which direction, at which station most."""
    if result.left.shaped > _CHANCE > result.left.p_value:
        return (
            " The plate's own shape would explain it, finer than a bowl or three lobes: touch it "
            "again, turned by 60 degrees (turned_deg of its setup); what turns with it is its own."
        )
    shares = [one.share for one in result.left.mountings]
    if shares and (points := 1 - sum(shares)) > max(shares):
        return f" The largest part of what is left ({100 * points:.0f} %) shows in the TCP points."
    if result.left.dials_hold_most:
        one = result.left.by_dial[0]
        where = f"on leg {LEGS[one.leg]} read along {LEGS[one.axis]}"
        size = f"there the dial is off by up to {compact(abs(one.most) * 1e3, 2)} mm, toward "
        size += toward(LEGS[one.axis], one.most)
        size += f" at posture {one.posture}" if one.posture else ""
        return _largest_part(result, one.share, where, size)
    return "".join(
        _largest_part(
            result, one.share, f"in {one.reads} ({one.setup})",
            f"up to {compact(abs(one.most) * 1e3, 2)} {one.unit}, with the tool at "
            f"{one.where[0]} mm",
        )
        for one in result.left.by_instrument[:1]
    )  # fmt: skip


def _largest_part(result: Result, share: float, where: str, size: str) -> str:
    """Where the largest part of what is left shows, and whether it stands out at all."""
    dials, tool = len(result.left.by_dial), len(result.left.by_instrument)
    alike = dials + tool > 1 and share < 2 / (dials + tool)
    spread = f", though all {'readings' if tool else 'dials'} show some" if alike else ""
    return f" The largest part of what is left ({100 * share:.0f} %) shows {where}{spread}: {size}."


def _alone(result: Result) -> str:
    """Causes of which one would be behind it if the rest were sound, with their sizes."""
    if not result.alone:
        return ""
    several = [one.words for one in result.alone]
    text = "; or ".join(several[:_MOST_ALONE])
    more = len(several) - _MOST_ALONE
    rest = f"; or {more} more named below" if more > 0 else ""
    return f" If one cause alone were behind most of it, it would be one of these: {text}{rest}."


def _too_few(result: Result) -> bool:
    """Whether only tolerances that are not this machine's would explain so little that is left."""
    return result.left.p_value > _CHANCE


def _nothing_explains(result: Result) -> str:
    if _too_few(result):
        return (
            "Something is wrong, and nothing stands out: these readings would be explained only by "
            "errors of everything beyond its tolerance, or by errors that have no structure. They "
            "are too few to tell more, or the tolerances are not this machine's."
        )
    if result.left.with_unreported > _CHANCE:
        return (
            "Something is wrong, and what it is does not stand out: several effects of the "
            "catalogue or free functions of its parts would explain it, none of them clearly."
        )
    return (
        "Something is wrong that no effect of the catalogue and no free function of its parts "
        "explains."
    )


def _why_significant(result: Result) -> str:
    """What is left against the noise: its size, or its pattern where it is no larger."""
    noise, left = result.noise.single_reading, result.after.scores.left
    whose = "the noise of one" if result.request.points else "the dial's noise"
    if any(left.shown[unit] > of_one for unit, of_one in noise.shown.items()):
        return f"Single readings are left with {left.said()} rms, where {whose} is {noise.said()}."
    if math.isnan(result.left.p_value):
        return "What was found predicts other readings than it was found by: nothing is claimed."
    return (
        f"What is left of single readings ({left.said()} rms) is no larger than {whose} of "
        f"{noise.said()}; it is significant by its pattern over setups and postures, which noise "
        f"alone would show with probability {probability(result.left.p_value)}."
    )


def _causes(result: Result) -> str:
    told = [f"{c.chosen.words}{alternatives(c)}" for c in result.effects]
    told += [one.words for one in result.located]
    besides = (f"Besides, {one[:1].lower()}{one[1:]}" for one in told[1:])
    return " ".join(map(sentence, (told[0], *besides)))


def alternatives(cause: Cause) -> str:
    """Rivals of a cause with their own sizes, in brackets; empty where there are none."""
    rivals = [one.words for one in cause.others]
    same = " or ".join(one.words for one in cause.same)
    if not rivals:
        return f" (or {same}: the same to these readings and to the tool)" if same else ""
    text = ", or ".join(rivals[:_MOST_RIVALS])
    rest = len(rivals) - _MOST_RIVALS
    if rest > 0:
        text += f", or {rest} further cause{'s' if rest > 1 else ''} named below"
    if same:
        text = f"{same}, which is the same to the tool, or {text}"
    return f" (or {text}: these readings cannot tell)"


def _fall(result: Result) -> str:
    fall = _falls(result.start, result.after.scores)
    return f"the difference between readings and prediction {fall}"


def _falls(before: Scores, after: Scores) -> str:
    """``falls from 0.3 to 0.01 mm rms``, and so on for inclinations where there are any."""
    parts, last = [], ""
    for unit, now in after.told.shown.items():
        was = before.told.shown[unit]
        verb = "hardly falls" if now > _SLIGHT * was else "falls"
        figures = told_apart(was, now)
        text = f"{verb if verb != last else ''} from {' to '.join(figures)} {unit} rms".strip()
        stays = now >= was or figures[0] == figures[1]
        parts.append(f"does not fall, at {figures[1]} {unit} rms" if stays else text)
        last = "" if stays else verb
    return ", and ".join(parts)


# --- Of an identification -------------------------------------------------------------------


def _found(result: Result) -> str:
    """The values, as the subject of the sentence."""
    catalogue = result.catalogue
    names = [catalogue.parameter(name) for name in result.identified]
    parts = [text for effect in catalogue.base for text in _by_leg(result, names, effect)]
    others = [name for name in names if name.effect not in catalogue.base]
    parts += [f"{parameter_words(n)} {_value(result, n)}" for n in others[:_MOST_NAMED]]
    if len(others) > _MOST_NAMED:
        parts.append(f"{len(others) - _MOST_NAMED} further parameters")
    text = listed(parts)
    return text[:1].upper() + text[1:]


def _gain(result: Result) -> str:
    """What the fit does to the deviations."""
    parts, last = [], ""
    before, after = result.nominal.told.shown, result.after.scores.told.shown
    for unit, now in after.items():
        verb = "hardly change" if now > _HARDLY * before[unit] else "reduce"
        what = f"{verb} {'them' if last else 'the deviations'} " if verb != last else ""
        parts.append(f"{what}from {' to '.join(told_apart(before[unit], now))} {unit}")
        last = verb
    return ", and ".join(parts)


def _rest(result: Result) -> str:
    """What remains, against the noise."""
    noise, fit = result.noise.single_reading.said(), result.after
    if fit.scores.dof <= 0:
        return "no reading is left over to judge the fit by"
    if fit.sigma_scale > 1:
        return (
            f"what is left is {fit.sigma_scale:.2g} times the noise of a reading ({noise}): "
            f"the machine, or the measurement, has an error that {effects_named(result)} cannot "
            f"explain"
        )
    return (
        f"what is left is no more than the noise of a reading ({noise}): these readings show "
        f"no further error"
    )


def effects_named(result: Result) -> str:
    """The effects that were free at first, in the plural; all of them where they were calibrated
    before.
    """
    if result.calibrated_before:
        return "errors calibrated before"
    of = result.catalogue.effect_of
    names = dict.fromkeys(of(name).name.replace("_", " ") for name in result.before.names)
    return listed(f"{n}es" if n.endswith(("sh", "ch", "ss", "x")) else f"{n}s" for n in names)


def _by_leg(result: Result, every: Sequence[Parameter], effect: str) -> list[str]:
    """One phrase an effect and campaign: ``joint offsets x -0.51, y +0.56 mm``."""
    groups: dict[str, list[Parameter]] = {}
    for name in every:
        if name.effect == effect:
            groups.setdefault(name.campaign, []).append(name)
    phrases = []
    for campaign, names in groups.items():
        what = effect.replace("_", " ") + ("s" if len(names) > 1 else "")
        where = f" ({campaign})" if campaign else ""
        if near := _near_nominal(result, names):
            phrases.append(f"{what} {near}{where}")
            continue
        values = ", ".join(f"{n.member or n.leg} {_value(result, n, False)}" for n in names)
        unit = result.catalogue[effect].unit
        phrases.append(f"{what} {values}{unit.behind}{where}")
    return phrases


def _near_nominal(result: Result, names: Sequence[Parameter]) -> str:
    """What is said of lengths that are off by no more than the noise of a reading; else empty.

    They are nominal to that noise only where the readings know them as well as that.
    """
    fit = result.after
    half = fit.coverage_factor * max(fit.sigmas[name] for name in names)
    noise = result.noise.single_reading.length
    within = half if math.isnan(noise) else noise
    if max(abs(fit.values[name]) for name in names) > within:
        return ""
    if all(fit.sigmas[n] > _UNSEEN * result.request.machine.tolerance(n) for n in names):
        return "not seen by these readings"
    return f"nominal to {compact(max(within, half) * 1e3, 1)} mm"


def _value(result: Result, name: Parameter, with_unit: bool = True) -> str:
    unit, one = result.catalogue.effect_of(name).unit, result.identified[name]
    # Along a weak direction sigmas are millimetres: what the readings do fix would be rounded off.
    places = 2 if unit.name == "mm" else decimals_for(one.sigma, 9)
    text = signed(one.value, places)
    return f"{text}{unit.behind}" if with_unit else text
