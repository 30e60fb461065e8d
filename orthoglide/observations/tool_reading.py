"""Files of readings of any kind: dials on legs as campaigns, readings of the tool beside them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.geometry import Array
from orthoglide.instruments import INSTRUMENTS
from orthoglide.machine_file import AnyMachine, MachineFile, machine_file_of
from orthoglide.observations.approach import Ints
from orthoglide.observations.campaign import Campaign
from orthoglide.observations.checks import Fail
from orthoglide.observations.columns import (
    APPROACHED,
    BESIDE,
    READING_MRAD,
    RHO,
    ROW_COLUMNS,
    SETUP_COLUMNS,
    SIGMA_MRAD,
    TOOL_COLUMNS,
    TRAVELLED,
    TURNED,
    by_leg,
    command_names,
    commands,
    mountings,
    recorded,
    second_names,
    untouched,
)
from orthoglide.observations.reading import campaign_of_table
from orthoglide.observations.table import Column, Table, choice, read_table, rows_table
from orthoglide.observations.tool import ToolCampaign, ToolSetup

Readings = Campaign | ToolCampaign
"""What one file holds of dials on legs, or of the tool's instruments."""

_KIND = Column(choice({kind: kind for kind in ("leg", "move", *INSTRUMENTS)}), "leg")


def read_readings(
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    *,
    require_readings: bool = True,
) -> tuple[Readings, ...]:
    """Reads a file of readings of any kind.

    Args:
        path: the CSV file, as for `read_campaign`.
        machine_file: the machine whose layout, stroke and controller count, or its file; the
            nominal one if None.
        require_readings: False: a sheet not yet filled in is welcome.

    Returns:
        A campaign of dial readings, readings of the tool, or both.

    Raises:
        FileError: naming the line and what would be right.
    """
    table = read_table(path)
    return readings_of_table(table, Path(table.file).stem, machine_file, require_readings)


def readings_from_rows(
    rows: Sequence[Mapping[str, str]],
    machine_file: AnyMachine | None = None,
    *,
    name: str,
    lines: Sequence[int] = (),
    file: str = "",
    sha256: str = "",
) -> tuple[Readings, ...]:
    """Readings from rows of text, as a result keeps those of its files.

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


def readings_of_table(
    table: Table,
    name: str,
    machine_file: AnyMachine | None,
    require_readings: bool = True,
) -> tuple[Readings, ...]:
    """Readings of any kind from a table of cells; arguments as for `read_readings`."""
    machine = machine_file_of(machine_file)
    kinds = table.values("kind", _KIND)
    of_tool = [k for k, kind in enumerate(kinds) if kind in INSTRUMENTS]
    others = [k for k, kind in enumerate(kinds) if kind not in INSTRUMENTS]
    legs = any(kinds[k] == "leg" for k in others)
    found: list[Readings] = []
    if legs or not of_tool:
        beside = _known(table, machine) if of_tool else ()
        found.append(campaign_of_table(table.part(others), name, machine, require_readings, beside))
    if of_tool:
        own = f"{name}-tool" if legs else name
        rows = table.part(of_tool if legs else range(len(kinds)))  # moves among dials' are theirs
        found.append(_tool(rows, own, machine, require_readings))
    return tuple(found)


def _known(table: Table, machine: MachineFile) -> tuple[str, ...]:
    """Columns that a file with readings of the tool may have."""
    legs, names = machine.geometry.leg_names, command_names(table, machine)
    return (
        *TOOL_COLUMNS, *ROW_COLUMNS, *SETUP_COLUMNS, *names, *second_names(names, legs), *RHO,
        *by_leg(APPROACHED, legs), *by_leg(TRAVELLED, legs), "reading_mrad", "sigma_mrad",
    )  # fmt: skip


def _tool(every: Table, name: str, machine: MachineFile, require_readings: bool) -> ToolCampaign:
    """Readings of the tool from rows of these and of moves."""
    named = every.values("kind", _KIND)
    moved, kinds = [kind == "move" for kind in named], [kind for kind in named if kind != "move"]
    names = command_names(every, machine)
    second = second_names(names, machine.geometry.leg_names)
    reading = [f"reading_{INSTRUMENTS[k].unit}" for k in kinds]
    known = _known(every, machine)
    warnings = every.check_names(known, ("kind", "setup", *names, *dict.fromkeys(reading)))
    _check_firmware(every, machine)
    table, fields = recorded(every, moved, names, machine)
    setups, setup = _setups(table, kinds)
    axis, sign = zip(*_directions(table, kinds), strict=True)
    made = ToolCampaign(
        name=name,
        setups=setups,
        setup=setup,
        axis=np.array(axis),
        sign=np.array(sign, dtype=float),
        second=_second(table, second, kinds, machine),
        warnings=warnings,
        **fields
        | {
            "reading": np.where(
                untouched(table, names), np.nan, _either(table, kinds, "reading", READING_MRAD)
            ),
            "sigma": _either(table, kinds, "sigma", SIGMA_MRAD),
        },
    )
    if require_readings or np.isfinite(made.reading).all():
        check_tool(made, table.fail)
    return made


def _check_firmware(table: Table, machine: MachineFile) -> None:
    """Refuses commands that were computed with other numbers of a firmware than the machine's."""
    for row, mark in enumerate(table.values("firmware", TOOL_COLUMNS["firmware"])):
        if mark and machine.firmware and mark != machine.firmware:
            table.fail(
                f"was imported with other numbers of the firmware ({mark}) than "
                f"{machine.file or 'the machine file'} ({machine.firmware}): take the machine.toml "
                f"of its own import, and leave out the campaigns of the other numbers",
                row,
            )


def _setups(table: Table, kinds: list[Any]) -> tuple[tuple[ToolSetup, ...], Ints]:
    cells = {key: table.values(key, TOOL_COLUMNS[key]) for key in ("setup", *BESIDE, TURNED)}
    beside, turned = list(zip(*(cells[key] for key in BESIDE), strict=True)), cells[TURNED]
    for row, kind in enumerate(kinds):
        if any(beside[row]) and INSTRUMENTS[kind].angular:
            empty = ", ".join(BESIDE)
            table.fail(f"a level shows the same wherever it stands: leave {empty} empty", row)
        if turned[row] and not INSTRUMENTS[kind].touches:
            table.fail(f"only a plate is turned on its seat ({TURNED}), nothing of a {kind}", row)
    first, setup = mountings(
        table,
        cells | {"kind": kinds},
        "give each instrument, each probe or tip, and a plate as it lay then a setup of its own",
    )
    setups = (ToolSetup(cells["setup"][k], kinds[k], beside[k], turned[k]) for k in first)
    return tuple(setups), setup


def _directions(table: Table, kinds: list[Any]) -> list[tuple[int, int]]:
    found = table.values("direction", TOOL_COLUMNS["direction"])
    cells = table.values("direction", Column(str, ""))
    for row, (kind, cell) in enumerate(zip(kinds, cells, strict=True)):
        if INSTRUMENTS[kind].axes and not cell:
            table.fail(f"a reading of kind {kind} needs its direction: x, y or z", row)
    return found


def _second(table: Table, names: tuple[str, ...], kinds: list[Any], machine: MachineFile) -> Array:
    found = np.full((len(kinds), 3), np.nan)
    rows = [k for k, kind in enumerate(kinds) if INSTRUMENTS[kind].paired]
    if not rows:
        return found
    for name in names:
        if name not in table.names:
            table.fail(f"has no column {name}, the second command of a distance: add it")
    found[rows] = commands(table.part(rows), names, machine)
    return found


def _either(table: Table, kinds: list[Any], what: str, mrad: Column) -> Array:
    """A column of millimetres or, for inclinations, of milliradians."""
    lengths = np.array(table.values(f"{what}_mm", ROW_COLUMNS[f"{what}_mm"]))
    angles = np.array(table.values(f"{what}_mrad", mrad))
    return np.where([INSTRUMENTS[kind].angular for kind in kinds], angles, lengths)


def check_tool(campaign: ToolCampaign, fail: Fail) -> None:
    """Refuses readings of the tool that cannot be meant as they stand; ``fail`` raises."""
    empty = np.flatnonzero(np.isnan(campaign.reading))
    if len(empty):
        more = f"; so are {len(empty) - 1} more" if len(empty) > 1 else ""
        fail(f"the reading is empty, or the height of a touch{more}: fill it in or remove the row",
             int(empty[0]))  # fmt: skip
    same = np.flatnonzero(
        (np.abs(campaign.second - campaign.command) < 1e-6).all(axis=1) & (campaign.reading > 0)
    )
    if len(same):
        fail("the two commands of this distance are the same: correct one", int(same[0]))
    short = np.flatnonzero(campaign.paired & (campaign.reading <= 0))
    if len(short):
        fail("a distance must be above 0: correct it", int(short[0]))
    bars = np.flatnonzero(campaign.about_ball)
    # Lengths, not deviations: these are of any sign and near zero.
    length = np.abs(campaign.reading[bars])
    turned = campaign.reading[bars] < 0
    if turned.any() and not turned.all() and length.min() > length.max() / 2:
        wrong = turned if turned.mean() < 0.5 else ~turned
        fail("this length has another sign than the others: correct it", int(bars[wrong][0]))
    metres = np.abs(campaign.reading[campaign.paired])
    if len(metres) and metres.max() < 1e-3:
        fail("all distances are below 1 mm: give millimetres, not metres", 0)
