"""Campaigns and TCP points from CSV files and data frames."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.geometry import LEGS, Array
from orthoglide.machine_file import Controller, MachineFile, nominal_machine_file
from orthoglide.observations.campaign import Campaign, Setup, derive_approach
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
    "bar": Column(choice({"1": 1, "2": 2, "1.0": 1, "2.0": 2}, "not 1, 2 or empty"), 0),
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
    warnings = table.check_names((*RHO, *TRAVEL, *APPROACH, *POINT, "sigma_mm"), (*commands, *POINT))
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


def _campaign(
    table: Table, name: str, machine: MachineFile, require_readings: bool
) -> Campaign:
    commands = _command_names(table)
    known = (*SETUP_COLUMNS, *ROW_COLUMNS, *RHO, *TRAVEL, *APPROACH)
    needed = ("setup", "leg", "direction", *commands, "gauge_mm")
    readings = ("reading_mm",) if require_readings else ()
    warnings = table.check_names(known, (*needed, *readings))
    setups, setup = _setups(table)
    command = _commands(table, commands, machine)
    row = {key: table.values(key, column) for key, column in _row_columns(table).items()}
    campaign = Campaign(
        name=name,
        setups=setups,
        setup=setup,
        command=command,
        approach=_approach(table, command, np.array(row["order"])),
        time=np.array(row["time_s"]),
        temperature=np.array(row["temperature_C"]),
        load=np.array(row["load_N"]),
        repeat=np.array(row["repeat"]),
        order=np.array(row["order"]),
        posture=tuple(row["posture"]),
        reading=np.array(row["reading_mm"]),
        sigma=np.array(row["sigma_mm"]),
        line=np.array(table.lines),
    )
    if require_readings:
        _require_readings(table, campaign.reading)
    noticed = check_campaign(campaign, machine, table.fail)
    return replace(campaign, warnings=(*warnings, *noticed))


def _row_columns(table: Table) -> dict[str, Column]:
    return ROW_COLUMNS if "order" in table.names else ROW_COLUMNS | {"order": Column(whole(0), 0)}
