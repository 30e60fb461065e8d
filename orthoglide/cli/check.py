"""``check``: what changed between two states of a machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

import orthoglide.cli.options as opt
from orthoglide.cli.progress import progress
from orthoglide.cli.rerun import read_result
from orthoglide.cli.terminal import say, tell, wrapped
from orthoglide.cli.writing import write_results
from orthoglide.errors import InputError
from orthoglide.progress import Step
from orthoglide.text import text_width

if TYPE_CHECKING:
    from orthoglide.checking import Check
    from orthoglide.effects import Effect
    from orthoglide.machine import Machine
    from orthoglide.observations import Readings


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
    from orthoglide.report.folder import check_folder

    if out is not None:
        check_folder(out)
    with progress(quiet) as step:
        step(Step("reading"))
        from orthoglide.checking import check as compare
        from orthoglide.cli.changes import changes_page, changes_text
        from orthoglide.effects.loading import load_effects
        from orthoglide.fit.copies import twice

        effects = load_effects(effects_file)
        given = None if machine_path is None else opt.load_machine(machine_path, effects_file)
        machine, before = _readings(old, given, None, effects)
        other, after = _readings(new, given, machine, effects)
        _check_numbers(old, machine, new, other)
        if other.geometry != machine.geometry:
            raise InputError(
                f"{old.name} and {new.name} are of machines of different dimensions "
                f"({machine.spec.title}; {other.spec.title}): check compares two states of one; "
                f"where the file was corrected since, and no number that the controller counts "
                f"with, give it for both with --machine; what other numbers of a controller left, "
                f"close-loop tells from the new readings"
            )
        found = compare(before, after, machine, noise=noise, seed=seed, progress=step)
        told = wrapped(changes_text(found), text_width())
        if out is not None:
            from orthoglide.report import report_files

            files = report_files(found.verdict, step)
            made = {"changes.csv": _table(found), "check.html": changes_page(found)}
            write_results(out, {**files, **made})
    for warning in twice((*before, *after)):
        say(f"warning: {warning}", err=True)
    report = "" if out is None else f"\n\nReport: {click.format_filename(out / 'check.html')}"
    tell(f"{told}{report}", found.line, quiet, out is not None)


def _readings(
    path: Path, given: Machine | None, otherwise: Machine | None, effects: tuple[Effect, ...]
) -> tuple[Machine, tuple[Readings, ...]]:
    """The campaigns of a file of readings, or of a result; and the machine that they were read by:
    the one given, else a result's own, of other files that of the other state.
    """
    from orthoglide.fit import readings_of
    from orthoglide.machine import Machine
    from orthoglide.request import request_of

    if path.suffix == ".toml":
        raise InputError(
            f"{path} is a machine file, which has no readings: give the result.json beside it, or "
            f"the campaign"
        )
    if path.is_dir():
        path = path / "result.json"
    if path.suffix == ".json":
        request = request_of(read_result(path), str(path), effects)
        if given is not None:
            _check_numbers(path, request.machine, Path(given.spec.file or "the machine"), given)
        return given or request.machine, request.readings
    machine = given or otherwise or Machine.nominal().with_effects(effects)
    return machine, readings_of([path], machine)


def _check_numbers(one: Path, machine: Machine, two: Path, other: Machine) -> None:
    """Refuses two imports with other numbers of the firmware: equal commands are no equal heights
    of the carriages, and what was pasted would be told as what changed.
    """
    marks = machine.spec.firmware, other.spec.firmware
    if all(marks) and marks[0] != marks[1]:
        raise InputError(
            f"{one} was imported with other numbers of the firmware ({marks[0]}) than {two} "
            f"({marks[1]}): check compares two states under the same numbers; what the numbers "
            f"changed between the visits left, close-loop tells from the new readings with the "
            f"machine.toml of their import"
        )


def _table(found: Check) -> str:
    from orthoglide.checking import COLUMNS
    from orthoglide.text import csv_text

    rows = ((d.parameter, *(c.replace("−", "-") for c in d.cells)) for d in found.differences)
    return csv_text(("parameter", *COLUMNS), rows)
