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
from orthoglide.numerals import (
    ByUnit,
    compact,
    plain,
    probability,
    signed,
    told_apart,
)
from orthoglide.report.embed import panels, whole
from orthoglide.report.phrases import listed, sentence
from orthoglide.report.rows import score_rows
from orthoglide.report.wording import effects_named, located_words

if TYPE_CHECKING:
    from orthoglide.posterior import BudgetItem, Cause
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
    "turns": "readings whole turns of the hand off",
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
    rows = [
        {
            "kind": _FAULTS[b.kind],
            "message": b.message,
            "with": f"{b.rms_with * 1e3:.4f}",
            "without": f"{b.rms_without * 1e3:.4f}",
        }
        for b in result.blunders
    ]
    with_them, without = result.first.scores.rms * 1e3, result.before.scores.rms * 1e3
    return {"rows": rows, "with": f"{with_them:.4f}", "without": f"{without:.4f}"}


def left(result: Result) -> Data:
    """The pattern of what is left."""
    return {
        "pattern": [sentence(text) for text in result.pattern],
        "rms": result.after.scores.left.said(),
        "noise": result.after.problem.one_reading.said(),
        "rows": [
            {
                "setup": rest.setup,
                "read": rest.reads,
                "share": f"{rest.share:.0%}",
                "rms": f"{compact(rest.rms * 1e3, 2)} {rest.unit}",
                "most": f"{compact(abs(rest.most) * 1e3, 2)} mm toward "
                f"{toward(LEGS[rest.axis], rest.most)}"
                if rest.kind == "leg"
                else f"{compact(rest.most * 1e3, 2)} {rest.unit}",
                "posture": rest.posture or "".join(f"tool at {p}" for p in rest.where[:1]),
            }
            for rest in (*result.rest, *result.rest_of_tool)
        ],
    }


def judged(result: Result, figures: Figures) -> Data:
    """Figures of merit of the nominal machine, before and after."""
    inside = result.tcp["translation"].inside if result.tcp else math.nan
    return {
        "tiles": before_and_after(result),
        "rows": score_rows(result),
        "figure": whole(figures["residuals"]),
        "dials": bool(result.after.problem.campaigns),
        "held": result.hold_out is not None,
        "own": listed([n.replace("_", " ") + "s" for n in result.request.own]),
        "tcp": result.tcp is not None,
        "inside": f"{inside:.0%}" if math.isfinite(inside) else "",
        "several": result.improved,
        "base": effects_named(result.before),
    }


def causes(result: Result, figures: Figures) -> Data:
    """Causes and places that were weighed, and how sure they are."""
    added = {c.name for c in result.effects} | {f.name for f in result.located}
    rows = [
        {
            "name": t.name,
            "words": result.short(t.name) if t.parameters else "a free function",
            "evidence": signed(t.evidence, 1),
            "added": t.name in added,
            "probability": f"{t.probability:.2f}",
        }
        for t in result.candidates
    ]
    return {
        "rows": rows,
        "figure": whole(figures["causes"]) if "causes" in figures else "",
        "stopped": result.stopped,
        "share": compact(result.share, 1),
        "left": probability(result.left.p_value),
    }


def located(result: Result, figures: Figures) -> Data:
    """Places without a name: the curve found, what else it could be, what it resembles."""
    found = [
        {
            "words": sentence(located_words(one)),
            "probability": f"{one.probability:.2f}",
            "panels": panels(figures[f"located-{k}"]),
            "members": [
                {
                    "name": c.place.name,
                    "words": c.place.words,
                    "size": c.size_words,
                    "probability": f"{c.probability:.2f}",
                }
                for c in one.members
            ],
            "resembling": [result.short(name) for name in one.resembling],
            "ruled_out": [result.short(name) for name in one.ruled_out],
        }
        for k, one in enumerate(result.located, start=1)
    ]
    return {"places": found, "most": _MOST_SHAPES}


def budget(result: Result) -> Data:
    """What is wrong by what mending it gains."""
    several = {c.name for c in result.effects if len(c.explanations) > 1}
    classes = [one for one in result.located if len(one.members) > 1]
    several |= {one.in_machine(result.catalogue)[0] for one in classes}
    named = {item.cause for item in result.budget if not item.rest}
    return {
        "rows": [
            {
                "cause": item.cause,
                "words": result.short(item.cause) + _counted(item, named, several),
                "tolerances": compact(item.tolerances, 2),
                "beyond": f"{item.beyond_tolerance:.2f}",
                "readings": _of_readings(item),
                "tcp": f"{item.tcp_mean * 1e3:.4f} ± {item.tcp_sigma * 1e3:.4f}",
                "gain": f"{plain(item.gain * 1e3, 4)} ± {item.gain_sigma * 1e3:.4f}",
                "compensated": (
                    f"{plain(item.compensated * 1e3, 4)} ± {item.compensated_sigma * 1e3:.4f}"
                ),
                "share": f"{plain(100 * item.share, 0)}%",
            }
            for item in result.budget[:_MOST_ITEMS]
        ]
    }


def _counted(item: BudgetItem, named: Collection[str], several: Collection[str]) -> str:
    """What else a row counts than its name says, behind it; of the causes and places that are
    ``named`` the readings cannot tell which of ``several`` it is.
    """
    if item.rest:
        return ": the rest of them" if item.cause in named else ""
    return ", or what these readings cannot tell from it" if item.cause in several else ""


def _of_readings(item: BudgetItem) -> str:
    """A cause's part of the readings; those of lengths are in millimetres, as the column says."""
    shown = ByUnit(item.readings_rms, item.readings_turn_rms).shown
    return ", ".join(f"{v:.4f}{' mrad' if unit == 'mrad' else ''}" for unit, v in shown.items())


def apart(result: Result, figures: Figures) -> Data:
    """What each cause makes of the readings, rivals overlaid."""
    found = [
        _apart(cause, panels(figures[f"signatures-{k}"]))
        for k, cause in enumerate(result.effects, start=1)
    ]
    return {"effects": found, "several": len(found) > 1}


def _apart(cause: Cause, shown: list[str]) -> Data:
    rivals = [
        {
            "name": rival.name,
            "words": rival.words,
            "probability": f"{rival.probability:.2f}",
        }
        for rival in cause.rivals
    ]
    rivals += [
        {
            "name": curve.place.name,
            "words": f"{curve.place.words}, by {curve.size_words}",
            "probability": f"{curve.probability:.2f}",
        }
        for curve in cause.places
    ]
    return {
        "name": cause.name,
        "panels": shown,
        "key": [one.name for one in cause.explanations[:MOST_CURVES]],
        "rivals": rivals,
    }


def readings(result: Result, figures: Figures) -> Data:
    """Readings and fit, setup by setup."""
    dials = not result.after.problem.points
    return {"panels": panels(figures["readings"]), "dials": dials}
