"""Rows of the tables that terminal and page share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from orthoglide.numerals import compact, decimals_for, hundredths, probability, signed
from orthoglide.result import CandidateScore, Result
from orthoglide.text import sentence

_MIN_SHOWN_PROBABILITY = 0.005  # probability that two decimals show
_MIN_DOF = 0.5  # degrees of freedom: less is no test


@dataclass(frozen=True)
class ParameterRow:
    """One identified value in its file's unit, ready to print."""

    name: str  # of the parameter
    value: str  # with its sign
    sigma: str  # everything else allowed; as if nothing else were wrong by `identify`
    low: str  # end of the 95 % interval
    high: str  # its other end
    tolerance: str  # standard deviation to expect
    unit: str  # of all these
    on_bound: bool  # whether the value ended on its bound


def parameter_rows(result: Result) -> list[ParameterRow]:
    """Return a row for each identified parameter."""
    rows = []
    for name, one in result.identified.items():
        places = decimals_for(one.sigma, most=9)
        low, high = (signed(end, places) for end in one.interval_95)
        rows.append(
            ParameterRow(
                name,
                signed(one.value, places),
                f"{one.sigma:.{places}f}",
                low,
                high,
                compact(one.tolerance),
                one.unit,
                one.on_bound,
            )
        )
    return rows


class ScoreRow(NamedTuple):
    """One figure of merit of the nominal machine, before and after."""

    what: str
    nominal: str
    before: str
    after: str


_ALIGNMENTS = {
    "none": "as they are",
    "translation": "best shift removed",
    "rigid": "best rigid motion removed",
}


POSSIBLE_TITLES = ("probability", "possible cause", "residual, rms", "stations left out, rms")
"""Titles of the rows by :func:`possible_rows`."""


def possible_rows(result: Result) -> list[tuple[str, str, str, str]]:
    """Return the most probable causes where nothing was found, with the errors of fit and of
    stations left out before and after.
    """
    before, rows = result.before.scores, []
    deviations = math.isfinite(before.deviation_rms)
    for one in result.possible:
        pairs = (
            (before.deviation_rms, one.after.deviation_rms)
            if deviations
            else (before.rms, one.after.rms),
            (before.cv_rms, one.after.cv_rms),
        )
        fit, left_out = (" to ".join(millimetres(pair)) + " mm" for pair in pairs)
        rows.append((hundredths(one.probability), one.words, fit, left_out))
    return rows


def possible_cause_sentences(result: Result) -> list[str]:
    """Return the most probable causes where nothing was found, a sentence each."""
    averaged = math.isfinite(result.before.scores.deviation_rms)
    what = "averaged deviations" if averaged else "residuals"
    return [
        f"{sentence(words)} Probability {chance}. It would reduce the rms of {what} from {fit}, "
        f"and of readings predicted from other stations from {left_out}."
        for chance, words, fit, left_out in possible_rows(result)
    ]


def probable_candidates(result: Result) -> list[CandidateScore]:
    """Return candidates whose probability two decimals show."""
    return [one for one in result.candidates if one.probability >= _MIN_SHOWN_PROBABILITY]


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
    held = result.hold_out
    if held is not None:
        for unit, *pair in zip(("mm", "mrad"), held.before, held.after, strict=True):
            if unit in held.before.shown:
                what = f"readings held out, rms, {unit}"
                rows.append(ScoreRow(what, "", *millimetres(pair)))
    judged = result.tcp or {}
    for alignment, words in _ALIGNMENTS.items() if judged else ():
        errors = judged[alignment]
        pairs = (errors.nominal, errors.before, errors.after)
        means, most = (millimetres([pair[k] for pair in pairs]) for k in (0, 1))
        cells = [f"{mean} / {top}" for mean, top in zip(means, most, strict=True)]
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
    known = [v for v in metres if math.isfinite(v)]
    places = max(decimals_for(min(known, default=0.0) * 1e3, 4), 3)
    return [f"{v * 1e3:.{places}f}" if math.isfinite(v) else "–" for v in metres]
