"""``compare``: the general mechanism against the simplified model, as tables and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orthoglide.cli.options import Names, load_machine, machine_option, out_option
from orthoglide.cli.progress import progress
from orthoglide.cli.writing import write_results
from orthoglide.progress import Progress, Step

if TYPE_CHECKING:
    from orthoglide.comparison import Row
    from orthoglide.machine import Machine


@click.command()
@machine_option
@out_option()
@click.option(
    "--effects",
    "names",
    type=Names(),
    default=(),
    metavar="NAME,...",
    help="Families or parameters to compare; the whole catalogue where absent.",
)
@click.option("--no-figures", is_flag=True, help="Tables only.")
@click.option("--quiet", is_flag=True, help="No progress and no table.")
def compare(
    machine_path: Path | None, out: Path, names: tuple[str, ...], no_figures: bool, quiet: bool
) -> None:
    """Tell when the simplified model is good enough: every effect at its tolerance.

    For each effect, and for the machine of --machine with all it was identified to have, the six
    parameters of the simplified model are fitted to the general mechanism; what is left is shown
    at the TCP over the workspace and in the readings of a sweep.
    """
    from orthoglide.comparison import worst_of_families
    from orthoglide.report.folder import check_folder

    check_folder(out)
    with progress(quiet) as step:
        files, rows, calibrated = _files(load_machine(machine_path), names, not no_figures, step)
        write_results(out, files)
    if not quiet:
        for row in (*calibrated[:1], *worst_of_families(rows)):
            answer = "will do" if row.good_enough else "will not do"
            click.echo(
                f"{row.name:<24} TCP {row.fitted.max * 1e6:8.2f} µm, readings "
                f"{row.reading_rms * 1e6:8.2f} µm rms: the reduction {answer}"
            )
        click.echo(f"written: {click.format_filename(out)}")


COMMANDS = (compare,)


def _files(
    machine: Machine, names: tuple[str, ...], draw: bool, step: Progress
) -> tuple[dict[str, str], tuple[Row, ...], tuple[Row, ...]]:
    from orthoglide.comparison import (
        LEGEND,
        compare_effects,
        compare_machine,
        comparison_page,
        csv_table,
        markdown_table,
        verdict_text,
        worst_of_families,
    )

    step(Step("computing", "comparing effects"))
    rows = compare_effects(machine, names or None)
    calibrated = compare_machine(machine) if any(machine.values.values()) else ()
    sections = [("Every effect at its tolerance", rows)]
    if calibrated:
        sections.insert(0, (f"{machine.spec.name}: all it has, and each alone", calibrated))
    figures = _figures(machine, worst_of_families(rows), bool(calibrated), step) if draw else {}
    text = f"{verdict_text()} {LEGEND}\n"
    for heading, some in sections:
        text += f"\n## {heading}\n\n{markdown_table(some)}"
    title = "When the simplified model is good enough"
    files = {
        "table.csv": csv_table([*calibrated, *rows]),
        "table.md": f"# {title}\n\n{text}",
        **{f"figures/{name}.svg": svg for name, svg in figures.items()},
        "compare.html": comparison_page(title, sections, list(figures.values())),
    }
    return files, rows, calibrated


def _figures(
    machine: Machine, worst: tuple[Row, ...], calibrated: bool, step: Progress
) -> dict[str, str]:
    """The machine as identified, and each family the reduction cannot follow, at its worst."""
    from dataclasses import replace

    from orthoglide.comparison import slice_figure, slices
    from orthoglide.machine import Machine

    figures = {}
    if calibrated:
        step(Step("computing", "drawing the machine"))
        figures["machine"] = slice_figure(machine.spec.name, slices(machine))
    plain = Machine(replace(machine.spec, parameters={}))
    for row in worst:
        if not row.good_enough and row.fitted.max > 0:
            step(Step("computing", f"drawing {row.name}"))
            planes = slices(plain.with_parameters({row.name: row.value}))
            figures[row.name] = slice_figure(f"{row.name} at its tolerance", planes)
    return figures
