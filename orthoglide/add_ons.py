"""Add-ons for the firmware of a machine: what each of them offers, and how it is found.

An add-on is an object that an entry point of the group ``orthoglide.firmware`` names, or the
``ADD_ON`` of a package in the folder ``orthoglide/firmware``. A machine file that an add-on wrote
keeps the firmware's numbers in a table ``[provenance.NAME]``. Nothing but the add-on of that name
reads this table; the rest of the package asks through `Printer`.
"""

from __future__ import annotations

import os
import pkgutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError, check_choice
from orthoglide.notes import Note

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

ENTRY_POINT_GROUP = "orthoglide.firmware"
"""Group of the entry points, and the package with the add-ons that come with this one."""

EXACT_DIGITS = 17
"""Significant digits with which a number is read back unchanged; a firmware's are not rounded."""

MARK_KEY = "numbers"
"""Key of a firmware's table: what tells its numbers from others, short."""


class Kinematics(Protocol):
    """Where a controller sends the carriages for a place of its tool, and the reverse."""

    def travel(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Travel of the carriages from mechanical zero ``(n, 3)`` for places ``(n, 3)``, metres."""

    def places(self, travel: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places of the tool ``(n, 3)`` at a travel ``(n, 3)``, metres."""


@dataclass(frozen=True)
class Corrections:
    """New numbers of a firmware beside the old ones.

    Attributes:
        rows: key, old and new value of every number, as the file has them.
        left: residuals of the readings by the firmware's equations: what, old, new, millimetres.
        height: what the numbers leave of heights over the plate (old, new), metres, rms.
        keep: why the old numbers are to be kept, a clause; empty where the new ones are better.
        words: what the new numbers change, a clause.
        where: how the numbers come into the file, and what is to be done after that.
        file: name of the firmware's file.
        paste: lines of the firmware's file with the new numbers.
        undo: lines of the firmware's file with the old numbers.
        kept: what the file of a calibrated machine records of the new numbers; a result has it in
            `Section.facts`.
        old: old numbers as an object of the add-on; ``None`` in a result that was loaded.
        new: new numbers as an object of the add-on; ``None`` in a result that was loaded.
    """

    rows: Sequence[tuple[str, str, str]]
    left: Sequence[tuple[str, str, str]]
    height: tuple[float, float]
    keep: str
    words: str
    where: str
    file: str
    paste: tuple[str, ...]
    undo: tuple[str, ...]
    kept: Mapping[str, Any] = field(default_factory=dict, metadata={"in_file": False})
    old: Any = field(default=None, metadata={"in_file": False})
    new: Any = field(default=None, metadata={"in_file": False})


@dataclass(frozen=True)
class Section:
    """What a firmware's add-on has to say of a result.

    Attributes:
        first: what must be known before anything else; empty where nothing must.
        again: what the firmware's own calibration has to do before any number is entered, a
            sentence; empty where nothing has.
        corrections: old and new numbers; ``None`` where the readings give none.
        touch: what to measure for new numbers, a sentence without its full stop.
        holds: what numbers the firmware has.
        beyond: causes that no number holds, each with what to do about it.
        facts: all of it, for JSON.
    """

    first: str
    again: str
    corrections: Corrections | None
    touch: str
    holds: str
    beyond: tuple[str, ...]
    facts: Mapping[str, Any] = field(metadata={"digits": EXACT_DIGITS})

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        return dict(self.facts)


@dataclass(frozen=True)
class Paste:
    """Numbers of a firmware for ``export``, in the place of a controller's zeros."""

    columns: dict[str, list[Any]]  # of a table with a row a number
    facts: Mapping[str, Any]  # for JSON
    paragraphs: tuple[str, ...]  # for people; the lines of a table stay as they are


class Printer(Protocol):
    """A firmware's numbers of one machine, read from the table of its machine file."""

    @property
    def kinematics(self) -> Kinematics:
        """Where the firmware sends the carriages, from mechanical zero of the machine file."""

    def objection(self, geometry: Any) -> tuple[str, ...]:
        """Why dimensions do not go with the numbers, and the path of the key of the machine file to
        blame; empty where they do.
        """

    def doubts(self, machine: Any) -> str:
        """What a user of the machine must know before anything else; empty where nothing is."""

    def imported(self, names: Collection[str]) -> Iterator[Note]:
        """Remarks of the import that matter to readings of these names."""

    def cautions(self, readings: Sequence[Any]) -> Iterator[Note]:
        """What speaks against taking these readings of the tool together."""

    def assumptions(self, machine: Any, causes: Sequence[Any]) -> Iterator[Note]:
        """What was assumed on import and matters to the causes that were found."""

    def provenance(self, corrections: Any) -> Mapping[str, Any]:
        """The table, by the add-on's name, that a calibrated machine keeps."""

    def corrections(self, machine: Any, readings: Sequence[Any]) -> Corrections | None:
        """New numbers for a calibrated machine; ``None`` where the readings of its tool give
        none.
        """

    def section(
        self, given: Any, calibrated: Any, corrections: Corrections | None, causes: Sequence[Any]
    ) -> Section:
        """What a report says of a calibrated machine.

        Args:
            given: the machine as it was imported.
            calibrated: the machine found.
            corrections: new numbers for it, where the readings give any.
            causes: explanations of what is wrong with it, as `orthoglide.result.Explanation`.
        """

    def paste(self) -> Paste:
        """Numbers that a calibrated machine keeps."""


class AddOn(Protocol):
    """Support for one firmware."""

    def read(self, path: str | os.PathLike[str], **options: Any) -> Any:
        """Read a firmware's file as an `orthoglide.firmware.imported.Imported`: a machine file,
        readings and notes.

        Raises:
            FileError: naming the line and what would be right.
        """

    def stored(self, table: Mapping[str, Any]) -> Printer | None:
        """Read the firmware's table of a machine file; ``None`` where it was edited and is of no
        use.
        """


@cache
def _entry_points() -> dict[str, EntryPoint]:
    """Entry points by the name of the firmware: those installed, and those of this package."""
    from importlib.metadata import EntryPoint, entry_points  # which is slow to load

    folder = import_module(ENTRY_POINT_GROUP).__path__
    own = [EntryPoint(m.name, f"{ENTRY_POINT_GROUP}.{m.name}:ADD_ON", ENTRY_POINT_GROUP)
           for m in pkgutil.iter_modules(folder) if m.ispkg]  # fmt: skip
    return {one.name: one for one in (*entry_points(group=ENTRY_POINT_GROUP), *own)}


def add_on(name: str) -> AddOn:
    """Return the add-on for a firmware.

    Raises:
        InputError: where there is none of that name, or it cannot be loaded.
    """
    check_choice("firmware", name, _entry_points())
    try:
        found: AddOn = _entry_points()[name].load()
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"the add-on for the firmware {name} cannot be loaded ({error}): install it again, or "
            f"remove it"
        ) from error
    return found


def firmware_table(provenance: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    """Return the name of the firmware in the provenance of a machine file, and its table; an empty
    name where no add-on has written one.
    """
    for name, table in provenance.items():
        if isinstance(table, Mapping) and name in _entry_points():
            return name, table
    return "", {}
