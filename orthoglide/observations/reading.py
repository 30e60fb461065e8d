"""Readings of all kinds from CSV files, data frames, and rows of results."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.arguments import public
from orthoglide.errors import FileError, InputError
from orthoglide.foreign import refuse_foreign
from orthoglide.instruments import OBSERVATIONS, Observation, Setup
from orthoglide.machine_file import AnyMachine, MachineFile, machine_file_of
from orthoglide.notes import Note
from orthoglide.observations.approach import Ints, Moves, derive_approach, stroke_overshoot
from orthoglide.observations.checks import (
    check_filled,
    check_firmware,
    check_layout,
    check_points,
    check_readings,
    check_sequence,
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
    PLACE,
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
from orthoglide.observations.table import (
    Table,
    commands,
    frame_table,
    read_table,
    rows_table,
    stated_commands,
)
from orthoglide.observations.tables import from_points, split_legs_and_tool

_UNIQUE_NAME_REMEDY = (
    "give each mounting of a dial a name of its own",
    "give each instrument, each probe or tip, and each state of a plate its own setup",
)
"""Remedies for two setups of one name, of dials and of the tool."""


def rows_of_kinds(kinds: Sequence[str], test: Callable[[Observation], Any]) -> NDArray[np.bool_]:
    """Return the rows of kinds that pass a test ``(n,)``, booleans; moves never pass."""
    kinds_passing = {kind for kind, observation in OBSERVATIONS.items() if test(observation)}
    return np.array([kind in kinds_passing for kind in kinds], dtype=bool)


def column_values(
    table: Table, column: Column, rows_with_column: NDArray[np.bool_], name: str = ""
) -> list[Any]:
    """Return a column's values in the rows that have it, and None elsewhere."""
    if rows_with_column.all():
        return table.values(column, name)
    values: list[Any] = [None] * len(rows_with_column)
    rows = np.flatnonzero(rows_with_column).tolist()
    for row, value in zip(rows, table.part(rows).values(column, name), strict=True):
        values[row] = value
    return values


def read_setups(table: Table, kinds: Sequence[str]) -> tuple[tuple[Setup, ...], Ints]:
    """Return the mountings in order of appearance, and the index of each row's mounting.

    Raises:
        FileError: for an impossible mounting, and two mountings of one name.
    """
    cells = {
        name: column_values(table, column, has_column, name)
        for column in COLUMNS
        if (has_column := rows_of_kinds(kinds, column.is_fixed_in_setup)).any()
        for name in column.names()
    }
    name_column, setups, numbers = list(cells).index(SETUP.name), list[Setup](), list[int]()
    first_by_name: dict[str, tuple[int, int, tuple[Any, ...]]] = {}  # number, row and cells
    for row, key in enumerate(zip(*cells.values(), strict=True)):
        given = (len(setups), row, key)
        number, first_row, first_key = first_by_name.setdefault(key[name_column], given)
        if row == first_row:
            setups.append(_make_setup(table, row, dict(zip(cells, key, strict=True))))
        elif key != first_key:
            differing = next(n for n, a, b in zip(cells, key, first_key, strict=True) if a != b)
            remedy = _UNIQUE_NAME_REMEDY[int(rows_of_kinds(kinds, at_tool).any())]
            table.fail(
                f"setup {key[name_column]!r} has another {differing} here than on line "
                f"{table.lines[first_row]}: {remedy}",
                row,
            )
        numbers.append(number)
    return tuple(setups), np.array(numbers)


def _make_setup(table: Table, row: int, cells: Mapping[str, Any]) -> Setup:
    """Return a mounting from its cells by column."""
    values: dict[str, Any] = {}
    for column in COLUMNS:
        given = tuple(cells[name] for name in column.names() if cells.get(name) is not None)
        if column is DIRECTION and given:
            values["axis"], values["sign"] = AXIS_AND_SIGN[given[0]]
        elif given:
            values[column.attribute] = given if column.is_triple else given[0]
    try:
        return Setup(**values)
    except InputError as error:
        table.fail(str(error).removeprefix(f"setup {values['name']!r}: "), row)


_HEAD_BYTES = 2**16  # bytes of a file that identify the program that wrote it

ReadingsOrPath = Readings | str | os.PathLike[str]
"""Readings, or the path of their file."""


@public
def read_campaign(
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    require_readings: bool = True,
) -> Readings:
    """Read a file of readings of any kinds, and check it as far as no fit is needed.

    Args:
        path: the CSV file (UTF-8; commas, or semicolons with decimal points or commas).
        machine_file: the machine, or its file, whose stroke, dial and controller are used; the
            nominal one if None.
        require_readings: if False, readings may be empty.

    Returns:
        One table, with remarks that are no errors in ``warnings``.

    Raises:
        FileError: naming the line and what would be right.
    """
    try:
        table = read_table(path)
        return readings_of_table(table, Path(table.file).stem, machine_file, require_readings)
    except FileError:
        # The file may be output of a firmware, which another command imports.
        if Path(path).is_file():  # a pipe would be waited for
            with suppress(OSError), Path(path).open("rb") as stream:
                refuse_foreign(Path(path), stream.read(_HEAD_BYTES), accepted=("archive",))
        raise


@public
def read_readings(
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    *,
    require_readings: bool = True,
) -> tuple[Readings, ...]:
    """Read a file of readings of any kinds into separate tables of legs and of the tool.

    Args:
        path: as for `read_campaign`.
        machine_file: as for `read_campaign`.
        require_readings: as for `read_campaign`.

    Returns:
        A table of readings of legs, with the moves, a table of those of the tool, or both.

    Raises:
        FileError: naming the line and what would be right.
    """
    return split_legs_and_tool(read_campaign(path, machine_file, require_readings))


@public
def read_tcp(path: str | os.PathLike[str], machine_file: AnyMachine | None = None) -> Readings:
    """Read a file with a row for each measured position of the tool.

    Args:
        path: as for `read_campaign`.
        machine_file: as for `read_campaign`.

    Returns:
        Readings of kind ``tcp``, one for each coordinate that is not empty.

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
) -> Readings:
    """Return readings from rows of text, as a result keeps those of its files: from column to cell,
    the first row naming all columns, with the lines and the digest of their file.

    Raises:
        FileError: as `read_campaign`.
    """
    table = rows_table(rows, file or name, lines, sha256)
    return replace(readings_of_table(table, name, machine_file), file=file)


@public
def readings_from_frame(
    df: Any,
    *,
    name: str = "frame",
    machine_file: AnyMachine | None = None,
    require_readings: bool = True,
) -> Readings:
    """Return readings from a data frame with the columns of a file of readings.

    Args:
        df: a pandas data frame, or a mapping of columns; missing values are empty fields.
        name: of the readings.
        machine_file: as for `read_campaign`.
        require_readings: as for `read_campaign`.

    Raises:
        FileError: as `read_campaign`, rows counted as lines of a file with a header.
    """
    readings = readings_of_table(frame_table(df, name), name, machine_file, require_readings)
    return replace(readings, file="")


Readings.from_frame = staticmethod(readings_from_frame)


def readings_of_table(
    table: Table, name: str, machine_file: AnyMachine | None, require_readings: bool = True
) -> Readings:
    """Return the readings of a table, with the moves; raises as `read_campaign`."""
    machine = machine_file_of(machine_file)
    if set(POINT.names()) & set(table.names) and not (
        {SETUP.name, READINGS["mm"].name} & set(table.names)
    ):
        return _points_of_table(table, name, machine)
    row_kinds, legs = table.values(KIND), machine.geometry.leg_names
    kinds = [kind for kind in row_kinds if kind != MOVE]
    is_move = np.array([kind == MOVE for kind in row_kinds])
    check_layout(row_kinds, machine, table.fail)
    command = stated_commands(table, machine)
    allowed = columns_for_command(command)
    required = [
        column for column in allowed
        if (require_readings if column in READINGS.values() else column.required)
        and column is not ORDER and rows_of_kinds(kinds, column.applies_to).any()
    ]  # fmt: skip
    # A column that says nothing of these kinds counts as unknown.
    allowed = [c for c in allowed if c is KIND or rows_of_kinds(kinds, c.applies_to).any()]
    warnings = table.check_names(
        column_names([*allowed, RHO, TRAVEL], legs), column_names(required, legs)
    )
    if is_move.all():
        table.fail("has moves only: add rows with readings", 0)
    check_firmware(table.values(FIRMWARE), machine, table.fail)
    moves, rows = (table.part(np.flatnonzero(k)) for k in (is_move, ~is_move))
    sequence = _read_sequence(table, rows, is_move, command, machine)
    setups, setup = read_setups(rows, kinds)
    second, paired = np.full((len(rows), 3), np.nan), rows_of_kinds(kinds, lambda o: o.paired)
    if paired.any():
        second[paired] = commands(rows.part(np.flatnonzero(paired)), COMMANDS[command], machine)
    fields = _row_values(rows, kinds)
    if command is PLACE:  # a touch whose height is not measured yet
        untouched = [not cell for cell in rows.cells(PLACE.names()[2])]
        fields["reading"] = np.where(untouched, np.nan, fields["reading"])
    readings = Readings(
        name=name, setups=setups, setup=setup, line=np.array(rows.lines), file=rows.file,
        sha256=rows.sha256, legs=machine.geometry.layout.names, second=second,
        **fields | sequence,
    )  # fmt: skip
    if require_readings:
        check_filled(readings, rows.fail)
    notes = check_readings(readings, machine, rows.fail)
    move_notes = _note_moves_with_readings(moves)
    return replace(readings, warnings=(*warnings, *move_notes, *notes))


def _read_sequence(
    table: Table, rows: Table, is_move: NDArray[np.bool_], command: Column, machine: MachineFile
) -> dict[str, Any]:
    """Return commands, order, approach and moves of the rows with readings, by attribute.

    Without a column of the order, the rows are in order. The approach is as recorded, or follows
    from the order.
    """
    legs, rho = machine.geometry.leg_names, commands(table, command, machine)
    order = np.arange(1, len(table) + 1)
    if ORDER.name in table.names:
        order = np.array(table.values(ORDER))
    check_sequence(rho, order, table.lines, table.fail)
    overshoot = stroke_overshoot(machine.geometry.stroke)
    moves = Moves(rho[is_move], order[is_move], np.array(table.lines)[is_move], overshoot)
    rho, order, approach = rho[~is_move], order[~is_move], rows.array(APPROACH, legs)
    is_recorded = [name in rows.names for name in APPROACH.names(legs)]
    if not all(is_recorded):
        approach = np.where(is_recorded, approach, derive_approach(rho, order, moves))
    return {"command": rho, "order": order, "moves": moves, "approach": approach}


def _row_values(table: Table, kinds: Sequence[str]) -> dict[str, Any]:
    """Return the values that belong to single rows, by attribute of `Readings`."""
    fields: dict[str, Any] = {}
    for column in COLUMNS:
        if column.per_setup or column.is_triple or not column.attribute:
            continue
        has_column = rows_of_kinds(kinds, column.applies_to)
        values: Any = column_values(table, column, has_column | (not column.required))
        if column.attribute in fields:
            values = np.where(has_column, values, fields[column.attribute])
        fields[column.attribute] = values
    axes = [AXIS_AND_SIGN.get(cell, (0, 1)) for cell in fields.pop(DIRECTION.attribute)]
    axis, sign = np.array(axes).T
    return fields | {"posture": tuple(fields[POSTURE.attribute]), "axis": axis, "sign": sign}


def _note_moves_with_readings(moves: Table) -> tuple[Note, ...]:
    cells = zip(moves.lines, moves.cells(READINGS["mm"].name), strict=True)
    lines = tuple(line for line, cell in cells if cell)
    message = (
        f"the reading of line {', '.join(map(str, lines))} was ignored: a row of kind {MOVE} is "
        f"gone through, not read"
    )
    return (Note(message, "reading", lines),) if lines else ()


def _points_of_table(table: Table, name: str, machine: MachineFile) -> Readings:
    """Return the readings of a table with a row for each point of the tool."""
    column, legs = stated_commands(table, machine), machine.geometry.leg_names
    allowed = (column, RHO, TRAVEL, APPROACH, POINT, SIGMAS["mm"])
    warnings = table.check_names(column_names(allowed, legs), column_names((column, POINT), legs))
    p = table.array(POINT)
    command = commands(table, column, machine)
    check_points(command, p, table.fail)
    return from_points(
        command, p, table.values(SIGMAS["mm"]), table.array(APPROACH, legs), table.lines,
        name=name or "points", file=table.file, sha256=table.sha256,
        warnings=warnings, legs=machine.geometry.layout.names,
    )  # fmt: skip
