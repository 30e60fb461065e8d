"""A closed loop's results for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orthoglide.numerals import compact, decimals_for, probability, signed
from orthoglide.report.causes import short
from orthoglide.report.text import console_text, table
from orthoglide.report.verdict_wording import cautions, headline, told
from orthoglide.report.wording import sentence

if TYPE_CHECKING:
    from rich.table import Table

    from orthoglide.report.verdict_view import View


def verdict_summary(view: View, ranked: bool = False) -> str:
    """What a person wants to see at the end of a run.

    Args:
        view: of the verdict.
        ranked: with all causes that were tried.
    """
    from rich.text import Text

    verdict = view.verdict
    parts: list[Text | Table] = [Text(headline(view), style="bold")]
    parts.append(Text(f"Verdict {told(verdict.word)}.\n"))
    parts += [Text(f"- data: {b.message}") for b in verdict.blunders]
    parts += [Text(f"- changed: {c.message}") for c in verdict.changed]
    if view.effects:
        parts.append(_causes(view))
    if ranked and view.tried:
        parts.append(_tried(view))
    parts.append(_scores(view))
    parts += [
        Text(f"- {line}") for line in (f"The search ended: {verdict.stopped}.", *view.pattern)
    ]
    parts += [Text(f"- {sentence(w)}") for w in view.warnings]
    parts += [Text(f"Warning: {caution}", style="bold") for caution in cautions(view)]
    return console_text(parts)


def _causes(view: View) -> Table:
    shown = table("cause", "probability", "p of its name", "in words")
    for explained in view.effects:
        effect = explained.effect
        shown.add_row(
            effect.name, f"{effect.probability:.2f}", probability(effect.naming_p), explained.words
        )
        for rival in effect.rivals:
            name = rival.trial.candidate.name
            shown.add_row(f"or {name}", f"{rival.weight:.2f}", "", short(name))
    return shown


def _tried(view: View) -> Table:
    shown = table("tried", "round", "evidence", "p alone", "left out, mm", "plausible")
    for tried in view.tried:
        shown.add_row(
            tried.name,
            str(tried.round),
            signed(tried.evidence, 1),
            probability(tried.p_value),
            compact(tried.cv_rms * 1e3, 3),
            "yes" if tried.plausible else "no",
        )
    return shown


def _scores(view: View) -> Table:
    verdict = view.verdict
    shown = table("mm", "nominal", "before", "after")
    nominal, before, after = verdict.base.nominal, verdict.base.scores, verdict.fit.scores
    for what, name in (("deviations, rms", "deviation_rms"), ("stations left out", "cv_rms")):
        figures = [getattr(s, name) * 1e3 for s in (nominal, before, after)]
        shown.add_row(what, *_millimetres(figures))
    if verdict.hold_out is not None:
        held = verdict.hold_out
        figures = [held.before_rms * 1e3, held.after_rms * 1e3]
        shown.add_row("readings held out, rms", "", *_millimetres(figures))
    if verdict.tcp is not None:
        errors = verdict.tcp["translation"]
        figures = [e[0] * 1e3 for e in (errors.nominal, errors.before, errors.after)]
        shown.add_row("TCP, mean, best shift removed", *_millimetres(figures))
    return shown


def _millimetres(figures: list[float]) -> list[str]:
    places = max(decimals_for(min(figures), 4), 3)
    return [f"{v:.{places}f}" for v in figures]
