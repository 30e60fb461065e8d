"""``check``: what changed between two states of a machine."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orthoglide.cli.options import PATH, load_machine, machine_option, noise_metres, out_option
from orthoglide.cli.progress import progress
from orthoglide.cli.rerun import read_result
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_results
from orthoglide.errors import InputError
from orthoglide.numerals import plain
from orthoglide.progress import Step

if TYPE_CHECKING:
    from orthoglide.checking import Check
    from orthoglide.machine import Machine
    from orthoglide.observations import Readings

_STYLE = "body{font:1rem/1.5 sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem}" \
         "table{border-collapse:collapse}td,th{padding:.2rem .8rem;text-align:left}"  # fmt: skip


@click.command()
@click.argument("old", type=PATH)
@click.argument("new", type=PATH)
@machine_option
@out_option(required=False, help="Folder for the results; nothing is written where absent.")
@click.option(
    "--noise",
    "noise_mm",
    type=float,
    metavar="MM",
    help="Standard deviation of one reading; else from machine file, rows or repeats.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of all random draws.")
@click.option("--quiet", is_flag=True, help="No progress and no tables.")
def check(
    old: Path,
    new: Path,
    machine_path: Path | None,
    out: Path | None,
    noise_mm: float | None,
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
    noise = noise_metres(noise_mm)
    with progress(quiet) as step:
        step(Step("reading"))
        from orthoglide.checking import check as compare

        machine = None if machine_path is None else load_machine(machine_path)
        machine, before = _readings(old, machine)
        machine, after = _readings(new, machine)
        found = compare(before, after, machine, noise=noise, seed=seed, progress=step)
        told = _told(found)
        if out is not None:
            from orthoglide.report import report_files

            files = report_files(found.verdict, step)
            write_results(out, {**files, "changes.csv": _table(found), "check.html": _page(found)})
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
        return machine or request.machine, (*request.campaigns, *request.tool)
    machine = machine or Machine.nominal()
    return machine, readings_of([path], machine)


def _told(found: Check) -> str:
    from orthoglide.report.wording import headline

    numbers, verdict = found.verdict.numbers, found.verdict
    checks = [str(c) for c in numbers.checks]
    now, zeros = (f"{numbers.expected[k].shape * 1e3:.3f} mm" for k in ("now", "zeros"))
    parts = [*(f"- {sentence}." for sentence in found.sentences), "", "What is left now:",
             headline(replace(verdict, changed=())),  # said above, parameter by parameter
             f"The tool is {now} off on average over the workspace, a shift of the whole left out; "
             f"{zeros} once the zeros are right."]  # fmt: skip
    parts += [f"Caution: {text}" for text in verdict.cautions]
    if checks:
        zero = ", ".join(f"{d.leg} {plain(d.new_zero * 1e3, 3)}" for d in numbers.drives)
        parts += ["", f"Once new zeros are entered ({zero} mm), these readings prove their signs:"]
        parts += [f"- {text}" for text in checks]
    return "\n".join(parts)


def _table(found: Check) -> str:
    from orthoglide.checking import COLUMNS
    from orthoglide.text import csv_text

    rows = ((d.parameter, *(c.replace("−", "-") for c in d.cells)) for d in found.differences)
    return csv_text(("parameter", *COLUMNS), rows)


def _page(found: Check) -> str:
    from orthoglide.checking import COLUMNS
    from orthoglide.frames import html_table

    cells = [(d.parameter, *d.cells) for d in found.differences]
    columns = dict(zip(("parameter", *COLUMNS), zip(*cells, strict=True), strict=True))
    title = f"What changed: {', '.join(found.old)} and {', '.join(found.new)}"
    told = "".join(f"<p>{escape(line)}</p>" for line in _told(found).split("\n") if line)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>"
        f"<h1>{escape(title)}</h1>{told}{html_table('Both states', columns, len(cells))}"
        '<p><a href="report.html">The report of all readings together</a></p></body></html>\n'
    )
