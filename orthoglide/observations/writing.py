"""Rows, files and data frames of readings and measuring sheets, which all read back."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orthoglide import files, text as texts
from orthoglide.arguments import public
from orthoglide.errors import InputError
from orthoglide.frames import data_frame
from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import LegDial
from orthoglide.machine_file import AnyMachine, Controller, MachineFile, machine_file_of
from orthoglide.observations.checks import DECIMALS
from orthoglide.observations.readings import Readings
from orthoglide.observations.schema import (
    APPROACH,
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
    RHO,
    SIGMAS,
    TIME,
    TRAVEL,
    Column,
    column_names,
    columns_for_command,
)
from orthoglide.observations.table import native_command_column
from orthoglide.observations.tables import concatenated

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, str]
"""From column to text."""

Columns = dict[str, Sequence[str]]
"""Cells by column."""

_TEXT_COLUMNS = {column.name for column in COLUMNS if column.is_text}
_PLACE_DECIMALS = 9  # decimals of a metre, of commanded places of the tool


def campaign_text(
    campaign: Readings | Sequence[Readings],
    machine_file: AnyMachine | None = None,
    *,
    commands_as_places: bool = False,
) -> str:
    """Return the CSV text of readings, with the columns of `campaign_rows`; several tables follow
    each other in one file.

    Raises:
        InputError: if several tables cannot be one file, as `concatenated` says.
    """
    if not isinstance(campaign, Readings):  # lines of several files would be mixed
        campaign = concatenated([replace(table, file="") for table in campaign])
    return csv_text(campaign_rows(campaign, machine_file, commands_as_places=commands_as_places))


def csv_text(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the CSV text of rows that all have the columns of the first."""
    return texts.csv_text(list(rows[0]) if rows else [], (row.values() for row in rows))


def command_columns(row: Row) -> list[str]:
    """Return the names of the columns of the three commands."""
    return [name for name in row if name.startswith(("rho_", "travel_"))]


def campaign_rows(
    campaign: Readings,
    machine_file: AnyMachine | None = None,
    *,
    commands_as_places: bool = False,
    write_approaches: bool = False,
) -> list[Row]:
    """Return the rows of a file of readings, with moves, or a row for each point of the tool.

    Optional columns that contain nothing are left out.

    Args:
        campaign: of dials or of the tool; readings that are nan are left empty.
        machine_file: the machine, or its file; commands are written as its controller shows them.
            Without one, or with a default controller, they are joint coordinates of an
            Orthoglide, travel of others.
        commands_as_places: whether commands are places of the tool, if the kinematics of the
            controller are known.
        write_approaches: whether to write approaches that follow from the order.

    Returns:
        From column to text; all rows have the same columns, in the order of the schema.
    """
    if campaign.by_point:
        return _point_rows(campaign, machine_file)
    machine = None if machine_file is None else machine_file_of(machine_file)
    names = campaign.legs if machine is None else machine.geometry.layout.names
    as_layout = machine is None or machine.controller == Controller()
    command = native_command_column(names) if as_layout else TRAVEL
    if commands_as_places and machine is not None and machine.kinematics is not None:
        command = PLACE
    columns, on_legs = Columns(), bool(campaign.on_legs.all())
    is_read = np.isfinite(campaign.reading)
    if command is PLACE:  # the height of a touch that is still to be taken is what is read
        to_touch = campaign.touching & ~is_read
        campaign = campaign.with_readings(np.where(to_touch, 0.0, campaign.reading))
    observations = [setup.observation for setup in campaign.setups]
    for column in _columns_to_write(campaign, command, on_legs, write_approaches):
        has_column = np.array([column.applies_to(o) for o in observations])[campaign.setup]
        if has_column.any():
            values = _values_of_column(campaign, column, machine)
            columns |= _cells_of_column(column, values, names.legs, has_column)
    if np.isfinite(campaign.time).any():  # readings not taken yet have no time
        columns |= _cells_of_column(TIME, campaign.time, has_column=is_read, always_written=True)
    if machine is not None and machine.firmware and not on_legs:
        columns[FIRMWARE.name] = [machine.firmware] * len(campaign)
    if command is PLACE:
        height = PLACE.names()[2]
        cells = zip(columns[height], to_touch.tolist(), strict=True)
        columns[height] = ["" if pending else cell for cell, pending in cells]
    if not len(campaign.moves):
        return _rows_from_columns(columns)
    commands = _commands_for_file(campaign.moves.command, command, machine)
    moves = _rows_from_columns(_cells_of_column(command, commands, names.legs))
    return _insert_moves(_rows_from_columns(columns), campaign, moves)


def _columns_to_write(
    campaign: Readings, command: Column, on_legs: bool, approaches: bool
) -> Iterator[Column]:
    """Yield the columns that a file may have; a file of dials on legs alone leaves out the default
    kind, and approaches that follow from the order.
    """
    left_out = set()
    if on_legs and not len(campaign.moves) and set(campaign.kind) <= {LegDial.kind}:
        left_out.add(KIND)
    if on_legs and not approaches and np.array_equal(campaign.approach, campaign.derived_approach):
        left_out.add(APPROACH)
    yield from (c for c in columns_for_command(command) if c not in left_out and c.attribute)


def _values_of_column(campaign: Readings, column: Column, machine: MachineFile | None) -> Any:
    """Return the values of a column by reading."""
    if column.per_setup:
        return [getattr(campaign.setups[k], column.attribute) for k in campaign.setup.tolist()]
    values = getattr(campaign, column.attribute)
    if column in (*COMMANDS, *COMMANDS.values()):
        return _commands_for_file(values, column, machine)
    return values


def _cells_of_column(
    column: Column,
    values: Any,
    legs: tuple[str, str, str] = LEGS,
    has_column: NDArray[np.bool_] | None = None,
    always_written: bool = False,
) -> Columns:
    """Return the cells of a column, or of each of three, unless all values ``(n,)`` or ``(n, 3)``
    are the default and need not be written; cells are empty in rows that do not have the column.
    """
    columns = Columns()
    components = np.asarray(values).T if column.is_triple else [values]
    for name, component in zip(column.names(legs), components, strict=True):
        entries = component.tolist() if isinstance(component, np.ndarray) else list(component)
        if has_column is not None and not has_column.all():
            written = zip(entries, has_column.tolist(), strict=True)
            entries = [value if is_written else None for value, is_written in written]
        cells = {v: "" if v is None else column.kind.write(v) for v in dict.fromkeys(entries)}
        is_informative = any(v is not None and v == v and v != column.empty_value for v in cells)
        if is_informative or always_written or column.always_written or column.required:
            columns[name] = [cells[value] for value in entries]
    return columns


def _commands_for_file(command: Array, column: Column, machine: MachineFile | None) -> Array:
    """Return commands ``(n, 3)`` in a column's terms: joint coordinates, values that the controller
    shows, or places of the tool.
    """
    is_place = column in (PLACE, COMMANDS[PLACE])
    if is_place and machine is not None and machine.kinematics is not None:
        shown, rows = np.full(command.shape, np.nan), np.isfinite(command).all(axis=1)
        shown[rows] = np.round(machine.kinematics.places(command[rows]), _PLACE_DECIMALS) + 0.0
        return shown
    if column in (RHO, COMMANDS[RHO]):
        return command
    shown = command if machine is None else machine.controller.from_rho(command, machine.geometry)
    return np.asarray(np.round(shown, DECIMALS) + 0.0)


def _point_rows(readings: Readings, machine_file: AnyMachine | None) -> list[Row]:
    """Return the rows of a file with a row for each point; empty optional columns are left out.

    Commands are joint coordinates of an Orthoglide, and the controller's values of other machines.

    Raises:
        InputError: if there are readings of another kind than coordinates of the tool.
    """
    machine = None if machine_file is None else machine_file_of(machine_file)
    names = readings.legs if machine is None else machine.geometry.layout.names
    points = readings.points()
    column = native_command_column(names)
    commands = _commands_for_file(points.command, column, machine)
    columns = _cells_of_column(column, commands, names.legs)
    columns |= _cells_of_column(POINT, points.p, always_written=True)
    if points.approach.any():
        columns |= _cells_of_column(APPROACH, points.approach, names.legs)
    return _rows_from_columns(columns | _cells_of_column(SIGMAS["mm"], points.sigma))


def _rows_from_columns(columns: Mapping[str, Sequence[str]]) -> list[Row]:
    """Return the rows of columns of equal length."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _insert_moves(rows: list[Row], campaign: Readings, move_rows: Sequence[Row]) -> list[Row]:
    """Return rows of readings and moves by line; a move has the mounting's columns of the next
    reading, for people.
    """
    moves = campaign.moves
    mounting_columns = column_names(c for c in COLUMNS if c.per_setup or c is DIRECTION)
    sequence = np.argsort(campaign.order, kind="stable")
    following = np.searchsorted(campaign.order[sequence], moves.order)
    numbered = list(zip(campaign.line.tolist(), rows, strict=True))
    for k, reading in enumerate(np.minimum(following, len(rows) - 1).tolist()):
        next_row = rows[sequence[reading]]
        cells = {name: cell if name in mounting_columns else "" for name, cell in next_row.items()}
        labels = {KIND.name: MOVE, POSTURE.name: MOVE, ORDER.name: str(moves.order[k])}
        numbered.append((int(moves.line[k]), cells | move_rows[k] | labels))
    return [row for _, row in sorted(numbered, key=lambda entry: entry[0])]


@public
def write_campaign(
    campaign: Readings | Sequence[Readings],
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write readings or a measuring sheet; empty optional columns are left out.

    Args:
        campaign: readings or a sheet, of dials or of the tool; nan is left empty. Several tables
            follow each other in one file.
        path: of the file.
        machine_file: as for `campaign_rows`.
        overwrite: whether an existing file may be replaced.

    Raises:
        FileError: if a file exists and may not be replaced, or cannot be written.
        InputError: if several tables cannot be one file: of different machines, or two with a setup
            of the same name.
    """
    campaigns = campaign if isinstance(campaign, Sequence) else (campaign,)
    if not campaigns or not all(isinstance(one, Readings) and len(one) for one in campaigns):
        raise InputError("give a campaign with readings, or a list of such, to write")
    files.write_file(path, campaign_text(campaign, machine_file), overwrite=overwrite)


@public
def readings_frame(campaign: Readings, machine_file: AnyMachine | None = None) -> pd.DataFrame:
    """Return the rows of a file of readings as a data frame, which ``from_frame`` reads.

    Arguments are as for `write_campaign`. Frames of several kinds may be concatenated.

    Raises:
        InputError: if pandas is not installed.
    """
    rows = campaign_rows(campaign, machine_file, write_approaches=True)

    def value(name: str, cell: str) -> Any:
        return cell if name in _TEXT_COLUMNS else float(cell or "nan")

    names = list(rows[0]) if rows else []
    return data_frame({name: [value(name, row[name]) for row in rows] for name in names})


Readings.to_frame = readings_frame
