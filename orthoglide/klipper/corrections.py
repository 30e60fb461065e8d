"""The firmware's numbers for a calibrated machine, beside the old ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from orthoglide.machine import Machine
from orthoglide.machine_file import TOWERS, Firmware
from orthoglide.numerals import signed

WHERE = (
    "Replace the values in the block below the header of SAVE_CONFIG (#*#) at the end of "
    "printer.cfg, and leave #*# before every line; or put the lines above that header and remove "
    "the old ones: what stands above goes before what stands below. Then RESTART, and probe the "
    "mesh again (BED_MESH_CALIBRATE); DELTA_CALIBRATE would put numbers of its own in their place."
)
"""How new numbers come into the file."""


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
        found = [("[printer] delta_radius", self.old.delta_radius, self.new.delta_radius, 1e3)]
        for k, name in enumerate(TOWERS):
            for key, unit in (("angle", 1.0), ("arm_length", 1e3), ("position_endstop", 1e3)):
                attribute = {"arm_length": "arm", "position_endstop": "endstop"}.get(key, key)
                one, other = getattr(self.old, attribute)[k], getattr(self.new, attribute)[k]
                found.append((f"[stepper_{name}] {key}", one, other, unit))
        return [(name, f"{a * unit:.6f}", f"{b * unit:.6f}") for name, a, b, unit in found]

    @property
    def words(self) -> str:
        """What they change most, and what that does to heights, as a clause."""
        old, new = self.old, self.new
        changed = {"delta_radius": new.delta_radius - old.delta_radius}
        for name, one, other in zip(TOWERS, old.endstop, new.endstop, strict=True):
            changed[f"position_endstop of tower {name}"] = other - one
        most = max(changed, key=lambda name: abs(changed[name]))
        by = signed(changed[most] * 1e3, 3)
        before, after = (f"{v * 1e3:.3f}" for v in self.height)
        return (
            f"most of all {most} by {by} mm; height over the plate goes from {before} to {after} "
            f"mm rms"
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
