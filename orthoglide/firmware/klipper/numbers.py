"""The firmware's numbers of a delta, its equations, and new numbers as tables and words.

With tower i at angle t_i and the one radius R, arms A_i, endstops e_i above the plate, a carriage
at height h_i has the nozzle at (x, y, z) where
``h_i = z + sqrt(A_i^2 - (R cos t_i - x)^2 - (R sin t_i - y)^2)``; at the endstop
``h_i = e_i + sqrt(A_i^2 - R^2)``, and stored positions count steps down from there
(klippy/kinematics/delta.py).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.add_ons import Corrections, Paste
from orthoglide.files import sha256
from orthoglide.firmware.klipper.config import Config
from orthoglide.geometry import Array
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import DeltaKinematics
from orthoglide.numerals import signed, with_sigma
from orthoglide.ordering import best_of

TOWERS = LinearDelta.names.legs
DEFAULT_ANGLES = (210.0, 330.0, 90.0)  # degrees at which the towers stand where nothing is given
_MAX_ARM_DIFFERENCE = 0.05
"""Largest relative difference of two arms: those that firmware found on owners' printers differ by
half a per cent, by more after a wrong distance."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Numbers:
    """The numbers of ``[printer]`` and ``[stepper_*]``."""

    # horizontal distance from nozzle to tower joints with the nozzle in the centre, metres
    delta_radius: float
    angle: Triple  # of the towers, degrees
    arm: Triple  # lengths of the arms, metres
    endstop: Triple  # height of the nozzle in the centre with this carriage at its endstop, metres

    @property
    def at_endstop(self) -> Array:
        """Height of the carriages at their endstops ``(3,)``, metres."""
        return np.array(self.endstop) + np.sqrt(np.array(self.arm) ** 2 - self.delta_radius**2)

    @property
    def mean_arm(self) -> float:
        """Length of the bars in the machine file, metres."""
        return round(float(np.mean(self.arm)), 6)

    @property
    def zero(self) -> float:
        """Height of the carriages at mechanical zero of the machine file, metres."""
        return float(np.sqrt(self.mean_arm**2 - self.delta_radius**2))

    def heights(self, p: Array) -> Array:
        """Return commanded heights of the carriages ``(n, 3)`` for points ``(n, 3)``, metres; nan
        where an arm does not reach.
        """
        return self.kinematics(0.0).travel(p)

    def points(self, heights: Array) -> Array:
        """Return places of the nozzle ``(n, 3)`` for heights of the carriages ``(n, 3)``, metres.

        Raises:
            UnreachableError: if the arms do not meet.
        """
        return self.kinematics(0.0).places(heights)

    def kinematics(self, height: float) -> DeltaKinematics:
        """Return the firmware's kinematics, with travel counted from a height, metres."""
        turn = np.deg2rad(np.array(self.angle))
        towers = self.delta_radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return DeltaKinematics(np.column_stack([towers, np.full(3, height)]), np.array(self.arm))

    def changed(self, change: Array) -> Numbers:
        """Return the numbers changed by ``(9,)``: endstops and radius, metres, angles of a and b,
        radians, all arms, and arms a and b beyond that, metres.
        """
        return Numbers(
            self.delta_radius + float(change[3]),
            _triple(np.array(self.angle) + np.rad2deg([*change[4:6], 0.0])),
            _triple(np.array(self.arm) + change[6] + [*change[7:9], 0.0]),
            _triple(np.array(self.endstop) + change[:3]),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as a machine file keeps them, millimetres and degrees."""
        return {
            "delta_radius_mm": round(self.delta_radius * 1e3, 9),
            "angle_deg": [round(v, 9) for v in self.angle],
            "arm_length_mm": [round(v * 1e3, 9) for v in self.arm],
            "position_endstop_mm": [round(v * 1e3, 9) for v in self.endstop],
        }

    @property
    def mark(self) -> str:
        """Short identifier of these numbers, which no spreadsheet takes for a number."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        return f"klipper-{sha256(text.encode())[:8]}"

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Numbers:
        """Return the numbers that a machine file keeps.

        Raises:
            KeyError, TypeError, ValueError: if the table was edited.
        """
        return cls(
            float(table["delta_radius_mm"]) * 1e-3,
            _triple(table["angle_deg"]),
            _triple(table["arm_length_mm"], 1e-3),
            _triple(table["position_endstop_mm"], 1e-3),
        )

    @classmethod
    def read(cls, config: Config) -> Numbers:
        """Return the numbers of a file of a printer whose carriages run on three towers.

        Raises:
            FileError: if it is another printer, or a number is missing or contradicts the others.
        """
        printer = config.section("printer")
        kind = printer.entries["kinematics"].text if "kinematics" in printer else "delta"
        if kind.lower() != "delta":
            turning = ", arms that turn about shoulders" * kind.startswith("rotary")
            printer.fail(
                "kinematics",
                f"is {kind[:40]!r}{turning}, not 'delta': only printers whose carriages run on "
                f"three towers are imported, and calibrated",
            )
        radius = printer.number("delta_radius", low=10, high=5000) * 1e-3
        towers = [config.section(f"stepper_{name}") for name in TOWERS]
        arm = towers[0].number("arm_length", low=10, high=5000)
        endstop = towers[0].number("position_endstop", low=1, high=10000)
        arms = [tower.number("arm_length", arm, 10, 5000) * 1e-3 for tower in towers]
        ends = [tower.number("position_endstop", endstop, 1, 10000) * 1e-3 for tower in towers]
        for k, tower in enumerate(towers):
            if not 0.5 * ends[0] < ends[k] < 2 * ends[0]:
                tower.fail(
                    "position_endstop",
                    f"is {ends[k] * 1e3:g} mm, and that of tower {TOWERS[0]} {ends[0] * 1e3:g}: "
                    f"carriages of one machine stop at about one height; give both in millimetres",
                )
            if abs(arms[k] / arms[0] - 1) > _MAX_ARM_DIFFERENCE:
                tower.fail(
                    "arm_length",
                    f"is {arms[k] * 1e3:g} mm, and that of tower {TOWERS[0]} {arms[0] * 1e3:g}: "
                    f"arms of one machine differ by less than {100 * _MAX_ARM_DIFFERENCE:.0f} %; "
                    f"correct it or, if DELTA_ANALYZE found it, correct the mistyped distance and "
                    f"run DELTA_ANALYZE again",
                )
            if arms[k] <= 1.02 * radius:
                tower.fail(
                    "arm_length",
                    f"is {arms[k] * 1e3:g}, not longer than delta_radius "
                    f"({radius * 1e3:g}): are they exchanged?",
                )
        defaults = zip(towers, DEFAULT_ANGLES, strict=True)
        angles = [tower.number("angle", angle, -720, 720) for tower, angle in defaults]
        return cls(radius, _triple(angles), _triple(arms), _triple(ends))

    @property
    def values(self) -> dict[tuple[str, str], str]:
        """Values of a ``printer.cfg`` by section and key."""
        values = {("[printer]", "delta_radius"): f"{self.delta_radius * 1e3:.6f}"}
        for k, name in enumerate(TOWERS):
            values[f"[stepper_{name}]", "angle"] = f"{self.angle[k]:.6f}"
            values[f"[stepper_{name}]", "arm_length"] = f"{self.arm[k] * 1e3:.6f}"
            values[f"[stepper_{name}]", "position_endstop"] = f"{self.endstop[k] * 1e3:.6f}"
        return values

    def lines(self) -> list[str]:
        """Return the lines of a ``printer.cfg``."""
        lines = list[str]()
        for (section, key), value in self.values.items():
            lines += [section] * (section not in lines)
            lines.append(f"{key}: {value}")
        return lines


def _triple(values: Iterable[Any], unit: float = 1.0) -> Triple:
    a, b, c = (float(v) * unit for v in values)
    return a, b, c


FIRMWARE_NAME = "klipper"
"""Name of the entry point, and of the table of a machine file, which has besides the numbers:
``warnings`` of the import, sentences; ``changed_since``, those of them that say what was moved or
changed since the firmware's own calibration; ``calibrate_again``, whether that has to be run before
any number is entered; ``meshes_relative``, whether the height at one place is subtracted from
meshes; ``assumed_mm``, sizes that no firmware stores; ``corrected``, new numbers of a calibrated
machine."""

CALIBRATION = "calibration"
"""Name of the readings of [delta_calibrate]: heights and distances. They are stored as steps from
the endstops and, unlike meshes, are valid for any numbers of the firmware."""

MAX_ROD_SPREAD = 5e-4  # metres: largest difference of rods of one set
_EQUAL_ARMS = 5e-5  # metres: largest difference of arms that are taken as equal


def unequal_arms_warning(numbers: Numbers) -> str:
    """Return a warning on stored arms that differ; empty if they are equal."""
    if (spread := float(np.ptp(numbers.arm))) <= _EQUAL_ARMS:
        return ""
    arms = ", ".join(f"{v * 1e3:.3f}" for v in numbers.arm)
    is_large = spread > MAX_ROD_SPREAD
    excess = ", more than rods of one set do" * is_large
    remedy = " Measure the rods before you trust any number of this firmware." * is_large
    return (
        f"The arms that the firmware stores ({arms} mm) differ by {spread * 1e3:.2f} mm{excess}. "
        f"They are taken as equal, of a free length, unless that length is given under [measured] "
        f"of the machine file.{remedy}"
    )


_MIN_SIZE_CONFLICT = 3e-5  # metres, rms: smaller changes of distances are their noise
_HARDLY_LESS = 0.95  # share of a residual above which its fall is not worth telling
CONFIG_FILE = "printer.cfg"
PASTE_INSTRUCTIONS = (
    "Replace the values in the block below the header of SAVE_CONFIG (#*#) at the end of "
    "printer.cfg, and leave #*# before every line. A line above that header overrides the same key "
    "in the block, so remove such lines or change their values too. Then RESTART, run "
    "PROBE_CALIBRATE if the probe touches beside the nozzle, and probe the mesh again "
    "(BED_MESH_CALIBRATE). Do not run DELTA_CALIBRATE: it replaces the new numbers."
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
    largest: str = ""  # where the residual is largest with the new ones, and that, a phrase
    others: Sequence[float] = (0.0, math.inf)  # old and new without that reading


def make_record(
    old: Numbers, new: Numbers, changes: Sequence[ResidualChange], keep: str, rods_measured: bool,
    gain: Sequence[float] = (), unasked_rods: float = 0.0,
) -> dict[str, Any]:  # fmt: skip
    """Return what a calibrated machine keeps of new numbers, with the residuals of the readings by
    both; ``keep``: why the new ones are not to be entered, a clause, empty if they are better;
    ``gain``: expected along the plate, and its standard deviation, metres; ``unasked_rods``: length
    of rods by the heights alone, metres, 0 if others ask for it.
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
        **({"gain_along_mm": [round(v * 1e3, 6) for v in gain]} if gain else {}),
        **({"rods_by_heights_mm": round(unasked_rods * 1e3, 6)} if unasked_rods else {}),
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
    by_heights = float(record.get("rods_by_heights_mm", np.mean(old.arm) * 1e3)) * 1e-3
    rises = [
        float(x["new_rms_mm"]) - float(x["old_rms_mm"])
        for x in record.get("left_of_readings", ()) if x["kind"] == "distances"
    ]  # fmt: skip
    if abs(rod_change) > MAX_ROD_SPREAD:
        longer = "longer" if rod_change > 0 else "shorter"
        why = (
            "as the distances say (a part that shrank makes distances shorter): measure a rod first"
        )
        if rods_measured:
            why = f"{np.mean(new.arm) * 1e3:.1f} mm, as was measured"
        gain = record.get("gain_along_mm")
        along = f"; along the plate {with_sigma(*gain)} mm are gained" if gain else ""
        rods = f"; the new numbers make the rods {longer}, {why}{along}"
    elif abs(by_heights - float(np.mean(old.arm))) > MAX_ROD_SPREAD:
        rods = (
            f"; the heights alone ask for rods of {by_heights * 1e3:.1f} mm, or the plate has "
            f"lobes: arm_length stays until a rod is measured (rods_mm under [measured])"
        )
    elif not rods_measured and any(rise * 1e-3 > _MIN_SIZE_CONFLICT for rise in rises):
        rods = "; with them the distances fit worse, as if the part had shrunk: measure a rod first"
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
