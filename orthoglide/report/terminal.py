"""A result for the terminal."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Literal

from orthoglide.numerals import probability
from orthoglide.report.claims import claims
from orthoglide.report.page import reason_not_to_enter
from orthoglide.report.rows import (
    POSSIBLE_TITLES,
    parameter_rows,
    possible_rows,
    probable_candidates,
    score_rows,
    weak_sentences,
)
from orthoglide.report.sentences import (
    further_warnings,
    gain_words,
    headline,
    meaning,
    no_action_text,
    undetected_text,
    unvaried_words,
)
from orthoglide.result import Result
from orthoglide.text import is_terminal, lower_first, sentence, text_width

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table
    from rich.text import Text


_MAX_SUSPECTS = 3  # causes listed below an action
_TEXT_COLUMNS = ("cause", "if it is the only cause", "possible cause", "considered")


def summary(
    result: Result,
    all_candidates: bool = False,
    omitted_kind: str = "",
    with_paths: Callable[[str], str] = str,
) -> str:
    """Return the result for the terminal, without warnings of ``omitted_kind``; ``with_paths``
    returns an advised command with the paths of its files.
    """
    from rich.text import Text

    parts: list[Text | Table] = [
        Text(headline(result), style="bold"),
        Text(f"Verdict {result.word}: {meaning(result)}.\n"),
    ]
    parts += [Text(f"- data: {b.message}") for b in result.blunders]
    parts += _tables(result, all_candidates)
    remarks = [] if result.searches else weak_sentences(result.weak, result.catalogue)
    hidden = (undetected_text(result), unvaried_words(result))
    warnings = (*hidden, *(w for w in further_warnings(result) if w.kind != omitted_kind))
    remarks += [sentence(w) for w in warnings if w]
    parts += [Text(f"- {line}") for line in remarks]
    parts += [Text(with_paths(line)) for line in action_lines(result)]
    parts += _new_zeros(result)
    if (corrections := result.corrections) is not None:
        advice, reason = reason_not_to_enter(result)
        if not advice:
            parts += table((corrections.file, "old", "new"), corrections.rows)
        title = "residual of the firmware's equations, rms, mm"
        parts += table((title, "old", "tried" if advice else "new"), corrections.left)
        if advice:
            parts.append(Text(f"{advice}: {reason}.", style="bold"))
    parts += [Text(f"Warning: {caution}", style="bold") for caution in result.further_cautions]
    return console_text(parts)


def _new_zeros(result: Result) -> Iterator[Text | Table]:
    """Yield the new zeros with a worked example and a check, if they are to be entered."""
    from rich.text import Text

    if result.firmware is not None or all(one.kind != "zeros" for one in result.actions):
        return
    numbers = result.numbers
    axis, *old_and_new = numbers.zeros.titles
    yield from table((axis, *(f"{title}, mm" for title in old_and_new)), numbers.zeros.rows)
    how, readings = numbers.check
    yield from map(Text, filter(None, (numbers.worked, how)))
    for reading in readings[:1]:
        yield Text(f"- {reading} orthoglide export gives such a reading for every axis.")


def action_lines(result: Result) -> Iterator[str]:
    """Yield the actions, a line each, with the parts to look at below."""
    yield from filter(None, [no_action_text(result)])
    for k, action in enumerate(result.actions, start=1):
        gain = ""
        if action.gain > 0:
            gain = f" ({''.join(gain_words(action, result.firmware is not None))})"
        yield f"{k}. {sentence(action.words)[:-1]}{gain}."
        for suspect in action.options[:_MAX_SUSPECTS]:
            texts = (f"{suspect.words}: look at {suspect.look_at}", suspect.confirm)
            yield f"   - {' '.join(sentence(text) for text in texts if text)}"
        if action.options[_MAX_SUSPECTS:]:
            yield "   - Test each of the other causes above in the same way."


def console_text(parts: Iterable[RenderableType]) -> str:
    """Return the parts one below the other, as wide as the terminal."""
    from rich.console import Console

    stream = io.StringIO()
    console = Console(
        file=stream, width=_width(), force_terminal=is_terminal(), highlight=False,
        legacy_windows=False, markup=False, emoji=False,
    )  # fmt: skip
    for part in parts:
        console.print(part)
    return stream.getvalue().rstrip("\n")


def _width() -> int:
    return min(text_width(), 120)


def _tables(result: Result, all_candidates: bool) -> Iterator[Table]:
    """Yield the tables of causes, candidates, parameters and scores that are not empty."""
    shares = []
    for claim in claims(result)[: len(result.effects) + len(result.located)]:
        same = "".join(f"\nor {lower_first(one.words)}" for one in claim.same)
        shares.append((probability(claim.first.probability), f"{claim.first.words}{same}"))
        rivals = ((probability(r.probability), f"or {lower_first(r.words)}") for r in claim.rivals)
        shares += rivals
    yield from table(("share of its finding", "cause"), shares)
    alone = ((probability(one.probability), one.words) for one in result.alone)
    yield from table(("probability", "if it is the only cause"), alone)
    yield from table(POSSIBLE_TITLES, possible_rows(result))
    candidates = probable_candidates(result) if all_candidates else ()
    considered = ((probability(c.probability), c.words or c.name) for c in candidates)
    yield from table(("probability of being active", "considered"), considered)
    parameters = [] if result.searches else parameter_rows(result)
    columns = ("parameter", "value", "± sigma", "95 % interval", "tolerance")
    yield from table(columns, (
        (f"{p.name}, {p.unit}", p.value, p.sigma, f"{p.low} to {p.high}", p.tolerance)
        for p in parameters
    ))  # fmt: skip
    yield from table(("", "nominal", "before", "after"), score_rows(result))


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[Table]:
    """Yield a table for the terminal if there are rows; lines break at spaces, not in numbers."""
    from rich import box
    from rich.table import Table

    lines = [columns, *rows]
    if len(lines) == 1:
        return
    console_table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for k, cells in enumerate(zip(*lines, strict=True)):
        justify: Literal["left", "right"] = (
            "left" if not k or columns[k] in _TEXT_COLUMNS else "right"
        )
        longest_word = max(map(len, " ".join(cells).split()), default=0)
        least = min(longest_word, _width() // len(columns) - 2)  # two spaces between columns
        console_table.add_column(columns[k], justify=justify, min_width=least, overflow="fold")
    for row in lines[1:]:
        console_table.add_row(*row)
    yield console_table
