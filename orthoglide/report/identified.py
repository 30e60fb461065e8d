"""The sentences of a report about an identification, from the values of its result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.effects.wording import parameter_words
from orthoglide.numerals import compact, decimals_for, distinct_figures, signed
from orthoglide.ordering import best_of
from orthoglide.parameters import Parameter
from orthoglide.result import Result, WeakDirection
from orthoglide.text import listed

_SIGMA_WITHOUT_PRIORS = "one sigma of the readings alone, without priors"
_HARDLY_CHANGED_RATIO = 0.95  # ratio of deviations above which they "hardly change"
_UNINFORMED_RATIO = 0.9  # ratio of a sigma to the tolerance above which the readings add nothing
_MOST_NAMED = 2  # parameters beyond the base model, or weak directions, that are named one by one
_MOST_NAMED_WEAK = 4  # parameters of a weak direction that its sentence names


def identified_words(result: Result) -> str:
    """Return the identified values, the change of the deviations and the residual, in sentences."""
    return f"{_identified_values(result)} {_deviation_change(result)}. {_residual_text(result)}"


def _identified_values(result: Result) -> str:
    """Return the identified values as the subject of the sentence."""
    catalogue = result.catalogue
    names = [catalogue.parameter(name) for name in result.identified]
    parts = [text for effect in catalogue.base for text in _campaign_phrases(result, names, effect)]
    others = [name for name in names if name.effect not in catalogue.base]
    named = others[:_MOST_NAMED]
    parts += [f"{parameter_words(n, catalogue.legs)} {_value(result, n)}" for n in named]
    if len(others) > _MOST_NAMED:
        parts.append(f"{len(others) - _MOST_NAMED} further parameters")
    text = listed(parts)
    return text[:1].upper() + text[1:]


def _deviation_change(result: Result) -> str:
    """Return by how much the fit reduces the deviations, a predicate."""
    parts, last = [], ""
    before, after = result.nominal.reported.shown, result.after.scores.reported.shown
    for unit, now in after.items():
        figures = distinct_figures(before[unit], now)
        verb = "hardly change" if now > _HARDLY_CHANGED_RATIO * before[unit] else "reduce"
        verb = "do not reduce" if figures[0] == figures[1] else verb
        lead = f"{verb} {'them' if last else 'the deviations'} " if verb != last else ""
        parts.append(f"{lead}from {' to '.join(dict.fromkeys(figures))} {unit}")
        last = verb
    return ", and ".join(parts)


def _residual_text(result: Result) -> str:
    """Return the residual compared with the noise, in sentences."""
    noise, fit = result.noise.single_reading.said(), result.after
    if fit.scores.dof <= 0:
        return "No reading is left over to judge the fit by."
    if fit.sigma_scale > 1:
        return (
            f"The residual is {fit.sigma_scale:.2g} times the noise of a reading ({noise}). The "
            f"machine, or the measurement, has an error that {base_effects(result)} cannot explain."
        )
    return (
        f"The residual is no more than the noise of a reading ({noise}): these readings show no "
        f"further error."
    )


def base_effects(result: Result) -> str:
    """Return the effects of the base model in the plural, or that they were calibrated before."""
    if result.calibrated_before:
        return "errors calibrated before"
    return _effect_plurals(result.before.names, result.catalogue)


def _effect_plurals(names: Iterable[str], catalogue: Catalogue) -> str:
    """Return the effects of parameters in the plural, each once."""
    effect_words = catalogue.legs.effect_words
    words = dict.fromkeys(effect_words(catalogue.effect_of(name).name) for name in names)
    return listed(f"{n}es" if n.endswith(("sh", "ch", "ss", "x")) else f"{n}s" for n in words)


def _campaign_phrases(result: Result, parameters: Sequence[Parameter], effect: str) -> list[str]:
    """Return a phrase for each campaign: ``joint offsets x -0.51, y +0.56 mm``."""
    groups: dict[str, list[Parameter]] = {}
    for name in parameters:
        if name.effect == effect:
            groups.setdefault(name.campaign, []).append(name)
    phrases = []
    for campaign, names in groups.items():
        noun = result.catalogue.legs.effect_words(effect) + ("s" if len(names) > 1 else "")
        campaign_words = f" ({campaign})" if campaign else ""
        if near_words := _near_nominal(result, names):
            phrases.append(f"{noun} {near_words}{campaign_words}")
            continue
        values = ", ".join(f"{n.member or n.leg} {_value(result, n, False)}" for n in names)
        unit = result.catalogue[effect].unit
        phrases.append(f"{noun} {values}{unit.behind}{campaign_words}")
    return phrases


def _near_nominal(result: Result, names: Sequence[Parameter]) -> str:
    """Return a phrase for lengths that differ from nominal by no more than the noise; else empty.

    The phrase states a larger uncertainty if the readings determine them less well than that.
    """
    fit = result.after
    half = fit.coverage_factor * max(fit.sigmas[name] for name in names)
    noise = result.noise.single_reading.length
    threshold = half if math.isnan(noise) else noise
    if max(abs(fit.values[name]) for name in names) > threshold:
        return ""
    if all(fit.sigmas[n] > _UNINFORMED_RATIO * result.request.machine.tolerance(n) for n in names):
        return "not seen by these readings"
    return f"nominal to {compact(max(threshold, half) * 1e3, 1)} mm"


def _value(result: Result, name: Parameter, with_unit: bool = True) -> str:
    unit, identified = result.catalogue.effect_of(name).unit, result.identified[name]
    # Along a weak direction a sigma of millimetres would round off digits that are determined.
    decimals = 2 if unit.name == "mm" else decimals_for(identified.sigma, 9)
    text = signed(identified.value, decimals)
    return f"{text}{unit.behind}" if with_unit else text


def weak_sentences(weak: Iterable[WeakDirection], catalogue: Catalogue = CATALOGUE) -> list[str]:
    """Return weak directions in sentences; similar ones share a sentence."""
    legs = [(w, _leg_with_weak_length(w, catalogue)) for w in weak]
    similar, others = [w for w, leg in legs if leg], [w for w, leg in legs if not leg]
    groups = [others] if len(others) > _MOST_NAMED else [[w] for w in others]
    sentences = [_direction_sentence(group, catalogue) for group in groups]
    if similar:
        first = _offset_and_length_sentence(similar, sorted(leg for _, leg in legs if leg))
        return [first, *sentences]
    return sentences


def _leg_with_weak_length(weak: WeakDirection, catalogue: Catalogue) -> str:
    """Return the leg (and campaign) whose offset and length change together; empty for others."""
    names = [catalogue.parameter(name) for name in weak.parameters]
    one_leg = len({(n.leg, n.campaign) for n in names}) == 1 and bool(names[0].leg)
    offset_and_length = {n.effect for n in names} == set(catalogue.base) and len(names) == 2
    same_sign = len({share > 0 for share in weak.parameters.values()}) == 1
    if not (one_leg and offset_and_length and same_sign):
        return ""
    return f"{names[0].leg} of {names[0].campaign}" if names[0].campaign else names[0].leg


def _offset_and_length_sentence(weak: list[WeakDirection], legs: list[str]) -> str:
    widest = best_of(weak, lambda w: w.sigma)
    text = (
        f"The readings cannot tell the joint offset from the leg length of leg {listed(legs)}: "
        f"where both grow by the same amount, by as much as {compact(widest.sigma, 2)} "
        f"{widest.unit} ({_SIGMA_WITHOUT_PRIORS}), hardly a reading changes. Their difference is "
        f"what is seen."
    )
    return text + _prior_sentence(widest)


def _direction_sentence(weak: list[WeakDirection], catalogue: Catalogue) -> str:
    """Return the sentence of one direction, or of several by the widest of them."""
    names = [name for one in weak for name in one.parameters]
    words = [parameter_words(catalogue.parameter(name), catalogue.legs) for name in names]
    if len(words) > _MOST_NAMED_WEAK:
        words[_MOST_NAMED_WEAK - 1 :] = [f"{len(words) - _MOST_NAMED_WEAK + 1} more"]
    text = f"The readings cannot tell {listed(words)} apart: together they"
    if len(weak) > 1:
        kinds = _effect_plurals(names, catalogue)
        text = (
            f"The readings hardly see {len(weak)} combinations of {kinds}: along one of them the "
            f"values"
        )
    elif len(words) == 1:
        text = f"The readings hardly see the {words[0]}: it"
    widest = best_of(weak, lambda w: w.sigma)
    size = f"{compact(widest.sigma, 2)} {widest.unit} ({_SIGMA_WITHOUT_PRIORS}), and hardly a"
    if math.isinf(widest.sigma):
        size = "any amount, and no"
    return f"{text} may change by {size} reading changes.{_prior_sentence(widest)}"


def _prior_sentence(weak: WeakDirection) -> str:
    if not weak.sigma_with_priors < 0.5 * weak.sigma:
        return ""
    size = f"{compact(weak.sigma_with_priors, 2)} {weak.unit}"
    return f" The tolerances, not the readings, narrow this to {size}."
