"""``compensate`` and ``export``: a calibrated machine at work."""

from __future__ import annotations

from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_results, write_texts
from orthoglide.errors import FileError, InputError, UnreachableError

_MACHINE = opt.machine(required=True, help="Machine file, such as calibrated.toml.")
_FORCE = click.option(
    "--force", is_flag=True, help="Even where the verdict says not to act on the numbers."
)


@click.command()
@click.argument("path", type=opt.PATH, metavar="PATH.csv")
@_MACHINE
@click.option("--out", type=opt.PATH, required=True, metavar="COMMANDS.csv", help="File to write.")
@click.option("--load", "load_N", type=float, default=0.0, metavar="N", show_default=True,
              help="Weight at the TCP.")  # fmt: skip
@click.option("--warming", type=float, default=0.0, metavar="K", show_default=True,
              help="Kelvin above the calibration's first reading.")  # fmt: skip
@_FORCE
def compensate(
    path: Path,
    machine_path: Path,
    effects_file: Path | None,
    out: Path,
    load_N: float,
    warming: float,
    force: bool,
) -> None:
    """Turn a path of TCP points into joint commands that reach them on the real machine.

    PATH.csv has the columns p_x_mm, p_y_mm, p_z_mm; its rows are gone through in their order, as
    lost motion depends on it.
    """
    from orthoglide import control

    if not (0 <= load_N < 1e4 and -100 < warming < 100):
        raise InputError("give --load from 0 to 10000 N and --warming within 100 K")
    points, machine = control.read_path(path), opt.load_machine(machine_path, effects_file)
    try:
        found = control.compensate(machine, points.p, load=load_N, warming=warming, force=force)
    except UnreachableError as error:
        line = points.line[error.index[0]] if error.index else None
        raise FileError(str(error), file=points.file, line=line) from error
    told = f"{click.format_filename(out)}: {found}"
    write_texts({out: control.commands_text(found)})
    for warning in points.warnings:
        say(f"warning: {warning}", err=True)
    say(told)


@click.command()
@_MACHINE
@click.option("--zeros-only", is_flag=True, help="For a controller that takes nothing but zeros.")
@_FORCE
@opt.out()
def export(
    machine_path: Path, effects_file: Path | None, out: Path, zeros_only: bool, force: bool
) -> None:
    """Write what other programs take of a calibrated machine.

    The controller's numbers with the sign rule written out (controller.txt and .json), and the
    calibrated URDF with its loop closures.
    """
    from orthoglide.control import export_files

    machine = opt.load_machine(machine_path, effects_file)
    if zeros_only and machine.spec.printer is not None:
        raise InputError(
            "--zeros-only has no effect: the firmware of this machine takes all its numbers or none"
        )
    write_results(out, export_files(machine, zeros_only=zeros_only, force=force))
    say(f"written: {click.format_filename(out)}")
