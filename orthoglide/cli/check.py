"""``check``: what changed between two states of a machine."""

from __future__ import annotations

from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.progress import progress
from orthoglide.cli.terminal import say, tell, wrapped
from orthoglide.cli.writing import write_results
from orthoglide.progress import Step
from orthoglide.text import csv_text, text_width


@click.command()
@click.argument("old", type=opt.PATH)
@click.argument("new", type=opt.PATH)
@opt.machine()
@opt.out_or_nothing
@opt.noise("from machine file, rows or repeats")
@opt.seed
@opt.quiet
def check(
    old: Path,
    new: Path,
    machine_path: Path | None,
    effects_file: Path | None,
    out: Path | None,
    noise: float | None,
    seed: int,
    quiet: bool,
) -> None:
    """Tell what changed between two states of a machine: after a repair, or a year.

    OLD and NEW are campaigns, or results (their folder or result.json), of which the readings are
    taken.
    """
    with progress(quiet) as step:
        step(Step("reading"))
        from orthoglide.checking import COLUMNS, check as compare, states_of
        from orthoglide.cli.changes import changes_page, changes_text
        from orthoglide.effects.loading import load_effects
        from orthoglide.fit import twice

        effects = load_effects(effects_file)
        given = None if machine_path is None else opt.load_machine(machine_path, effects_file)
        states = states_of(old, new, given, effects)
        noise = states.noise if noise is None else noise
        found = compare(
            states.old, states.new, states.machine, noise=noise, seed=seed, progress=step
        )
        told = wrapped(changes_text(found), text_width())
        if out is not None:
            from orthoglide.report import report_files

            files = report_files(found.verdict, step)
            rows = (
                (d.parameter, *(c.replace("−", "-") for c in d.cells)) for d in found.differences
            )
            table = csv_text(("parameter", *COLUMNS), rows)
            write_results(out, files | {"changes.csv": table, "check.html": changes_page(found)})
    for warning in twice((*states.old, *states.new)):
        say(f"warning: {warning}", err=True)
    report = "" if out is None else f"\n\nReport: {click.format_filename(out / 'check.html')}"
    tell(f"{told}{report}", found.line, quiet, out is not None)
