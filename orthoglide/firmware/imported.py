"""Results of an import: a machine file, readings, and notes for the owner."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from orthoglide.errors import FileError
from orthoglide.geometry import Array
from orthoglide.instruments import Setup
from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.observations import Readings
from orthoglide.observations.checks import DECIMALS, check_commands, check_readings

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

    setup: Setup
    label: str  # for people
    travel: Array  # of the carriages from mechanical zero (3,), metres
    reading: float  # metres
    second: Array | None = None  # travel at the other end of a distance (3,), metres
    sigma: float = float("nan")  # metres; nan: the machine file's
    temperature: float = float("nan")  # that the firmware recorded then, degrees Celsius
    repeat: int = 1  # number of the visit
    line: int | None = None  # in the file; ``None``: that of the campaign to be written


def plain_name(text: str, default: str) -> str:
    """Return a name as files and parameters may carry it."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:_MAX_NAME_LENGTH] or default


def note_few_touches(touch_count: int) -> Iterator[Note]:
    """Yield a note if the longest list of touches is too short to find causes."""
    if touch_count < _FEW_TOUCHES:
        yield Note(
            f"{touch_count} touches of the plate are too few to distinguish causes: "
            f"probe a grid of 9 by 9 or more over a round bed's full radius",
            "mesh",
        )


def campaign_of_rows(
    name: str, rows: Sequence[Row], machine: MachineFile, file: str = ""
) -> Readings:
    """Return readings, one or more, of a machine as they are read back from a campaign's file.

    A plate is touched from above; from where the ends of a distance are reached is unknown.

    Raises:
        FileError: if the readings cannot be used.
    """
    lines = [k + 2 if row.line is None else row.line for k, row in enumerate(rows)]

    def fail(message: str, row: int | None = None) -> NoReturn:
        raise FileError(message, file=file or name, line=None if row is None else lines[row])

    def rounded(values: Any) -> Array:
        return np.round(np.array(values, dtype=float), DECIMALS) + 0.0

    def command(travel: Any) -> Array:
        travel = rounded(travel).reshape(-1, 3)
        shown = machine.controller.from_rho(travel, machine.geometry)
        return check_commands(shown, True, machine, fail)

    numbers = {setup: k for k, setup in enumerate(dict.fromkeys(row.setup for row in rows))}
    touches = np.array([[row.setup.observation.touches] for row in rows])
    second = np.full((len(rows), 3), np.nan)
    paired = [k for k, row in enumerate(rows) if row.second is not None]
    second[paired] = command([rows[k].second for k in paired])
    temperature = np.array([row.temperature for row in rows])
    readings = Readings(
        name,
        tuple(numbers),
        np.array([numbers[row.setup] for row in rows]),
        command([row.travel for row in rows]),
        rounded([row.reading for row in rows]),
        np.repeat(np.where(touches, -1.0, 0.0), 3, axis=1),
        temperature=np.where((temperature > _COLD) & (temperature < _HOT), temperature, np.nan),
        repeat=np.array([row.repeat for row in rows]),
        order=np.arange(1, len(rows) + 1),
        posture=tuple(row.label for row in rows),
        sigma=rounded([row.sigma for row in rows]),
        line=np.array(lines),
        second=second,
        file=file,
        legs=machine.geometry.layout.names,
    )
    check_readings(readings, machine, fail)
    return readings
