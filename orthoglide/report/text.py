"""Results for the terminal."""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING

from orthoglide.report.rows import parameter_rows, score_rows
from orthoglide.report.wording import headline, weak_sentences

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from orthoglide.fit import Estimate

_WIDTH = 100  # where the output goes to a file


def summary(estimate: Estimate) -> str:
    """What a person wants to see at the end of a run: the sentence, the tables, the remarks."""
    from rich.text import Text

    remarks = [Text(f"- {r}") for r in (*estimate.warnings, *weak_sentences(estimate.weak))]
    head = Text(f"{headline(estimate)}\n", style="bold")
    return console_text([head, _parameters(estimate), _scores(estimate), *remarks])


def console_text(parts: Iterable[RenderableType]) -> str:
    """Parts one below the other, as wide as the terminal."""
    from rich.console import Console

    terminal = sys.stdout.isatty()
    width = min(shutil.get_terminal_size((_WIDTH, 24)).columns, 120) if terminal else _WIDTH
    stream = io.StringIO()
    console = Console(
        file=stream, width=width, force_terminal=terminal, highlight=False, legacy_windows=False
    )
    for part in parts:
        console.print(part)
    return stream.getvalue().rstrip("\n")


def table(*columns: str) -> Table:
    """A table whose first column is a name and whose others are numbers."""
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        made.add_column(column, justify="left" if k == 0 else "right", no_wrap=k == 0)
    return made


def _parameters(estimate: Estimate) -> Table:
    shown = table("parameter", "value", "± sigma", "95 % interval", "tolerance", "unit")
    for row in parameter_rows(estimate):
        interval = f"{row.low} to {row.high}"
        shown.add_row(row.name, row.value, row.sigma, interval, row.tolerance, row.unit)
    return shown


def _scores(estimate: Estimate) -> Table:
    shown = table("", "before", "after")
    for row in score_rows(estimate):
        shown.add_row(row.what, row.before, row.after)
    return shown
