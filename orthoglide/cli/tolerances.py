"""``tolerances``: which tolerances a wanted error of the tool needs."""

from __future__ import annotations

from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import need
from orthoglide.cli.terminal import say
from orthoglide.errors import InputError

_LEAST, _MOST = 1e-6, 1e3  # millimetres, that anybody wants of a tool


@click.command()
@click.option("--tcp", "tcp_mm", type=float, required=True, metavar="MM",
              help="Mean error wanted of the tool, over the workspace after the best "
                   "translation.")  # fmt: skip
@opt.machine()
@click.option("--calibrated-by", "sheet", type=opt.PATH, metavar="SHEET.csv",
              help="Also if every machine is calibrated by this sheet.")  # fmt: skip
@opt.noise()
def tolerances(
    tcp_mm: float,
    machine_path: Path | None,
    effects_file: Path | None,
    sheet: Path | None,
    noise: float | None,
) -> None:
    """Tell how large tolerances may be for a wanted error of the tool, and which cost most.

    Linear, from the tolerances of the machine file taken as standard deviations: all scaled alike,
    and shared out so that every effect makes the same part of the error.
    """
    from orthoglide.planning import needed_tolerances

    need("noise", "sheet")
    if not _LEAST <= tcp_mm <= _MOST:
        raise InputError(
            f"--tcp must be a positive number of millimetres from {_LEAST:g} to {_MOST:g}, "
            f"not {tcp_mm:g}"
        )
    machine = opt.load_machine(machine_path, effects_file)
    answers = [needed_tolerances(machine, tcp_mm * 1e-3)]
    if sheet is not None:
        read = opt.dial_sheet(sheet, machine, "name one of dials on legs")
        answers.append(needed_tolerances(machine, tcp_mm * 1e-3, read, noise))
    say("\n\n".join(map(str, answers)), needed=True)
