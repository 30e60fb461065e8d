"""The numbers of a firmware that computes the kinematics itself, as text and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from orthoglide.klipper import Corrections
from orthoglide.machine_file import Firmware

_LACKING = (
    "There are none: the plate is the firmware's z = 0, and no readings of it out to its rim are "
    "kept with this machine. Take calibrated.toml of a run of close-loop that has some."
)


@dataclass(frozen=True)
class FirmwareNumbers:
    """What a firmware takes in the place of zeros."""

    old: Firmware  # its present numbers
    # old and new; `None` where the machine keeps no readings of the plate out to its rim
    found: Corrections | None

    @property
    def columns(self) -> dict[str, list[Any]]:
        """A row a number, as the file has them; the drive is the section with the key."""
        rows = self.found.rows if self.found else []
        return {
            "drive": [name for name, _, _ in rows],
            "old": [float(old) for _, old, _ in rows],
            "new": [float(new) for _, _, new in rows],
        }

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return (
            self.found.as_dict() if self.found else {"old": self.old.as_dict(), "missing": _LACKING}
        )

    def paragraphs(self) -> tuple[str, ...]:
        """For people; a table's lines are kept as they are."""
        if self.found is None:
            return (_LACKING,)
        found = self.found
        (before, after), (one, other) = (
            [f"{v * 1e3:.3f} mm" for v in pair] for pair in (found.height, found.sideways)
        )
        named = [f"  {name:28}{old:>14}{new:>14}" for name, old, new in found.rows]
        return (
            "These bring the tool nearest to where the firmware believes it is, over the plate and "
            "50 mm above it, the plate being its z = 0. Enter all of them or none, and keep the "
            "old ones: they undo it.",
            "\n".join((f"{'printer.cfg':30}{'old':>14}{'new':>14}", *named)),
            f"Height over the plate to expect: {before} rms off with the old numbers, {after} with "
            f"the new; along the plate {one} and {other}.",
            *((f"Keep the old ones: {found.keep}.",) if found.keep else ()),
            found.where,
            "\n".join(("To paste:", *found.new.lines())),
            "\n".join(("To undo:", *found.old.lines())),
            "What no number of the firmware holds stands in the report.",
        )
