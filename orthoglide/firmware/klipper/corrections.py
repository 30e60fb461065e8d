"""New numbers for the firmware as tables and words: what to paste, and what they leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orthoglide.add_ons import Corrections, Paste
from orthoglide.firmware.klipper.numbers import TOWERS, Numbers
from orthoglide.firmware.klipper.provenance import MAX_ROD_SPREAD
from orthoglide.numerals import signed
from orthoglide.ordering import best_of

CONFIG_FILE = "printer.cfg"
PASTE_INSTRUCTIONS = (
    "Replace the values in the block below the header of SAVE_CONFIG (#*#) at the end of "
    "printer.cfg, and leave #*# before every line; they have no effect while a line above that "
    "header gives the same key: remove such lines, or put the new ones in their place. Then "
    "RESTART, run PROBE_CALIBRATE where the probe touches beside the nozzle, and probe the mesh "
    "again (BED_MESH_CALIBRATE); DELTA_CALIBRATE would put numbers of its own in their place."
)
"""How new numbers come into the file."""

_ENTER_ALL = (
    "These bring the tool nearest to where the firmware believes it is over the plate, the plate "
    "being its z = 0. Enter all of them or none. Save the old numbers; entering them again undoes "
    "the change."
)

_NO_NEW_NUMBERS = (
    "There are none: the plate is the firmware's z = 0, and no readings of it out to its rim are "
    "kept with this machine. Take calibrated.toml of a run of close-loop that has some."
)


@dataclass(frozen=True)
class ResidualChange:
    """Root mean squares of the residuals of the readings of a file, metres."""

    file: str  # name of the readings
    kind: str  # ``heights`` or ``distances``
    count: int  # of the readings
    old: float  # by the firmware's equations with the old numbers
    new: float  # with the new ones


def make_corrections(
    old: Numbers, new: Numbers, left: Sequence[ResidualChange], keep: str, rods_measured: bool
) -> Corrections:
    """Return new numbers beside the old ones.

    Args:
        old: the present ones.
        new: those that bring the calibrated machine nearest to where it is commanded to be.
        left: what both leave of the readings.
        keep: why the new ones are not to be entered, a clause; empty where they are better.
        rods_measured: whether the machine file gives the length of the rods as measured.
    """
    # Every file counts alike, as heights of two days lie apart by more than touches scatter.
    each = [(one.old, one.new) for one in left if one.kind == "heights"] or [(0.0, 0.0)]
    before, after = np.sqrt(np.mean(np.square(each), axis=0)).tolist()
    longer, rods = float(np.mean(new.arm) - np.mean(old.arm)), ""
    if abs(longer) > MAX_ROD_SPREAD:  # the size is told with the causes
        way = "longer" if longer > 0 else "shorter"
        why = "as measured"
        if not rods_measured:
            why = (
                "as distances say, and a print that shrank makes these shorter: measure a rod first"
            )
        rods = f"; they have {way} rods, {why}"
    if (spread := float(np.ptp(new.arm))) > MAX_ROD_SPREAD and not rods_measured:
        rods += (
            f"; their arms differ by {spread * 1e3:.2f} mm, more than rods of one set do: measure "
            f"the rods before you enter them"
        )
    offered = old if keep else new  # what fits worse is never shown as new numbers
    values = offered.values
    return Corrections(
        rows=[(" ".join(key), value, values[key]) for key, value in old.values.items()],
        left=[(f"{x.file}, {x.kind}", f"{x.old * 1e3:.3f}", f"{x.new * 1e3:.3f}") for x in left],
        height=(before, after),
        keep=keep,
        words=(
            f"most of all {_largest_change(old, new)}; of heights over the plate its equations "
            f"leave {after * 1e3:.3f} mm rms, and {before * 1e3:.3f} mm with the old ones{rods}"
        ),
        where=PASTE_INSTRUCTIONS,
        kept={
            "new": offered.as_dict(),
            **({"tried": new.as_dict()} if keep else {}),
            "height_rms_mm": [round(before * 1e3, 6), round(after * 1e3, 6)],
            "keep_old_because": keep,
            **({"rods_measured": True} if rods_measured else {}),
            "left_of_readings": [
                {"file": x.file, "kind": x.kind, "count": x.count,
                 "old_rms_mm": round(x.old * 1e3, 6), "new_rms_mm": round(x.new * 1e3, 6)}
                for x in left
            ],
        },
        file=CONFIG_FILE,
        paste=tuple(offered.lines()),
        undo=tuple(old.lines()),
        old=old,
        new=offered,
    )  # fmt: skip


def _largest_change(old: Numbers, new: Numbers) -> str:
    """Return the number that changes most, with its change; an angle counts by how far its tower
    moves.
    """
    change = new.delta_radius - old.delta_radius
    moves = {f"delta_radius by {signed(change * 1e3, 3)} mm": change}
    for k, tower in enumerate(TOWERS):
        for name, change in (
            ("position_endstop", new.endstop[k] - old.endstop[k]),
            ("arm_length", new.arm[k] - old.arm[k]),
        ):
            moves[f"{name} of tower {tower} by {signed(change * 1e3, 3)} mm"] = change
        turn = new.angle[k] - old.angle[k]
        moves[f"angle of tower {tower} by {signed(turn, 3)}°"] = np.deg2rad(turn) * old.delta_radius
    return best_of(moves, lambda words: abs(moves[words]))


def make_paste(old: Numbers, table: object) -> Paste:
    """Return the numbers that a machine file keeps in place of old ones, to paste."""
    facts: dict[str, object] = {"old": old.as_dict()}
    try:
        found = _stored_corrections(old, table)
    except (KeyError, TypeError, ValueError):  # nothing was kept, or the table was edited
        lacking = facts | {"missing": _NO_NEW_NUMBERS}
        return Paste({"drive": [], "old": [], "new": []}, lacking, (_NO_NEW_NUMBERS,))
    drive, before, after = zip(*found.rows, strict=True)
    columns = {"drive": [*drive], "old": [*map(float, before)], "new": [*map(float, after)]}
    named = [f"  {name:28}{one:>14}{other:>14}" for name, one, other in found.rows]
    left = [f"  {name:40}{one:>8}{other:>8}" for name, one, other in found.left]
    return Paste(columns, facts | dict(found.kept), (
        *(() if found.keep else (_ENTER_ALL,)),
        "\n".join((f"{found.file:30}{'old':>14}{'new':>14}", *named)),
        "\n".join(("Left of the readings by its equations, rms, mm, old and new:", *left)),
        *((f"Do not enter new numbers: {found.keep}.",) if found.keep else ()),
        *(() if found.keep else (
            found.where,
            "\n".join(("To paste:", *found.paste)),
            "\n".join(("To undo:", *found.undo)),
        )),
        "What no number of the firmware holds stands in the report.",
    ))  # fmt: skip


def _stored_corrections(old: Numbers, table: Any) -> Corrections:
    """Return the new numbers of a machine file; one of an earlier version has no residuals.

    Raises:
        KeyError, TypeError, ValueError: where nothing was kept, or the table was edited.
    """
    if not isinstance(table, Mapping):
        raise TypeError
    left = [
        ResidualChange(str(x["file"]), str(x["kind"]), int(x["count"]), float(x["old_rms_mm"]) * 1e-3,
             float(x["new_rms_mm"]) * 1e-3)
        for x in table.get("left_of_readings", ())
    ]  # fmt: skip
    keep = str(table.get("keep_old_because", ""))
    known = table.get("rods_measured") is True
    return replace(
        make_corrections(old, Numbers.from_table(table["new"]), left, keep, known), kept=table
    )
