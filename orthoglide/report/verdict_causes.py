"""Sections of a verdict's report on its causes: which, how sure, what tells them apart."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from orthoglide.numerals import compact, probability, signed
from orthoglide.report.causes import short
from orthoglide.report.embed import panels, whole
from orthoglide.report.figures import Drawing
from orthoglide.report.html import Data
from orthoglide.report.wording import sentence

if TYPE_CHECKING:
    from orthoglide.report.verdict_view import Explained, View

# --- Causes ---------------------------------------------------------------------------------


def causes_data(view: View, figures: Mapping[str, Drawing]) -> Data:
    """Causes that were tried, and how sure they are."""
    verdict = view.verdict
    probabilities = {
        name: p
        for e in view.effects
        for name, p in (
            (e.effect.name, e.effect.probability),
            *((r.trial.candidate.name, r.weight) for r in e.effect.rivals),
        )
    }
    added = {e.effect.name for e in view.effects}
    rows = [
        {
            "name": t.name,
            "words": short(t.name),
            "round": t.round,
            "evidence": signed(t.evidence, 1),
            "p": probability(t.p_value),
            "cv": f"{t.cv_rms * 1e3:.4f}",
            "plausible": t.plausible,
            "added": t.name in added,
            "probability": f"{probabilities[t.name]:.2f}" if t.name in probabilities else "",
        }
        for t in view.tried
    ]
    tests = [
        {
            "name": e.effect.name,
            "detection": probability(e.effect.detection_p),
            "naming": probability(e.effect.naming_p),
            "before": f"{e.effect.cv_rms[0] * 1e3:.4f}",
            "after": f"{e.effect.cv_rms[1] * 1e3:.4f}",
        }
        for e in view.effects
    ]
    detection = verdict.left.detection
    return {
        "rows": rows,
        "rounds": len({t.round for t in view.tried}) > 1,
        "tests": tests,
        "figure": whole(figures["causes"]) if "causes" in figures else "",
        "stopped": verdict.stopped,
        "detection": probability(detection.p_value),
        "lack": probability(detection.lack_of_fit_p),
        "count": len(verdict.left.signatures.candidates),
    }


def apart_data(view: View, figures: Mapping[str, Drawing]) -> Data:
    """What each cause makes of the readings, rivals overlaid."""
    from orthoglide.diagnosis.ranking import CLASS_WIDTH, lack_scale

    bars = any(s.bar for c in view.verdict.fit.problem.campaigns for s in c.setups)
    effects = [
        {
            "name": e.effect.name,
            "panels": panels(figures[f"signatures-{k}"]),
            "key": [name for name, _ in e.fits[:4]],
            "more": max(len(e.fits) - 4, 0),
            "rivals": [_rival(e, r) for r in e.effect.rivals],
            "limit": compact(CLASS_WIDTH * lack_scale(e.effect.trial.estimate) ** 2, 2),
            "scaled": lack_scale(e.effect.trial.estimate) > 1,
        }
        for k, e in enumerate(view.effects, start=1)
    ]
    return {"effects": effects, "bars": bars, "several": len(effects) > 1}


def _rival(explained: Explained, rival: Any) -> dict[str, str]:
    more = rival.trial.chi2 - explained.effect.trial.chi2
    return {
        "name": rival.trial.candidate.name,
        "words": short(rival.trial.candidate.name),
        "chi2": signed(more, 2),
        "probability": f"{rival.weight:.2f}",
    }


def left_data(view: View) -> Data:
    """The pattern of what is left."""
    return {
        "pattern": [sentence(text) for text in view.pattern],
        "rms": compact(view.verdict.fit.scores.rms * 1e3, 2),
        "noise": compact(view.verdict.fit.problem.noise.typical * 1e3, 2),
    }


# --- What to measure next -------------------------------------------------------------------


_AIMS = {
    "separate": "To tell the causes apart",
    "narrow": "To narrow what is hardly seen",
}
_MINUS = re.compile(r"(?<=\s)-(?=\d)")
_COLUMNS = ("setup", "leg", "direction", "posture", "gauge_mm", "bar")


def next_data(view: View, sheet: str) -> Data:
    """What to measure next, with the sheet as a link."""
    useful = [s for s in view.following if s.aim != "none"]
    suggestions = [
        {
            "aim": _AIMS[s.aim],
            "reason": _reason(s.reason),
            "rows": [_station(row) for row in _once(s.rows)],
            "bar": any(row.get("bar") for row in s.rows),
            "approach": any("approach_x" in row for row in s.rows),
        }
        for s in useful
    ]
    data = base64.b64encode(sheet.encode()).decode()
    return {
        "suggestions": suggestions,
        "hopeless": [_reason(s.reason) for s in view.following if s.aim == "none"],
        "link": f"data:text/csv;charset=utf-8;base64,{data}" if sheet else "",
        "count": max(sheet.count("\n") - 1, 0),
    }


def _reason(text: str) -> str:
    return sentence(_MINUS.sub("−", text))


def _once(rows: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """Rows that are visited several times, once, with how often."""
    found: dict[tuple[tuple[str, str], ...], int] = {}
    for row in rows:
        key = tuple((k, v) for k, v in row.items() if k not in ("repeat", "order"))
        found[key] = found.get(key, 0) + 1
    return [{**dict(key), "times": str(times)} for key, times in found.items()]


def _station(row: Mapping[str, str]) -> dict[str, str]:
    rho = [f"{float(row[f'rho_{leg}_mm']):.2f}" for leg in "xyz"]
    sides = {"1": "+", "-1": "−"}
    side = "".join(sides.get(row.get(f"approach_{leg}", ""), "·") for leg in "xyz")
    return {
        **{k: row.get(k, "") for k in _COLUMNS},
        "gauge_mm": f"{float(row['gauge_mm']):.1f}",
        "rho": ", ".join(rho),
        "side": side,
        "times": row["times"],
    }
