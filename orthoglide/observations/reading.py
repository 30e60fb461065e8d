"""Campaigns and TCP points from CSV files and data frames."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Array
from orthoglide.machine_file import Controller, MachineFile, nominal_machine_file
from orthoglide.observations.campaign import Campaign, Ints, Setup, derive_approach
from orthoglide.observations.checks import check_campaign, check_commands, check_tcp
from orthoglide.observations.table import (
    DIRECTION,
    LEG,
    SIGN,
    Column,
    Table,
    choice,
    frame_table,
    number,
    positive,
    read_table,
    whole,
)
from orthoglide.observations.tcp import TcpPoints

MM = 1e-3
NAN = float("nan")

RHO = tuple(f"rho_{leg}_mm" for leg in LEGS)
TRAVEL = tuple(f"travel_{leg}_mm" for leg in LEGS)
APPROACH = tuple(f"approach_{leg}" for leg in LEGS)
POINT = tuple(f"p_{leg}_mm" for leg in LEGS)

SETUP_COLUMNS: dict[str, Column] = {
    "setup": Column(str),
    "leg": Column(LEG),
    "direction": Column(DIRECTION),
    "gauge_mm": Column(number(MM)),
    "bar": Column(choice({"1": 1, "2": 2, "1.0": 1, "2.0": 2}, "not 1, 2 or empty: correct it"), 0),
}
"""What one mounting of one dial has once and for all."""

ROW_COLUMNS: dict[str, Column] = {
    "posture": Column(str, ""),
    "repeat": Column(whole(1), 1),
    "order": Column(whole(0)),
    "time_s": Column(number(), NAN),
    "temperature_C": Column(number(low=-40, high=100), NAN),
    "load_N": Column(number(low=0, high=1e4), 0.0),
    "reading_mm": Column(number(MM), NAN),
    "sigma_mm": Column(positive(MM), NAN),
}
"""What each reading has of its own, besides its command and approach."""

_COMMAND = Column(number(MM))
_APPROACH = Column(SIGN, 0)
_COORDINATE = Column(number(MM), NAN)


def read_campaign(
    path: str | os.PathLike[str],
    machine_file: MachineFile | None = None,
    require_readings: bool = True,
) -> Campaign:
    """Reads a campaign and looks for faults that need no fit.

    Args:
        path: the CSV file (UTF-8; commas, or semicolons with decimal points or commas).
        machine_file: whose stroke, dial and controller count; the nominal one if None.
        require_readings: False: a sheet not yet filled in is welcome.

    Returns:
        The campaign, with what was noticed and is no error in ``warnings``.

    Raises:
        FileError: naming the line and what would be right.
    """
    table = read_table(path)
    machine = machine_file or nominal_machine_file()
    campaign = _campaign(table, Path(path).stem, machine, require_readings)
    return replace(campaign, file=str(path), sha256=table.sha256)


Given = Campaign | str | os.PathLike[str]
"""A campaign, or the path of its file."""


def as_campaigns(
    given: Given | Iterable[Given], machine_file: MachineFile | None = None
) -> tuple[Campaign, ...]:
    """One or several campaigns; paths are read by :func:`read_campaign`.

    Raises:
        FileError: as :func:`read_campaign`.
        InputError: where there is none.
    """
    several = (given,) if isinstance(given, Campaign | str | os.PathLike) else tuple(given)
    if not several:
        raise InputError("there is no campaign: give at least one file of readings")
    return tuple(
        read_campaign(one, machine_file) if isinstance(one, str | os.PathLike) else one
        for one in several
    )


def campaign_from_frame(
    df: Any,
    *,
    name: str = "frame",
    machine_file: MachineFile | None = None,
    controller: Controller | None = None,
    require_readings: bool = True,
) -> Campaign:
    """A campaign from a data frame: see `Campaign.from_frame`."""
    machine = machine_file or nominal_machine_file()
    if controller is not None:
        machine = replace(machine, controller=controller)
    return _campaign(frame_table(df, name), name, machine, require_readings)


def read_tcp(path: str | os.PathLike[str], machine_file: MachineFile | None = None) -> TcpPoints:
    """Reads TCP points.

    Args:
        path: the CSV file, as for `read_campaign`.
        machine_file: whose stroke and controller count; the nominal one if None.

    Returns:
        The points; a coordinate left empty is nan.

    Raises:
        FileError: naming the line and what would be right.
    """
    table = read_table(path)
    commands = _command_names(table)
    warnings = table.check_names(
        (*RHO, *TRAVEL, *APPROACH, *POINT, "sigma_mm"), (*commands, *POINT)
    )
    points = TcpPoints(
        command=_commands(table, commands, machine_file or nominal_machine_file()),
        p=_columns(table, POINT, _COORDINATE),
        sigma=np.array(table.values("sigma_mm", ROW_COLUMNS["sigma_mm"])),
        approach=_columns(table, APPROACH, _APPROACH),
        line=np.array(table.lines),
        file=str(path),
        sha256=table.sha256,
        warnings=warnings,
    )
    check_tcp(points, table.fail)
    return points


def _campaign(table: Table, name: str, machine: MachineFile, require_readings: bool) -> Campaign:
    commands = _command_names(table)
    known = (*SETUP_COLUMNS, *ROW_COLUMNS, *RHO, *TRAVEL, *APPROACH)
    needed = ("setup", "leg", "direction", *commands, "gauge_mm")
    readings = ("reading_mm",) if require_readings else ()
    warnings = table.check_names(known, (*needed, *readings))
    setups, setup = _setups(table)
    command = _commands(table, commands, machine)
    row: dict[str, Any] = {key: table.values(key, column) for key, column in ROW_COLUMNS.items()}
    if "order" not in table.names:
        row["order"] = range(1, len(table.rows) + 1)
    fields: dict[str, Any] = {
        key.partition("_")[0]: np.array(row[key]) for key in row if key != "posture"
    }
    campaign = Campaign(
        name=name,
        setups=setups,
        setup=setup,
        command=command,
        approach=_approach(table, command, fields["order"]),
        posture=tuple(row["posture"]),
        line=np.array(table.lines),
        **fields,
    )
    if require_readings:
        _require_readings(table, campaign.reading)
    noticed = check_campaign(campaign, machine, table.fail)
    return replace(campaign, warnings=(*warnings, *noticed))


def _command_names(table: Table) -> tuple[str, ...]:
    """The three columns that hold the commands: joint coordinates or the controller's values."""
    if set(RHO) & set(table.names) and set(TRAVEL) & set(table.names):
        table.fail("has both rho_ and travel_ columns: keep the three of one kind")
    return TRAVEL if set(TRAVEL) & set(table.names) else RHO


def _columns(table: Table, names: tuple[str, ...], column: Column) -> Array:
    return np.array([table.values(name, column) for name in names], dtype=float).T


def _commands(table: Table, names: tuple[str, ...], machine: MachineFile) -> Array:
    return check_commands(_columns(table, names, _COMMAND), names == TRAVEL, machine, table.fail)


def _approach(table: Table, command: Array, order: Ints) -> Array:
    """Approach as recorded; axes without a column get theirs from the sequence."""
    recorded = _columns(table, APPROACH, _APPROACH)
    given = [name in table.names for name in APPROACH]
    return np.where(given, recorded, derive_approach(command, order))


def _setups(table: Table) -> tuple[tuple[Setup, ...], Ints]:
    """The mountings in order of appearance, and the place in them of each row's."""
    cells = {key: table.values(key, column) for key, column in SETUP_COLUMNS.items()}
    first: dict[str, int] = {}
    for row, name in enumerate(cells["setup"]):
        before = first.setdefault(name, row)
        for key, values in cells.items():
            if values[row] != values[before]:
                table.fail(
                    f"setup {name!r} has another {key} here than on line {table.lines[before]}: "
                    "give each mounting of a dial a name of its own",
                    row,
                )
        if cells["leg"][row] == cells["direction"][row][0]:
            table.fail("direction is the leg's own axis: name one across the leg", row)
    setups = tuple(
        Setup(
            name=name,
            leg=cells["leg"][row],
            axis=cells["direction"][row][0],
            sign=cells["direction"][row][1],
            gauge=cells["gauge_mm"][row],
            bar=cells["bar"][row],
        )
        for name, row in first.items()
    )
    places = {name: place for place, name in enumerate(first)}
    return setups, np.array([places[name] for name in cells["setup"]])


def _require_readings(table: Table, reading: Array) -> None:
    empty = np.flatnonzero(np.isnan(reading))
    if len(empty) == len(reading):
        table.fail("has no readings yet: fill in reading_mm", 0)
    if len(empty):
        table.fail("reading_mm is empty: fill it in or remove the row", int(empty[0]))
