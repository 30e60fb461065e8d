"""What importing a printer told, kept with its machine for the results that it matters to."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.text import shown

WARNINGS, AGAIN = "warnings", "calibrate_again"
"""Keys of a machine file's provenance: sentences, and whether the firmware's own calibration is to
be run again before anything is entered."""

CALIBRATE = "calibrate"
"""Kind of a note that says so."""

# Kinds of what a result says itself, and of what helps to read more.
_OF_READINGS = ("mesh", "readings", "rods")
_APART = re.compile(r"(\S+)\.csv and (\S+)\.csv are not of one plate")


def kept(notes: Iterable[Note]) -> dict[str, Any]:
    """What provenance keeps of notes."""
    told = [shown(note) for note in notes if note.kind not in _OF_READINGS]
    again = any(note.kind == CALIBRATE for note in notes)
    return ({WARNINGS: told} if told else {}) | ({AGAIN: True} if again else {})


def imported(spec: MachineFile, names: Collection[str]) -> Iterator[Note]:
    """What was told when a machine was imported, for a result of campaigns of these names.

    That two do not go together is told anew where both are read, and matters only to the first.
    """
    stored = spec.provenance.get("klipper")
    told = stored.get(WARNINGS) if isinstance(stored, Mapping) else None
    for text in told if isinstance(told, list) else ():
        if isinstance(text, str) and (
            (two := _APART.match(text)) is None or (two[1] in names and two[2] not in names)
        ):
            yield Note(text, "imported")
