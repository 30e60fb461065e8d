"""``check``: what changed between two states of a machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

import orthoglide.cli.options as opt
from orthoglide.cli.progress import progress
from orthoglide.cli.rerun import read_result
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_results
from orthoglide.errors import InputError
from orthoglide.progress import Step

if TYPE_CHECKING:
    from orthoglide.checking import Check
    from orthoglide.machine import Machine
    from orthoglide.observations import Readings


@click.command()
@click.argument("old", type=opt.PATH)
@click.argument("new", type=opt.PATH)
@opt.machine
@opt.out_or_nothing
@opt.noise("from machine file, rows or repeats")
@opt.seed
@opt.quiet
def check(
    old: Path,
    new: Path,
    machine_path: Path | None,
    out: Path | None,
    noise: float | None,
    seed: int,
    quiet: bool,
) -> None:
    """Tell what changed between two states of a machine: after a repair, or a year.

    OLD and NEW are campaigns, or results (result.json), of which the readings are taken.
    """
    from orthoglide.report.folder import check_folder

    if out is not None:
        check_folder(out)
    if seed < 0:
        raise InputError(f"--seed must be 0 or more, not {seed}")
    with progress(quiet) as step:
        step(Step("reading"))
        from orthoglide.checking import check as compare
        from orthoglide.cli.changes import changes_page, changes_text

        machine = None if machine_path is None else opt.load_machine(machine_path)
        machine, before = _readings(old, machine)
        machine, after = _readings(new, machine)
        found = compare(before, after, machine, noise=noise, seed=seed, progress=step)
        told = changes_text(found)
        if out is not None:
            from orthoglide.report import report_files

            files = report_files(found.verdict, step)
            made = {"changes.csv": _table(found), "check.html": changes_page(found)}
            write_results(out, {**files, **made})
    if not quiet:
        say(told, needed=out is None)
        if out is not None:
            say(f"\nReport: {click.format_filename(out / 'check.html')}")


COMMANDS = (check,)


def _readings(path: Path, machine: Machine | None) -> tuple[Machine, tuple[Readings, ...]]:
    """The campaigns of a file of readings, or of a result; and the machine that they were read by:
    the one given, else the result's.
    """
    from orthoglide.fit import readings_of
    from orthoglide.machine import Machine
    from orthoglide.request import request_of

    if path.suffix == ".json":
        request = request_of(read_result(path), str(path))
        return machine or request.machine, request.readings
    machine = machine or Machine.nominal()
    return machine, readings_of([path], machine)


def _table(found: Check) -> str:
    from orthoglide.checking import COLUMNS
    from orthoglide.text import csv_text

    rows = ((d.parameter, *(c.replace("−", "-") for c in d.cells)) for d in found.differences)
    return csv_text(("parameter", *COLUMNS), rows)
