"""What terminal and page share: rows of tables, and sentences about a fit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.effects.wording import parameter_words
from orthoglide.numerals import compact, decimals_for, distinct_figures, probability, signed
from orthoglide.ordering import best_of
from orthoglide.result import CandidateScore, Result, WeakDirection
from orthoglide.result.fits import Scores
from orthoglide.text import listed, sentence

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


_MIN_SHOWN_PROBABILITY = 0.005  # smallest probability that two decimals show
_MIN_DOF = 0.5  # degrees of freedom below which nothing is tested


@dataclass(frozen=True)
class ParameterRow:
    """One identified value in its file's unit, ready to print."""

    name: str  # name of the parameter
    value: str  # with its sign
    sigma: str  # standard deviation of the full model; of the noise alone after `identify`
    low: str  # lower end of the 95 % interval
    high: str  # upper end
    tolerance: str  # prior standard deviation
    unit: str  # unit of all figures
    on_bound: bool  # whether the value ended on its bound


def parameter_rows(result: Result) -> list[ParameterRow]:
    """Return a row for each identified parameter."""
    rows = []
    for name, p in result.identified.items():
        decimals = decimals_for(p.sigma, most=9)
        value, low, high = (signed(v, decimals) for v in (p.value, *p.interval_95))
        sigma, tolerance = f"{p.sigma:.{decimals}f}", compact(p.tolerance)
        rows.append(ParameterRow(name, value, sigma, low, high, tolerance, p.unit, p.on_bound))
    return rows


class ScoreRow(NamedTuple):
    """One figure of merit of the nominal machine, before and after."""

    what: str
    nominal: str
    before: str
    after: str


_ALIGNMENTS = {
    "none": "as they are",
    "translation": "after the best translation",
    "rigid": "after the best rigid motion",
}


POSSIBLE_TITLES = ("probability", "possible cause", "deviations, rms", "stations left out, rms")
"""Titles of the rows by :func:`possible_rows`."""


def possible_rows(result: Result) -> list[tuple[str, str, str, str]]:
    """Return the most probable causes if nothing was found, with the residuals of the fit and of
    stations left out before and after each.
    """
    before, rows = result.before.scores, []
    residual = "deviation_rms" if math.isfinite(before.deviation_rms) else "rms"
    for cause in result.possible:
        pairs = ([getattr(s, n) for s in (before, cause.after)] for n in (residual, "cv_rms"))
        fit, left_out = (" to ".join(millimetres(pair)) + " mm" for pair in pairs)
        rows.append((probability(cause.probability), cause.words, fit, left_out))
    return rows


def possible_cause_sentences(result: Result) -> list[str]:
    """Return the most probable causes if nothing was found, a sentence each."""
    what = residual_words(result.before.scores)
    return [
        f"{sentence(words)} Probability {chance}. It would reduce {what} from {fit} rms, and "
        f"that of readings predicted from other stations from {left_out}."
        for chance, words, fit, left_out in possible_rows(result)
    ]


def probable_candidates(result: Result) -> list[CandidateScore]:
    """Return candidates whose probability two decimals show."""
    return [c for c in result.candidates if c.probability >= _MIN_SHOWN_PROBABILITY]


def score_rows(result: Result) -> list[ScoreRow]:
    """Return figures of the nominal machine, the base model and the final model."""
    stages = (result.nominal, result.before.scores, result.after.scores)
    rows = [
        ScoreRow(f"{what}, {unit}", *millimetres([getattr(s, name) for s in stages]))
        for what, unit, name in (
            ("deviations, rms", "mm", "deviation_rms"),
            ("residuals, rms", "mm", "rms"),
            ("residuals, rms", "mrad", "turn_rms"),
            ("largest residual", "mm", "max"),
            ("largest residual", "mrad", "turn_max"),
            ("stations left out, rms", "mm", "cv_rms"),
            ("stations left out, rms", "mrad", "turn_cv_rms"),
        )
        if unit in stages[0].left.shown and any(math.isfinite(getattr(s, name)) for s in stages)
    ]
    hold_out = result.hold_out
    if hold_out is not None:
        for unit, *pair in zip(("mm", "mrad"), hold_out.before, hold_out.after, strict=True):
            if unit in hold_out.before.shown:
                what = f"readings held out, rms, {unit}"
                rows.append(ScoreRow(what, "", *millimetres(pair)))
    tcp_errors = result.tcp or {}
    for alignment, words in _ALIGNMENTS.items() if tcp_errors else ():
        errors = tcp_errors[alignment]
        means = millimetres([errors.nominal_mean, errors.before_mean, errors.after_mean])
        largest = millimetres([errors.nominal_max, errors.before_max, errors.after_max])
        cells = [f"{mean} / {top}" for mean, top in zip(means, largest, strict=True)]
        rows.append(ScoreRow(f"TCP, mean / largest, {words}, mm", *cells))
    rows += [
        ScoreRow("chi²", *(f"{s.chi2:.1f}" for s in stages)),
        ScoreRow("degrees of freedom", *(compact(s.dof, 4) for s in stages)),
        ScoreRow(
            "probability that noise alone leaves as much",
            *(probability(s.lack_of_fit_p) if s.dof >= _MIN_DOF else "–" for s in stages),
        ),
    ]
    return rows


def millimetres(metres: Sequence[float]) -> list[str]:
    """Return lengths in millimetres (or angles in milliradians) as text, with the decimals that the
    smallest is worth; a dash for nan.
    """
    finite = [v for v in metres if math.isfinite(v)]
    decimals = max(decimals_for(min(finite, default=0.0) * 1e3, 4), 3)
    return [f"{v * 1e3:.{decimals}f}" if math.isfinite(v) else "–" for v in metres]
