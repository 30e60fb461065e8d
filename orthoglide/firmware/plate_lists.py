"""Lists of points of a plate that firmware or people wrote, as readings of a machine.

Read are RepRapFirmware's ``heightmap.csv``, the lines ``Bed X: Y: Z:`` of Marlin's ``G29``,
``Z-probe: X: Y:`` of Repetier, ``probe: at X,Y bed will contact at z=Z`` of Klipper's console
within a log, other lines with ``X: Y: Z:``, and plain tables of x, y, z. A height is that of the
nozzle when the plate was touched; a constant that is added to all heights of a list makes no
difference.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from orthoglide import files
from orthoglide.arguments import public
from orthoglide.errors import FileError
from orthoglide.firmware.imported import (
    Imported,
    Row,
    campaign_of_rows,
    note_few_touches,
    plain_name,
)
from orthoglide.firmware.touches import MIN_PLACES, Touch, TouchLists, read_touches
from orthoglide.foreign import refuse_foreign
from orthoglide.geometry import fit_plane
from orthoglide.instruments import PlateTouch, Setup
from orthoglide.machine_file import AnyMachine, DeltaKinematics, machine_file_of
from orthoglide.notes import Note
from orthoglide.observations.touched_plates import disagreements
from orthoglide.text import printable_path

_MAX_FROM_MEDIAN = 20.0  # millimetres: no plate has heights further from the median of all
_MIN_NEAR_SHARE = 0.75  # of a list's heights that must be nearer: else their unit is another
_MAX_OFF_PLANE = 3.0  # millimetres from a plane, more than on a delta before its calibration
_MAX_LINES_NAMED, _MAX_CHARACTERS = 5, 40  # lines that a note names, and characters of one


@public
def import_plates(path: str | os.PathLike[str], machine_file: AnyMachine) -> Imported:
    """Read lists of touches of a plate as readings of a machine.

    Args:
        path: path of the file.
        machine_file: linear delta, or its file, with the sizes by which its firmware computed the
            places.

    Returns:
        The machine, a campaign for each list, and notes on what was left out.

    Raises:
        FileError: if the file has no such list, or belongs to another command.
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
    touch_lists = read_touches(lines, printable_path(path))
    first_lines, lists = dict[tuple[tuple[float, float, float], ...], int](), list[list[Touch]]()
    for touches in touch_lists.lists:
        line = touches[0].line
        first_line = first_lines.setdefault(tuple((t.x, t.y, t.z) for t in touches), line)
        if first_line != line:
            touch_lists.leave_out(f"a copy of the list of line {first_line} from", line)
        elif usable := _usable_touches(touches, kinematics, touch_lists):
            lists.append(usable)
    if not lists:
        reasons = "; ".join(_left_out_sentences(touch_lists))
        raise FileError(
            f"has no list of plate points{f' ({reasons})' if reasons else ''}: give a height map, "
            f"lines 'Bed X: Y: Z:', or a table whose first line names x, y and z, in millimetres",
            file=printable_path(path),
        )
    stem = plain_name(Path(path).stem, "points")
    names = [stem] if len(lists) == 1 else [f"{stem}-{k}" for k in range(1, len(lists) + 1)]
    campaigns = tuple(
        campaign_of_rows(
            name, list(_rows(name, touches, kinematics)), machine, printable_path(path)
        )
        for name, touches in zip(names, lists, strict=True)
    )
    differing = list(disagreements(kinematics, campaigns, relative=True))
    notes = (*_notes(lists, touch_lists, printable_path(path)), *(note for *_, note in differing))
    return Imported(machine, campaigns, notes, () if differing else tuple(names))


def _usable_touches(
    touches: Sequence[Touch], kinematics: DeltaKinematics, touch_lists: TouchLists
) -> list[Touch]:
    """Return the touches of a list within reach of the arms and near its median height; none if
    they are too few for a plane.
    """
    p, usable = np.array([(t.x, t.y, t.z) for t in touches]), list[Touch]()
    near_median = np.abs(p[:, 2] - np.median(p[:, 2])) <= _MAX_FROM_MEDIAN
    near_median &= bool(near_median.mean() > _MIN_NEAR_SHARE)
    reached = np.asarray(np.isfinite(kinematics.travel(p * 1e-3)).all(axis=1))
    for touch, close, within in zip(touches, near_median, reached, strict=True):
        if not close:
            reason = f"more than {_MAX_FROM_MEDIAN:g} mm from the height of most; give millimetres"
            touch_lists.leave_out(reason, touch.line, f"z {touch.z:g}")
        elif not within:
            value = f"x {touch.x:g}, y {touch.y:g}"
            touch_lists.leave_out("beyond the arms of the machine file", touch.line, value)
        else:
            usable.append(touch)
    if len({touch.place for touch in usable}) >= MIN_PLACES:
        return usable
    for touch in usable:
        touch_lists.leave_out(f"a list of fewer than {MIN_PLACES} places", touch.line)
    return []


def _rows(name: str, touches: Sequence[Touch], kinematics: DeltaKinematics) -> Iterator[Row]:
    """Yield touches as readings; a place that is touched again at once is visited again."""
    travel = kinematics.travel(np.array([(t.x, t.y, t.z) for t in touches]) * 1e-3)
    repeat, setup = 1, Setup(name, kind=PlateTouch.kind)
    for k, (touch, position) in enumerate(zip(touches, travel, strict=True)):
        repeat = repeat + 1 if k and touch.place == touches[k - 1].place else 1
        yield Row(
            setup, f"{touch.x:g} {touch.y:g}", position, 0.0,
            temperature=touch.temperature, repeat=repeat, line=touch.line,
        )  # fmt: skip


def _left_out_sentences(touch_lists: TouchLists) -> Iterator[str]:
    """Yield a sentence for each reason why lines were left out, with the value of the first."""
    for reason, lines in touch_lists.left_out.items():
        line_numbers = ", ".join(map(str, [*lines][:_MAX_LINES_NAMED]))
        line_numbers += ", ..." * (len(lines) > _MAX_LINES_NAMED)
        first_text = next(iter(lines.values()))[:_MAX_CHARACTERS]
        value = f" ({first_text!r})" if first_text else ""
        yield f"left out: line{'s' * (len(lines) > 1)} {line_numbers}: {reason}{value}"


def _notes(lists: Sequence[Sequence[Touch]], touch_lists: TouchLists, file: str) -> Iterator[Note]:
    """Yield remarks on the lists that were read."""
    yield from (Note(f"{file}: {text}", "readings") for text in _left_out_sentences(touch_lists))
    if len(lists) > 1:
        yield Note(
            f"{file} has {len(lists)} lists: give close-loop those that were probed with the same "
            f"numbers of the firmware", "mesh",
        )  # fmt: skip
    points = (np.array([(t.x, t.y, t.z) for t in touches]) for touches in lists)
    max_residual = max(float(np.abs(fit_plane(p, p[:, 2])[1]).max()) for p in points)
    if max_residual > _MAX_OFF_PLANE:
        yield Note(
            f"heights lie up to {max_residual:.1f} mm off a plane: look whether they are in "
            f"millimetres, and probed with the sizes of the machine file", "mesh",
        )  # fmt: skip
    yield from note_few_touches(max(map(len, lists)))
    yield Note(
        "the places are taken as the nozzle's, computed by the firmware with the sizes of the "
        "machine file (L, radius_mm less r, angles_deg): correct them there if it had others; of a "
        "probe beside the nozzle add the columns beside_x_mm and beside_y_mm", "probe",
    )  # fmt: skip
