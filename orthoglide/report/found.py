"""Sections of the page on what was found: the verdict, faults, causes, and what they explain."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from orthoglide.effects.words import toward
from orthoglide.figures.causes import MOST_CURVES
from orthoglide.figures.style import Drawing
from orthoglide.geometry import LEGS
from orthoglide.numerals import ByUnit, compact, told_apart
from orthoglide.report.embed import panels, whole
from orthoglide.report.phrases import listed
from orthoglide.report.rows import score_rows
from orthoglide.report.wording import effects_named, located_words

if TYPE_CHECKING:
    from orthoglide.diagnosis.rest import SetupRest
    from orthoglide.posterior import BudgetItem
    from orthoglide.result import Result

Data = dict[str, Any]
Figures = Mapping[str, Drawing]

_MOST_ITEMS = 12
_MOST_SHAPES = 5  # known causes named as ruled out

_FAULTS = {
    "outlier": "a reading out of line",
    "knocked_stand": "a stand that was knocked",
    "zeroed": "a dial set to zero anew at each repeat",
    "command": "a posture that is not where its command says",
    "sign": "a dial that counted the other way",
    "label": "a setup of another leg or direction",
    "exchanged_labels": "two setups exchanged",
    "shifted": "readings a row too late or too early",
    "unit": "a wrong unit",
    "stuck": "a dial that stuck",
    "scatter": "visits that do not repeat",
}


@dataclass(frozen=True)
class BeforeAfter:
    """A figure before and after."""

    what: str
    before: str
    after: str
    unit: str


def before_and_after(result: Result) -> list[BeforeAfter]:
    """What the finding gains, at a glance."""
    before, after = result.before, result.after
    start = before.scores if result.improved else result.nominal
    found = [
        *_tiles("Readings", start.told, after.scores.told, "rms left"),
        *_tiles("Stations left out", start.left_out, after.scores.left_out, "rms"),
    ]
    if (held := result.hold_out) is not None:
        found += _tiles("Readings held out", held.before, held.after, "rms")
    if result.tcp is not None:
        errors = result.tcp["translation"]
        first = errors.before if result.improved else errors.nominal
        was, now = (ByUnit(length, math.nan) for length in (first[0], errors.after[0]))
        found += _tiles("TCP, best shift removed", was, now, "mean error")
    noise = after.problem.one_reading.shown
    found += [
        BeforeAfter("Noise of a reading", "", compact(value, 2), f"{unit}, sigma")
        for unit, value in noise.items()
    ]
    return found


def _tiles(what: str, before: ByUnit, after: ByUnit, figure: str) -> list[BeforeAfter]:
    """A tile a unit."""
    found = []
    for unit, now in after.shown.items():
        was = before.shown.get(unit, math.nan)
        found.append(BeforeAfter(what, *told_apart(was, now), f"{unit} {figure}"))
    return found or [BeforeAfter(what, "", "–", f"mm {figure}")]


def faults(result: Result) -> Data:
    """Faults of the data, each with and without."""
    return {"rows": [(_FAULTS[b.kind], b) for b in result.blunders]}


def left(result: Result) -> Data:
    """The pattern of what is left."""
    return {"rows": [(rest, _most(rest)) for rest in (*result.rest, *result.rest_of_tool)]}


def _most(rest: SetupRest) -> str:
    if rest.kind != "leg":
        return f"{compact(rest.most * 1e3, 2)} {rest.unit}"
    way = toward(LEGS[rest.axis], rest.most)
    return f"{compact(abs(rest.most) * 1e3, 2)} mm toward {way}"


def judged(result: Result, figures: Figures) -> Data:
    """Figures of merit of the nominal machine, before and after."""
    inside = result.tcp["translation"].inside if result.tcp else math.nan
    return {
        "tiles": before_and_after(result),
        "rows": score_rows(result),
        "figure": whole(figures["residuals"]),
        "own": listed([n.replace("_", " ") + "s" for n in result.request.own]),
        "inside": f"{inside:.0%}" if math.isfinite(inside) else "",
        "base": effects_named(result.before),
    }


def causes(result: Result, figures: Figures) -> Data:
    """Causes and places that were weighed, and how sure they are."""
    return {
        "added": {c.name for c in result.effects} | {f.name for f in result.located},
        "figure": whole(figures["causes"]) if "causes" in figures else "",
    }


def located(result: Result, figures: Figures) -> Data:
    """Places without a name: the curve found, what else it could be, what it resembles."""
    places = [
        (located_words(one), one, panels(figures[f"located-{k}"]))
        for k, one in enumerate(result.located, start=1)
    ]
    return {"places": places, "most": _MOST_SHAPES}


def budget(result: Result) -> Data:
    """What is wrong by what mending it gains."""
    several = {c.name for c in result.effects if len(c.explanations) > 1}
    classes = [one for one in result.located if len(one.members) > 1]
    several |= {one.in_machine(result.catalogue)[0] for one in classes}
    named = {item.cause for item in result.budget if not item.rest}
    rows = [
        (item, result.short(item.cause) + _counted(item, named, several))
        for item in result.budget[:_MOST_ITEMS]
    ]
    return {"rows": rows}


def _counted(item: BudgetItem, named: Collection[str], several: Collection[str]) -> str:
    """What else a row counts than its name says, behind it; of the causes and places that are
    ``named`` the readings cannot tell which of ``several`` it is.
    """
    if item.rest:
        return ": the rest of them" if item.cause in named else ""
    return ", or what these readings cannot tell from it" if item.cause in several else ""


def apart(result: Result, figures: Figures) -> Data:
    """What each cause makes of the readings, rivals overlaid."""
    every = enumerate(result.effects, start=1)
    causes = [(cause, panels(figures[f"signatures-{k}"])) for k, cause in every]
    return {"causes": causes, "most": MOST_CURVES}


def readings(figures: Figures) -> Data:
    """Readings and fit, setup by setup."""
    return {"panels": panels(figures["readings"])}
