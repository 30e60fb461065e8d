"""What the columns of a table hold together: commands, and mountings of instruments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Array
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
    TRAVEL,
    Column,
    at_tool,
)
from orthoglide.observations.table import Table

_UNIQUE_NAME_REMEDY = (
    "give each mounting of a dial a name of its own",
    "give each instrument, each probe or tip, and each state of a plate its own setup",
)
"""What to do about one name of two setups, of dials and of the tool."""

_COMMAND_TOLERANCE = 2e-9  # metres: commands that were rounded to a nanometre
_PLACE_TOLERANCE = 1e-8  # metres: the same of commands and places, each rounded to a nanometre
_PLACE_WITHOUT_HEIGHT = replace(PLACE, empty_value=NAN)  # empty of a place that is to be touched


def native_command_column(names: LegNames) -> Column:
    """Return the columns of a layout's commands: joint coordinates, or travel."""
    return RHO if RHO.name.startswith(names.command) else TRAVEL


def native_command_names(names: LegNames) -> tuple[str, ...]:
    """Return the names of the three columns of a layout's commands."""
    return native_command_column(names).names(names.legs)


def stated_commands(table: Table, machine: MachineFile | None = None) -> Column:
    """Return the columns in which a table states its commands.

    Raises:
        FileError: where it states them in two ways that disagree, or in one of another layout.
    """
    delta = machine is not None and not machine.geometry.dialled
    legs = machine.geometry.leg_names if machine is not None and delta else LEGS
    own, other = (TRAVEL, PLACE) if delta else (RHO, TRAVEL)
    stated = [set(c.names(legs)) & set(table.names) for c in (own, other)]
    if not delta and "travel_a_mm" in table.names:
        table.fail(
            "has the columns of a linear delta: give its machine file, with [layout], by --machine"
        )
    if not stated[1] or (machine is not None and delta and machine.kinematics is None):
        return own
    if not stated[0]:
        return other
    if machine is None or not _commands_agree(table, machine, legs):
        table.fail(
            f"has {own.names(legs)[0]} and {other.names(legs)[0]}, and they disagree: keep those "
            f"of one kind"
            if delta
            else "has both rho_ and travel_ columns: keep the three of one kind"
        )
    return own  # as `compensate` writes them


def _commands_agree(table: Table, machine: MachineFile, legs: tuple[str, str, str]) -> bool:
    """Return whether the commands of a table are the same in both ways in which it states them."""
    if machine.geometry.dialled and not {*RHO.names(), *TRAVEL.names()} <= set(table.names):
        return False
    travelled = machine.controller.to_rho(table.array(TRAVEL, legs), machine.geometry)
    if machine.geometry.dialled or machine.kinematics is None:
        other, within = table.array(RHO), _COMMAND_TOLERANCE
    else:
        other, within = machine.kinematics.travel(table.array(PLACE)), _PLACE_TOLERANCE
    return bool(np.abs(travelled - other).max(initial=0.0) <= within)


def commands(table: Table, column: Column, machine: MachineFile) -> Array:
    """Return the joint coordinates ``(n, 3)``, metres, of a table's commands, or of second ones.

    Raises:
        FileError: for a command that cannot be read, or that the machine cannot reach.
    """
    kinematics = machine.kinematics
    if kinematics is None or column not in (PLACE, COMMANDS[PLACE]):
        given = table.array(column, machine.geometry.leg_names)
        travelled = column in (TRAVEL, COMMANDS[TRAVEL])
        return check_commands(given, travelled, machine, table.fail)
    each = (column, column, _PLACE_WITHOUT_HEIGHT if column is PLACE else column)
    cells = [table.values(c, n) for c, n in zip(each, column.names(), strict=True)]
    travel = kinematics.travel(np.nan_to_num(np.array(cells, dtype=float).T))
    far = np.flatnonzero(np.isnan(travel).any(axis=1))
    if len(far):
        names = ", ".join(column.names())
        table.fail(f"{names} is a place that no arm reaches: correct it", int(far[0]))
    shown = machine.controller.from_rho(travel, machine.geometry)
    return check_commands(shown, True, machine, table.fail)


def awaiting_touch(table: Table, column: Column) -> NDArray[np.bool_]:
    """Return which rows state where to go down and not yet at what height it touched ``(n,)``."""
    if column is not PLACE:
        return np.zeros(len(table.rows), dtype=bool)
    return np.array([not cell for cell in table.cells(PLACE.names()[2])])


def rows_of_kinds(kinds: Sequence[str], test: Callable[[Observation], Any]) -> NDArray[np.bool_]:
    """Return which rows are of a kind that passes a test ``(n,)``, booleans; moves never are."""
    passed = {kind for kind, one in OBSERVATIONS.items() if test(one)}
    return np.array([kind in passed for kind in kinds], dtype=bool)


def column_values(
    table: Table, column: Column, own: NDArray[np.bool_], name: str = ""
) -> list[Any]:
    """Return a column's values in the rows that have it, and None elsewhere."""
    if own.all():
        return table.values(column, name)
    found: list[Any] = [None] * len(own)
    rows = np.flatnonzero(own).tolist()
    for row, value in zip(rows, table.part(rows).values(column, name), strict=True):
        found[row] = value
    return found


def read_setups(table: Table, kinds: Sequence[str]) -> tuple[tuple[Setup, ...], Ints]:
    """Return the mountings in order of appearance, and the place in them of each row's.

    Raises:
        FileError: for a mounting that cannot be, and a name of two.
    """
    cells = {
        name: column_values(table, column, own, name)
        for column in COLUMNS
        if (own := rows_of_kinds(kinds, column.is_fixed_in_setup)).any()
        for name in column.names()
    }
    keys = list(zip(*cells.values(), strict=True))
    first: dict[tuple[Any, ...], int] = {}
    for row, key in enumerate(keys):
        first.setdefault(key, row)
    found = {
        k: _make_setup(table, row, dict(zip(cells, k, strict=True))) for k, row in first.items()
    }
    before: dict[str, tuple[Any, ...]] = {}
    for key, setup in found.items():
        if (other := before.setdefault(setup.name, key)) is not key:
            differing = next(n for n, a, b in zip(cells, key, other, strict=True) if a != b)
            remedy = _UNIQUE_NAME_REMEDY[int(rows_of_kinds(kinds, at_tool).any())]
            table.fail(
                f"setup {setup.name!r} has another {differing} here than on line "
                f"{table.lines[first[other]]}: {remedy}",
                first[key],
            )
    places = {key: place for place, key in enumerate(found)}
    return tuple(found.values()), np.array([places[key] for key in keys])


def _make_setup(table: Table, row: int, cells: Mapping[str, Any]) -> Setup:
    """Return a mounting from its cells by column."""
    values: dict[str, Any] = {}
    for column in COLUMNS:
        own = tuple(cells[name] for name in column.names() if cells.get(name) is not None)
        if column is DIRECTION and own:
            values["axis"], values["sign"] = AXIS_AND_SIGN[own[0]]
        elif own:
            values[column.attribute] = own if column.is_triple else own[0]
    try:
        return Setup(**values)
    except InputError as error:
        table.fail(str(error).removeprefix(f"setup {values['name']!r}: "), row)
