"""The firmware's numbers for a calibrated machine, beside the old ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.klipper.left import Left
from orthoglide.machine import Machine
from orthoglide.machine_file import TOWERS, Firmware
from orthoglide.numerals import signed
from orthoglide.ordering import best_of

WHERE = (
    "Replace the values in the block below the header of SAVE_CONFIG (#*#) at the end of "
    "printer.cfg, and leave #*# before every line; they have no effect while a line above that "
    "header gives the same key: remove such lines, or put the new ones in their place. Then "
    "RESTART{}, and probe the mesh again (BED_MESH_CALIBRATE); DELTA_CALIBRATE would put numbers "
    "of its own in their place."
)
"""How new numbers come into the file."""

FIRST = (
    "Run DELTA_CALIBRATE and SAVE_CONFIG, probe the mesh again and import the new file, before any "
    "number is entered: the stored readings do not go with the stored numbers."
)
"""What is to be done where the firmware's own calibration comes before all numbers."""

_WORTH, _LEAST = 0.05, 3e-6  # of an error, and metres: numbers that gain less are not worth a paste
_OFFSET = 2e-5  # metres by which a probe's offset no longer fits: a mesh that lies off by it shows
_LARGER = 5e-4  # of a print's size: less is no more than plastic shrinks from spool to spool
_OF_A_PRINT = 1 / 3  # of the radius of the towers, which every machine's arms reach


@dataclass(frozen=True)
class Corrections:
    """New numbers for the firmware."""

    old: Firmware  # its present numbers
    new: Firmware  # those that bring the calibrated machine nearest to where it is told to be
    # error to expect of height over the plate (before, after), metres, rms: what is known, and how
    # far it is not
    height: tuple[float, float]
    sideways: tuple[float, float]  # the same along the plate, past a shift and a turn of everything
    left: tuple[Left, ...] = ()  # what the firmware's equations leave of the readings
    offset: float = 0.0  # by how much the probe's z_offset will be larger, metres
    refused: str = ""  # why they are not to be entered whatever they gain, a clause

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Section and key, old and new, as the file has them."""
        new = self.new.sections()
        return [
            (f"{section} {key}", value, new[section][key])
            for section, keys in self.old.sections().items()
            for key, value in keys.items()
        ]

    @property
    def keep(self) -> str:
        """Why the old ones are to be kept, a clause; empty where the new ones are to be entered:
        better by what is known, and by what the firmware itself makes of the readings.
        """
        before, after = self.height
        if self.refused:
            return self.refused
        if before - after <= max(_WORTH * before, _LEAST):
            how = "hardly better" if after < before else "no better"
            return f"by what is known the new ones are {how}"
        for kind, least in (("heights", _WORTH), ("distances", -_WORTH)):
            was, now = self.rms_left(kind)
            if was - now < least * was:
                return (
                    f"of the {kind} that were read the firmware's own equations leave "
                    f"{now * 1e3:.3f} mm rms with the new ones, and {was * 1e3:.3f} mm with those"
                )
        return ""

    def rms_left(self, kind: str) -> tuple[float, float]:
        """What the old and the new ones leave of the readings of a kind, metres, every file alike,
        as heights of two days lie apart by more than touches scatter; 0 of none.
        """
        own = [(one.old, one.new) for one in self.left if one.kind == kind]
        was, now = np.sqrt(np.mean(np.square(own or [(0.0, 0.0)]), axis=0)).tolist()
        return was, now

    @property
    def left_rows(self) -> list[tuple[str, str, str]]:
        """What is left, as a table: of each file's readings, and of all of a kind."""
        rows = [(f"{one.file}, {one.kind}", one.old, one.new) for one in self.left]
        for kind in dict.fromkeys(one.kind for one in self.left):
            if sum(one.kind == kind for one in self.left) > 1:
                rows.append((f"all {kind}, every file alike", *self.rms_left(kind)))
        return [(what, f"{was * 1e3:.3f}", f"{now * 1e3:.3f}") for what, was, now in rows]

    @property
    def where(self) -> str:
        """How they come into the file, and what is to be done after that."""
        return WHERE.format(f", {self.probe}" if self.probe else "")

    @property
    def probe(self) -> str:
        """What is to be done to the probe, a clause; empty where its offset fits still."""
        if abs(self.offset) <= _OFFSET:
            return ""
        by = signed(self.offset * 1e3, 2)
        return f"run PROBE_CALIBRATE and SAVE_CONFIG, as z_offset changes by about {by} mm"

    @property
    def size(self) -> float:
        """How much larger prints become along the plate, over their size with the old numbers."""
        reach = _OF_A_PRINT * self.old.delta_radius
        angle = np.arange(6) * np.pi / 3
        ring = reach * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        same = self.old.heights(ring) - self.old.at_endstop + self.new.at_endstop
        believed = self.new.points(same)[:, :2]
        return float(reach / np.hypot(*(believed - believed.mean(axis=0)).T).mean()) - 1

    @property
    def words(self) -> str:
        """What they change most, and what that does to heights and sizes, as a clause."""
        old, new = self.old, self.new
        changed = {"delta_radius": new.delta_radius - old.delta_radius}
        for name, one, other in zip(TOWERS, old.endstop, new.endstop, strict=True):
            changed[f"position_endstop of tower {name}"] = other - one
        most = best_of(changed, lambda name: abs(changed[name]))
        by = signed(changed[most] * 1e3, 3)
        before, after = (f"{v * 1e3:.3f}" for v in self.height)
        larger, size = self.size, ""
        if abs(larger) > _LARGER:
            way = "larger" if larger > 0 else "smaller"
            size = (
                f", and prints become {abs(larger) * 100:.2f} % {way} (where their size was right, "
                f"scale them by {1 / (1 + larger):.4f})"
            )
        return (
            f"most of all {most} by {by} mm; height over the plate goes from {before} to {after} "
            f"mm rms{size}"
        )

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        left = {"left_of_readings": [one.as_dict() for one in self.left]} if self.left else {}
        return {"old": self.old.as_dict(), **self.kept, **left}

    @property
    def kept(self) -> dict[str, object]:
        """What a machine file keeps of them beside the old numbers."""
        return {
            "new": self.new.as_dict(),
            "height_rms_mm": [round(v * 1e3, 6) for v in self.height],
            "sideways_rms_mm": [round(v * 1e3, 6) for v in self.sideways],
            "z_offset_by_mm": round(self.offset * 1e3, 6),
            "keep_old_because": self.keep,
        }


def corrections_of(machine: Machine) -> Corrections | None:
    """Those that were kept with a machine; ``None`` where its readings gave none."""
    old, kept = machine.spec.printer, machine.spec.provenance.get("klipper")
    if old is None or not isinstance(kept, Mapping):
        return None
    try:
        found = kept["corrected"]
        (a, b), (c, d) = (
            [float(v) * 1e-3 for v in found[name]] for name in ("height_rms_mm", "sideways_rms_mm")
        )
        offset, keep = float(found.get("z_offset_by_mm", 0.0)), found.get("keep_old_because", "")
        new = Firmware.of(found["new"])
        return Corrections(old, new, (a, b), (c, d), offset=offset * 1e-3, refused=str(keep))
    except (KeyError, TypeError, ValueError):  # none, or the table was edited
        return None
