"""The columns of files of readings, each stated once, in the order of writing.

Reading, checking and writing use these columns, and the tables of ``docs/files.md`` are printed
from them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from orthoglide import units
from orthoglide.geometry import LEGS
from orthoglide.instruments import (
    BESIDE as BESIDE_NAMES,
    MATERIAL,
    OBSERVATIONS,
    SIZES,
    TURNED,
    LegDial,
    Observation,
)
from orthoglide.numerals import compact
from orthoglide.quantities import Kind
from orthoglide.units import MM, NOISE, ONE, RAD, Unit

TURNS = 0.1
"""The largest standard deviation of a turn, radians: a level in a telephone shows hundredths."""

MOVE = "move"
"""The kind of a row that is a command which the machine goes through without a reading."""

_DEG = Unit("deg", 1.0)
_MRAD = RAD.spoken

NAN = float("nan")

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_LONGEST_LABEL = 100
_LARGEST = 1e9  # in the unit of a column, far beyond any reading


def number(unit: Unit = ONE, low: float = -_LARGEST, high: float = _LARGEST) -> Kind:
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

    unlimited = (low, high) == (-_LARGEST, _LARGEST)
    return Kind(
        "a number" if unlimited else f"{compact(low, 6)} to {compact(high, 6)}",
        read,
        write,
        unit.behind.strip(),
    )


def whole(low: int) -> Kind:
    """Return the kind of a whole number; ``3.0`` counts as one, as spreadsheets write it."""
    any_number = number()

    def read(cell: str) -> int:
        value = any_number.read(cell)
        if value != int(value) or value < low:
            raise ValueError(f"not a whole number from {low} on: correct it")
        return int(value)

    return Kind(f"a whole number from {low} on", read, str)


def words(meanings: Mapping[str, Any], remedy: str = "", nothing: Any = None) -> Kind:
    """Return the kind of a word that has a meaning; a meaning is written as its first word.

    Args:
        meanings: from word to meaning.
        remedy: of any other word, behind the word.
        nothing: the meaning of an empty cell.
    """
    shown: dict[Any, str] = {}
    for word, meaning in meanings.items():
        shown.setdefault(meaning, word)
    allowed = ", ".join(f"`{word}`" for meaning, word in shown.items() if meaning != nothing)
    shown[nothing] = ""

    def read(cell: str) -> Any:
        if cell not in meanings:
            raise ValueError(
                remedy or f"which is none of {', '.join(meanings)}: write one of these"
            )
        return meanings[cell]

    return Kind(allowed, read, shown.__getitem__)


def _label(cell: str) -> str:
    if "\n" in cell or "\r" in cell:
        raise ValueError("which has several lines: write it on one")
    if len(cell) > _LONGEST_LABEL:
        raise ValueError(f"of {len(cell)} characters: shorten it to {_LONGEST_LABEL}")
    return cell


LABEL = Kind(f"one line, up to {_LONGEST_LABEL} characters", _label)
"""A name for people."""


@dataclass(frozen=True)
class Column:
    """A column of a file, or three of one quantity.

    Attributes:
        name: in the file; ``{leg}`` or ``{axis}`` stands for each leg or base axis.
        kind: what its cells are.
        meaning: sentences for the documentation.
        attribute: what holds its values: of a `Setup` where the column is of setups, else of
            `Readings`.
        empty: the value of an empty cell and of an absent column; None if cells must be filled in.
        of: whether readings of a kind have it.
        of_setup: whether a mounting has it once and for all, whatever its kind.
        always: whether it is written even where it states nothing.
        text: whether it is text in data frames; numbers otherwise.
    """

    name: str
    kind: Kind
    meaning: str
    attribute: str = ""
    empty: Any = None
    of: Callable[[Observation], bool] = lambda observation: True
    of_setup: bool = False
    always: bool = False
    text: bool = False

    def names(self, legs: tuple[str, str, str] = LEGS) -> tuple[str, ...]:
        """Return the names in the file of a machine with these legs."""
        if not self.spread:
            return (self.name,)
        each = zip(legs, LEGS, strict=True)
        return tuple(self.name.format(leg=leg, axis=axis) for leg, axis in each)

    def fixed(self, observation: Observation) -> bool:
        """Return whether a mounting of a kind has it once and for all."""
        return self.of(observation) and (self.of_setup or self.name in observation.of_setup)

    @property
    def spread(self) -> bool:
        """Return whether these are three columns."""
        return "{" in self.name

    @property
    def required(self) -> bool:
        """Return whether readings that have it need it."""
        return self.empty is None


def at_tool(observation: Observation) -> bool:
    """Return whether readings of a kind are of the tool; of a leg otherwise."""
    return not observation.on_leg


def _of_mounting(
    name: str, kind: Kind, meaning: str, attribute: str, empty: Any = None, every: bool = False
) -> Column:
    """Return a column of mountings: of the kinds that list it, or of all kinds of the tool."""
    of = at_tool if every else lambda observation: name in observation.of_setup
    return Column(name, kind, meaning, attribute, empty, of, of_setup=True)


def _second(column: Column) -> Column:
    """Return the columns of the second command of readings between two."""
    return replace(
        column,
        name=column.name.replace("}_", "}2_"),
        meaning=f"The second command of a reading between two, as `{column.name}`.",
        attribute="second",
        of=lambda observation: observation.paired,
    )


def _by_unit(unit: str) -> Callable[[Observation], bool]:
    return lambda observation: observation.unit == unit


def _shown(unit: Unit, *values: float) -> list[float]:
    """Return values in SI as files show them."""
    return [float(units.from_si(value, unit.si)) for value in values]


# fmt: off
KIND = Column("kind", words({kind: kind for kind in (LegDial.kind, MOVE, *OBSERVATIONS)}),
    f"Kind of the reading. A row of kind `{MOVE}` is a command that the machine goes through "
    "without being read.", "kind", LegDial.kind, of_setup=True, always=True, text=True)
SETUP = Column("setup", LABEL,
    "Name of the mounting, whose rows share one unknown datum. It stands in double quotes in the "
    'names of parameters if it is `common` or contains `@` or `"`.',
    "name", of_setup=True, text=True)
LEG = replace(_of_mounting("leg", words({name: leg for leg, name in enumerate(LEGS)}),
    "The leg that is touched.", "leg"), text=True)
DIRECTION = Column("direction",
    words({mark + name: mark.strip("+") + name for mark in ("", "-", "+") for name in LEGS}),
    "The base axis along or about which is read, not the leg's own; with a minus if the instrument "
    "counts against it.", "direction", of=lambda observation: bool(observation.axes), text=True)
POSTURE = Column("posture", LABEL, "A label for people, which no computation uses.",
    "posture", "", always=True, text=True)
RHO = Column("rho_{axis}_mm", number(MM),
    "Commanded joint coordinates of an Orthoglide, `r` removed.", "command")
TRAVEL = Column("travel_{leg}_mm", number(MM),
    "Or the commands as the controller shows them. Layouts other than the Orthoglide have these "
    "only, by the names of their legs.", "command")
PLACE = Column("{axis}_mm", number(MM),
    "Or where the controller of a linear delta is told to send the tool. `z_mm` is empty if a "
    "plate is to be touched there.", "command")
GAUGE = _of_mounting("gauge_mm", number(MM),
    "Where the dial stands along the leg's own axis, `r` removed.", "gauge")
GAUGE2 = _of_mounting("gauge2_mm", number(MM),
    "Where the second dial stands. The reading is what the dial at `gauge2_mm` shows less what the "
    "dial at `gauge_mm` shows.", "gauge2")
BAR = _of_mounting("bar",
    words({"1": 1, "2": 2, "1.0": 1, "2.0": 2}, "not 1, 2 or empty: correct it", 0),
    "The bar that is touched. If empty, the leg's median line is.", "bar", 0)
REPEAT = Column("repeat", whole(1), "Number of the repetition.", "repeat", 1, always=True)
ORDER = Column("order", whole(0),
    "Place in the sequence of the machine's moves. If the column is absent, the row counts.",
    "order", always=True)
APPROACH = Column("approach_{leg}",
    words({"1": 1, "-1": -1, "+1": 1, "1.0": 1, "-1.0": -1, "+1.0": 1, "0": 0, "0.0": 0},
          "not +1 or -1: give the direction of the axis' last move, or leave the field empty", 0),
    "Direction of each axis' last move; empty: unknown. If the columns are absent, it is derived "
    "from the order.", "approach", 0, always=True)
TIME = Column("time_s", number(Unit("s", 1.0)), "Time since the start.", "time", NAN)
TEMPERATURE = Column("temperature_C", number(Unit("degrees Celsius", 1.0), -40, 100),
    "Recorded temperature.", "temperature", NAN)
LOAD = Column("load_N", number(Unit("N", 1.0), 0, 1e4), "Weight at the TCP.", "load", 0.0)
READINGS = {
    unit.name: Column(f"reading_{unit.name}", number(unit), "What the instrument shows.",
        "reading", NAN, _by_unit(unit.name), always=True)
    for unit in (MM, _MRAD)
}
SIGMAS = {
    unit.name: Column(f"sigma_{unit.name}", number(unit, *_shown(unit, NOISE[0], most)),
        "Standard deviation of this reading.", "sigma", NAN, _by_unit(unit.name))
    for unit, most in ((MM, NOISE[1]), (_MRAD, TURNS))
}
BESIDE = replace(_of_mounting(BESIDE_NAMES[0], number(MM),
    "Where the setup is read, from the tool (`tool_mm`) along x, y and z of the platform: a probe "
    "beside the nozzle, or a longer tool.", "beside", 0.0, every=True), name="beside_{axis}_mm")
TURN = _of_mounting(TURNED, number(_DEG, -360, 360),
    "How far the setup's plate was turned on its seat, counter-clockwise from above.",
    "turned", 0.0, every=True)
PART = replace(_of_mounting(MATERIAL, words({name: name for name in SIZES if name}, nothing=""),
    "What the part is made of on which distances are read: `printed` parts are 0.3 ± 0.3 % "
    "smaller than they were commanded and all of a file are one part; `metal`, such as a rule, a "
    "jig or a milled part, is true to 0.02 %. If empty, anything within 1 % is as likely.",
    "material", ""), text=True)
FIRMWARE = Column("firmware", LABEL,
    "Mark of the firmware's numbers with which an imported file's travel was computed. A file with "
    "another mark than the machine file's is refused.", "", "", at_tool, text=True)
POINT = Column("p_{axis}_mm", number(MM), "Measured position of the tool. A coordinate that was "
    "not measured is empty.", "p", NAN)
# fmt: on

COMMANDS = {column: _second(column) for column in (RHO, TRAVEL, PLACE)}
"""Ways to state the command, each with the columns of a second one."""

COLUMNS: tuple[Column, ...] = (
    KIND, SETUP, LEG, DIRECTION, POSTURE, *COMMANDS, GAUGE, GAUGE2, BAR, *COMMANDS.values(),
    REPEAT, ORDER, APPROACH, TIME, TEMPERATURE, LOAD, *READINGS.values(), *SIGMAS.values(),
    BESIDE, TURN, PART, FIRMWARE,
)  # fmt: skip
"""The columns of a file of readings, in the order of writing."""

AXES = {mark + name: (axis, sign)
        for mark, sign in (("", 1), ("-", -1)) for axis, name in enumerate(LEGS)}  # fmt: skip
"""Axis and sign of the directions."""


def names_of(columns: Iterable[Column], legs: tuple[str, str, str] = LEGS) -> list[str]:
    """Return the names of columns in the file of a machine with these legs."""
    return [name for column in columns for name in column.names(legs)]


def columns_with(command: Column) -> list[Column]:
    """Return the columns of a file that states its commands in one of the ways."""
    others = {*COMMANDS, *COMMANDS.values()} - {command, COMMANDS[command]}
    return [column for column in COLUMNS if column not in others]
