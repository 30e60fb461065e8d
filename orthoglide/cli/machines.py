"""A machine file at work: kinematics, compensation, exports, comparison, view and imports."""

from __future__ import annotations

import math
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

import orthoglide.cli.options as opt
from orthoglide.cli.app import Group, cli, deliver, progress, warn
from orthoglide.errors import FileError, InputError, UnreachableError
from orthoglide.numerals import mm_text
from orthoglide.progress import Step
from orthoglide.text import csv_text, wrapped

if TYPE_CHECKING:
    from orthoglide.firmware.imported import Imported
    from orthoglide.geometry import Array
    from orthoglide.observations.checks import Fail

_force_option = opt.flag("--force", "Even where the verdict says not to act on the numbers.")


@cli.command()
@click.argument("path", type=opt.PATH, metavar="PATH.csv")
@opt.machine(required=True)
@opt.out("File to write; else the commands are printed.", "COMMANDS.csv")
@click.option("--load", "load_N", type=click.FloatRange(0, 1e4), default=0.0, metavar="N",
              show_default=True, help="Weight at the TCP.")  # fmt: skip
@click.option("--warming", type=click.FloatRange(-100, 100), default=0.0, metavar="K",
              show_default=True,
              help="Kelvin above the calibration's first reading.")  # fmt: skip
@_force_option
def compensate(
    path: Path, machine: opt.MachineOption, out: Path | None, load_N: float, warming: float,
    force: bool,
) -> None:  # fmt: skip
    """Turn a path of TCP points into joint commands that reach them on the real machine.

    PATH.csv has the columns p_x_mm, p_y_mm, p_z_mm; its rows are gone through in their order, as
    lost motion depends on it.

    \b
    Example:
      orthoglide compensate path.csv --machine april/calibrated.toml --out commands.csv
    """
    from orthoglide import control

    if not math.isfinite(load_N + warming):
        raise InputError("give --load from 0 to 10000 N and --warming within 100 K")
    points, robot = control.read_path(path), machine.load()
    try:
        commands = control.compensate(robot, points, load=load_N, warming=warming, force=force)
    except UnreachableError as error:
        line = points.line[error.index[0]] if error.index else None
        raise FileError(str(error), file=points.file, line=line) from error
    warn(points.warnings)
    _deliver_table(control.commands_text(commands), out, str(commands))


def _deliver_table(text: str, out: Path | None, answer: str) -> None:
    """Write a table and print the answer; or print the table, the answer on the error stream."""
    if out is not None:
        deliver(wrapped(f"{click.format_filename(out)}: {answer}"), {out: text})
        return
    click.echo(text, nl=False)
    if answer:
        click.echo(wrapped(answer), err=True)


@cli.command()
@opt.machine(required=True)
@opt.flag("--zeros-only", "For a controller that takes nothing but zeros.")
@_force_option
@opt.out("Folder for the files; else the controller's numbers are printed.")
def export(machine: opt.MachineOption, zeros_only: bool, force: bool, out: Path | None) -> None:
    """Write files of a calibrated machine for controllers and other programs.

    The controller's numbers with the sign rule written out (controller.txt and .json), and the
    calibrated URDF with its loop closures.

    \b
    Example:
      orthoglide export --machine april/calibrated.toml --out controller
    """
    from orthoglide.control import export_files

    robot = machine.load()
    if zeros_only and robot.spec.printer is not None:
        raise InputError(
            "--zeros-only has no effect: the firmware of this machine takes all its numbers or none"
        )
    files = export_files(robot, zeros_only=zeros_only, force=force)
    if out is None:
        deliver(files["controller.txt"].rstrip("\n"))
    else:
        deliver(f"written: {click.format_filename(out)}", files, out)


@cli.command()
@opt.machine()
@opt.out("Folder for tables and figures; nothing is written if absent.")
@opt.names("--effects", "Effects or parameters to compare; the whole catalogue if absent.")
@opt.flag("--no-figures", "Tables only.")
@opt.quiet
def compare(
    machine: opt.MachineOption, out: Path | None, effects: tuple[str, ...], no_figures: bool,
    quiet: bool,
) -> None:  # fmt: skip
    """Report when the simplified model is good enough: every effect at its tolerance.

    For each effect, and for the machine of --machine with all its identified errors, the six
    parameters of the simplified model are fitted to the general mechanism; the residual is shown
    at the TCP over the workspace and, on an Orthoglide, in the readings of a sweep.

    \b
    Example:
      orthoglide compare --machine april/calibrated.toml --out comparison
    """
    from orthoglide.comparison import compare_effects, compare_machine, worst_by_effect
    from orthoglide.comparison.comparing import LIMITS, comparison_files, short_table
    from orthoglide.report.terminal import console_text, table

    robot = machine.load()
    with progress(quiet) as step:
        step(Step("computing", "comparing effects"))
        effect_rows = compare_effects(robot, effects or None)
        machine_rows = compare_machine(robot) if any(robot.values.values()) else ()
        worst = (*machine_rows[:1], *worst_by_effect(effect_rows))
        figures = () if no_figures else worst
        files = {} if out is None else comparison_files(robot, machine_rows, effect_rows, figures)
    table_text = console_text(table(*short_table(worst)))
    good_count = sum(row.good_enough for row in worst)
    written = "" if out is None else f"\n\nwritten: {click.format_filename(out)}"
    line = f"The simplified model is good enough in {good_count} of {len(worst)} rows."
    deliver(line if quiet else f"{table_text}\n\n{wrapped(LIMITS)}\n{line}{written}", files, out)


class _Coordinate(click.ParamType):
    """A number; another word that begins with a minus sign is refused as an unknown option."""

    name = "float"

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """Return millimetres."""
        try:
            return float(value)
        except ValueError:
            if str(value).startswith("-"):
                raise click.NoSuchOption(str(value), ctx=ctx) from None
            self.fail(f"{value!r} is not a number.", param, ctx)


def _kinematics_command(metavar: str) -> opt.Decorator:
    return opt.combine_options(
        # Coordinates may begin with a minus sign, which would else be read as options.
        cli.command(context_settings={"ignore_unknown_options": True}),
        click.argument("numbers", nargs=-1, type=_Coordinate(), metavar=f"[{metavar}]"),
        opt.machine(),
        opt.file("--csv", "Rows to compute, in place of numbers.", "CSV"),
        opt.out("With --csv: file to write; else the rows are printed.", "CSV"),
    )


@_kinematics_command("COMMAND COMMAND COMMAND")
def forward(**options: Any) -> None:
    """TCP of commands: three joint coordinates in mm, or a CSV of rho_*_mm or travel_*_mm, with
    approach_* where it is known.

    Mechanical zero of the nominal machine is 310.25 310.25 310.25, where the TCP is 0 0 0. Machines
    of another layout are commanded by travel from mechanical zero, there 0 0 0.

    Computed columns come last in the CSV: p_*_mm, or computed_p_*_mm beside given ones. Others are
    copied as they are and have no effect, time, temperature and load included.

    \b
    Examples:
      orthoglide forward 310.25 310.25 310.25
      orthoglide forward --csv commands.csv --out points.csv --machine april/calibrated.toml
    """
    _compute(True, **options)


@_kinematics_command("P_X P_Y P_Z")
def inverse(**options: Any) -> None:
    """Commands for a TCP: three coordinates in mm, or a CSV of p_x_mm, p_y_mm, p_z_mm.

    With a calibrated machine file these are the commands that bring the real TCP to the point.

    Computed columns come last in the CSV, named computed_* beside given ones. Others are copied as
    they are and have no effect, except approach_*.

    \b
    Example:
      orthoglide inverse 10 0 -5 --machine april/calibrated.toml
    """
    _compute(False, **options)


def _compute(
    to_tcp: bool, *, numbers: tuple[float, ...], machine: opt.MachineOption, csv: Path | None,
    out: Path | None,
) -> None:  # fmt: skip
    """Print the TCP of commands, or commands for a TCP; or append them to the rows of a file."""
    import numpy as np

    from orthoglide.observations.checks import check_commands
    from orthoglide.observations.schema import APPROACH, POINT
    from orthoglide.observations.table import native_command_column, read_table, stated_commands

    def solve(inputs: Array, fail: Fail, as_travel: bool = False, **approach: Array) -> Array:
        """Return the TCP of commands ``(n, 3)``, or the commands of a TCP, metres."""
        if to_tcp:
            return robot.forward(check_commands(inputs, as_travel, robot.spec, fail), **approach)
        return check_commands(robot.inverse(inputs, **approach), False, robot.spec, fail)

    if (csv is None) == (not numbers) or (out is not None and csv is None):
        raise InputError("give either three numbers in mm, or --csv with the rows to compute")
    robot = machine.load()
    if csv is None:
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise InputError("give exactly three finite numbers, in mm")
        result = solve(np.array([numbers]) * 1e-3, _raise_input_error)[0]
        click.echo(" ".join(map(mm_text, result)))
        return
    rows, layout = read_table(csv), robot.geometry.layout.names
    columns, result_columns = replace(POINT, empty_value=None), native_command_column(layout)
    if to_tcp:
        columns, result_columns = stated_commands(rows, robot.spec), POINT
    names, result_names = columns.names(layout.legs), result_columns.names(layout.legs)
    rows.check_names((*names, *(n for n in rows.names if n not in names)), names)
    approach = {}
    if set(APPROACH.names(layout.legs)) <= set(rows.names):
        approach["approach"] = rows.array(APPROACH, layout.legs)
    values = rows.array(columns, layout.legs)
    results = solve(values, rows.fail, names[0].startswith("travel"), **approach)
    if result_names[0].startswith("travel"):
        results = robot.spec.controller.from_rho(results, robot.geometry)
    if set(result_names) & set(rows.names):  # desired values stay beside the computed ones
        result_names = tuple(f"computed_{name}" for name in result_names)
    text = csv_text(
        (*rows.names, *result_names),
        (
            [*row, *map(mm_text, new)]
            for *row, new in zip(*rows.columns.values(), results, strict=True)
        ),
    )
    count = f"{len(results)} row{'s' * (len(results) != 1)}"
    answer = f"{count}, computed: {', '.join(result_names)}; others are copied"
    _deliver_table(text, out, answer if out else "")


def _raise_input_error(message: str, row: int | None) -> NoReturn:
    raise InputError(message)


@cli.command()
@opt.machine()
@click.option("--magnify", type=float, default=1.0, show_default=True, metavar="X",
              help="Factor by which errors are enlarged.")  # fmt: skip
@opt.out("Write a page that needs no network, and open no viewer.", "FILE.html")
@opt.flag("--no-open", "Print the viewer's address, and open no browser.")
def view(machine: opt.MachineOption, magnify: float, out: Path | None, no_open: bool) -> None:
    """Show a machine in three dimensions.

    It stands at mechanical zero, and its controls move the tool along x, y and z. What depends on
    approach, time, temperature or load is drawn after a move outward, an hour later, 10 K warmer,
    under 10 N. The viewer is meshcat: pip install orthoglide[viewer].

    \b
    Examples:
      orthoglide view
      orthoglide view april/calibrated.toml --magnify 50 --out april.html
    """
    from orthoglide.pictures import SHOWN_CONDITIONS

    opt.exclude("out", "no_open", because="a page is written, and no viewer is opened")
    robot = machine.load()
    with redirect_stdout(StringIO()):  # meshcat prints the address of its server
        viewer = robot.show(
            magnify=magnify, out=out, open_browser=out is None and not no_open, **SHOWN_CONDITIONS
        )
    scale = "true to scale" if magnify == 1 else f"errors {magnify:g} times as large"
    description = scale if robot.values else "without errors"
    if out is not None:
        deliver(f"{click.format_filename(out)}: the machine, {description}")
        return
    deliver(f"{viewer.viewer.url()} shows the machine, {description}")
    click.pause("Press a key to end the viewer.")  # at once where nobody is at a terminal


@cli.group("import", cls=Group)
def import_() -> None:
    """Machine file and readings from what a firmware stored."""


@import_.command()
@click.argument("config", type=opt.PATH)
@opt.out("Folder for machine.toml and the campaigns; must be new or empty.", required=True)
@opt.pairs("--turned", "Meshes by name, and how far the plate lay turned on its seat when it was "
           "probed, counter-clockwise from above.", "NAME=DEGREES,...")  # fmt: skip
def klipper(config: Path, out: Path, turned: opt.Pairs) -> None:
    """Read a linear delta's printer.cfg: its numbers, heights, distances and meshes.

    \b
    Example:
      orthoglide import klipper printer.cfg --out printer
    """
    from orthoglide.add_ons import add_on
    from orthoglide.machine_file import machine_file_contents

    imported = add_on("klipper").read(config, turned=dict(turned))
    files = dict(machine_file_contents(imported.machine, "machine.toml"))
    _deliver_import(imported, out, files, out / "machine.toml")


@import_.command()
@click.argument("points", metavar="FILE", type=opt.PATH)
@opt.machine(required=True)
@opt.out("Folder for the campaigns; must be new or empty.", required=True)
def plates(points: Path, machine: opt.MachineOption, out: Path) -> None:
    """Read a plate's points: heightmap.csv, 'Bed X: Y: Z:', 'probe at X,Y is z=Z', or x, y, z.

    \b
    Example:
      orthoglide import plates heightmap.csv --machine machine.toml --out plate
    """
    from orthoglide.firmware.plate_lists import import_plates

    file = machine.path or Path("machine.toml")  # which is required
    _deliver_import(import_plates(points, machine.load().spec), out, {}, file)


def _deliver_import(
    imported: Imported, out: Path, files: dict[str, str | bytes], machine_file: Path
) -> None:
    """Write the readings of an import, and print a line on each and the commands to run next.

    One command takes all files that belong together; if this is unknown, each file has its own.
    """
    from orthoglide.observations import campaign_text

    def command(*names: str) -> str:
        campaigns = " ".join(f"{opt.shell_path(out)}/{name}.csv" for name in names)
        file = opt.shell_path(machine_file)
        return f"orthoglide close-loop {campaigns} --machine {file} --out OUT"

    lines = list[str]()
    for campaign in imported.campaigns:
        files[f"{campaign.name}.csv"] = campaign_text(campaign, imported.machine)
        setups_text = ", ".join(f"{setup.name} ({setup.kind})" for setup in campaign.setups)
        lines.append(f"{campaign.name}.csv: {len(campaign)} readings: {setups_text}")
    excluded = [c.name for c in imported.campaigns if c.name not in imported.together]
    if not excluded:
        lines.append(f"\nNext: {command('*')}")
    else:
        runs = [imported.together] if imported.together else [(name,) for name in excluded]
        lines.append("\nNext, probe again, as these files must not all go together; or for now")
        lines += [command(*names) for names in runs]
    deliver("\n".join(lines), files, out)
    warn(imported.notes)
