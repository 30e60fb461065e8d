"""Readings of any kind, measuring sheets and TCP points as rows, files and data frames, which all
read back.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orthoglide import files, text as texts
from orthoglide.errors import InputError
from orthoglide.frames import data_frame
from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import LegDial
from orthoglide.layout import LegNames
from orthoglide.machine_file import AnyMachine, Controller, MachineFile, machine_file_of
from orthoglide.observations.checks import DECIMALS
from orthoglide.observations.columns import native_command_column
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
    READINGS,
    RHO,
    SETUP,
    SIGMAS,
    TIME,
    TRAVEL,
    Column,
    column_names,
    columns_for_command,
)
from orthoglide.observations.tables import concatenated, renumber_orders, split_legs_and_tool

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, str]
"""From column to text."""

Columns = dict[str, Sequence[str]]
"""Cells by column."""

_TEXT_COLUMNS = {column.name for column in COLUMNS if column.is_text}
_PLACE_DECIMALS = 9  # decimals of a metre, of where a tool is sent


def campaign_text(campaign: Readings, machine_file: AnyMachine | None = None) -> str:
    """The CSV text of readings; arguments as for `campaign_rows`."""
    return csv_text(campaign_rows(campaign, machine_file))


def csv_text(rows: Sequence[Mapping[str, str]]) -> str:
    """CSV text of rows that all have the columns of the first."""
    return texts.csv_text(list(rows[0]) if rows else [], (row.values() for row in rows))


def command_columns(row: Row) -> list[str]:
    """Columns of the three commands."""
    return [name for name in row if name.startswith(("rho_", "travel_"))]


def campaign_rows(
    campaign: Readings,
    machine_file: AnyMachine | None = None,
    *,
    commands_as_places: bool = False,
    write_approaches: bool = False,
) -> list[Row]:
    """The rows of a file of readings, moves included, or a row a point of points of the tool;
    optional columns only where they say something.

    Args:
        campaign: of dials or of the tool; readings that are nan are left empty.
        machine_file: the machine as whose controller shows them commands are written, or its file.
            Where none is given, or it counts as the layout does, they are the campaign's own: joint
            coordinates of an Orthoglide, travel of others.
        commands_as_places: commands are where the tool is sent, where the machine file knows how its controller
            sends it there.
        write_approaches: give the approach even where it follows from the order.

    Returns:
        From column to text; all rows have the same columns, in the order of the schema.
    """
    if campaign.by_point:
        return tcp_rows(campaign, machine_file)
    machine = None if machine_file is None else machine_file_of(machine_file)
    names = _leg_names(campaign.legs, machine)
    plain = machine is None or machine.controller == Controller()
    command = native_command_column(names) if plain else TRAVEL
    if commands_as_places and machine is not None and machine.kinematics is not None:
        command = PLACE
    on_legs, columns = bool(campaign.on_legs.all()), Columns()
    for column in _columns_to_write(campaign, command, on_legs, write_approaches):
        own = np.array([column.applies_to(s.observation) for s in campaign.setups])[campaign.setup]
        if own.any():
            columns |= _cells_of_column(
                column, _values_of_column(campaign, column, machine), names.legs, own
            )
    if np.isfinite(campaign.time).any():  # the time of a reading not taken yet is none
        taken = np.isfinite(campaign.reading)
        columns |= _cells_of_column(
            TIME, campaign.time, rows_with_column=taken, always_written=True
        )
    if machine is not None and machine.firmware and not on_legs:
        columns[FIRMWARE.name] = [machine.firmware] * len(campaign)
    if command is PLACE:
        columns |= _blank_pending_touches(campaign, columns)
    gone = _cells_of_column(
        command, _commands_for_file(campaign.moves.command, command, machine), names.legs
    )
    leads = [c for c in COLUMNS if c is SETUP or (on_legs and (c.per_setup or c is DIRECTION))]
    return _insert_moves(
        rows_from_columns(columns), campaign, rows_from_columns(gone), column_names(leads)
    )


def _leg_names(own: LegNames, machine: MachineFile | None) -> LegNames:
    """Names of a machine's legs; readings' ``own`` where none is given."""
    return own if machine is None else machine.geometry.layout.names


def _columns_to_write(
    campaign: Readings, command: Column, on_legs: bool, approaches: bool
) -> Iterator[Column]:
    """Yield the columns that a file may have; one of dials on legs alone leaves out a kind that is
    plain, and an approach that follows from the order.
    """
    left_out = set()
    if on_legs and not len(campaign.moves) and set(campaign.kind) <= {LegDial.kind}:
        left_out.add(KIND)
    if on_legs and not approaches and np.array_equal(campaign.approach, campaign.derived_approach):
        left_out.add(APPROACH)
    yield from (c for c in columns_for_command(command) if c not in left_out and c.attribute)


def _values_of_column(campaign: Readings, column: Column, machine: MachineFile | None) -> Any:
    """Return the values of a column, of each reading."""
    if column.per_setup:
        values = [getattr(setup, column.attribute) for setup in campaign.setups]
        return [values[place] for place in campaign.setup.tolist()]
    held = getattr(campaign, column.attribute)
    return (
        _commands_for_file(held, column, machine)
        if column in (*COMMANDS, *COMMANDS.values())
        else held
    )


def _cells_of_column(
    column: Column,
    values: Any,
    legs: tuple[str, str, str] = LEGS,
    rows_with_column: NDArray[np.bool_] | None = None,
    always_written: bool = False,
) -> Columns:
    """Return the cells of a column, or of those of three, that state something.

    Args:
        column: of the schema.
        values: ``(n,)``, or ``(n, 3)`` of three columns.
        legs: names of the machine's legs.
        rows_with_column: which rows have it ``(n,)``; all if None. The cells of others are empty.
        always_written: whether it is given even where it states nothing.
    """
    found = Columns()
    each = np.asarray(values).T if column.is_triple else [values]
    for name, one in zip(column.names(legs), each, strict=True):
        given = one.tolist() if isinstance(one, np.ndarray) else list(one)
        if rows_with_column is not None and not rows_with_column.all():
            given = [
                value if has else None
                for value, has in zip(given, rows_with_column.tolist(), strict=True)
            ]
        distinct = dict.fromkeys(given)
        texts = {v: "" if v is None else column.kind.write(v) for v in distinct}
        stated = any(v is not None and v == v and v != column.empty_value for v in distinct)
        if stated or always_written or column.always_written or column.required:
            found[name] = [texts[value] for value in given]
    return found


def _commands_for_file(command: Array, column: Column, machine: MachineFile | None) -> Array:
    """Return commands ``(n, 3)`` as columns state them: joint coordinates, what the controller of a
    machine shows, or where it sends the tool.
    """
    places = column in (PLACE, COMMANDS[PLACE])
    if places and machine is not None and machine.kinematics is not None:
        shown, known = np.full(command.shape, np.nan), np.isfinite(command).all(axis=1)
        shown[known] = np.round(machine.kinematics.places(command[known]), _PLACE_DECIMALS) + 0.0
        return shown
    if column in (RHO, COMMANDS[RHO]):
        return command
    shown = command if machine is None else machine.controller.from_rho(command, machine.geometry)
    return np.asarray(np.round(shown, DECIMALS) + 0.0)


def _blank_pending_touches(campaign: Readings, columns: Columns) -> Columns:
    """Heights and readings where a plate is still to be touched: the height is what is read."""
    waiting = campaign.touching & np.isnan(campaign.reading)
    height, read = PLACE.names()[2], READINGS["mm"].name
    return {
        name: [cell if not waits else there
               for cell, waits in zip(columns[name], waiting.tolist(), strict=True)]
        for name, there in ((height, ""), (read, "0")) if name in columns
    }  # fmt: skip


def tcp_rows(given: Readings, machine_file: AnyMachine | None = None) -> list[Row]:
    """The rows of a file with a row a point; optional columns only where they say something.
    Commands are joint coordinates, or the controller's values of a machine that is no Orthoglide.

    Raises:
        InputError: where there are readings of another kind than coordinates of the tool.
    """
    machine = None if machine_file is None else machine_file_of(machine_file)
    points, names = given.points(), _leg_names(given.legs, machine)
    command = native_command_column(names)
    approach = (
        _cells_of_column(APPROACH, points.approach, names.legs) if points.approach.any() else {}
    )
    return rows_from_columns(
        _cells_of_column(command, _commands_for_file(points.command, command, machine), names.legs)
        | _cells_of_column(POINT, points.p, always_written=True)
        | approach
        | _cells_of_column(SIGMAS["mm"], points.sigma)
    )


def rows_from_columns(columns: Mapping[str, Sequence[str]]) -> list[Row]:
    """Rows of columns of equal length."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _insert_moves(
    rows: list[Row], campaign: Readings, shown: Sequence[Row], told: Sequence[str]
) -> list[Row]:
    """Moves among the readings by line, each with the columns ``told`` of the mounting that it
    leads to, for people.
    """
    moves = campaign.moves
    if not len(moves):
        return rows
    sequence = np.argsort(campaign.order, kind="stable")
    following = np.searchsorted(campaign.order[sequence], moves.order)
    found = list(zip(campaign.line.tolist(), rows, strict=True))
    for k, place in enumerate(np.minimum(following, len(rows) - 1).tolist()):
        cells = {n: c if n in told else "" for n, c in rows[sequence[place]].items()}
        own = {KIND.name: MOVE, POSTURE.name: MOVE, ORDER.name: str(moves.order[k])}
        found.append((int(moves.line[k]), cells | shown[k] | own))
    return [row for _, row in sorted(found, key=lambda at: at[0])]


def readings_text(
    given: Sequence[Readings],
    machine_file: AnyMachine | None = None,
    *,
    commands_as_places: bool = False,
) -> str:
    """The CSV text of one file of readings of several kinds, with a row for each reading; arguments
    as for `campaign_rows`.
    """
    said = {
        "commands_as_places": commands_as_places,
        "write_approaches": len(given) > 1,
    }  # empty is unknown, if one gives them
    every = (replace(one, by_point=False) for one in given)
    rows = [row for one in every for row in campaign_rows(one, machine_file, **said)]
    names = dict.fromkeys(name for row in rows for name in row)
    return csv_text([{name: row.get(name, "") for name in names} for row in rows])


def write_campaign(
    campaign: Readings | Sequence[Readings],
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Writes readings or a measuring sheet; optional columns only where they say something.

    Args:
        campaign: what to write, of dials or of the tool; readings that are nan are left empty.
            Several go into one file, dials first, each in order behind the one before.
        path: where to.
        machine_file: the machine, or its file: where its controller counts in a way of its own,
            commands are written as it shows them; as the campaign has them if None.
        overwrite: whether an existing file may be replaced.

    Raises:
        FileError: where a file stands already and may not be replaced, or none can be written.
        InputError: where several cannot be one file: of different machines, two with dials, or two
            with a setup of the same name.
    """
    several = campaign if isinstance(campaign, Sequence) else (campaign,)
    if not several or not all(isinstance(one, Readings) and len(one) for one in several):
        raise InputError("give a campaign with readings, or a list of such, to write")
    given = [part for one in several for part in split_legs_and_tool(one)]
    if sum(bool(one.on_legs.any()) for one in given) > 1:
        raise InputError("one file has one campaign of dials: write the others to their own files")
    # Dials take all moves of a file for theirs: those behind their readings are nothing to them.
    ordered = sorted(given, key=lambda one: not one.on_legs.any())
    concatenated(ordered)  # refuses what cannot be one file
    if len(several) == 1 and several[0].by_point:
        text = campaign_text(several[0], machine_file)
    else:
        text = readings_text(renumber_orders(ordered), machine_file)
    files.write_file(path, text, overwrite=overwrite)


def readings_frame(campaign: Readings, machine_file: AnyMachine | None = None) -> pd.DataFrame:
    """The rows of the file of readings as a data frame, which ``from_frame`` takes back; arguments
    as for `write_campaign`. Frames of several kinds put together are those of a mixed file.

    Raises:
        InputError: where pandas is not installed.
    """
    rows = campaign_rows(campaign, machine_file, write_approaches=True)

    def value(name: str, cell: str) -> Any:
        return cell if name in _TEXT_COLUMNS else float(cell or "nan")

    names = list(rows[0]) if rows else []
    return data_frame({name: [value(name, row[name]) for row in rows] for name in names})


Readings.to_frame = readings_frame
