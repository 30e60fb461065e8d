"""Results of an import: a machine file, readings, and notes for the owner."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.geometry import Array
from orthoglide.instruments import (
    MATERIAL_COLUMN,
    OBSERVATIONS,
    PLATE_TURN_COLUMN,
    TOOL_OFFSET_COLUMNS,
)
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.observations import Readings, readings_from_rows
from orthoglide.observations.schema import APPROACH, COMMANDS, TEMPERATURE, TRAVEL

_DIGITS = 9  # decimals of millimetres in a file
_MAX_NAME_LENGTH = 60  # characters of a name
_FEW_TOUCHES = 30  # twice the 15 numbers of endstops, towers, arms and a plane
_COLD, _HOT = -40.0, 100.0  # degrees Celsius, of a frame or a bed on which a plate is touched


@dataclass(frozen=True)
class Imported:
    """Result of an import.

    Attributes:
        machine: nominal machine, with the firmware's numbers in its provenance.
        campaigns: readings, a campaign for each list of the file.
        notes: remarks for the owner, in sentences.
        together: names of the campaigns that belong together; empty if this is unknown.
    """

    machine: MachineFile
    campaigns: tuple[Readings, ...]
    notes: tuple[Note, ...]
    together: tuple[str, ...]

    @property
    def apart(self) -> tuple[Note, ...]:
        """Notes on campaigns that are not of one plate and one set of numbers."""
        return tuple(note for note in self.notes if note.kind in ("apart", "moved"))


@dataclass(frozen=True, eq=False)
class Row:
    """One reading, SI."""

    kind: str  # of the instrument
    setup: str
    label: str  # for people
    travel: Array  # of the carriages from mechanical zero (3,), metres
    reading: float  # metres
    second: Array | None = None  # travel at the other end of a distance (3,), metres
    beside: Array | None = None  # where the probe is from the nozzle (2,), metres
    sigma: float = float("nan")  # metres; nan: the machine file's
    turned: float = 0.0  # by how much the plate was turned on its seat, degrees
    temperature: float = float("nan")  # that the firmware recorded then, degrees Celsius
    material: str = ""  # of a part on which a distance was read

    def cells(self) -> dict[str, str]:
        """Return the reading as a row of a file."""
        touches, legs = OBSERVATIONS[self.kind].touches, LinearDelta.names.legs
        second = [None] * 3 if self.second is None else self.second
        beside = [0.0] * 2 if self.beside is None else self.beside
        cells: dict[str, float | None] = {
            **dict(zip(TRAVEL.names(legs), self.travel, strict=True)),
            **dict(zip(COMMANDS[TRAVEL].names(legs), second, strict=True)),
            **dict(zip(TOOL_OFFSET_COLUMNS, beside, strict=False)),
            "reading_mm": self.reading,
            "sigma_mm": self.sigma,
        }
        return {
            "kind": self.kind,
            "setup": self.setup,
            "posture": self.label,
            **{name: _millimetres(value) for name, value in cells.items()},
            **dict.fromkeys(APPROACH.names(legs), "-1" if touches else ""),  # from above
            PLATE_TURN_COLUMN: f"{self.turned:g}" if touches else "",
            TEMPERATURE.name: temperature_cell(self.temperature),
            MATERIAL_COLUMN: self.material,
        }


def plain_name(text: str, default: str) -> str:
    """Return a name as files and parameters may carry it."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:_MAX_NAME_LENGTH] or default


def note_few_touches(touch_count: int) -> Iterator[Note]:
    """Yield a note if the longest list of touches is too short to find causes."""
    if touch_count < _FEW_TOUCHES:
        yield Note(
            f"{touch_count} touches of the plate leave hardly anything to look for a cause with: "
            f"probe a grid of 9 by 9 or more over a round bed's full radius",
            "mesh",
        )


def temperature_cell(temperature: float) -> str:
    """Return a temperature as a cell of a file; empty if no machine has such a temperature."""
    return f"{temperature:g}" if _COLD < temperature < _HOT else ""


def _millimetres(value: float | None) -> str:
    return "" if value is None or np.isnan(value) else repr(round(float(value) * 1e3, _DIGITS))


def readings_from_cells(
    name: str, rows: Sequence[Mapping[str, str]], machine: MachineFile,
    lines: Sequence[int] = (), file: str = "",
) -> Readings:  # fmt: skip
    """Return rows of cells by column, one or more, as the readings of a machine.

    Errors name the line of a row in a file, if these are given.

    Raises:
        FileError: if the readings cannot be used.
    """
    used_columns = {key for row in rows for key, cell in row.items() if cell}
    cells = [{key: cell for key, cell in row.items() if key in used_columns} for row in rows]
    (readings,) = readings_from_rows(cells, machine, name=name, lines=lines, file=file)
    return readings
