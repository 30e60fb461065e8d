"""The sentences of a report about a fit: its improvement, and directions that are hardly seen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.effects.wording import parameter_words
from orthoglide.numerals import compact, distinct_figures
from orthoglide.ordering import best_of
from orthoglide.result import Result, Scores, WeakDirection
from orthoglide.text import listed

_SIGMA_WITHOUT_PRIORS = "one sigma of the readings alone, without priors"
_HARDLY_FALLS_RATIO = 0.9  # ratio of residuals above which they "hardly" fall
_UNINFORMED_RATIO = 0.9  # ratio of a sigma to the tolerance above which the readings add nothing
_MOST_NAMED = 2  # weak directions that have a sentence each
_MOST_NAMED_WEAK = 4  # parameters of a weak direction that its sentence names


def improvement_words(before: Scores, after: Scores) -> str:
    """Return by how much a fit reduces the residuals, a clause."""
    return f"{residual_words(after)} {_rms_change(before, after)}"


def residual_words(scores: Scores) -> str:
    """Return what the first residual of a fit is called: that of averaged deviations of dials, or
    else of readings.
    """
    if math.isfinite(scores.deviation_rms):
        return "the residual of averaged readings relative to each setup's first posture"
    return "the residual of the readings"


def _rms_change(before: Scores, after: Scores) -> str:
    """Return ``falls from 0.3 to 0.01 mm rms``, for lengths and for inclinations."""
    parts, last = [], ""
    for unit, now in after.reported.shown.items():
        was = before.reported.shown[unit]
        verb = "hardly falls" if now > _HARDLY_FALLS_RATIO * was else "falls"
        figures = distinct_figures(was, now)
        text = f"{verb if verb != last else ''} from {' to '.join(figures)} {unit} rms".strip()
        stays = now >= was or figures[0] == figures[1]
        parts.append(f"does not fall: it is {figures[1]} {unit} rms" if stays else text)
        last = "" if stays else verb
    return ", and ".join(parts)


def unseen_effects_text(result: Result) -> str:
    """Return the effects of the last fit whose values the readings leave to the priors, a sentence;
    empty for none.
    """
    fit, catalogue, machine = result.after, result.catalogue, result.request.machine
    seen = {
        catalogue.effect_of(name).name
        for name, sigma in fit.sigmas.items()
        if sigma <= _UNINFORMED_RATIO * machine.tolerance(name)
        or abs(fit.values[name]) > fit.coverage_factor * sigma
    }
    unseen = [name for name in fit.names if catalogue.effect_of(name).name not in seen]
    return f"These readings do not see the {_effect_plurals(unseen, catalogue)}." if unseen else ""


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


def weak_sentences(weak: Sequence[WeakDirection], catalogue: Catalogue = CATALOGUE) -> list[str]:
    """Return weak directions in sentences; many share one."""
    groups = [weak] if len(weak) > _MOST_NAMED else [[one] for one in weak]
    return [_direction_sentence(group, catalogue) for group in groups]


def _direction_sentence(weak: Sequence[WeakDirection], catalogue: Catalogue) -> str:
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
    size = f"{compact(widest.sigma, 2)} {widest.unit} ({_SIGMA_WITHOUT_PRIORS}), and hardly any"
    if math.isinf(widest.sigma):
        size = "any amount, and no"
    sentence = f"{text} may change by {size} reading changes."
    if not widest.sigma_with_priors < 0.5 * widest.sigma:
        return sentence
    narrowed = f"{compact(widest.sigma_with_priors, 2)} {widest.unit}"
    return f"{sentence} The tolerances, not the readings, narrow this to {narrowed}."
