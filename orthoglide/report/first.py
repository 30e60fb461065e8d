"""The first screen of the page: what is wrong, what the tool loses by it, and what to do."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from orthoglide.control import withheld
from orthoglide.report.words import BESIDES, evidence, meaning, standing
from orthoglide.result import Cause, Change, Curve, DataRival, Explanation, Result
from orthoglide.text import sentence

if TYPE_CHECKING:
    from orthoglide.accuracy import ExpectedError

Data = dict[str, Any]

MOST = 5
"""Rivals that are named before the rest is folded away."""

_CERTAIN, _SURE = 0.995, 0.9
_CLEARLY = 50.0  # log odds
_STAGES = {
    "now": "The tool now",
    "zeros": "With zeros corrected",
    "zeros_and_lengths": "And {bar} lengths entered",
    "compensated": "With commands compensated",
}
_NUMBERS = ("With the firmware's numbers", "With the new ones")


@dataclass(frozen=True)
class Statement:
    """One cause or place as a reader meets it."""

    words: str  # a sentence with part, direction, size and unit
    sure: str  # how sure it is, and how well its size is known
    option: int  # its place among the options of the drawing; -1: none


@dataclass(frozen=True)
class Claim:
    """What was found in one place of the machine."""

    first: Statement  # the most probable
    same: tuple[Statement, ...]  # other names of it: the same to these readings and to the tool
    rivals: tuple[Statement, ...]  # that these readings cannot tell from it, most probable first


@dataclass(frozen=True)
class Tile:
    """Error of the tool at one stage of correction, millimetres as text, and lines below it."""

    what: str
    size: str
    lines: tuple[str, str]


def finding(result: Result) -> Data:
    """The verdict, how sure it is, the tool's error, what to do, and what speaks against it."""
    after, searches = result.after, result.searches
    lacking = not searches and after.sigma_scale > 1
    return {
        "first": result.contradicted or (result.firmware.first if result.firmware else ""),
        "word": result.word,
        "meaning": sentence(meaning(result)),
        "claims": claims(result),
        "drawing": result.picture.svg(),
        "options": len(result.picture.options),
        "dials": bool(result.picture.dials),
        "text": "" if result.found else standing(result),
        "more": BESIDES if result.word == "partial" else "",
        "evidence": evidence(result) if searches else "",
        "tiles": tiles(result),
        "printer": result.firmware is not None and result.firmware.corrections is not None,
        "open": after.scores.left.said() if not result.stands or lacking else "",
        "legs": bool(result.request.campaigns),
        "loses": result.loses,
        "actions": result.actions,
        "sheet": result.next_sheet is not None,
        "most": MOST,
        "cautions": result.further_cautions,
        "warnings": [sentence(w) for w in result.warnings],
    }


def claims(result: Result) -> list[Claim]:
    """Causes, places and changes, each with what else it could be."""
    option = itertools.count()
    causes = [_of_cause(cause, option) for cause in result.effects]
    for found in result.located:
        first, *others = (_of_curve(c, next(option)) for c in found.members)
        causes.append(Claim(first, (), (*others, *_of_data(found.data))))
    if result.word == "partial":
        causes = [
            replace(c, first=replace(c.first, sure=f"among the causes known {c.first.sure}"))
            for c in causes
        ]
    return [*causes, *(_of_change(change, option) for change in result.moved)]


def _of_cause(cause: Cause, option: Iterator[int]) -> Claim:
    first = _statement(cause.chosen, cause.together, next(option))
    same, rivals = (
        tuple(_statement(e, e.probability, next(option)) for e in part)
        for part in (cause.same, cause.rivals)
    )
    places = (_of_curve(c, next(option)) for c in cause.places)
    return Claim(first, same, (*rivals, *places, *_of_data(cause.data)))


def _of_data(several: Sequence[DataRival]) -> Iterator[Statement]:
    """Faults of the data, of which the drawing shows none."""
    return (Statement(sentence(d.words), sure_words(d.probability), -1) for d in several)


def _statement(one: Explanation, probability: float, option: int) -> Statement:
    sure = sure_words(probability)
    if one.half_width:
        sure += f", its size to ± {one.half_width} (95 %)"
    return Statement(sentence(one.words), sure, option)


def _of_curve(curve: Curve, option: int) -> Statement:
    return Statement(sentence(curve.words_with_measure), sure_words(curve.probability), option)


def _of_change(change: Change, option: Iterator[int]) -> Claim:
    sure = sure_words(1 / (1 + math.exp(-min(change.evidence, _CLEARLY))))
    first, *rivals = (Statement(sentence(words), "", next(option)) for words in change.each)
    which = " that one of them changed" if rivals else ""
    return Claim(replace(first, sure=f"{sure}{which}"), (), tuple(rivals))


def sure_words(p: float) -> str:
    """A probability as a mechanic says it: ``97 % sure``, ``51 % likely``."""
    if p >= _CERTAIN:
        return "more than 99 % sure"
    return f"{100 * p:.0f} % {'sure' if p >= _SURE else 'likely'}"


def tiles(result: Result) -> list[Tile]:
    """The tool's mean error over the workspace, now and as more is put right; of a printer its
    height over the plate, which is all that its numbers are for.
    """
    if result.firmware is not None and (found := result.firmware.corrections) is not None:
        told = [
            Tile(what, f"{size * 1e3:.3f}", ("of the heights", "that were read, rms"))
            for what, size in zip(_NUMBERS, found.height, strict=True)
        ]
        return told if result.stands and not withheld(result.machine) else told[:1]
    expected = result.numbers.expected
    stages = ("now", "zeros") if not result.stands and result.searches else _STAGES
    bar = result.numbers.names.bar
    return [_tile(_STAGES[name].format(bar=bar), expected[name]) for name in stages]


def _tile(what: str, error: ExpectedError) -> Tile:
    shape, _, sigma = error.words.partition(" ± ")
    known = f"± {sigma} " if sigma else ""
    return Tile(what, shape, (f"{known}in a workpiece", f"all shifted by {error.place_words}"))
