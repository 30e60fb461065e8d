"""The columns of files of readings, in the order of writing.

Reading, checking, writing and the tables of ``docs/files.md`` use these definitions.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from orthoglide import units
from orthoglide.geometry import LEGS
from orthoglide.instruments import (
    OBSERVATIONS,
    SHRINKAGE_BY_MATERIAL,
    TOOL_OFFSET_COLUMNS as BESIDE_NAMES,
    LegDial,
    Observation,
)
from orthoglide.numerals import compact
from orthoglide.units import MM, NOISE_LIMITS, ONE, RAD, Kind, Unit

MAX_ROTATION_SD = 0.1
"""The largest standard deviation of an angle, radians: a level in a telephone shows hundredths."""

MOVE = "move"
"""The kind of a row with a command but no reading."""

_DEG = Unit("deg", 1.0)
_MRAD = RAD.spoken

NAN = float("nan")

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_MAX_LABEL_LENGTH = 100
_MAX_VALUE = 1e9  # in the unit of a column, far beyond any reading


def number_kind(unit: Unit = ONE, low: float = -_MAX_VALUE, high: float = _MAX_VALUE) -> Kind:
    """Return the kind of a number between two limits in its unit; nan is an empty cell."""

    def read(cell: str) -> float:
        if not NUMBER.fullmatch(cell):
            if _NOT_FINITE.fullmatch(cell):
                raise ValueError("not a finite number: measure again, or remove the row")
            raise ValueError("not a number: write it like 12.34, without its unit")
        if not low <= float(cell) <= high:
            raise ValueError(
                f"which is out of range: give a number from {compact(low, 6)} to {compact(high, 6)}"
            )
        return units.to_si(cell, unit.si)

    def write(value: float) -> str:
        return "" if value != value else str(units.from_si(value, unit.si))

    return Kind(read, write, unit.behind.strip())


def integer_kind(low: int) -> Kind:
    """Return the kind of a whole number; ``3.0`` counts as one, as spreadsheets write it."""
    any_number = number_kind()

    def read(cell: str) -> int:
        value = any_number.read(cell)
        if value != int(value) or value < low:
            raise ValueError(f"not a whole number from {low} on: correct it")
        return int(value)

    return Kind(read, str)


def word_kind(meanings: Mapping[str, Any], remedy: str = "", empty_meaning: Any = None) -> Kind:
    """Return the kind of a word with a meaning, which is written as the first word that has it;
    ``remedy``: end of the message for any other word.
    """
    word_of: dict[Any, str] = {}
    for word, meaning in meanings.items():
        word_of.setdefault(meaning, word)
    choices = tuple(word for meaning, word in word_of.items() if meaning != empty_meaning)
    word_of[empty_meaning] = ""

    def read(cell: str) -> Any:
        if cell not in meanings:
            raise ValueError(remedy or f"not one of {', '.join(meanings)}: correct it")
        return meanings[cell]

    return Kind(read, word_of.__getitem__, choices=choices)


def _label(cell: str) -> str:
    if "\n" in cell or "\r" in cell:
        raise ValueError("which has several lines: write it on one")
    if len(cell) > _MAX_LABEL_LENGTH:
        raise ValueError(f"of {len(cell)} characters: shorten it to {_MAX_LABEL_LENGTH}")
    return cell


LABEL = Kind(_label)
"""A name for people."""


@dataclass(frozen=True)
class Column:
    """A column of a file, or three of one quantity."""

    name: str  # in the file; `{leg}` or `{axis}` stands for each leg or base axis
    kind: Kind  # type, unit and range of its cells
    meaning: str  # sentences for the documentation
    attribute: str = ""  # of its values: of `Setup` for columns of setups, else of `Readings`
    empty_value: Any = None  # of an empty cell and an absent column; None if one must be filled in
    applies_to: Callable[[Observation], bool] = lambda observation: True  # kinds that have it
    per_setup: bool = False  # whether its value is fixed in a setup, whatever its kind
    always_written: bool = False  # whether default values are written
    is_text: bool = False  # whether it is text in data frames; numbers otherwise

    def names(self, legs: tuple[str, str, str] = LEGS) -> tuple[str, ...]:
        """Return the names in the file of a machine with these legs."""
        if not self.is_triple:
            return (self.name,)
        letters = zip(legs, LEGS, strict=True)
        return tuple(self.name.format(leg=leg, axis=axis) for leg, axis in letters)

    def is_fixed_in_setup(self, observation: Observation) -> bool:
        """Return whether its value is fixed in a setup of a kind."""
        return self.applies_to(observation) and (
            self.per_setup or self.name in observation.setup_columns
        )

    @property
    def is_triple(self) -> bool:
        """Return whether these are three columns."""
        return "{" in self.name

    @property
    def required(self) -> bool:
        """Return whether its cells must be filled in."""
        return self.empty_value is None


def at_tool(observation: Observation) -> bool:
    """Return whether readings of a kind are of the tool; of a leg otherwise."""
    return not observation.on_leg


def _setup_column(
    name: str,
    kind: Kind,
    meaning: str,
    attribute: str,
    empty: Any = None,
) -> Column:
    """Return a column of setups of the kinds that list it."""
    return Column(
        name, kind, meaning, attribute, empty,
        lambda observation: name in observation.setup_columns, per_setup=True,
    )  # fmt: skip


def _second_command_column(column: Column) -> Column:
    """Return the columns of the second command of readings between two."""
    return replace(
        column,
        name=column.name.replace("}_", "}2_"),
        meaning=f"The second command of a reading between two, as `{column.name}`.",
        attribute="second",
        applies_to=lambda observation: observation.paired,
    )


def _has_unit(unit: str) -> Callable[[Observation], bool]:
    return lambda observation: observation.unit == unit


# fmt: off
KIND = Column("kind", word_kind({kind: kind for kind in (LegDial.kind, MOVE, *OBSERVATIONS)}),
    f"Kind of the reading. In a row of kind `{MOVE}` the machine goes there and nothing is read.",
    "kind", LegDial.kind, per_setup=True, always_written=True, is_text=True)
SETUP = Column("setup", LABEL,
    "Name of the mounting, whose rows share one unknown datum. Names of parameters quote it if it "
    'is `common` or contains `@` or `"`.',
    "name", per_setup=True, is_text=True)
LEG = replace(_setup_column("leg", word_kind({name: leg for leg, name in enumerate(LEGS)}),
    "The leg that is touched.", "leg"), is_text=True)
DIRECTION = Column("direction",
    word_kind({mark + name: mark.strip("+") + name for mark in ("", "-", "+") for name in LEGS}),
    "The base axis along or about which is read, not the leg's own; minus if the instrument counts "
    "against it.", "direction", applies_to=lambda observation: bool(observation.axes),
    is_text=True)
POSTURE = Column("posture", LABEL, "A label for people, which no computation uses.",
    "posture", "", always_written=True, is_text=True)
RHO = Column("rho_{axis}_mm", number_kind(MM),
    "Commanded joint coordinates of an Orthoglide, `r` removed.", "command")
TRAVEL = Column("travel_{leg}_mm", number_kind(MM),
    "Or the commands as the controller shows them; other layouts have these only.", "command")
PLACE = Column("{axis}_mm", number_kind(MM),
    "Or where the controller of a linear delta sends the tool. `z_mm` is empty if a plate is to be "
    "touched there.", "command")
GAUGE = _setup_column("gauge_mm", number_kind(MM),
    "Where the dial stands along the leg's own axis, `r` removed.", "gauge")
GAUGE2 = _setup_column("gauge2_mm", number_kind(MM),
    "Where the second dial stands.", "gauge2")
BAR = _setup_column("bar",
    word_kind({"1": 1, "2": 2, "1.0": 1, "2.0": 2}, "not 1, 2 or empty: correct it", 0),
    "The bar that is touched. If empty, the leg's median line is.", "bar", 0)
REPEAT = Column("repeat", integer_kind(1), "Number of the repetition.", "repeat", 1,
    always_written=True)
ORDER = Column("order", integer_kind(0),
    "Place in the sequence of the machine's moves. If the column is absent, the row counts.",
    "order", always_written=True)
APPROACH = Column("approach_{leg}",
    word_kind({"1": 1, "-1": -1, "+1": 1, "1.0": 1, "-1.0": -1, "+1.0": 1, "0": 0, "0.0": 0},
          "not +1 or -1: give the direction of the axis' last move, or leave the field empty", 0),
    "Direction of each axis' last move; empty: unknown. Without the columns the order gives it.",
    "approach", 0, always_written=True)
TIME = Column("time_s", number_kind(Unit("s", 1.0)), "Time since the start.", "time", NAN)
TEMPERATURE = Column("temperature_C", number_kind(Unit("degrees Celsius", 1.0), -40, 100),
    "Recorded temperature, degrees Celsius.", "temperature", NAN)
LOAD = Column("load_N", number_kind(Unit("N", 1.0), 0, 1e4), "Weight at the TCP.", "load", 0.0)
READINGS = {
    unit.name: Column(f"reading_{unit.name}", number_kind(unit), "What the instrument shows.",
        "reading", NAN, _has_unit(unit.name), always_written=True)
    for unit in (MM, _MRAD)
}
SIGMAS = {
    unit.name: Column(f"sigma_{unit.name}",
        number_kind(
            unit, *(float(units.from_si(v, unit.si)) for v in (NOISE_LIMITS[0], max_sigma))
        ),
        "Standard deviation of this reading.", "sigma", NAN, _has_unit(unit.name))
    for unit, max_sigma in ((MM, NOISE_LIMITS[1]), (_MRAD, MAX_ROTATION_SD))
}
BESIDE = replace(_setup_column(BESIDE_NAMES[0], number_kind(MM),
    "Where the setup is read, from the tool along x, y and z of the platform: a probe beside the "
    "nozzle, or a longer tool.", "beside", 0.0),
    name="beside_{axis}_mm")
TURN = _setup_column("turned_deg", number_kind(_DEG, -360, 360),
    "How far the setup's plate was turned on its seat, counter-clockwise from above.",
    "turned", 0.0)
PART = replace(_setup_column("material",
    word_kind({name: name for name in SHRINKAGE_BY_MATERIAL if name}, empty_meaning=""),
    "Material of the part on which distances are read: `printed` parts are 0.3 ± 0.3 % smaller "
    "than commanded, and all of a file are one; `metal` (a rule, a jig) is true to 0.02 %. If "
    "empty, anything within 1 % is as likely.",
    "material", ""), is_text=True)
FIRMWARE = Column("firmware", LABEL,
    "Mark of the firmware's numbers by which an import computed the travel. If the machine file's "
    "differs, the file is refused.", "", "", at_tool, is_text=True)
POINT = Column("p_{axis}_mm", number_kind(MM),
    "Measured position of the tool. A coordinate that was not measured is empty.", "p", NAN)
# fmt: on

COMMANDS = {column: _second_command_column(column) for column in (RHO, TRAVEL, PLACE)}
"""Ways to state the command, each with the columns of a second one."""

COLUMNS: tuple[Column, ...] = (
    KIND, SETUP, LEG, DIRECTION, POSTURE, *COMMANDS, GAUGE, GAUGE2, BAR, *COMMANDS.values(),
    REPEAT, ORDER, APPROACH, TIME, TEMPERATURE, LOAD, *READINGS.values(), *SIGMAS.values(),
    BESIDE, TURN, PART, FIRMWARE,
)  # fmt: skip
"""The columns of a file of readings, in the order of writing."""

AXIS_AND_SIGN = {mark + name: (axis, sign)
        for mark, sign in (("", 1), ("-", -1)) for axis, name in enumerate(LEGS)}  # fmt: skip
"""Axis and sign of the directions."""


def column_names(columns: Iterable[Column], legs: tuple[str, str, str] = LEGS) -> list[str]:
    """Return the names of columns in the file of a machine with these legs."""
    return [name for column in columns for name in column.names(legs)]


def columns_for_command(command: Column) -> list[Column]:
    """Return the columns of a file that states its commands in one of the ways."""
    others = {*COMMANDS, *COMMANDS.values()} - {command, COMMANDS[command]}
    return [column for column in COLUMNS if column not in others]
