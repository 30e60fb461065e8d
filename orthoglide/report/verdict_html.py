"""The report of a closed loop: its sections and what each shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from orthoglide.effects import family_of, is_dial
from orthoglide.numerals import compact, decimals_for, probability, signed
from orthoglide.report.causes import short
from orthoglide.report.embed import panels, whole
from orthoglide.report.figures import Drawing
from orthoglide.report.html import (
    Data,
    Page,
    Section,
    controller_data,
    method_data,
    readings_data,
    render,
)
from orthoglide.report.run import Run
from orthoglide.report.verdict_causes import apart_data, causes_data, left_data, next_data
from orthoglide.report.verdict_wording import cautions, headline, look_at, told
from orthoglide.report.wording import listed, sentence, weak_sentences

if TYPE_CHECKING:
    from orthoglide.report.verdict_view import View

_KINDS = {
    "outlier": "a reading out of line",
    "knocked_stand": "a stand that was knocked",
    "sign": "a dial that counted the other way",
    "exchanged_labels": "two setups exchanged",
    "unit": "a wrong unit",
    "stuck": "a dial that stuck",
}


def verdict_page(view: View, run: Run, drawings: Sequence[Drawing], sheet: str) -> str:
    """The report of a closed loop.

    Args:
        view: of the verdict.
        run: what was asked.
        drawings: figures by name.
        sheet: the text of ``next_measurements.csv``; empty where nothing is proposed.
    """
    verdict = view.verdict
    figures = {d.name: d for d in drawings}
    wanted = (
        ("finding", "", _finding(view), True),
        ("faults", "Faults of the data", _faults(view), bool(verdict.blunders)),
        ("look", "What to look at on the machine", _look(view), bool(view.effects)),
        ("left", "What is left", left_data(view), bool(view.pattern)),
        ("controller", "Numbers for the controller", controller_data(verdict), True),
        ("judged", "Before and after", _judged(view, figures), True),
        ("causes", "Causes, and how sure they are", causes_data(view, figures), True),
        ("apart", "What each cause makes of the readings", apart_data(view, figures), True),
        ("next", "What to measure next", next_data(view, sheet), True),
        ("workspace", "The TCP over the workspace", _workspace(view, figures), True),
        ("values", "What was identified, with two kinds of sigma", _values(view), True),
        ("readings", "Readings and fit, setup by setup", readings_data(figures), True),
        ("unseen", "What these readings cannot see", _unseen(view), True),
        ("loop", "How this was computed", {**method_data(verdict.base, run), **_loop(view)}, True),
    )
    kept = [Section(template, title, data) for template, title, data, shown in wanted if shown]
    kept = [s for s in kept if s.template != "controller" or s.data["rows"]]
    kept = [s for s in kept if s.template != "apart" or s.data["effects"]]
    return render(Page("What is wrong with this machine", _subtitle(view, run), kept, run))


def _subtitle(view: View, run: Run) -> str:
    first = view.verdict.faulty or view.verdict.base
    count = sum(map(len, first.problem.campaigns))
    files = listed(i.file for i in run.inputs if i.role == "campaign")
    judges = [f"{i.file} {_JUDGES[i.role]}" for i in run.inputs if i.role != "campaign"]
    told = f"{files}: {count} readings in {first.problem.setup_count} setups"
    return "; ".join([told, *judges])


_JUDGES = {"holdout": "held out to judge by", "tcp": "measured at the TCP to judge by"}


# --- The finding ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Tile:
    """A figure before and after."""

    what: str
    before: str
    after: str
    unit: str


def tiles(view: View) -> list[Tile]:
    """What the finding gains, at a glance."""
    verdict = view.verdict
    before, after = verdict.base, verdict.fit
    first = before.nominal if not view.effects else before.scores
    found = [
        _tile("Readings", first.deviation_rms, after.scores.deviation_rms, "mm rms left"),
        _tile("Stations left out", first.cv_rms, after.scores.cv_rms, "mm rms"),
    ]
    if verdict.hold_out is not None:
        held = verdict.hold_out
        found.append(_tile("Readings held out", held.before_rms, held.after_rms, "mm rms"))
    if verdict.tcp is not None:
        errors = verdict.tcp["translation"]
        start = errors.before if view.effects else errors.nominal
        found.append(_tile("TCP as measured", start[0], errors.after[0], "mm mean error"))
    noise = after.problem.noise.typical * 1e3
    found.append(Tile("Noise of a reading", "", compact(noise, 2), "mm, sigma"))
    return found


def _tile(what: str, before: float, after: float, unit: str) -> Tile:
    places = decimals_for(min(before, after) * 1e3, 3)
    return Tile(what, f"{before * 1e3:.{places}f}", f"{after * 1e3:.{places}f}", unit)


def _finding(view: View) -> Data:
    verdict = view.verdict
    return {
        "sentence": headline(view),
        "word": verdict.word,
        "told": sentence(told(verdict.word).partition(": ")[2]),
        "tiles": tiles(view),
        "since": "joint offsets and leg lengths alone" if view.effects else "the nominal machine",
        "cautions": cautions(view),
        "warnings": [sentence(w) for w in view.warnings],
    }


def _faults(view: View) -> Data:
    verdict = view.verdict
    if verdict.faulty is None:
        return {"rows": []}
    rows = [
        {
            "kind": _KINDS[b.kind],
            "message": b.message,
            "with": f"{b.rms_with * 1e3:.4f}",
            "without": f"{b.rms_without * 1e3:.4f}",
        }
        for b in verdict.blunders
    ]
    with_them, without = verdict.faulty.scores.rms * 1e3, verdict.base.scores.rms * 1e3
    return {"rows": rows, "with": f"{with_them:.4f}", "without": f"{without:.4f}"}


def _look(view: View) -> Data:
    causes = [
        {
            "text": sentence(e.words),
            "rivals": [sentence(short(r.trial.candidate.name)) for r in e.effect.rivals],
        }
        for e in view.effects
    ]
    return {"causes": causes, "rows": look_at(view)}


# --- Before and after -----------------------------------------------------------------------


def _judged(view: View, figures: Mapping[str, Drawing]) -> Data:
    verdict = view.verdict
    stages = (verdict.base.nominal, verdict.base.scores, verdict.fit.scores)
    rows: list[tuple[str, ...]] = []
    for what, name in (
        ("readings: deviations, rms", "deviation_rms"),
        ("readings: residuals, rms", "rms"),
        ("readings: largest residual", "max"),
        ("stations left out, rms", "cv_rms"),
    ):
        rows.append((what, *_millimetres([getattr(s, name) for s in stages])))
    if verdict.hold_out is not None:
        held = verdict.hold_out
        rows.append(
            ("readings held out, rms", "", *_millimetres([held.before_rms, held.after_rms]))
        )
    for alignment, words in _ALIGNMENTS.items() if verdict.tcp else ():
        errors = verdict.tcp[alignment]  # type: ignore[index]
        pairs = (errors.nominal, errors.before, errors.after)
        means, most = (_millimetres([pair[k] for pair in pairs]) for k in (0, 1))
        cells = [f"{mean} / {top}" for mean, top in zip(means, most, strict=True)]
        rows.append((f"TCP, mean / largest, {words}", *cells))
    chances = [probability(s.lack_of_fit_p) for s in stages]
    rows.append(("probability of what is left by noise alone", *chances))
    inside = verdict.tcp["translation"].inside if verdict.tcp else float("nan")
    return {
        "rows": rows,
        "figure": whole(figures["residuals"]),
        "held": verdict.hold_out is not None,
        "own": listed([n.replace("_", " ") + "s" for n in verdict.own]),
        "tcp": verdict.tcp is not None,
        "inside": f"{inside:.0%}" if inside == inside else "",
        "several": bool(view.effects),
    }


_ALIGNMENTS = {
    "none": "as they are",
    "translation": "best shift removed",
    "rigid": "best rigid motion removed",
}


def _millimetres(figures: Sequence[float]) -> list[str]:
    places = max(decimals_for(min(figures) * 1e3, 4), 3)
    return [f"{v * 1e3:.{places}f}" for v in figures]


# --- The workspace, values, and what is not seen ----------------------------------------------


def _workspace(view: View, figures: Mapping[str, Drawing]) -> Data:
    space = view.workspace
    every = panels(figures["workspace"])
    rows = [
        ("predicted error of a controller that knows of no error", space.nominal),
        ("predicted error with offsets and lengths set right", space.before),
        ("95 % radius about that, everything else allowed", space.sure_before),
        ("95 % radius with all that was found put in, everything else allowed", space.sure),
        ("95 % radius with all that was found put in, if nothing else is wrong", space.alone),
    ]
    if not view.effects:  # then the base model is all that was found
        del rows[1:3]
    return {
        "rows": [
            (what, *_millimetres([float(v.mean()), float(v.max())])) for what, v in rows
        ],
        "groups": [every[k : k + 3] for k in range(0, len(every), 3)],
        "averaged": bool(view.verdict.spread),
        "feeds": _feeds(view),
    }  # fmt: skip


def _feeds(view: View) -> str:
    """The families that make most of the uncertainty of the TCP."""
    shares = view.uncertain_families
    return listed([f"{name.replace('_', ' ')} ({share:.0%})" for name, share in shares])


def _values(view: View) -> Data:
    verdict, fit = view.verdict, view.verdict.fit
    rows = []
    for name, tolerance in zip(fit.names, fit.problem.tolerance, strict=True):
        unit = family_of(name).unit
        sigma, alone = verdict.posterior.unknowns.sigmas[name] / unit.si, fit.sigmas[name] / unit.si
        places = decimals_for(sigma, most=9)
        rows.append(
            {
                "name": name,
                "value": signed(fit.values[name] / unit.si, places),
                "sigma": f"{sigma:.{places}f}",
                "alone": compact(alone, 2),
                "tolerance": compact(tolerance / unit.si),
                "unit": unit.name,
            }
        )
    shared = verdict.machine.spec.parameters
    freed = {family_of(n).name for n in fit.names}
    others = dict.fromkeys(
        family_of(n).name.replace("_", " ")
        for n, entry in shared.items()
        if family_of(n).name not in freed and entry.value
    )
    return {
        "rows": rows,
        "averaged": bool(verdict.spread),
        "others": listed(others),
        "dials": any(is_dial(n) for n in fit.names),
        "scale": f"{fit.sigma_scale:.2g}" if fit.sigma_scale > 1 else "",
    }


def _unseen(view: View) -> Data:
    by_family: dict[str, list[str]] = {}
    for name in view.verdict.invisible:
        by_family.setdefault(family_of(name).name, []).append(name.partition(".")[2])
    return {
        "sentences": weak_sentences(view.verdict.fit.weak),
        "families": [(f.replace("_", " "), listed(members)) for f, members in by_family.items()],
        "unexcited": [f.replace("_", " ") for f in view.unexcited],
    }


def _loop(view: View) -> Data:
    return {"seed": view.verdict.seed, "stopped": view.verdict.stopped}
