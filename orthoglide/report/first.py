"""The first screen of the page: what is wrong, what the tool loses by it, and what to do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from orthoglide.control import withheld
from orthoglide.report.claims import BESIDES, claims
from orthoglide.report.words import evidence, meaning, standing, warnings_besides
from orthoglide.result import Result
from orthoglide.text import sentence

if TYPE_CHECKING:
    from orthoglide.accuracy import ExpectedError

Data = dict[str, Any]

MOST = 5
"""Rivals that are named before the rest is folded away."""

_STAGES = {
    "now": "The tool now",
    "zeros": "With zeros corrected",
    "zeros_and_lengths": "And {bar} lengths entered",
    "compensated": "With commands compensated",
}
_NUMBERS = ("With the firmware's numbers", "With the new ones")


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
        "averaged": any(cause.rivals for cause in result.effects),
        "tiles": tiles(result),
        "printer": result.firmware is not None and result.firmware.corrections is not None,
        "open": after.scores.left.said() if not result.stands or lacking else "",
        "legs": bool(result.request.campaigns),
        "loses": result.loses,
        "actions": result.actions,
        "sheet": result.next_sheet is not None,
        "most": MOST,
        "cautions": result.further_cautions,
        "warnings": [sentence(w) for w in warnings_besides(result)],
    }


def tiles(result: Result) -> list[Tile]:
    """The tool's mean error over the workspace, now and after each correction that changes it; of a
    printer its height over the plate, which is all that its numbers are for.
    """
    if result.firmware is not None and (found := result.firmware.corrections) is not None:
        told = [
            Tile(what, f"{size * 1e3:.3f}", ("of the heights", "that were read, rms"))
            for what, size in zip(_NUMBERS, found.height, strict=True)
        ]
        enter = result.stands and not found.keep and not withheld(result.machine)
        return told if enter else told[:1]
    expected = result.numbers.expected
    stages = ("now", "zeros") if not result.stands and result.searches else _STAGES
    bar = result.numbers.names.bar
    told, last = [], math.inf
    for name in stages:
        error = expected[name]
        if abs(error.shape - last) > error.shape_sigma:
            told.append(_tile(_STAGES[name].format(bar=bar), error))
            last = error.shape
    return told


def _tile(what: str, error: ExpectedError) -> Tile:
    shape, _, sigma = error.words.partition(" ± ")
    known = f"± {sigma} " if sigma else ""
    return Tile(what, shape, (f"{known}in a workpiece", f"all shifted by {error.place_words} mm"))
