"""``forward`` and ``inverse``: between commands and TCP, on numbers or a CSV file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import need
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_texts
from orthoglide.errors import InputError
from orthoglide.text import csv_text

if TYPE_CHECKING:
    from orthoglide.geometry import Array
    from orthoglide.machine import Machine

# Coordinates may begin with a minus sign, which would else be read as options.
_NUMBERS = {"ignore_unknown_options": True}


class _Coordinate(click.ParamType):
    """A number, or what looks like an option and is none."""

    name = "float"

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """In millimetres."""
        try:
            return float(value)
        except ValueError:
            if str(value).startswith("-"):
                raise click.NoSuchOption(str(value), ctx=ctx) from None
            self.fail(f"{value!r} is not a number.", param, ctx)


def _arguments(metavar: str) -> opt.Decorator:
    return opt.together(
        click.argument("numbers", nargs=-1, type=_Coordinate(), metavar=f"[{metavar}]"),
        opt.machine(),
        click.option("--csv", "table", type=opt.PATH, metavar="CSV", help="Rows to compute."),
        click.option("--out", type=opt.PATH, metavar="CSV", help="With --csv: file to write."),
    )


@click.command(context_settings=_NUMBERS)
@_arguments("COMMAND COMMAND COMMAND")
def forward(**given: Any) -> None:
    """TCP of commands: three joint coordinates in mm, or a CSV of rho_*_mm or travel_*_mm, with
    approach_* where it is known.

    Mechanical zero of the nominal machine is 310.25 310.25 310.25, where the TCP is 0 0 0. Machines
    of another layout are commanded by travel from mechanical zero, there 0 0 0.
    """
    _run(True, **given)


@click.command(context_settings=_NUMBERS)
@_arguments("P_X P_Y P_Z")
def inverse(**given: Any) -> None:
    """Commands for a TCP: three coordinates in mm, or a CSV of p_x_mm, p_y_mm, p_z_mm.

    With a calibrated machine file these are the commands that bring the real TCP to the point.
    """
    _run(False, **given)


Fail = Callable[[str, int | None], NoReturn]


def _solved(
    to_tcp: bool, machine: Machine, given: Array, fail: Fail, travelled: bool = False, **seen: Array
) -> Array:
    """TCP of commands ``(n, 3)`` in metres, ``travelled`` where they are the controller's values;
    or the reverse. How each drive arrives is ``seen`` where it is known.
    """
    import numpy as np

    from orthoglide.observations.checks import STROKE_SLACK, check_commands

    if to_tcp:
        return machine.forward(check_commands(given, travelled, machine.spec, fail), **seen)
    rho, geometry = machine.inverse(given, **seen), machine.geometry
    outside = np.argwhere(~geometry.in_stroke(rho, STROKE_SLACK))
    if len(outside):
        row, axis = outside[0]
        low, high = ((geometry.zero[axis] + limit) * 1e3 for limit in geometry.stroke)
        fail(
            f"the point needs carriage {geometry.leg_names[axis]} at "
            f"{rho[row, axis] * 1e3:.6f} mm, outside its stroke of {low:g} to {high:g} mm: "
            "give a point nearer to the middle",
            int(row),
        )
    return rho


def _run(
    to_tcp: bool,
    *,
    numbers: tuple[float, ...],
    machine_path: Path | None,
    effects_file: Path | None,
    table: Path | None,
    out: Path | None,
) -> None:
    import numpy as np

    need("effects_file", "machine_path")
    if (table is None) != (out is None):
        raise InputError("--csv and --out go together: name a file to read and a file to write")
    if (table is None) == (not numbers):
        raise InputError("give either three numbers in mm, or --csv and --out")
    if table is None or out is None:
        machine = opt.load_machine(machine_path, effects_file)
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise InputError("give exactly three finite numbers, in mm")
        found = _solved(to_tcp, machine, np.array([numbers]) * 1e-3, _refuse)
        say(" ".join(_number(value) for value in found[0]), needed=True)
        return
    from orthoglide.observations.columns import own_commands, stated_commands
    from orthoglide.observations.schema import APPROACH, POINT
    from orthoglide.observations.table import read_table

    rows = read_table(table)
    machine = opt.load_machine(machine_path, effects_file)
    layout = machine.geometry.layout.names
    column, computed = own_commands(layout), POINT
    if to_tcp:
        column = stated_commands(rows, machine.spec)
    else:
        column, computed = replace(POINT, empty=None), column
    names, new = column.names(layout.legs), computed.names(layout.legs)
    rows.check_names((*names, *(n for n in rows.names if n not in names)), names)
    given = rows.array(column, layout.legs)
    travelled = names[0].startswith("travel")
    known = set(APPROACH.names(layout.legs)) <= set(rows.names)
    seen = {"approach": rows.array(APPROACH, layout.legs)} if known else {}
    found = _solved(to_tcp, machine, given, rows.fail, travelled, **seen)
    if new[0].startswith("travel"):
        found = machine.spec.controller.from_rho(found, machine.geometry)
    if set(new) & set(rows.names):  # what was wanted stays beside what is found
        new = tuple(f"computed_{name}" for name in new)
    wider = ([*row, *map(_number, more)] for row, more in zip(rows.rows, found, strict=True))
    write_texts({out: csv_text((*rows.names, *new), wider)})


def _refuse(message: str, row: int | None) -> NoReturn:
    raise InputError(message)


def _number(metres: float) -> str:
    return f"{metres * 1e3:z.6f}"
