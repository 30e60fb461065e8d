"""Results for the terminal."""

from __future__ import annotations

import io
import shutil
import sys
from typing import TYPE_CHECKING

from orthoglide.report.rows import parameter_rows, score_rows
from orthoglide.report.wording import headline, weak_sentences

if TYPE_CHECKING:
    from rich.table import Table

    from orthoglide.identification import Estimate

_WIDTH = 100  # where the output goes to a file


def summary(estimate: Estimate) -> str:
    """What a person wants to see at the end of a run: the sentence, the tables, the remarks."""
    from rich.console import Console
    from rich.text import Text

    terminal = sys.stdout.isatty()
    width = min(shutil.get_terminal_size((_WIDTH, 24)).columns, 120) if terminal else _WIDTH
    stream = io.StringIO()
    console = Console(
        file=stream, width=width, force_terminal=terminal, highlight=False, legacy_windows=False
    )
    console.print(Text(headline(estimate), style="bold"))
    console.print()
    console.print(_parameters(estimate))
    console.print(_scores(estimate))
    for remark in (*estimate.warnings, *weak_sentences(estimate.weak)):
        console.print(Text(f"- {remark}"))
    return stream.getvalue().rstrip("\n")


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=k == 0)
    return table


def _parameters(estimate: Estimate) -> Table:
    table = _table("parameter", "value", "± sigma", "95 % interval", "tolerance", "unit")
    for row in parameter_rows(estimate):
        interval = f"{row.low} to {row.high}"
        table.add_row(row.name, row.value, row.sigma, interval, row.tolerance, row.unit)
    return table


def _scores(estimate: Estimate) -> Table:
    table = _table("", "before", "after")
    for row in score_rows(estimate):
        table.add_row(row.what, row.before, row.after)
    return table
