"""Campaigns, measuring sheets and TCP points as rows of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from orthoglide import text, units
from orthoglide.geometry import LEGS, Array
from orthoglide.machine_file import Controller, MachineFile
from orthoglide.observations.campaign import Campaign
from orthoglide.observations.checks import DECIMALS
from orthoglide.observations.columns import (
    APPROACH,
    APPROACHED,
    MM,
    POINT,
    RHO,
    TRAVEL,
    TRAVELLED,
    by_leg,
)
from orthoglide.observations.tcp import TcpPoints
from orthoglide.observations.tool import ToolCampaign

Row = dict[str, str]
"""From column to text."""


def campaign_text(campaign: Campaign, machine_file: MachineFile | None = None) -> str:
    """The CSV text of a campaign; arguments as for `campaign_rows`."""
    return csv_text(campaign_rows(campaign, machine_file))


def csv_text(rows: Sequence[Mapping[str, str]]) -> str:
    """CSV text of rows that all have the columns of the first."""
    return text.csv_text(list(rows[0]) if rows else [], (row.values() for row in rows))


def command_columns(row: Row) -> list[str]:
    """Columns of the three commands."""
    return [name for name in row if name.startswith(("rho_", "travel_"))]


def campaign_rows(campaign: Campaign, machine_file: MachineFile | None = None) -> list[Row]:
    """The rows of a campaign's file, moves included.

    Args:
        campaign: readings that are nan are left empty.
        machine_file: where its controller counts in a way of its own, commands are written as the
            controller shows them; joint coordinates otherwise.

    Returns:
        From column to text; all rows have the same columns, in the order of FORMAT's table.
    """
    derived = np.array_equal(campaign.approach, campaign.derived_approach)
    needed = {
        "kind": bool(len(campaign.moves)),
        "bar": any(s.bar for s in campaign.setups),
        **dict.fromkeys(APPROACH, not derived),
        "time_s": bool(np.isfinite(campaign.time).any()),
        "temperature_C": bool(np.isfinite(campaign.temperature).any()),
        "load_N": bool(campaign.load.any()),
        "sigma_mm": bool(np.isfinite(campaign.sigma).any()),
    }
    setups = [campaign.setups[k] for k in campaign.setup]
    taken = np.isfinite(campaign.reading)  # the time of a reading not taken yet is none
    columns: dict[str, Sequence[Any]] = {
        "kind": ["leg"] * len(campaign),
        "setup": [s.name for s in setups],
        "leg": [LEGS[s.leg] for s in setups],
        "direction": [s.direction for s in setups],
        "posture": campaign.posture,
        **_commands(campaign.command, machine_file),
        "gauge_mm": [units.from_si(s.gauge, MM) for s in setups],
        "bar": [s.bar or "" for s in setups],
        "repeat": campaign.repeat.tolist(),
        "order": campaign.order.tolist(),
        **{name: signs(campaign.approach[:, axis]) for axis, name in enumerate(APPROACH)},
        "time_s": numbers(np.where(taken, campaign.time, np.nan)),
        "temperature_C": numbers(campaign.temperature),
        "load_N": numbers(campaign.load),
        "reading_mm": numbers(campaign.reading, MM),
        "sigma_mm": numbers(campaign.sigma, MM),
    }
    rows = rows_of({name: cells for name, cells in columns.items() if needed.get(name, True)})
    told = ("setup", "leg", "direction", "gauge_mm", "bar")
    return with_moves(rows, campaign, _commands(campaign.moves.command, machine_file), told)


def tcp_rows(points: TcpPoints, machine_file: MachineFile | None = None) -> list[Row]:
    """The rows of a file of TCP points; optional columns only where they say something.

    Args:
        points: measured.
        machine_file: of a machine that is no Orthoglide, whose controller's values the commands are
            then; others give joint coordinates.
    """
    legs: tuple[str, str, str] = LEGS
    shown = _commands(points.command, None)
    if machine_file is not None and not machine_file.geometry.dialled:
        legs = machine_file.geometry.leg_names
        shown = shown_commands(points.command, machine_file, by_leg(TRAVELLED, legs))
    columns = shown | {name: numbers(points.p[:, axis], MM) for axis, name in enumerate(POINT)}
    if points.approach.any():
        named = enumerate(by_leg(APPROACHED, legs))
        columns |= {name: signs(points.approach[:, axis]) for axis, name in named}
    if np.isfinite(points.sigma).any():
        columns["sigma_mm"] = numbers(points.sigma, MM)
    return rows_of(columns)


def rows_of(columns: Mapping[str, Sequence[Any]]) -> list[Row]:
    """Rows of columns of equal length."""
    cells = zip(*columns.values(), strict=True)
    return [dict(zip(columns, map(str, row), strict=True)) for row in cells]


def with_moves(
    rows: list[Row],
    campaign: Campaign | ToolCampaign,
    shown: Mapping[str, Sequence[str]],
    told: Sequence[str],
) -> list[Row]:
    """Moves among the readings by line, each with the mounting that it leads to, for people.

    Args:
        rows: of the readings, in their order.
        campaign: the readings.
        shown: cells of the commands of the moves.
        told: columns of the mounting.
    """
    moves = campaign.moves
    if not len(moves):
        return rows
    commands = rows_of(shown)
    sequence = np.argsort(campaign.order, kind="stable")
    following = np.searchsorted(campaign.order[sequence], moves.order)
    found = list(zip(campaign.line.tolist(), rows, strict=True))
    for k, place in enumerate(np.minimum(following, len(rows) - 1).tolist()):
        cells = {n: c if n in told else "" for n, c in rows[sequence[place]].items()}
        own = {"kind": "move", "posture": "move", "order": str(moves.order[k])}
        found.append((int(moves.line[k]), cells | commands[k] | own))
    return [row for _, row in sorted(found, key=lambda at: at[0])]


def _commands(command: Array, machine_file: MachineFile | None) -> dict[str, list[str]]:
    if machine_file is not None and machine_file.controller != Controller():
        return shown_commands(command, machine_file, TRAVEL)
    return {name: numbers(command[:, axis], MM) for axis, name in enumerate(RHO)}


def shown_commands(
    command: Array, machine: MachineFile, names: Sequence[str]
) -> dict[str, list[str]]:
    """Cells of commands ``(n, 3)`` as the machine's controller shows them."""
    shown = np.round(machine.controller.from_rho(command, machine.geometry), DECIMALS) + 0.0
    return {name: numbers(shown[:, axis], MM) for axis, name in enumerate(names)}


def numbers(values: Array, factor: float = 1.0) -> list[str]:
    """Cells of SI numbers in a unit worth ``factor``; nan is empty."""
    return ["" if np.isnan(v) else str(units.from_si(v, factor)) for v in values.tolist()]


def signs(values: Array) -> list[str]:
    """Cells of directions of a move; 0 is empty."""
    return ["" if v == 0 else f"{v:.0f}" for v in values.tolist()]
