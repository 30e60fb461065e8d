"""What was found, as claims that page and terminal show: each with what else it could be."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from orthoglide.numerals import SIGMAS_95, with_sigma
from orthoglide.ordering import ranked
from orthoglide.result import Cause, Change, Curve, DataRival, Explanation, Located, Result
from orthoglide.text import sentence
from orthoglide.units import display_unit as spoken_unit

SOMETHING_ELSE_WRONG = "Something else is wrong as well."
"""Behind what was found, where it does not explain all."""

_CERTAIN, _SURE = 0.995, 0.9
_MAX_LOG_ODDS = 50.0  # log odds: beyond, exp would overflow
_MOST_RIVALS = 2  # alternatives that a headline names; the report lists all
_NO_OPTION = -1  # of what no drawing shows


@dataclass(frozen=True)
class Statement:
    """One cause or place as a reader meets it."""

    words: str  # a sentence with part, direction, size and unit
    sure: str  # how sure it is, and how well its size is known
    option: int = _NO_OPTION  # its place among the options of the drawing
    probability: float = math.nan  # given the other findings; nan for a change
    brief: str = ""  # the same in a few words, where `words` take more than a sentence


@dataclass(frozen=True)
class Claim:
    """What was found, and what else it could be."""

    first: Statement  # the most probable
    same: tuple[Statement, ...]  # explanations with equal effects on readings and tool
    rivals: tuple[Statement, ...]  # that these readings cannot tell from it, most probable first
    note: str = ""  # what else must be known of it, a sentence


def claims(result: Result) -> list[Claim]:
    """Return causes, free-form errors and changes, each with its alternatives."""
    option = itertools.count()
    found = [_cause_claim(cause, option) for cause in result.effects]
    found += [_located_claim(one, option) for one in result.located]
    if result.word == "partial":
        found = [
            replace(
                c, first=replace(c.first, sure=f"{c.first.sure}, if it is one of the known causes")
            )
            for c in found
        ]
    return [*found, *(_change_claim(change, option) for change in result.moved)]


def claims_text(several: Iterable[Claim]) -> str:
    """Return claims as sentences, each with its most probable alternatives and the number of
    others.
    """
    told: list[str] = []
    for k, claim in enumerate(several):
        first = claim.first.brief or claim.first.words
        told.append(f"Besides, {lower_first(first)}" if k else first)
        told += (
            f"Equivalently, {lower_first(one.words)[:-1]}: readings and tool are equal."
            for one in claim.same
        )
        told += (f"Or {lower_first(one.brief or one.words)}" for one in claim.rivals[:_MOST_RIVALS])
        if (more := len(claim.rivals) - _MOST_RIVALS) > 0:
            told.append(
                f"Or one of {more} more, named below." if more > 1 else "Or one more, below."
            )
        if claim.rivals:
            told.append("These readings cannot tell which.")
        told += [claim.note] if claim.note else []
    return " ".join(told)


def probability_words(p: float) -> str:
    """Return a probability in words: ``97 % sure``, ``51 % likely``."""
    if p >= _CERTAIN:
        return "more than 99 % sure"
    return f"{100 * p:.0f} % {'sure' if p >= _SURE else 'likely'}"


def lower_first(text: str) -> str:
    """Return a sentence with a small first letter, to follow another word."""
    return text[:1].lower() + text[1:]


def _cause_claim(cause: Cause, option: Iterator[int]) -> Claim:
    """Return the claim of a cause; an alternative that is more probable comes first."""
    first = _statement(cause.chosen, cause.together, next(option))
    same, rivals = (
        tuple(_statement(e, e.probability, next(option)) for e in part)
        for part in (cause.same, cause.rivals)
    )
    others = (
        *rivals,
        *_place_statements(cause.places, option),
        *_data_fault_statements(cause.data),
    )
    likeliest, *rest = ranked((first, *others), lambda one: one.probability)
    if likeliest is first:
        return Claim(first, same, tuple(rest))
    return Claim(likeliest, (), tuple(ranked((*rest, *same), lambda one: one.probability)))


def _located_claim(found: Located, option: Iterator[int]) -> Claim:
    """Return the claim of a free-form error; a data fault that is more probable comes first."""
    every = (*_place_statements(found.members, option), *_data_fault_statements(found.data))
    first, *others = ranked(every, lambda one: one.probability)
    note = ""
    if found.resembling_words:
        note = f"It resembles a known cause: {found.resembling_words[0]}."
    return Claim(first, (), tuple(others), note)


def _place_statements(curves: Iterable[Curve], option: Iterator[int]) -> tuple[Statement, ...]:
    """Return each place once, with the summed probability of the functions that describe it."""
    once: dict[str, tuple[Curve, float, int]] = {}
    for curve in curves:
        number = next(option)
        first, p, shown = once.get(curve.description, (curve, 0.0, number))
        once[curve.description] = first, p + curve.probability, shown
    return tuple(
        Statement(sentence(curve.words_with_measure), probability_words(min(p, 1.0)), shown, p)
        for curve, p, shown in once.values()
    )


def _data_fault_statements(several: Iterable[DataRival]) -> Iterator[Statement]:
    """Yield data faults, which the drawing does not show."""
    for d in several:
        yield Statement(
            sentence(d.words),
            probability_words(d.probability),
            _NO_OPTION,
            d.probability,
            sentence(d.brief),
        )


def _statement(one: Explanation, probability: float, option: int) -> Statement:
    sure = probability_words(probability)
    if one.half_width:
        factor, unit = spoken_unit(one.unit)
        size = with_sigma(abs(one.value) * factor, SIGMAS_95 * one.sigma * factor, most=9)
        sure += f", its size {size} {unit} (95 %)"
    return Statement(sentence(one.words), sure, option, probability)


def _change_claim(change: Change, option: Iterator[int]) -> Claim:
    sure = probability_words(1 / (1 + math.exp(-min(change.evidence, _MAX_LOG_ODDS))))
    first, *rivals = (Statement(sentence(words), "", next(option)) for words in change.each)
    which = " that one of them changed" if rivals else ""
    return Claim(replace(first, sure=f"{sure}{which}"), (), tuple(rivals))
