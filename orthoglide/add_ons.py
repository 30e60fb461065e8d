"""Add-ons for the firmware of a machine: their interface, and how they are found.

An add-on is an object named by an entry point of the group ``orthoglide.firmware``, or the
``ADD_ON`` of a package in the folder ``orthoglide/firmware``. A machine file that an add-on wrote
contains the firmware's numbers in a table ``[provenance.NAME]``. Only the add-on of that name reads
this table; the rest of the package uses `Printer`.
"""

from __future__ import annotations

import os
import pkgutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from orthoglide.errors import InputError, check_choice
from orthoglide.notes import Note

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

ENTRY_POINT_GROUP = "orthoglide.firmware"
"""Group of the entry points, and the package with the add-ons that come with this one."""

EXACT_DIGITS = 17
"""Significant digits with which a number is read back unchanged; firmware numbers keep them."""

MARK_KEY = "numbers"
"""Key of a firmware's table: short identifier of its numbers."""


@dataclass(frozen=True)
class Corrections:
    """New numbers of a firmware beside the old ones."""

    # key, old and new value of every number, as the file has them
    rows: Sequence[tuple[str, str, str]]
    # residuals of the readings by the firmware's equations: name, old, new, millimetres
    left: Sequence[tuple[str, str, str]]
    # residuals of heights over the plate with the old and new numbers, metres, rms
    height: tuple[float, float]
    keep: str  # why the old numbers are to be kept, a clause; empty if the new ones are better
    words: str  # what the new numbers change, a clause
    where: str  # how to enter the numbers in the file, and what to do after that
    file: str  # name of the firmware's file
    paste: tuple[str, ...]  # lines of the firmware's file with the new numbers
    undo: tuple[str, ...]  # lines of the firmware's file with the old numbers
    # record of the new numbers in the file of a calibrated machine; a result has it in
    # `Section.facts`
    kept: Mapping[str, Any] = field(default_factory=dict, metadata={"in_file": False})
    # old numbers as an object of the add-on; ``None`` in a result that was loaded
    old: Any = field(default=None, metadata={"in_file": False})
    # new numbers as an object of the add-on; ``None`` in a result that was loaded
    new: Any = field(default=None, metadata={"in_file": False})


@dataclass(frozen=True)
class Section:
    """Remarks of a firmware's add-on on a result."""

    first: str  # warnings to read first; empty without any
    # sentence that the firmware's own calibration has to be run before any number is entered; empty
    # if it has not
    again: str
    corrections: Corrections | None  # old and new numbers; ``None`` if the readings give none
    touch: str  # what to measure for new numbers, a sentence without its full stop
    holds: str  # numbers that the firmware has, a phrase
    beyond: tuple[str, ...]  # causes that no number can describe, each with what to do about it
    facts: Mapping[str, Any] = field(metadata={"digits": EXACT_DIGITS})  # the same facts for JSON

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that are derived from the fields."""
        return dict(self.facts)


@dataclass(frozen=True)
class Paste:
    """Numbers of a firmware for ``export``, in the place of a controller's zeros."""

    columns: dict[str, list[Any]]  # of a table with one row for each number
    facts: Mapping[str, Any]  # for JSON
    paragraphs: tuple[str, ...]  # for people; the lines of a table stay as they are


class Printer(Protocol):
    """A firmware's numbers of one machine, read from the table of its machine file."""

    @property
    def kinematics(self) -> Any:
        """Kinematics of the firmware, an `orthoglide.machine_file.DeltaKinematics`; travel counts
        from mechanical zero of the machine file.
        """

    @property
    def meshes_relative(self) -> bool:
        """Whether the firmware subtracts the height at one place from every list of touches."""

    @property
    def changed_since(self) -> tuple[str, ...]:
        """What was moved or changed since the firmware's own calibration, in sentences."""

    def objection(self, geometry: Any) -> tuple[str, ...]:
        """Return why dimensions contradict the numbers, and the path of the key of the machine file
        to blame; empty if they agree.
        """

    def doubts(self, machine: Any) -> str:
        """Return a warning to users of the machine; empty without one."""

    def imported(self, names: Collection[str]) -> Iterator[Note]:
        """Yield remarks of the import on readings of these names."""

    def assumptions(self, machine: Any, causes: Sequence[Any]) -> Iterator[Note]:
        """Yield assumptions of the import on which the causes depend."""

    def provenance(self, corrections: Any) -> Mapping[str, Any]:
        """Return the table of a calibrated machine by the add-on's name."""

    def corrections(self, machine: Any, readings: Sequence[Any]) -> Corrections | None:
        """Return new numbers for a calibrated machine; ``None`` if its readings give none."""

    def section(
        self, given: Any, calibrated: Any, corrections: Corrections | None, causes: Sequence[Any]
    ) -> Section:
        """Return the report's section on a calibrated machine.

        Args:
            given: machine as it was imported.
            calibrated: calibrated machine.
            corrections: new numbers for it, if the readings give any.
            causes: its faults, as `orthoglide.result.Explanation`.
        """

    def paste(self) -> Paste:
        """Return the numbers that a calibrated machine keeps."""


class AddOn(Protocol):
    """Support for one firmware."""

    def read(self, path: str | os.PathLike[str], **options: Any) -> Any:
        """Read a firmware's file as an `orthoglide.firmware.imported.Imported`: a machine file,
        readings and notes.

        Raises:
            FileError: names the line and the remedy.
        """

    def stored(self, table: Mapping[str, Any]) -> Printer | None:
        """Return the printer of a firmware's table; ``None`` if the table was edited and is
        unusable.
        """


@cache
def _entry_points() -> dict[str, EntryPoint]:
    """Return installed entry points and those of this package, by the name of the firmware."""
    from importlib.metadata import EntryPoint, entry_points  # which is slow to load

    folder = import_module(ENTRY_POINT_GROUP).__path__
    bundled = [EntryPoint(m.name, f"{ENTRY_POINT_GROUP}.{m.name}:ADD_ON", ENTRY_POINT_GROUP)
           for m in pkgutil.iter_modules(folder) if m.ispkg]  # fmt: skip
    return {
        entry_point.name: entry_point
        for entry_point in (*entry_points(group=ENTRY_POINT_GROUP), *bundled)
    }


def add_on(name: str) -> AddOn:
    """Return the add-on for a firmware.

    Raises:
        InputError: if there is none of that name, or it cannot be loaded.
    """
    check_choice("firmware", name, _entry_points())
    try:
        loaded: AddOn = _entry_points()[name].load()
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"the add-on for the firmware {name} cannot be loaded ({error}): install it again, or "
            f"remove it"
        ) from error
    return loaded


def firmware_table(provenance: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    """Return the name and the table of the firmware in the provenance of a machine file; an empty
    name if no add-on wrote the file.
    """
    for name, table in provenance.items():
        if isinstance(table, Mapping) and name in _entry_points():
            return name, table
    return "", {}
