"""Campaigns from CSV files, data frames, and rows as results keep them."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.instruments import INSTRUMENTS
from orthoglide.machine_file import AnyMachine, Controller, machine_file_of
from orthoglide.notes import Note
from orthoglide.observations.approach import Ints
from orthoglide.observations.campaign import Campaign, Setup
from orthoglide.observations.checks import check_campaign, check_filled
from orthoglide.observations.columns import (
    APPROACH,
    RHO,
    ROW_COLUMNS,
    SETUP_COLUMNS,
    TRAVEL,
    command_names,
    mountings,
    recorded,
)
from orthoglide.observations.table import Column, Table, frame_table, read_table


def read_campaign(
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    require_readings: bool = True,
) -> Campaign:
    """Reads a campaign and looks for faults that need no fit.

    Args:
        path: the CSV file (UTF-8; commas, or semicolons with decimal points or commas).
        machine_file: the machine whose stroke, dial and controller count, or its file; the nominal
            one if None.
        require_readings: False: a sheet not yet filled in is welcome.

    Returns:
        The campaign, with what was noticed and is no error in ``warnings``.

    Raises:
        FileError: naming the line and what would be right.
    """
    table = read_table(path)
    return campaign_of_table(table, Path(table.file).stem, machine_file, require_readings)


Given = Campaign | str | os.PathLike[str]
"""A campaign, or the path of its file."""


def campaign_from_frame(
    df: Any,
    *,
    name: str = "frame",
    machine_file: AnyMachine | None = None,
    controller: Controller | None = None,
    require_readings: bool = True,
) -> Campaign:
    """A campaign from a data frame with the columns of a campaign file.

    Args:
        df: a pandas data frame, or a mapping of columns; missing values are empty fields.
        name: the campaign's name.
        machine_file: as for `read_campaign`.
        controller: to convert ``travel_*_mm``; the machine file's if None.
        require_readings: as for `read_campaign`.

    Raises:
        FileError: as `read_campaign`, rows counted as lines of a file with a header.
    """
    machine = machine_file_of(machine_file)
    if controller is not None:
        machine = replace(machine, controller=controller)
    found = campaign_of_table(frame_table(df, name), name, machine, require_readings)
    return replace(found, file="")


Campaign.from_frame = staticmethod(campaign_from_frame)


def campaign_of_table(
    table: Table,
    name: str,
    machine_file: AnyMachine | None,
    require_readings: bool = True,
    others: tuple[str, ...] = (),
) -> Campaign:
    """A campaign of dial readings from a table of cells, in which ``others`` are columns of other
    readings of its file.

    Raises:
        FileError: naming the line and what would be right.
    """
    machine = machine_file_of(machine_file)
    if of_tool := set(INSTRUMENTS).intersection(table.values("kind", Column(str, ""))):
        table.fail(
            f"holds readings at the tool ({', '.join(sorted(of_tool))}), and is no campaign of "
            f"dials on legs alone: read it with og.read_readings"
        )
    moved = table.values("kind", ROW_COLUMNS["kind"])
    if not machine.geometry.dialled:
        table.fail(
            f"dials on the legs are read on an Orthoglide only, and this machine's layout is "
            f"{machine.geometry.layout.kind}: name the kind of the reading in column kind "
            f"({', '.join(INSTRUMENTS)})",
            int(np.argmin(moved)),
        )
    names = command_names(table)
    known = (*SETUP_COLUMNS, *ROW_COLUMNS, *RHO, *TRAVEL, *APPROACH, *others)
    needed = ("setup", "leg", "direction", *names, "gauge_mm")
    readings = ("reading_mm",) if require_readings else ()
    warnings = table.check_names(known, (*needed, *readings))
    if all(moved):
        table.fail("has moves only: add rows with readings", 0)
    read, fields = recorded(table, moved, names, machine)
    setups, setup = _setups(read)
    campaign = Campaign(name=name, setups=setups, setup=setup, **fields)
    if require_readings:
        check_filled(campaign.reading, read.fail)
    noticed = check_campaign(campaign, machine, read.fail)
    unread = _moves_with_readings(table.part(np.flatnonzero(moved).tolist()))
    return replace(campaign, warnings=(*warnings, *unread, *noticed))


def _moves_with_readings(moves: Table) -> tuple[Note, ...]:
    read = [k for k, cell in enumerate(moves.values("reading_mm", Column(str, ""))) if cell]
    if not read:
        return ()
    lines = tuple(moves.lines[k] for k in read)
    return (
        Note(
            f"the reading of line {', '.join(map(str, lines))} was ignored: a row of kind move "
            "is gone through, not read",
            "reading",
            lines,
        ),
    )


def _setups(table: Table) -> tuple[tuple[Setup, ...], Ints]:
    """The mountings in order of appearance, and the place in them of each row's."""
    cells = {key: table.values(key, column) for key, column in SETUP_COLUMNS.items()}
    for row, (leg, direction) in enumerate(zip(cells["leg"], cells["direction"], strict=True)):
        if leg == direction[0]:
            table.fail("direction is the leg's own axis: name one across the leg", row)
    first, setup = mountings(table, cells, "give each mounting of a dial a name of its own")
    setups = tuple(
        Setup(
            name=cells["setup"][row],
            leg=cells["leg"][row],
            axis=cells["direction"][row][0],
            sign=cells["direction"][row][1],
            gauge=cells["gauge_mm"][row],
            bar=cells["bar"][row],
        )
        for row in first
    )
    return setups, setup
