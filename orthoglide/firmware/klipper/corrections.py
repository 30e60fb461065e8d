"""New numbers for the firmware as tables and words: lines to paste, and residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.add_ons import Corrections, Paste
from orthoglide.firmware.klipper.numbers import TOWERS, Numbers
from orthoglide.firmware.klipper.provenance import MAX_ROD_SPREAD
from orthoglide.numerals import signed
from orthoglide.ordering import best_of

_HARDLY_LESS = 0.95  # share of a residual above which its fall is not worth telling
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


def make_record(
    old: Numbers, new: Numbers, changes: Sequence[ResidualChange], keep: str, rods_measured: bool
) -> dict[str, Any]:
    """Return what a calibrated machine keeps of new numbers.

    Args:
        old: present numbers.
        new: numbers that bring the calibrated machine nearest to where it is commanded to be.
        changes: residuals of the readings with both.
        keep: why the new ones are not to be entered, a clause; empty if they are better.
        rods_measured: whether the machine file gives the length of the rods as measured.
    """
    # Files have equal weights, as heights of two days differ by more than touches scatter.
    heights = [(x.old, x.new) for x in changes if x.kind == "heights"] or [(0.0, 0.0)]
    height_rms = np.sqrt(np.mean(np.square(heights), axis=0)) * 1e3
    return {
        "new": (old if keep else new).as_dict(),  # numbers that fit worse are never shown as new
        **({"tried": new.as_dict()} if keep else {}),
        "height_rms_mm": height_rms.round(6).tolist(),
        "keep_old_because": keep,
        **({"rods_measured": True} if rods_measured else {}),
        "left_of_readings": [
            {"file": x.file, "kind": x.kind, "count": x.count,
             "old_rms_mm": round(x.old * 1e3, 6), "new_rms_mm": round(x.new * 1e3, 6)}
            for x in changes
        ],
    }  # fmt: skip


def corrections_of(old: Numbers, record: Mapping[str, Any]) -> Corrections:
    """Return the new numbers of a record beside the old ones; without residuals if an earlier
    version wrote it.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: if there is no record, or it was edited.
    """
    offered, new = (Numbers.from_table(record.get(k, record["new"])) for k in ("new", "tried"))
    before, after = (float(value) * 1e-3 for value in record["height_rms_mm"])
    keep, rods_measured = str(record["keep_old_because"]), record.get("rods_measured") is True
    rod_change, rods = float(np.mean(new.arm) - np.mean(old.arm)), ""
    if abs(rod_change) > MAX_ROD_SPREAD:  # the size is told with the causes
        longer = "longer" if rod_change > 0 else "shorter"
        why = "as the heights ask, and no distance does: measure a rod first"
        if rods_measured:
            why = "as was measured"
        elif "left_of_readings" not in record or any(
            x["kind"] == "distances" and x["new_rms_mm"] < x["old_rms_mm"]
            for x in record["left_of_readings"]
        ):
            why = (
                "as the distances say (a part that shrank makes distances shorter): measure a rod "
                "first"
            )
        rods = f"; the new numbers make the rods {longer}, {why}"
    if (spread := float(np.ptp(new.arm))) > MAX_ROD_SPREAD and not rods_measured:
        rods += (
            f"; the new arms differ by {spread * 1e3:.2f} mm, more than rods of one set do: "
            f"measure the rods before you enter them"
        )
    return Corrections(
        rows=[(" ".join(key), value, offered.values[key]) for key, value in old.values.items()],
        left=[
            (f"{x['file']}, {x['kind']}", f"{x['old_rms_mm']:.3f}", f"{x['new_rms_mm']:.3f}")
            for x in record.get("left_of_readings", ())
        ],
        height=(before, after),
        keep=keep,
        words=f"above all {_largest_change(old, new)}; {_gain_clause(record)}{rods}",
        where=PASTE_INSTRUCTIONS,
        kept=record,
        file=CONFIG_FILE,
        paste=tuple(offered.lines()),
        undo=tuple(old.lines()),
        old=old,
        new=offered,
    )  # fmt: skip


def _gain_clause(record: Mapping[str, Any]) -> str:
    """Return what the new numbers leave of the heights; if these hardly fall, of the readings whose
    residual falls most.
    """
    what, (before, after) = "heights over the plate", map(float, record["height_rms_mm"])
    by_file = record.get("left_of_readings", ())
    if after > _HARDLY_LESS * before and by_file:
        most = best_of(by_file, lambda x: x["old_rms_mm"] - x["new_rms_mm"])
        what = f"the {most['kind']} of {most['file']}"
        before, after = most["old_rms_mm"], most["new_rms_mm"]
    return (
        f"by its equations the residual of {what} changes from {before:.3f} to {after:.3f} mm rms"
    )


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


def make_paste(old: Numbers, record: Any) -> Paste:
    """Return the numbers that a machine file keeps in place of the old ones, to paste."""
    facts: dict[str, object] = {"old": old.as_dict()}
    try:
        corrections = corrections_of(old, record)
    except (AttributeError, KeyError, TypeError, ValueError):  # nothing was kept, or it was edited
        lacking = facts | {"missing": _NO_NEW_NUMBERS}
        return Paste({"drive": [], "old": [], "new": []}, lacking, (_NO_NEW_NUMBERS,))
    drive, before, after = zip(*corrections.rows, strict=True)
    columns = {"drive": [*drive], "old": [*map(float, before)], "new": [*map(float, after)]}
    number_lines = [f"  {name:28}{was:>14}{new:>14}" for name, was, new in corrections.rows]
    residual_lines = [f"  {name:40}{was:>8}{new:>8}" for name, was, new in corrections.left]
    numbers = "\n".join((f"{corrections.file:30}{'old':>14}{'new':>14}", *number_lines))
    title, last = "residual of its equations, rms, mm", "tried" if corrections.keep else "new"
    residuals = "\n".join((f"{title:42}{'old':>8}{last:>8}", *residual_lines))
    paragraphs: tuple[str, ...] = (
        _ENTER_ALL, numbers, residuals, corrections.where,
        "\n".join(("To paste:", *corrections.paste)), "\n".join(("To undo:", *corrections.undo)),
    )  # fmt: skip
    if corrections.keep:
        paragraphs = (residuals, f"Do not enter new numbers: {corrections.keep}.")
    rest = "The report lists the errors that no number of the firmware can correct."
    return Paste(columns, facts | dict(record), (*paragraphs, rest))
