"""Rows of the tables that terminal and page share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from orthoglide.numerals import compact, decimals_for, probability, signed
from orthoglide.report.fit_sentences import residual_words
from orthoglide.result import CandidateScore, Result
from orthoglide.text import sentence

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
