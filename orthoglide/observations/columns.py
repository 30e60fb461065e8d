"""The columns of campaign and TCP files: names, parsers, and the commands among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import INSTRUMENTS
from orthoglide.layout import LegNames
from orthoglide.machine_file import MachineFile
from orthoglide.observations.approach import Ints, Moves, derive_approach, overshoot
from orthoglide.observations.checks import check_commands, check_sequence
from orthoglide.observations.table import (
    DIRECTION,
    LEG,
    SIGN,
    Column,
    Table,
    choice,
    label,
    number,
    positive,
    whole,
)
from orthoglide.units import NOISE

MM = 1e-3
NAN = float("nan")

TRAVELLED, APPROACHED = "travel_{}_mm", "approach_{}"
"""Columns of the controller's values, and of each drive's last move."""


PLACE, SECOND_PLACE = ("x_mm", "y_mm", "z_mm"), ("x2_mm", "y2_mm", "z2_mm")
"""Columns of where a delta's controller was sent, and of a distance's second place."""


def by_leg(column: str, legs: tuple[str, str, str] = LEGS) -> tuple[str, ...]:
    """The three columns of a quantity that every leg, or base axis, has."""
    return tuple(column.format(leg) for leg in legs)


def of_commands(names: LegNames) -> tuple[str, ...]:
    """The three columns of commands: joint coordinates of the Orthoglide, travel of others."""
    return by_leg(f"{names.command}_{{}}_mm", names.legs)


RHO, TRAVEL = by_leg("rho_{}_mm"), by_leg(TRAVELLED)
APPROACH, POINT = by_leg(APPROACHED), by_leg("p_{}_mm")

SETUP_COLUMNS: dict[str, Column] = {
    "setup": Column(label),
    "leg": Column(LEG),
    "direction": Column(DIRECTION),
    "gauge_mm": Column(number(MM)),
    "bar": Column(choice({"1": 1, "2": 2, "1.0": 1, "2.0": 2}, "not 1, 2 or empty: correct it"), 0),
}
"""What one mounting of one dial has once and for all."""

ROW_COLUMNS: dict[str, Column] = {
    "kind": Column(choice({"leg": False, "move": True}), False),
    "posture": Column(label, ""),
    "repeat": Column(whole(1), 1),
    "order": Column(whole(0)),
    "time_s": Column(number(), NAN),
    "temperature_C": Column(number(low=-40, high=100), NAN),
    "load_N": Column(number(low=0, high=1e4), 0.0),
    "reading_mm": Column(number(MM), NAN),
    "sigma_mm": Column(positive(MM, NOISE[1]), NAN),
}
"""What each row has of its own, besides its command and approach; of ``kind``: is it a move?"""

_COMMAND = Column(number(MM))
_HEIGHT = Column(number(MM), NAN)  # empty of a place that is to be touched
_ROUNDED = 2e-9  # metres: commands that were rounded to a nanometre
_PLACED = 1e-8  # metres: the same of commands and places, each rounded to a nanometre
DIRECTION_OF_MOVE = Column(SIGN, 0)

BESIDE = ("beside_x_mm", "beside_y_mm", "beside_z_mm")
"""Where a probe touches or a tip stands, from the tool on the platform."""

TURNED = "turned_deg"
"""How far a plate was turned on its seat, counter-clockwise from above."""

TOOL_COLUMNS: dict[str, Column] = {
    "kind": Column(choice({kind: kind for kind in INSTRUMENTS})),
    "setup": Column(label),
    "direction": Column(DIRECTION, (0, 1)),
    "firmware": Column(label, ""),
    **dict.fromkeys(BESIDE, Column(number(MM), 0.0)),
    TURNED: Column(number(low=-360, high=360), 0.0),
}
"""What rows of the tool have besides those of `ROW_COLUMNS`."""

TURNS = 0.1
"""The largest standard deviation of a turn, radians: a level in a telephone shows hundredths."""

READING_MRAD = Column(number(MM), NAN)
SIGMA_MRAD = Column(positive(MM, TURNS), NAN)


def command_names(table: Table, machine: MachineFile | None = None) -> tuple[str, ...]:
    """The three columns that hold the commands: joint coordinates or the controller's values."""
    if machine is not None and not machine.geometry.dialled:
        own = of_commands(machine.geometry.layout.names)
        if not set(PLACE) & set(table.names) or machine.kinematics is None:
            return own
        if not set(own) & set(table.names):
            return PLACE
        travel, p = (columns(table, names, _COMMAND) for names in (own, PLACE))
        apart = machine.controller.to_rho(travel, machine.geometry) - machine.kinematics.travel(p)
        if not np.abs(apart).max(initial=0.0) <= _PLACED:
            table.fail(f"has {own[0]} and {PLACE[0]}, and they disagree: keep those of one kind")
        return own  # as `compensate` writes them
    if "travel_a_mm" in table.names:
        table.fail(
            "has the columns of a linear delta: give its machine file, with [layout], by --machine"
        )
    if set(RHO) & set(table.names) and set(TRAVEL) & set(table.names):
        if machine is not None and _agree(table, machine):  # as `compensate` writes them
            return RHO
        table.fail("has both rho_ and travel_ columns: keep the three of one kind")
    return TRAVEL if set(TRAVEL) & set(table.names) else RHO


def _agree(table: Table, machine: MachineFile) -> bool:
    """Whether a table's commands are the same by both ways to count them."""
    if not {*RHO, *TRAVEL} <= set(table.names):
        return False
    rho, shown = (columns(table, names, _COMMAND) for names in (RHO, TRAVEL))
    apart = machine.controller.to_rho(shown, machine.geometry) - rho
    return bool(np.abs(apart).max(initial=0.0) <= _ROUNDED)


def columns(table: Table, names: tuple[str, ...], column: Column) -> Array:
    """Several columns of numbers ``(n, k)``."""
    return np.array([table.values(name, column) for name in names], dtype=float).T


def recorded(
    table: Table, moved: ArrayLike, names: tuple[str, ...], machine: MachineFile
) -> tuple[Table, dict[str, Any]]:
    """The rows with readings, and what they have of their own as fields of a campaign.

    The order is that of the rows where no column says; the approach as recorded, where it was, else
    from the sequence.

    Args:
        table: of readings and moves.
        moved: which rows are moves ``(n,)``, booleans.
        names: columns of the commands.
        machine: whose stroke and controller count.
    """
    command, order = commands(table, names, machine), np.arange(1, len(table.rows) + 1)
    if "order" in table.names:
        order = np.array(table.values("order", ROW_COLUMNS["order"]))
    check_sequence(command, order, table.lines, table.fail)
    gone = np.asarray(moved, dtype=bool)
    beyond = overshoot(machine.geometry.stroke)
    moves = Moves(command[gone], order[gone], np.array(table.lines)[gone], beyond)
    command, order = command[~gone], order[~gone]
    read = table.part(np.flatnonzero(~gone).tolist())
    approach = by_leg(APPROACHED, machine.geometry.leg_names)
    given = [name in table.names for name in approach]
    told = columns(read, approach, DIRECTION_OF_MOVE)
    own = {key: column for key, column in ROW_COLUMNS.items() if key != "kind"}
    found = {key.partition("_")[0]: read.values(key, column) for key, column in own.items()}
    return read, found | {
        "command": command,
        "order": order,
        "moves": moves,
        "approach": np.where(given, told, derive_approach(command, order, moves)),
        "posture": tuple(found["posture"]),
        "line": read.lines,
        "file": read.file,
        "sha256": read.sha256,
        "legs": machine.geometry.layout.names,
    }


def mountings(
    table: Table, cells: Mapping[str, Sequence[Any]], remedy: str
) -> tuple[tuple[int, ...], Ints]:
    """First row of every setup, in order of appearance, and the place among them of each row's.

    Args:
        table: of readings.
        cells: what a mounting has once and for all, by column, ``setup`` among them.
        remedy: where a setup is told to be two.
    """
    first: dict[str, int] = {}
    for row, name in enumerate(cells["setup"]):
        before = first.setdefault(name, row)
        for key, values in cells.items():
            if values[row] != values[before]:
                table.fail(
                    f"setup {name!r} has another {key} here than on line {table.lines[before]}: "
                    f"{remedy}",
                    row,
                )
    places = {name: place for place, name in enumerate(first)}
    return tuple(first.values()), np.array([places[name] for name in cells["setup"]])


def commands(table: Table, names: tuple[str, ...], machine: MachineFile) -> Array:
    """Joint coordinates ``(n, 3)``, metres, of a table's commands, all within the stroke."""
    if names == PLACE:
        height = np.nan_to_num(columns(table, names[2:], _HEIGHT))
        given = np.hstack([columns(table, names[:2], _COMMAND), height])
    else:
        given = columns(table, names, _COMMAND)
    travelled = names[0].startswith("travel")
    if names[0] in (PLACE[0], SECOND_PLACE[0]) and (kinematics := machine.kinematics):
        travel = kinematics.travel(given)
        far = np.flatnonzero(np.isnan(travel).any(axis=1))
        if len(far):
            table.fail(
                f"{', '.join(names)} is a place that no arm reaches: correct it", int(far[0])
            )
        given, travelled = machine.controller.from_rho(travel, machine.geometry), True
    return check_commands(given, travelled, machine, table.fail)


def untouched(table: Table, names: tuple[str, ...]) -> NDArray[np.bool_]:
    """Which rows say where to go down, and not yet at what height it touched ``(n,)``."""
    if names != PLACE:
        return np.zeros(len(table.rows), dtype=bool)
    return np.isnan(columns(table, names[2:], _HEIGHT)[:, 0])


def second_names(names: tuple[str, ...], legs: tuple[str, str, str]) -> tuple[str, ...]:
    """The three columns of a distance's second command, as its first has its own."""
    if names == PLACE:
        return SECOND_PLACE
    return by_leg(names[0].partition("_")[0] + "_{}2_mm", legs)
