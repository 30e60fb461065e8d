"""Lists of points of a plate that firmware or people wrote, as readings of a machine.

Read are RepRapFirmware's ``heightmap.csv``, the lines ``Bed X: Y: Z:`` of Marlin's ``G29`` and
``probe at X,Y is z=Z`` of Klipper's console within a log, other lines with ``X: Y: Z:``, and plain
tables of x, y, z. A height is where the nozzle stood
when the plate was touched; a height that is added to all of a list makes no difference.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from orthoglide import files
from orthoglide.add_ons import Kinematics
from orthoglide.errors import FileError
from orthoglide.firmware.imported import (
    Imported,
    note_few_touches,
    plain_name,
    readings_from_cells,
    temperature_cell,
)
from orthoglide.firmware.touches import MIN_PLACES, Touch, TouchLists, read_touches
from orthoglide.foreign import refuse_foreign
from orthoglide.geometry import plane_columns
from orthoglide.instruments import PlateTouch
from orthoglide.machine_file import AnyMachine, MachineFile, machine_file_of
from orthoglide.notes import Note
from orthoglide.observations.schema import APPROACH, PLACE, TEMPERATURE
from orthoglide.text import printable_path

_MAX_FROM_MEDIAN = 20.0  # millimetres from the median of all: heights that no plate has
_MIN_NEAR_SHARE = 0.75  # of a list's heights that have to be nearer: else they are in another unit
_MAX_OFF_PLANE = (
    3.0  # millimetres from a plane: a plate, and a delta before its calibration, are nearer
)
_MAX_LINES_NAMED, _MAX_CHARACTERS = 5, 40  # lines that a note names, and characters of one


def import_plates(path: str | os.PathLike[str], machine_file: AnyMachine) -> Imported:
    """Read lists of touches of a plate as readings of a machine.

    Args:
        path: of the list.
        machine_file: a linear delta, or its file, with the sizes by which its firmware computed
            the places.

    Returns:
        The machine, a campaign for each list, and notes on what was left out.

    Raises:
        FileError: where the file has no such list, or belongs to another command.
    """
    machine = machine_file_of(machine_file)
    kinematics = machine.kinematics
    if kinematics is None:
        raise FileError(
            f"has the layout {machine.geometry.layout.kind}: lists of plate points are read for a "
            f"linear delta; give its machine file, with [layout]",
            file=machine.file or "the machine file",
        )
    content = files.read_bytes(path, files.FILE_LIMIT)
    refuse_foreign(Path(path), content, accepted=("height map", "bed lines", "probe lines"))
    lines = re.split(r"\r\n|\r|\n", files.decode(content, Path(path), errors="replace"))
    read = read_touches(lines, printable_path(path))
    lists = [
        kept for touches in _distinct(read) if (kept := _usable_touches(touches, kinematics, read))
    ]
    if not lists:
        why = "; ".join(_left_out_sentences(read))
        raise FileError(
            f"has no list of plate points{f' ({why})' if why else ''}: give a height map, lines "
            f"'Bed X: Y: Z:', or a table whose first line names x, y and z, in millimetres",
            file=printable_path(path),
        )
    stem = plain_name(Path(path).stem, "points")
    names = [stem] if len(lists) == 1 else [f"{stem}-{k}" for k in range(1, len(lists) + 1)]
    campaigns = tuple(
        readings_from_cells(name, list(_rows(name, touches, machine)), machine,
                    [one.line for one in touches], printable_path(path))
        for name, touches in zip(names, lists, strict=True)
    )  # fmt: skip
    return Imported(
        machine, campaigns, tuple(_notes(lists, read, printable_path(path))), tuple(names)
    )


def _distinct(read: TouchLists) -> Iterator[list[Touch]]:
    """Return lists of which none is another one to the last digit."""
    known: dict[tuple[tuple[float, float, float], ...], int] = {}
    for touches in read.lists:
        line = touches[0].line
        first = known.setdefault(tuple((one.x, one.y, one.z) for one in touches), line)
        if first == line:
            yield touches
        else:
            read.leave_out(f"a copy of the list of line {first} from", line)


def _usable_touches(
    touches: Sequence[Touch], kinematics: Kinematics, read: TouchLists
) -> list[Touch]:
    """Return the touches of a list that the arms reach and that are near the others' height; none
    where they tell of no plane.
    """
    p, found = np.array([(one.x, one.y, one.z) for one in touches]), list[Touch]()
    near = np.abs(p[:, 2] - np.median(p[:, 2])) <= _MAX_FROM_MEDIAN
    near &= bool(near.mean() > _MIN_NEAR_SHARE)
    reached = np.asarray(np.isfinite(kinematics.travel(p * 1e-3)).all(axis=1))
    for one, close, within in zip(touches, near, reached, strict=True):
        if not close:
            why = f"more than {_MAX_FROM_MEDIAN:g} mm from the height of most; give millimetres"
            read.leave_out(why, one.line, f"z {one.z:g}")
        elif not within:
            read.leave_out(
                "beyond the arms of the machine file", one.line, f"x {one.x:g}, y {one.y:g}"
            )
        else:
            found.append(one)
    if len({one.place for one in found}) >= MIN_PLACES:
        return found
    for one in found:
        read.leave_out(f"a list of fewer than {MIN_PLACES} places", one.line)
    return []


def _rows(name: str, touches: Sequence[Touch], machine: MachineFile) -> Iterator[dict[str, str]]:
    """Rows of a file of readings."""
    repeat = 1
    for k, one in enumerate(touches):
        repeat = repeat + 1 if k and one.place == touches[k - 1].place else 1
        place = dict(zip(PLACE.names(), (repr(v) for v in (one.x, one.y, one.z)), strict=True))
        yield {
            "kind": PlateTouch.kind,
            "setup": name,
            "posture": f"{one.x:g} {one.y:g}",
            **place,
            "repeat": str(repeat),
            "reading_mm": "0",
            TEMPERATURE.name: temperature_cell(one.temperature),
            **dict.fromkeys(APPROACH.names(machine.geometry.leg_names), "-1"),  # from above
        }


def _left_out_sentences(read: TouchLists) -> Iterator[str]:
    """A sentence for each reason why lines were left out, with what stands in the first of them."""
    for why, lines in read.left_out.items():
        named = ", ".join(map(str, [*lines][:_MAX_LINES_NAMED])) + ", ..." * (
            len(lines) > _MAX_LINES_NAMED
        )
        first = next(iter(lines.values()))[:_MAX_CHARACTERS]
        value = f" ({first!r})" if first else ""
        yield f"left out: line{'s' * (len(lines) > 1)} {named}: {why}{value}"


def _off_plane(touches: Sequence[Touch]) -> float:
    """Return how far a touch is off the plane of all at most, millimetres."""
    p = np.array([(one.x, one.y, one.z) for one in touches])
    plane = plane_columns(p)
    off = p[:, 2] - plane @ np.linalg.lstsq(plane, p[:, 2], rcond=None)[0]
    return float(np.abs(off).max())


def _notes(lists: Sequence[Sequence[Touch]], read: TouchLists, file: str) -> Iterator[Note]:
    """Remarks on lists that were read."""
    yield from (Note(f"{file}: {text}", "readings") for text in _left_out_sentences(read))
    if len(lists) > 1:
        yield Note(
            f"{file} has {len(lists)} lists: give close-loop those that were probed with the same "
            f"numbers of the firmware", "mesh",
        )  # fmt: skip
    rough = max(_off_plane(touches) for touches in lists)
    if rough > _MAX_OFF_PLANE:
        yield Note(
            f"heights lie up to {rough:.1f} mm off a plane: look whether they are in millimetres, "
            f"and probed with the sizes of the machine file", "mesh",
        )  # fmt: skip
    yield from note_few_touches(max(map(len, lists)))
    yield Note(
        "the places are taken as the nozzle's, computed by the firmware with the sizes of the "
        "machine file (L, radius_mm less r, angles_deg): correct them there if it had others; of a "
        "probe beside the nozzle add the columns beside_x_mm and beside_y_mm", "probe",
    )  # fmt: skip
