"""The firmware's numbers for a calibrated machine, beside the old ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.machine import Machine
from orthoglide.machine_file import TOWERS, Firmware
from orthoglide.numerals import signed

WHERE = (
    "Replace the values in the block below the header of SAVE_CONFIG (#*#) at the end of "
    "printer.cfg, and leave #*# before every line; they have no effect while a line above that "
    "header gives the same key: remove such lines, or put the new ones in their place. Then "
    "RESTART, and probe the mesh again (BED_MESH_CALIBRATE); DELTA_CALIBRATE would put numbers of "
    "its own in their place."
)
"""How new numbers come into the file."""

_WORTH, _LEAST = 0.02, 3e-6  # of an error, and metres: numbers that gain less are not worth a line
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
    def gains(self) -> bool:
        """Whether heights are to be expected better by more than is worth a line."""
        before, after = self.height
        return before - after > max(_WORTH * before, _LEAST)

    @property
    def vain(self) -> str:
        """What they are than the old ones that should be kept; empty where they gain something."""
        before, after = self.height
        return "" if self.gains else "hardly better" if after < before else "no better"

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
        most = max(changed, key=lambda name: abs(changed[name]))
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
        return {"old": self.old.as_dict(), **self.kept}

    @property
    def kept(self) -> dict[str, object]:
        """What a machine file keeps of them beside the old numbers."""
        return {
            "new": self.new.as_dict(),
            "height_rms_mm": [round(v * 1e3, 6) for v in self.height],
            "sideways_rms_mm": [round(v * 1e3, 6) for v in self.sideways],
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
        return Corrections(old, Firmware.of(found["new"]), (a, b), (c, d))
    except (KeyError, TypeError, ValueError):  # none, or the table was edited
        return None
