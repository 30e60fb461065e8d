"""The findings as claims for page and terminal, each with its alternatives."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from orthoglide.numerals import SIGMAS_95, with_sigma
from orthoglide.ordering import ranked
from orthoglide.result import Cause, Change, Curve, DataRival, Explanation, Located, Result
from orthoglide.text import lower_first, sentence

SOMETHING_ELSE_WRONG = "Something else is wrong as well."
"""Words after findings that do not explain the whole residual."""

_CERTAIN, _SURE = 0.995, 0.9
_MAX_LOG_ODDS = 50.0  # log odds above which exp would overflow
_MOST_RIVALS = 2  # alternatives that a headline names; the report lists all
_NO_OPTION = -1  # option of a statement that no drawing shows


@dataclass(frozen=True)
class Statement:
    """One cause or free-form error in words."""

    words: str  # a sentence with part, direction, size and unit
    sure: str  # its probability, and the uncertainty of its size
    option: int = _NO_OPTION  # its number among the options of the drawing
    probability: float = math.nan  # conditional on the other findings; nan for a change
    brief: str = ""  # a shorter form if `words` take more than a sentence


@dataclass(frozen=True)
class Claim:
    """A finding with its alternatives."""

    first: Statement  # the most probable explanation
    same: tuple[Statement, ...]  # explanations with equal effects on readings and tool
    rivals: tuple[Statement, ...]  # explanations that fit as well, most probable first
    note: str = ""  # a remark, a sentence


def claims(result: Result) -> list[Claim]:
    """Return causes, free-form errors and changes, each with its alternatives."""
    option = itertools.count()
    finding_claims = [_cause_claim(cause, option) for cause in result.effects]
    finding_claims += [_located_claim(located, option) for located in result.located]
    if result.word == "partial":
        condition = ", if it is one of the known causes"
        firsts = (replace(c.first, sure=c.first.sure + condition) for c in finding_claims)
        finding_claims = [replace(c, first=f) for c, f in zip(finding_claims, firsts, strict=True)]
    return [*finding_claims, *(_change_claim(change, option) for change in result.moved)]


def found_text(result: Result) -> str:
    """Return what was found as sentences, each claim with its most probable alternatives and the
    number of others; after `identify` also the zeros to be entered.
    """
    sentences: list[str] = []
    for k, claim in enumerate(claims(result)[: len(result.effects) + len(result.located)]):
        first = claim.first.brief or claim.first.words
        sentences.append(f"Besides, {lower_first(first)}" if k else first)
        sentences += (
            f"Equivalently, {lower_first(one.words)[:-1]}: readings and tool are equal."
            for one in claim.same
        )
        named, more = claim.rivals[:_MOST_RIVALS], len(claim.rivals) - _MOST_RIVALS
        sentences += (f"Or {lower_first(one.brief or one.words)}" for one in named)
        if more > 0:
            which = f"Or one of {more} more, named below." if more > 1 else "Or one more, below."
            sentences.append(which)
        if claim.rivals:
            sentences.append("These readings cannot tell which.")
        sentences += [claim.note] if claim.note else []
    if result.word == "partial":
        sentences.append(SOMETHING_ELSE_WRONG)
    # Errors of the zeros are among what `identify` was asked for, and are no cause of their own.
    if not (result.searches or result.firmware):
        sentences += (sentence(one.words) for one in result.actions if one.kind == "zeros")
    return " ".join(sentences)


def probability_words(p: float) -> str:
    """Return a probability in words: ``97 % sure``, ``51 % likely``."""
    if p >= _CERTAIN:
        return "more than 99 % sure"
    return f"{100 * p:.0f} % {'sure' if p >= _SURE else 'likely'}"


def _cause_claim(cause: Cause, option: Iterator[int]) -> Claim:
    """Return the claim of a cause; an alternative that is more probable comes first."""
    first = _statement(cause.chosen, cause.together, next(option))
    same, rivals = (
        tuple(_statement(e, e.probability, next(option)) for e in explanations)
        for explanations in (cause.same, cause.rivals)
    )
    places = _place_statements(cause.places, option)
    every = (first, *rivals, *places, *_data_fault_statements(cause.data))
    likeliest, *others = ranked(every, lambda one: one.probability)
    if likeliest is first:
        return Claim(first, same, tuple(others))
    return Claim(likeliest, (), tuple(ranked((*others, *same), lambda one: one.probability)))


def _located_claim(found: Located, option: Iterator[int]) -> Claim:
    """Return the claim of a free-form error; a data fault that is more probable comes first."""
    statements = (*_place_statements(found.members, option), *_data_fault_statements(found.data))
    first, *others = ranked(statements, lambda one: one.probability)
    note = "".join(f"It resembles a known cause: {words}." for words in found.resembling_words[:1])
    return Claim(first, (), tuple(others), note)


def _place_statements(curves: Iterable[Curve], option: Iterator[int]) -> tuple[Statement, ...]:
    """Return each place once, with the summed probability of its error functions."""
    by_description: dict[str, tuple[Curve, float, int]] = {}
    for curve in curves:
        next_option = next(option)
        first, p, option_number = by_description.get(curve.description, (curve, 0.0, next_option))
        by_description[curve.description] = first, p + curve.probability, option_number
    return tuple(
        Statement(
            sentence(curve.words_with_measure), probability_words(min(p, 1.0)), option_number, p
        )
        for curve, p, option_number in by_description.values()
    )


def _data_fault_statements(faults: Iterable[DataRival]) -> Iterator[Statement]:
    """Yield statements of data faults, which the drawing does not show."""
    for fault in faults:
        words, p = sentence(fault.words), fault.probability
        yield Statement(words, probability_words(p), probability=p, brief=sentence(fault.brief))


def _statement(explanation: Explanation, probability: float, option: int) -> Statement:
    sure = probability_words(probability)
    if explanation.half_width:
        in_file, unit = explanation.effect.unit, explanation.effect.unit.spoken
        factor = in_file.si / unit.si
        size = with_sigma(
            abs(explanation.value) * factor, SIGMAS_95 * explanation.sigma * factor, most=9
        )
        sure += f", its size {size} {unit.name} (95 %)"
    return Statement(sentence(explanation.words), sure, option, probability)


def _change_claim(change: Change, option: Iterator[int]) -> Claim:
    sure = probability_words(1 / (1 + math.exp(-min(change.evidence, _MAX_LOG_ODDS))))
    first, *rivals = (Statement(sentence(words), "", next(option)) for words in change.each)
    which = " that one of them changed" if rivals else ""
    return Claim(replace(first, sure=f"{sure}{which}"), (), tuple(rivals))
