"""Commands and mountings of instruments from the columns of a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.instruments import OBSERVATIONS, Observation, Setup
from orthoglide.layout import LegNames
from orthoglide.machine_file import MachineFile
from orthoglide.observations.approach import Ints
from orthoglide.observations.checks import check_commands
from orthoglide.observations.schema import (
    AXIS_AND_SIGN,
    COLUMNS,
    COMMANDS,
    DIRECTION,
    NAN,
    PLACE,
    RHO,
    SETUP,
    TRAVEL,
    Column,
    at_tool,
)
from orthoglide.observations.table import Table

_UNIQUE_NAME_REMEDY = (
    "give each mounting of a dial a name of its own",
    "give each instrument, each probe or tip, and each state of a plate its own setup",
)
"""Remedies for two setups of one name, of dials and of the tool."""

_AGREEMENT = 1e-8  # metres: commands that are stated in two ways, both rounded to a nanometre
_PLACE_WITHOUT_HEIGHT = replace(PLACE, empty_value=NAN)  # the height is empty before a touch


def native_command_column(names: LegNames) -> Column:
    """Return the columns of a layout's commands: joint coordinates, or travel."""
    return RHO if RHO.name.startswith(names.command) else TRAVEL


def native_command_names(names: LegNames) -> tuple[str, ...]:
    """Return the names of the three columns of a layout's commands."""
    return native_command_column(names).names(names.legs)


def stated_commands(table: Table, machine: MachineFile) -> Column:
    """Return the columns in which a table states its commands.

    Raises:
        FileError: if two ways of stating them disagree, or the columns are of another layout.
    """
    legs, is_delta = machine.geometry.leg_names, not machine.geometry.dialled
    native, other = (TRAVEL, PLACE) if is_delta else (RHO, TRAVEL)
    if not is_delta and "travel_a_mm" in table.names:
        table.fail(
            "has the columns of a linear delta: give its machine file, with [layout], by --machine"
        )
    names = [set(column.names(legs)) for column in (native, other)]
    if not names[1] & set(table.names) or (is_delta and machine.kinematics is None):
        return native
    if not names[0] & set(table.names):
        return other
    fault = "one of these kinds is not complete"
    if (names[0] | names[1]) <= set(table.names):  # `compensate` writes both
        difference = commands(table, native, machine) - commands(table, other, machine)
        if np.abs(difference).max(initial=0.0) <= _AGREEMENT:
            return native
        fault = "they disagree"
    both = f"{native.names(legs)[0]} and {other.names(legs)[0]}"
    table.fail(f"has {both}, and {fault}: keep the columns of one kind")


def commands(table: Table, column: Column, machine: MachineFile) -> Array:
    """Return the joint coordinates ``(n, 3)``, metres, of a table's commands, or of second ones.

    Raises:
        FileError: for a command that is invalid, or that the machine cannot reach.
    """
    kinematics = machine.kinematics
    if kinematics is None or column not in (PLACE, COMMANDS[PLACE]):
        given = table.array(column, machine.geometry.leg_names)
        is_travel = column in (TRAVEL, COMMANDS[TRAVEL])
        return check_commands(given, is_travel, machine, table.fail)
    columns = (column, column, _PLACE_WITHOUT_HEIGHT if column is PLACE else column)
    cells = [table.values(c, n) for c, n in zip(columns, column.names(), strict=True)]
    travel = kinematics.travel(np.nan_to_num(np.array(cells, dtype=float).T))
    unreachable = np.flatnonzero(np.isnan(travel).any(axis=1))
    if len(unreachable):
        names = ", ".join(column.names())
        table.fail(f"{names} is a place that no arm reaches: correct it", int(unreachable[0]))
    shown = machine.controller.from_rho(travel, machine.geometry)
    return check_commands(shown, True, machine, table.fail)


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
