"""Values above the header of SAVE_CONFIG that override others below it, and which are right."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from orthoglide.errors import InputError
from orthoglide.klipper.calibration import Calibration
from orthoglide.klipper.config import Config, Override
from orthoglide.klipper.entries import Entry
from orthoglide.klipper.numbers import firmware_of
from orthoglide.machine_file import TOWERS
from orthoglide.notes import Note

STALE = "stale"
"""Kind of the note where the values above are those of another time."""

_NUMBERS = {("printer", "delta_radius")} | {
    (f"stepper_{name}", key)
    for name in TOWERS
    for key in ("angle", "arm_length", "position_endstop")
}
_FITS, _TELLS = 1e-4, 2.0
"""Metres to which heights fit the numbers that were made of them, and times as well as others."""


def override_note(config: Config) -> Note | None:
    """What stands above the header and otherwise below it, and by which the stored heights fit."""
    if not (found := config.overrides):
        return None
    mine = [o for o in found if (o.section, o.key) in _NUMBERS]
    others = "" if len(mine) == len(found) else " (and of the others those that are not meant)"
    lines, kind = _lines(config, (o.own for o in mine)), "twice"
    above, below = _misfit(config), _misfit(config.as_saved)
    vain = "what is pasted below the header has no effect until"
    remedy = (
        "Remove the lines that are not meant: what is pasted below the header has no effect while "
        "the same key stands above it"
    )
    if mine and below < _FITS and not above < _TELLS * below:
        kind = STALE
        remedy = (
            f"By the numbers below the stored heights fit to {_mm(below)}, by {lines} above "
            f"{_mm(above, 'to ')}: remove {lines}{others} and RESTART, then import again; {vain} "
            f"then"
        )
    elif mine and above < _FITS and not below < _TELLS * above:
        remedy = (
            f"By {lines} above the stored heights fit to {_mm(above)}, by the numbers below "
            f"{_mm(below, 'to ')}: those above are right; {vain} {lines} "
            f"{'are' if len(mine) > 1 else 'is'} removed"
        )
    return Note(
        f"{Path(config.file).name} has other values above the header of SAVE_CONFIG than below it, "
        f"and the firmware takes those above, as is done here: "
        f"{'; '.join(_told(config, one) for one in found)}. {remedy}",
        kind,
        tuple(entry.line for one in found for entry in (one.own, one.saved)),
    )


def _misfit(config: Config) -> float:
    """Of the stored heights, metres; infinite where the numbers are of no machine, nan without
    heights.
    """
    try:
        return Calibration(config, firmware_of(config), []).misfit
    except InputError:
        return math.inf


def _mm(metres: float, before: str = "") -> str:
    return f"{before}{max(metres * 1e3, 0.01):.2g} mm" if metres < math.inf else "not at all"


def _told(config: Config, one: Override) -> str:
    def told(entry: Entry) -> str:
        where = _lines(config, [entry])
        return where if "\n" in entry.text else f"{entry.text[:40]} ({where})"

    return f"[{one.section}] {one.key}: {told(one.own)}, below {told(one.saved)}"


def _lines(config: Config, entries: Iterable[Entry]) -> str:
    """``lines 9, 25 and line 2 of towers.cfg``."""
    by_file: dict[str, list[int]] = {}
    for entry in entries:
        by_file.setdefault(entry.file, []).append(entry.line)
    return " and ".join(
        f"line{'s' * (len(lines) > 1)} {', '.join(map(str, sorted(lines)))}"
        + f" of {Path(file).name}" * (file != config.file)
        for file, lines in by_file.items()
    )
