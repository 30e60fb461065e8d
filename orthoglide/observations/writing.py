"""Readings of any kind, measuring sheets and TCP points as rows of text; they read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide import text, units
from orthoglide.geometry import LEGS, Array
from orthoglide.layout import LegNames
from orthoglide.machine_file import AnyMachine, Controller, MachineFile, machine_file_of
from orthoglide.observations.campaign import Campaign
from orthoglide.observations.checks import DECIMALS
from orthoglide.observations.columns import (
    APPROACH,
    APPROACHED,
    BESIDE,
    MM,
    PLACE,
    POINT,
    SECOND_PLACE,
    TRAVELLED,
    TURNED,
    by_leg,
    of_commands,
    second_names,
)
from orthoglide.observations.tcp import TcpPoints
from orthoglide.observations.tool import ToolCampaign

Row = dict[str, str]
"""From column to text."""

Columns = dict[str, Sequence[Any] | None]
"""Cells by column; None where a column says nothing."""

_PLACED = 9  # decimals of a metre, of where a tool is sent
_MOUNTING: tuple[str, ...] = ("setup", "leg", "direction", "gauge_mm", "bar")


def campaign_text(campaign: Campaign | ToolCampaign, machine_file: AnyMachine | None = None) -> str:
    """The CSV text of readings; arguments as for `campaign_rows`."""
    return csv_text(campaign_rows(campaign, machine_file))


def csv_text(rows: Sequence[Mapping[str, str]]) -> str:
    """CSV text of rows that all have the columns of the first."""
    return text.csv_text(list(rows[0]) if rows else [], (row.values() for row in rows))


def command_columns(row: Row) -> list[str]:
    """Columns of the three commands."""
    return [name for name in row if name.startswith(("rho_", "travel_"))]


def campaign_rows(
    campaign: Campaign | ToolCampaign,
    machine_file: AnyMachine | None = None,
    *,
    places: bool = False,
    approaches: bool = False,
) -> list[Row]:
    """The rows of a file of readings, moves included; optional columns only where they say
    something.

    Args:
        campaign: of dials or of the tool; readings that are nan are left empty.
        machine_file: the machine as whose controller shows them commands are written, or its file.
            Where none is given, or it counts as the layout does, they are the campaign's own: joint
            coordinates of an Orthoglide, travel of others.
        places: commands are where the tool is sent, where the machine file knows how its controller
            sends it there.
        approaches: give the approach even where it follows from the order.

    Returns:
        From column to text; all rows have the same columns, in the order of FORMAT's table.
    """
    machine = None if machine_file is None else machine_file_of(machine_file)
    of, angles = _legs(campaign.legs, machine), campaign.angular
    plain, legs = machine is None or machine.controller == Controller(), of.legs
    names = of_commands(of) if plain else by_leg(TRAVELLED, legs)
    if places and machine is not None and machine.kinematics is not None:
        names = PLACE
    timed = np.isfinite(campaign.time).any()
    taken = np.isfinite(campaign.reading)  # the time of a reading not taken yet is none
    columns: Columns = {
        "kind": campaign.kind,
        "setup": [campaign.setups[k].name for k in campaign.setup],
        **dict.fromkeys(("leg", "direction")),
        "posture": campaign.posture,
        **_commands(campaign.command, machine, names),
        **dict.fromkeys(("gauge_mm", "bar", *second_names(names, legs))),
        "repeat": campaign.repeat.tolist(),
        "order": campaign.order.tolist(),
        **_approaches(campaign.approach, legs),
        "time_s": numbers(np.where(taken, campaign.time, np.nan)) if timed else None,
        "temperature_C": _told(numbers(campaign.temperature)),
        "load_N": numbers(campaign.load) if campaign.load.any() else None,
        "reading_mm": None if angles.all() else _numbers_of(~angles, campaign.reading),
        "reading_mrad": _numbers_of(angles, campaign.reading) if angles.any() else None,
        "sigma_mm": _told(_numbers_of(~angles, campaign.sigma)),
        "sigma_mrad": _told(_numbers_of(angles, campaign.sigma)),
    }
    if isinstance(campaign, Campaign):
        own, told = _of_dials(campaign, approaches), _MOUNTING
    else:
        own, told = _of_tool(campaign, machine, names), _MOUNTING[:1]
    rows = rows_of(columns | own)
    moves = rows_of(_commands(campaign.moves.command, machine, names))
    return _with_moves(rows, campaign, moves, told)


def _legs(own: LegNames, machine: MachineFile | None) -> LegNames:
    """Names of a machine's legs; readings' ``own`` where none is given."""
    return own if machine is None else machine.geometry.layout.names


def _of_dials(campaign: Campaign, approaches: bool) -> Columns:
    """The columns that dials on legs have of their own."""
    setups = [campaign.setups[k] for k in campaign.setup]
    derived = not approaches and np.array_equal(campaign.approach, campaign.derived_approach)
    return {
        **({} if len(campaign.moves) else {"kind": None}),
        "leg": [LEGS[s.leg] for s in setups],
        "direction": [s.direction for s in setups],
        "gauge_mm": [units.from_si(s.gauge, MM) for s in setups],
        "bar": _told([str(s.bar or "") for s in setups]),
        **(dict.fromkeys(APPROACH) if derived else {}),
    }


def _of_tool(
    campaign: ToolCampaign, machine: MachineFile | None, names: tuple[str, ...]
) -> Columns:
    """The columns that readings of the tool have of their own."""
    named = [
        ("-" if sign < 0 else "") + LEGS[axis] if campaign.setups[k].instrument.axes else ""
        for axis, sign, k in zip(campaign.axis, campaign.sign, campaign.setup, strict=True)
    ]
    others = second_names(names, _legs(campaign.legs, machine).legs)
    beside = zip(BESIDE, campaign.beside.T, strict=True)
    return {
        "direction": _told(named),
        **(_commands(campaign.second, machine, others) if campaign.paired.any() else {}),
        "firmware": _told([machine.firmware if machine else ""] * len(campaign)),
        **{name: numbers(values, MM) if values.any() else None for name, values in beside},
        TURNED: numbers(campaign.turned_by) if campaign.turned_by.any() else None,
        **(_touches(campaign, machine) if names == PLACE else {}),
    }


def _touches(campaign: ToolCampaign, machine: MachineFile | None) -> Columns:
    """Heights and readings where a plate is still to be touched: the height is what is read."""
    open_ = campaign.touching & np.isnan(campaign.reading)
    if not open_.any():
        return {}
    height = _commands(campaign.command, machine, PLACE)[PLACE[2]]
    read = _numbers_of(~campaign.angular, campaign.reading)
    return {
        PLACE[2]: ["" if is_open else cell for cell, is_open in zip(height, open_, strict=True)],
        "reading_mm": ["0" if is_open else cell for cell, is_open in zip(read, open_, strict=True)],
    }


def tcp_rows(points: TcpPoints, machine_file: AnyMachine | None = None) -> list[Row]:
    """The rows of a file of TCP points; optional columns only where they say something. Commands
    are joint coordinates, or the controller's values of a machine that is no Orthoglide.
    """
    machine = None if machine_file is None else machine_file_of(machine_file)
    legs = _legs(points.legs, machine)
    approach = _approaches(points.approach, legs.legs)
    return rows_of(
        {
            **_commands(points.command, machine, of_commands(legs)),
            **{name: numbers(points.p[:, axis], MM) for axis, name in enumerate(POINT)},
            **(approach if points.approach.any() else {}),
            "sigma_mm": _told(numbers(points.sigma, MM)),
        }
    )


def rows_of(columns: Mapping[str, Sequence[Any] | None]) -> list[Row]:
    """Rows of columns of equal length; without those that are None."""
    said = {name: cells for name, cells in columns.items() if cells is not None}
    cells = zip(*said.values(), strict=True)
    return [dict(zip(said, map(str, row), strict=True)) for row in cells]


def _with_moves(
    rows: list[Row], campaign: Campaign | ToolCampaign, shown: Sequence[Row], told: Sequence[str]
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
        own = {"kind": "move", "posture": "move", "order": str(moves.order[k])}
        found.append((int(moves.line[k]), cells | shown[k] | own))
    return [row for _, row in sorted(found, key=lambda at: at[0])]


def _commands(
    command: Array, machine: MachineFile | None, names: tuple[str, ...]
) -> dict[str, list[str]]:
    """Cells of commands ``(n, 3)`` by their columns: joint coordinates, what the controller of a
    machine shows, or where it sends the tool; nan is empty.
    """
    shown = command
    if names in (PLACE, SECOND_PLACE) and machine is not None and machine.kinematics is not None:
        shown, told = np.full(command.shape, np.nan), np.isfinite(command).all(axis=1)
        shown[told] = np.round(machine.kinematics.places(command[told]), _PLACED) + 0.0
    elif names[0].startswith("travel"):
        if machine is not None:
            shown = machine.controller.from_rho(command, machine.geometry)
        shown = np.round(shown, DECIMALS) + 0.0
    return {name: numbers(shown[:, axis], MM) for axis, name in enumerate(names)}


def _approaches(approach: Array, legs: tuple[str, str, str]) -> dict[str, list[str]]:
    """Cells of directions of the last move ``(n, 3)``; 0 is empty."""
    return {
        name: ["" if v == 0 else f"{v:.0f}" for v in approach[:, axis].tolist()]
        for axis, name in enumerate(by_leg(APPROACHED, legs))
    }


def numbers(values: Array, factor: float = 1.0) -> list[str]:
    """Cells of SI numbers in a unit worth ``factor``; nan is empty."""
    return ["" if np.isnan(v) else str(units.from_si(v, factor)) for v in values.tolist()]


def _numbers_of(chosen: NDArray[np.bool_], values: Array) -> list[str]:
    """Cells of some of the values ``(n,)``, thousandths; the others are empty."""
    return numbers(np.where(chosen, values, np.nan), MM)


def _told(cells: list[str]) -> list[str] | None:
    """Cells, or None where all are empty."""
    return cells if any(cells) else None
