"""New numbers for the firmware as tables and words: lines to paste, and residuals."""

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
    old: Numbers, new: Numbers, changes: Sequence[ResidualChange], keep: str, rods_measured: bool
) -> Corrections:
    """Return new numbers beside the old ones.

    Args:
        old: present numbers.
        new: numbers that bring the calibrated machine nearest to where it is commanded to be.
        changes: residuals of the readings with both.
        keep: why the new ones are not to be entered, a clause; empty if they are better.
        rods_measured: whether the machine file gives the length of the rods as measured.
    """
    # Files have equal weights, as heights of two days differ by more than touches scatter.
    heights = [(x.old, x.new) for x in changes if x.kind == "heights"] or [(0.0, 0.0)]
    before, after = np.sqrt(np.mean(np.square(heights), axis=0)).tolist()
    rod_change, rods = float(np.mean(new.arm) - np.mean(old.arm)), ""
    if abs(rod_change) > MAX_ROD_SPREAD:  # the size is told with the causes
        rods = f"; they have {'longer' if rod_change > 0 else 'shorter'} rods, as " + (
            "measured" if rods_measured else
            "distances say, and a print that shrank makes these shorter: measure a rod first"
        )  # fmt: skip
    if (spread := float(np.ptp(new.arm))) > MAX_ROD_SPREAD and not rods_measured:
        rods += (
            f"; their arms differ by {spread * 1e3:.2f} mm, more than rods of one set do: measure "
            f"the rods before you enter them"
        )
    offered = old if keep else new  # numbers that fit worse are never shown as new
    values = offered.values
    return Corrections(
        rows=[(" ".join(key), value, values[key]) for key, value in old.values.items()],
        left=[(f"{x.file}, {x.kind}", f"{x.old * 1e3:.3f}", f"{x.new * 1e3:.3f}") for x in changes],
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
                for x in changes
            ],
        },
        file=CONFIG_FILE,
        paste=tuple(offered.lines()),
        undo=tuple(old.lines()),
        old=old,
        new=offered,
    )  # fmt: skip


def _largest_change(old: Numbers, new: Numbers) -> str:
    """Return the number that changes most, with its change; for an angle the displacement of the
    tower counts.
    """
    change = new.delta_radius - old.delta_radius
    moves = {f"delta_radius by {signed(change * 1e3, 3)} mm": change}
    for k, tower in enumerate(TOWERS):
        endstop, arm = new.endstop[k] - old.endstop[k], new.arm[k] - old.arm[k]
        for name, change in (("position_endstop", endstop), ("arm_length", arm)):
            moves[f"{name} of tower {tower} by {signed(change * 1e3, 3)} mm"] = change
        turn = new.angle[k] - old.angle[k]
        moves[f"angle of tower {tower} by {signed(turn, 3)}°"] = np.deg2rad(turn) * old.delta_radius
    return best_of(moves, lambda words: abs(moves[words]))


def make_paste(old: Numbers, table: object) -> Paste:
    """Return the numbers that a machine file keeps in place of the old ones, to paste."""
    facts: dict[str, object] = {"old": old.as_dict()}
    try:
        corrections = _stored_corrections(old, table)
    except (KeyError, TypeError, ValueError):  # nothing was kept, or the table was edited
        lacking = facts | {"missing": _NO_NEW_NUMBERS}
        return Paste({"drive": [], "old": [], "new": []}, lacking, (_NO_NEW_NUMBERS,))
    drive, before, after = zip(*corrections.rows, strict=True)
    columns = {"drive": [*drive], "old": [*map(float, before)], "new": [*map(float, after)]}
    number_lines = [f"  {name:28}{was:>14}{new:>14}" for name, was, new in corrections.rows]
    residual_lines = [f"  {name:40}{was:>8}{new:>8}" for name, was, new in corrections.left]
    residual_title = "Left of the readings by its equations, rms, mm, old and new:"
    return Paste(columns, facts | dict(corrections.kept), (
        *(() if corrections.keep else (_ENTER_ALL,)),
        "\n".join((f"{corrections.file:30}{'old':>14}{'new':>14}", *number_lines)),
        "\n".join((residual_title, *residual_lines)),
        *((f"Do not enter new numbers: {corrections.keep}.",) if corrections.keep else ()),
        *(() if corrections.keep else (
            corrections.where,
            "\n".join(("To paste:", *corrections.paste)),
            "\n".join(("To undo:", *corrections.undo)),
        )),
        "What no number of the firmware holds stands in the report.",
    ))  # fmt: skip


def _stored_corrections(old: Numbers, table: Any) -> Corrections:
    """Return the new numbers of a machine file; without residuals if an earlier version wrote it.

    Raises:
        KeyError, TypeError, ValueError: if the file has no new numbers, or was edited.
    """
    if not isinstance(table, Mapping):
        raise TypeError
    changes = [
        ResidualChange(str(x["file"]), str(x["kind"]), int(x["count"]),
                       float(x["old_rms_mm"]) * 1e-3, float(x["new_rms_mm"]) * 1e-3)
        for x in table.get("left_of_readings", ())
    ]  # fmt: skip
    keep = str(table.get("keep_old_because", ""))
    rods_measured = table.get("rods_measured") is True
    new = Numbers.from_table(table["new"])
    return replace(make_corrections(old, new, changes, keep, rods_measured), kept=table)
