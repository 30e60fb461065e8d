"""Sections of the page on what was found: the verdict, faults, causes, and what they explain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from orthoglide.numerals import compact, decimals_for, probability, signed
from orthoglide.report.embed import panels, whole
from orthoglide.report.figures.causes import MOST_CURVES
from orthoglide.report.figures.style import Drawing
from orthoglide.report.phrases import listed, sentence
from orthoglide.report.rows import score_rows
from orthoglide.report.wording import MEANINGS, effects_named, headline, look_at

if TYPE_CHECKING:
    from orthoglide.result import Cause, Result

Data = dict[str, Any]
Figures = Mapping[str, Drawing]

_FAULTS = {
    "outlier": "a reading out of line",
    "knocked_stand": "a stand that was knocked",
    "sign": "a dial that counted the other way",
    "exchanged_labels": "two setups exchanged",
    "unit": "a wrong unit",
    "stuck": "a dial that stuck",
    "scatter": "visits that do not repeat",
}


@dataclass(frozen=True)
class Tile:
    """A figure before and after."""

    what: str
    before: str
    after: str
    unit: str


def tiles(result: Result) -> list[Tile]:
    """What the finding gains, at a glance."""
    before, after = result.before, result.after
    start = before.scores if result.effects else result.nominal
    found = [
        _tile("Readings", start.deviation_rms, after.scores.deviation_rms, "mm rms left"),
        _tile("Stations left out", start.cv_rms, after.scores.cv_rms, "mm rms"),
    ]
    if result.hold_out is not None:
        held = result.hold_out
        found.append(_tile("Readings held out", held.before_rms, held.after_rms, "mm rms"))
    if result.tcp is not None:
        errors = result.tcp["translation"]
        first = errors.before if result.effects else errors.nominal
        found.append(_tile("TCP, best shift removed", first[0], errors.after[0], "mm mean error"))
    noise = after.problem.noise.typical * 1e3
    found.append(Tile("Noise of a reading", "", compact(noise, 2), "mm, sigma"))
    return found


def _tile(what: str, before: float, after: float, unit: str) -> Tile:
    if not math.isfinite(before + after):
        return Tile(what, "", "–", unit)
    places = decimals_for(min(before, after) * 1e3, 3)
    return Tile(what, f"{before * 1e3:.{places}f}", f"{after * 1e3:.{places}f}", unit)


def finding(result: Result) -> Data:
    """The verdict, its sentence, and what speaks against acting on it."""
    after = result.after
    lacking = not result.request.searches and after.sigma_scale > 1
    return {
        "sentence": headline(result),
        "word": result.word,
        "meaning": sentence(MEANINGS[result.word]),
        "tiles": tiles(result),
        "effects": bool(result.effects),
        "base": effects_named(result.before),
        "lacking": f"{after.sigma_scale:.2g}" if lacking else "",
        "cautions": result.cautions,
        "warnings": [sentence(w) for w in result.warnings],
    }


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


def look(result: Result) -> Data:
    """Where to look on the machine."""
    return {"rows": look_at(result)}


def left(result: Result) -> Data:
    """The pattern of what is left."""
    return {
        "pattern": [sentence(text) for text in result.pattern],
        "rms": compact(result.after.scores.rms * 1e3, 2),
        "noise": compact(result.after.problem.noise.typical * 1e3, 2),
    }


def judged(result: Result, figures: Figures) -> Data:
    """Figures of merit of the nominal machine, before and after."""
    inside = result.tcp["translation"].inside if result.tcp else math.nan
    return {
        "rows": score_rows(result),
        "figure": whole(figures["residuals"]),
        "held": result.hold_out is not None,
        "own": listed([n.replace("_", " ") + "s" for n in result.request.own]),
        "tcp": result.tcp is not None,
        "inside": f"{inside:.0%}" if math.isfinite(inside) else "",
        "several": bool(result.effects),
        "base": effects_named(result.before),
    }


def causes(result: Result, figures: Figures) -> Data:
    """Causes that were tried, and how sure they are."""
    known = {one.name: one.probability for c in result.causes for one in c.explanations}
    added = {cause.name for cause in result.causes}
    rows = [
        {
            "name": t.name,
            "words": result.short(t.name),
            "round": t.round,
            "evidence": signed(t.evidence, 1),
            "p": probability(t.p_value),
            "cv": f"{t.cv_rms * 1e3:.4f}",
            "plausible": t.plausible,
            "added": t.name in added,
            "probability": f"{known[t.name]:.2f}" if t.name in known else "",
        }
        for t in result.candidates
    ]
    tests = [
        {
            "name": cause.name,
            "detection": probability(cause.effect.detection_p),
            "naming": probability(cause.effect.naming_p),
            "before": f"{cause.effect.cv_rms[0] * 1e3:.4f}",
            "after": f"{cause.effect.cv_rms[1] * 1e3:.4f}",
        }
        for cause in result.causes
    ]
    detection = result.detection
    return {
        "rows": rows,
        "rounds": len({t.round for t in result.candidates}) > 1,
        "tests": tests,
        "figure": whole(figures["causes"]) if "causes" in figures else "",
        "stopped": result.stopped,
        "detection": probability(detection.p_value),
        "lack": probability(detection.lack_of_fit_p),
        "count": len(result.left.signatures.candidates) if result.left else 0,
    }


def apart(result: Result, figures: Figures) -> Data:
    """What each cause makes of the readings, rivals overlaid."""
    bars = any(s.bar for c in result.after.problem.campaigns for s in c.setups)
    found = [
        _apart(cause, panels(figures[f"signatures-{k}"]))
        for k, cause in enumerate(result.causes, start=1)
    ]
    return {"effects": found, "bars": bars, "several": len(found) > 1}


def _apart(cause: Cause, shown: list[str]) -> Data:
    rivals = [
        {
            "name": rival.name,
            "words": rival.words,
            "chi2": signed(cause.chi2_more(rival), 2),
            "probability": f"{rival.probability:.2f}",
        }
        for rival in cause.rivals
    ]
    return {
        "name": cause.name,
        "panels": shown,
        "key": [one.name for one in cause.explanations[:MOST_CURVES]],
        "rivals": rivals,
        "limit": compact(cause.class_width, 2),
        "scaled": cause.lacking,
    }


def readings(figures: Figures) -> Data:
    """Readings and fit, setup by setup."""
    return {"panels": panels(figures["readings"])}
