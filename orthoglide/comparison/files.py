"""A comparison as files: tables, figures and a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from orthoglide.comparison.comparing import slices
from orthoglide.comparison.rows import Row
from orthoglide.comparison.tables import (
    comparison_page,
    csv_table,
    legend,
    markdown_table,
    slice_figure,
)
from orthoglide.machine import Machine
from orthoglide.progress import Progress, Step, silent

_TITLE = "When the simplified model is good enough"


def comparison_files(
    machine: Machine,
    whole: Sequence[Row],
    rows: Sequence[Row],
    drawn: Sequence[Row] = (),
    progress: Progress = silent,
) -> dict[str, str]:
    """Return the files of a comparison's folder by name.

    Args:
        machine: that was compared.
        whole: rows of all that it was identified to have; may be empty.
        rows: rows of every effect at its tolerance.
        drawn: rows of which a figure is drawn, if the reduction cannot follow them.
        progress: called with each figure.
    """
    every = [
        (f"{machine.spec.title}: all it has, and each alone", whole),
        ("Every effect at its tolerance", rows),
    ]
    sections = [(name, some) for name, some in every if some]
    figures = dict(_figures(machine, drawn, progress))
    tables = "".join(f"\n## {name}\n\n{markdown_table(some)}" for name, some in sections)
    both = [row for _, some in sections for row in some]
    return {
        "table.csv": csv_table(both),
        "table.md": f"# {_TITLE}\n\n{legend(both)}\n{tables}",
        **{f"figures/{name}.svg": svg for name, svg in figures.items()},
        "compare.html": comparison_page(_TITLE, sections, list(figures.values())),
    }


def _figures(
    machine: Machine, rows: Sequence[Row], progress: Progress
) -> Iterator[tuple[str, str]]:
    """Yield drawings of the machine as identified, and of effects the reduction cannot follow."""
    for row in rows:
        progress(Step("computing", f"drawing {row.name}"))
        if not row.effect:
            yield row.name, slice_figure(machine.spec.title, slices(machine))
        elif not row.good_enough and row.fitted.max > 0:
            alone = machine.with_only({row.name: row.value})
            yield row.name, slice_figure(f"{row.name} at its tolerance", slices(alone))
