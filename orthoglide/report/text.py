"""A result for the terminal."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from orthoglide.numerals import compact, hundredths, signed
from orthoglide.report.phrases import (
    WHICHEVER,
    sentence,
    unshown_words,
    unvaried_words,
    weak_sentences,
)
from orthoglide.report.rows import parameter_rows, score_rows
from orthoglide.report.wording import MEANINGS, headline, too_early
from orthoglide.result.firmware import UNSEEN, Unseen
from orthoglide.text import is_terminal, text_width

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from orthoglide.klipper import Corrections
    from orthoglide.result import Result
    from orthoglide.result.actions import Action


def summary(result: Result, ranked: bool = False) -> str:
    """What a person wants to see at the end of a run.

    Args:
        result: what was found.
        ranked: with all causes that were tried.
    """
    from rich.text import Text

    parts: list[Text | Table] = [
        Text(headline(result), style="bold"),
        Text(f"Verdict {result.word}: {MEANINGS[result.word]}.\n"),
    ]
    parts += [Text(f"- data: {b.message}") for b in result.blunders]
    if result.effects:
        parts.append(_causes(result))
    if result.located:
        parts.append(_located(result))
    if result.alone:
        parts.append(_alone(result))
    if ranked and result.candidates:
        parts.append(_tried(result))
    searches = result.request.searches
    parts += [_scores(result)] if searches else [_parameters(result), _scores(result)]
    remarks = [f"The search ended: {result.stopped}."] if searches else []
    remarks += [] if searches else weak_sentences(result.after.weak, result.catalogue)
    hidden = (unshown_words(result), unvaried_words(result))
    remarks += [*result.pattern, *(sentence(w) for w in (*hidden, *result.warnings) if w)]
    parts += [Text(f"- {line}") for line in remarks]
    parts += [Text(line) for line in to_do(result)]
    if result.firmware is not None and result.firmware.corrections is not None:
        parts.append(_firmware(result.firmware.corrections))
        if why := too_early(result):
            parts.append(Text(f"Do not enter these numbers yet: {why}.", style="bold"))
        parts += [Text(line) for line in _unseen(result.firmware.unseen)]
    parts += [Text(f"Warning: {caution}", style="bold") for caution in result.cautions]
    return console_text(parts)


def _unseen(found: Sequence[Unseen]) -> Iterator[str]:
    if found:
        yield f"- {UNSEEN}"
    yield from (f"   - {sentence(one.brief)}" for one in found)


def to_do(result: Result) -> Iterator[str]:
    """What to do, a line each, with what to look at below."""
    for k, action in enumerate(result.actions, start=1):
        yield f"{k}. {sentence(action.words)[:-1]}{_gain(action)}."
        for one in action.options:
            told = (f"{one.words}: look at {one.look_at}", one.confirm)
            yield f"   - {' '.join(sentence(text) for text in told if text)}"


def _gain(action: Action) -> str:
    """What it gains, in brackets; empty where nothing."""
    if not action.gain > 0:
        return ""
    mean = f" {WHICHEVER}" if action.whichever else ""
    return f" (gains {compact(action.gain * 1e3, 2)} mm at the tool{mean})"


def console_text(parts: Iterable[RenderableType]) -> str:
    """Parts one below the other, as wide as the terminal."""
    from rich.console import Console

    terminal, width = is_terminal(), min(text_width(), 120)
    stream = io.StringIO()
    console = Console(
        file=stream, width=width, force_terminal=terminal, highlight=False, legacy_windows=False,
        markup=False, emoji=False,
    )  # fmt: skip
    for part in parts:
        console.print(part)
    return stream.getvalue().rstrip("\n")


def _table(*columns: str) -> Table:
    """A table whose first column does not wrap and whose others are numbers, or in words."""
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        left = k == 0 or column in ("cause", "if one alone", "in words")
        made.add_column(column, justify="left" if left else "right", no_wrap=k == 0)
    return made


def _parameters(result: Result) -> Table:
    shown = _table("parameter", "value", "± sigma", "95 % interval", "tolerance", "unit")
    for row in parameter_rows(result):
        interval = f"{row.low} to {row.high}"
        shown.add_row(row.name, row.value, row.sigma, interval, row.tolerance, row.unit)
    return shown


def _causes(result: Result) -> Table:
    shown = _table("probability", "cause")
    for cause in result.effects:
        names = "\nor ".join(f"{one.words}\n{one.name}" for one in (cause.chosen, *cause.same))
        shown.add_row(hundredths(cause.together), names)
        for rival in cause.rivals:
            shown.add_row(hundredths(rival.probability), f"or {rival.words}\n{rival.name}")
    return shown


def _alone(result: Result) -> Table:
    shown = _table("probability", "if one alone")
    for one in result.alone:
        shown.add_row(hundredths(one.probability), f"{one.words}\n{one.name}")
    return shown


def _located(result: Result) -> Table:
    shown = _table("place", "probability", "size", "in words")
    for found in result.located:
        for k, c in enumerate(found.members):
            name = f"or {c.place.name}" if k else c.place.name
            shown.add_row(name, f"{c.probability:.2f}", c.size_words, c.place.words)
    return shown


def _tried(result: Result) -> Table:
    shown = _table("weighed", "evidence", "probability")
    for tried in result.candidates:
        shown.add_row(tried.name, signed(tried.evidence, 1), f"{tried.probability:.2f}")
    return shown


def _firmware(found: Corrections) -> Table:
    shown = _table("printer.cfg", "old", "new")
    for row in found.rows:
        shown.add_row(*row)
    return shown


def _scores(result: Result) -> Table:
    shown = _table("", "nominal", "before", "after")
    for row in score_rows(result):
        shown.add_row(*row)
    return shown
