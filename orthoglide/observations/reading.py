"""Readings of all kinds from CSV files, data frames, and rows as results keep them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import FileError
from orthoglide.foreign import refuse_foreign
from orthoglide.geometry import Array
from orthoglide.machine_file import AnyMachine, Controller, MachineFile, machine_file_of
from orthoglide.notes import Note
from orthoglide.observations.approach import Moves, derive_approach, stroke_overshoot
from orthoglide.observations.checks import (
    check_filled,
    check_firmware,
    check_layout,
    check_points,
    check_readings,
    check_sequence,
)
from orthoglide.observations.columns import (
    awaiting_touch,
    column_values,
    commands,
    read_setups,
    rows_of_kinds,
    stated_commands,
)
from orthoglide.observations.readings import Readings
from orthoglide.observations.schema import (
    APPROACH,
    AXIS_AND_SIGN,
    COLUMNS,
    COMMANDS,
    DIRECTION,
    FIRMWARE,
    KIND,
    MOVE,
    ORDER,
    POINT,
    POSTURE,
    READINGS,
    RHO,
    SETUP,
    SIGMAS,
    TRAVEL,
    Column,
    at_tool,
    column_names,
    columns_for_command,
)
from orthoglide.observations.table import Table, frame_table, read_table, rows_table
from orthoglide.observations.tables import concatenated, from_points

_HEAD_BYTES = 2**16  # bytes of a file that say what wrote it

ReadingsOrPath = Readings | str | os.PathLike[str]
"""Readings, or the path of their file."""


def read_campaign(
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    require_readings: bool = True,
) -> Readings:
    """Read a file of readings of any kinds and look for faults that need no fit.

    Args:
        path: the CSV file (UTF-8; commas, or semicolons with decimal points or commas).
        machine_file: the machine whose stroke, dial and controller count, or its file; the nominal
            one if None.
        require_readings: False: a sheet not yet filled in is welcome.

    Returns:
        One table, with what was noticed and is no error in ``warnings``.

    Raises:
        FileError: naming the line and what would be right.
    """
    return concatenated(read_readings(path, machine_file, require_readings=require_readings))


def read_readings(
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    *,
    require_readings: bool = True,
) -> tuple[Readings, ...]:
    """Read a file of readings of any kinds, those of legs and of the tool apart.

    Args:
        path: the CSV file, as for `read_campaign`.
        machine_file: the machine whose stroke, dial and controller count, or its file; the nominal
            one if None.
        require_readings: False: a sheet not yet filled in is welcome.

    Returns:
        A table of readings of legs, with the moves, a table of those of the tool, or both.

    Raises:
        FileError: naming the line and what would be right.
    """
    try:
        table = read_table(path)
        return readings_of_table(table, Path(table.file).stem, machine_file, require_readings)
    except FileError:
        # What is no table of readings may be what a firmware wrote, which has a command of its own.
        if Path(path).is_file():  # a pipe is read once
            with suppress(OSError), Path(path).open("rb") as stream:
                refuse_foreign(Path(path), stream.read(_HEAD_BYTES), accepted=("archive",))
        raise


def read_tcp(path: str | os.PathLike[str], machine_file: AnyMachine | None = None) -> Readings:
    """Read a file with a row for each measured position of the tool.

    Args:
        path: the CSV file, as for `read_campaign`.
        machine_file: the machine whose layout, stroke and controller count, or its file; the
            nominal one if None.

    Returns:
        Readings of kind ``tcp``, one for each coordinate that is not left empty.

    Raises:
        FileError: naming the line and what would be right.
    """
    table = read_table(path)
    return _points_of_table(table, Path(table.file).stem, machine_file_of(machine_file))


def readings_from_rows(
    rows: Sequence[Mapping[str, str]],
    machine_file: AnyMachine | None = None,
    *,
    name: str,
    lines: Sequence[int] = (),
    file: str = "",
    sha256: str = "",
) -> tuple[Readings, ...]:
    """Readings from rows of text, as a result keeps those of its files: of rows with points of the
    tool one table, as `read_tcp` has it.

    Args:
        rows: from column to text; the first row names all columns.
        machine_file: as for `read_readings`.
        name: of the readings.
        lines: line of each row in the file; from 2 on where empty.
        file: the file's name.
        sha256: digest of the file.

    Raises:
        FileError: as `read_readings`.
    """
    table = rows_table(rows, file or name, lines, sha256)
    return tuple(replace(r, file=file) for r in readings_of_table(table, name, machine_file))


def readings_from_frame(
    df: Any,
    *,
    name: str = "frame",
    machine_file: AnyMachine | None = None,
    controller: Controller | None = None,
    require_readings: bool = True,
) -> Readings:
    """Readings from a data frame with the columns of a file of readings.

    Args:
        df: a pandas data frame, or a mapping of columns; missing values are empty fields.
        name: of the readings.
        machine_file: as for `read_campaign`.
        controller: to convert ``travel_*_mm``; the machine file's if None.
        require_readings: as for `read_campaign`.

    Raises:
        FileError: as `read_campaign`, rows counted as lines of a file with a header.
    """
    machine = machine_file_of(machine_file)
    if controller is not None:
        machine = replace(machine, controller=controller)
    found = readings_of_table(frame_table(df, name), name, machine, require_readings)
    return replace(concatenated(found), file="")


Readings.from_frame = staticmethod(readings_from_frame)


def readings_of_table(
    table: Table,
    name: str,
    machine_file: AnyMachine | None,
    require_readings: bool = True,
) -> tuple[Readings, ...]:
    """Readings from a table of cells, those of legs and of the tool apart; moves go with legs.

    Raises:
        FileError: naming the line and what would be right.
    """
    machine = machine_file_of(machine_file)
    of_points = set(POINT.names()) & set(table.names)
    if of_points and not {SETUP.name, READINGS["mm"].name} & set(table.names):
        return (_points_of_table(table, name, machine),)
    kinds = table.values(KIND)
    tool = rows_of_kinds(kinds, at_tool)
    if not tool.any() or all(kinds[k] == MOVE for k in np.flatnonzero(~tool)):
        return (_one_table(table, name, machine, require_readings, kinds),)
    halves = ((~tool, name), (tool, f"{name}-tool"))
    return tuple(
        _one_table(table.part(np.flatnonzero(rows)), called, machine, require_readings, kinds)
        for rows, called in halves
    )


def _one_table(
    table: Table, name: str, machine: MachineFile, require_readings: bool, every: Sequence[str]
) -> Readings:
    """Return the readings of a table; ``every`` has the kinds of rows of its whole file."""
    named, legs = table.values(KIND), machine.geometry.leg_names
    kinds, moved = [k for k in named if k != MOVE], np.array([kind == MOVE for kind in named])
    check_layout(named, machine, table.fail)
    command = stated_commands(table, machine)
    warnings = table.check_names(
        [*column_names(_allowed_columns(every, command), legs), *column_names((RHO, TRAVEL), legs)],
        column_names(_required_columns(kinds, command, require_readings), legs),
    )
    if moved.all():
        table.fail("has moves only: add rows with readings", 0)
    check_firmware(table.values(FIRMWARE), machine, table.fail)
    read, sequence = _read_sequence(table, moved, command, machine)
    setups, setup = read_setups(read, kinds)
    sequence["second"] = _second_commands(
        read, rows_of_kinds(kinds, COMMANDS[command].applies_to), command, machine
    )
    fields = _row_values(read, kinds)
    fields["reading"] = np.where(awaiting_touch(read, command), np.nan, fields["reading"])
    made = Readings(
        name=name, setups=setups, setup=setup, line=np.array(read.lines), file=read.file,
        sha256=read.sha256, legs=machine.geometry.layout.names,
        **fields | sequence,
    )  # fmt: skip
    if require_readings:
        check_filled(made, read.fail)
    noticed = check_readings(made, machine, read.fail)
    unread = _note_moves_with_readings(table.part(np.flatnonzero(moved)))
    return replace(made, warnings=(*warnings, *unread, *noticed))


def _allowed_columns(kinds: Sequence[str], command: Column) -> list[Column]:
    """Return the columns that a file may have; any of the schema where the tool is read."""
    known = columns_for_command(command)
    if rows_of_kinds(kinds, at_tool).any():
        return known
    return [
        column
        for column in known
        if column is KIND or rows_of_kinds(kinds, column.applies_to).any()
    ]


def _required_columns(
    kinds: Sequence[str], command: Column, require_readings: bool
) -> list[Column]:
    """Return the columns that a file must have."""

    def needed(column: Column) -> bool:
        if column in READINGS.values():
            return require_readings
        return column.required and column is not ORDER

    named = [KIND] if rows_of_kinds(kinds, at_tool).any() else []
    found = [column for column in columns_for_command(command) if needed(column)]
    return named + [column for column in found if rows_of_kinds(kinds, column.applies_to).any()]


def _read_sequence(
    table: Table, gone: NDArray[np.bool_], command: Column, machine: MachineFile
) -> tuple[Table, dict[str, Any]]:
    """Return the rows with readings, and what depends on the sequence that all rows share.

    The order is that of the rows where no column states it; the approach as recorded, where it was,
    else from the sequence.
    """
    legs, rho = machine.geometry.leg_names, commands(table, command, machine)
    order = np.arange(1, len(table.rows) + 1)
    if ORDER.name in table.names:
        order = np.array(table.values(ORDER))
    check_sequence(rho, order, table.lines, table.fail)
    beyond = stroke_overshoot(machine.geometry.stroke)
    moves = Moves(rho[gone], order[gone], np.array(table.lines)[gone], beyond)
    rho, order, read = rho[~gone], order[~gone], table.part(np.flatnonzero(~gone))
    approach, given = read.array(APPROACH, legs), [n in read.names for n in APPROACH.names(legs)]
    if not all(given):
        approach = np.where(given, approach, derive_approach(rho, order, moves))
    return read, {"command": rho, "order": order, "moves": moves, "approach": approach}


def _row_values(table: Table, kinds: Sequence[str]) -> dict[str, Any]:
    """Return what each row has for itself, by attribute of `Readings`."""
    found: dict[str, Any] = {}
    for column in COLUMNS:
        if column.per_setup or column.is_triple or not column.attribute:
            continue
        own = rows_of_kinds(kinds, column.applies_to)
        given = not column.required or own.all()
        values = table.values(column) if given else column_values(table, column, own)
        before = found.get(column.attribute)
        found[column.attribute] = values if before is None else np.where(own, values, before)
    axes = [AXIS_AND_SIGN.get(cell, (0, 1)) for cell in found.pop(DIRECTION.attribute)]
    axis, sign = np.array(axes).T
    return found | {"posture": tuple(found[POSTURE.attribute]), "axis": axis, "sign": sign}


def _second_commands(
    table: Table, own: NDArray[np.bool_], command: Column, machine: MachineFile
) -> Array:
    """Return the second commands ``(n, 3)`` of rows that have one, metres; nan elsewhere."""
    found = np.full((len(own), 3), np.nan)
    if own.any():
        found[own] = commands(table.part(np.flatnonzero(own)), COMMANDS[command], machine)
    return found


def _note_moves_with_readings(moves: Table) -> tuple[Note, ...]:
    cells = zip(moves.lines, moves.cells(READINGS["mm"].name), strict=True)
    lines = tuple(line for line, cell in cells if cell)
    told = (
        f"the reading of line {', '.join(map(str, lines))} was ignored: a row of kind {MOVE} is "
        f"gone through, not read"
    )
    return (Note(told, "reading", lines),) if lines else ()


def _points_of_table(table: Table, name: str, machine: MachineFile) -> Readings:
    column, legs = stated_commands(table, machine), machine.geometry.leg_names
    known = (column, RHO, TRAVEL, APPROACH, POINT, SIGMAS["mm"])
    warnings = table.check_names(column_names(known, legs), column_names((column, POINT), legs))
    p = table.array(POINT)
    command = commands(table, column, machine)
    check_points(command, p, table.fail)
    return from_points(
        command, p, table.values(SIGMAS["mm"]), table.array(APPROACH, legs), table.lines,
        name=name or "points", file=table.file, sha256=table.sha256,
        warnings=warnings, legs=machine.geometry.layout.names,
    )  # fmt: skip
