"""``compare``: the general mechanism against the simplified model, as tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

import orthoglide.cli.options as opt
from orthoglide.cli.progress import progress
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_results
from orthoglide.progress import Progress, Step

if TYPE_CHECKING:
    from orthoglide.comparison import Row
    from orthoglide.machine import Machine

_TITLE = "When the simplified model is good enough"


@click.command()
@opt.machine()
@opt.out()
@click.option("--effects", "names", type=opt.Names(), default=(), metavar="NAME,...",
              help="Effects or parameters to compare; the whole catalogue where absent.",
              )  # fmt: skip
@click.option("--no-figures", is_flag=True, help="Tables only.")
@click.option("--quiet", is_flag=True, help="No progress and no table.")
def compare(
    machine_path: Path | None,
    effects_file: Path | None,
    out: Path,
    names: tuple[str, ...],
    no_figures: bool,
    quiet: bool,
) -> None:
    """Tell when the simplified model is good enough: every effect at its tolerance.

    For each effect, and for the machine of --machine with all it was identified to have, the six
    parameters of the simplified model are fitted to the general mechanism; what is left is shown
    at the TCP over the workspace and, on an Orthoglide, in the readings of a sweep.
    """
    from orthoglide.comparison import compare_effects, compare_machine, worst_by_effect

    machine = opt.load_machine(machine_path, effects_file)
    with progress(quiet) as step:
        step(Step("computing", "comparing effects"))
        rows = compare_effects(machine, names or None)
        whole = compare_machine(machine) if any(machine.values.values()) else ()
        worst = (*whole[:1], *worst_by_effect(rows))
        figures = {} if no_figures else dict(_figures(machine, worst, step))
        sections = [
            (f"{machine.spec.title}: all it has, and each alone", whole),
            ("Every effect at its tolerance", rows),
        ]
        told = "\n".join(map(str, worst))
        write_results(out, _files([(name, some) for name, some in sections if some], figures))
    if not quiet:
        say(f"{told}\nwritten: {click.format_filename(out)}")


def _files(sections: list[tuple[str, tuple[Row, ...]]], figures: dict[str, str]) -> dict[str, str]:
    from orthoglide.comparison.tables import comparison_page, csv_table, legend, markdown_table

    every = [row for _, rows in sections for row in rows]
    tables = "".join(f"\n## {name}\n\n{markdown_table(rows)}" for name, rows in sections)
    return {
        "table.csv": csv_table(every),
        "table.md": f"# {_TITLE}\n\n{legend(every)}\n{tables}",
        **{f"figures/{name}.svg": svg for name, svg in figures.items()},
        "compare.html": comparison_page(_TITLE, sections, list(figures.values())),
    }


def _figures(machine: Machine, rows: tuple[Row, ...], step: Progress) -> Iterator[tuple[str, str]]:
    """The machine as identified, and each effect the reduction cannot follow, at its worst."""
    from orthoglide.comparison import slices
    from orthoglide.comparison.tables import slice_figure

    for row in rows:
        step(Step("computing", f"drawing {row.name}"))
        if not row.effect:
            yield row.name, slice_figure(machine.spec.title, slices(machine))
        elif not row.good_enough and row.fitted.max > 0:
            alone = machine.with_only({row.name: row.value})
            yield row.name, slice_figure(f"{row.name} at its tolerance", slices(alone))
