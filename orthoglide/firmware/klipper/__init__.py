"""Linear deltas under Klipper: what the firmware stores, read; and its numbers, to paste.

The formats and equations are those of the firmware's documentation and sources
(klippy/kinematics/delta.py, klippy/extras/delta_calibrate.py, bed_mesh.py); the code is our own.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.add_ons import Corrections, Paste, Section
from orthoglide.firmware.imported import Imported as Imported
from orthoglide.firmware.klipper.corrections import make_paste
from orthoglide.firmware.klipper.importing import import_printer as import_printer
from orthoglide.firmware.klipper.numbers import TOWERS, Numbers
from orthoglide.firmware.klipper.provenance import (
    ASSUMED_KEY,
    CALIBRATE_AGAIN_KEY,
    CORRECTED_KEY,
    FIRMWARE_NAME,
    MAX_ROD_SPREAD,
    MESHES_RELATIVE_KEY,
    WARNINGS_KEY,
    disagreements,
    unequal_arms_warning,
)
from orthoglide.geometry import Geometry
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import DeltaKinematics
from orthoglide.notes import Note
from orthoglide.observations import Readings

_CALIBRATE_FIRST = (
    "Run DELTA_CALIBRATE and SAVE_CONFIG, probe the mesh again and import the new file, before any "
    "number is entered: the stored readings do not go with the stored numbers."
)
_TOUCH_ADVICE = (
    "Touch the plate too, out to its rim, for numbers for the firmware: its z = 0 is the plate"
)
_FIRMWARE_NUMBERS = "three endstops, one radius, three angles and three arms"
_EQUAL_ARMS = 1.5e-4  # metres from the stored arms: less than half of the spread
_ROUNDING = 2e-6  # metres by which lengths of the file may be rounded
_DISAGREEING_FILES = re.compile(r"(\S+)\.csv and (\S+)\.csv are not of one plate")
_ASSUMED_SIZES = {
    "r": "the effector's radius",
    "d": "the distance of an arm's two rods",
    "tool_below": "how far the nozzle hangs below the joints",
}


@dataclass(frozen=True)
class Printer:
    """The firmware's numbers of one machine, with what the import keeps beside them: a printer as
    `orthoglide.add_ons` asks for it.
    """

    numbers: Numbers
    table: Mapping[str, Any]

    @property
    def meshes_relative(self) -> bool:
        """Whether the firmware takes the height at one place out of every mesh."""
        return bool(self.table.get(MESHES_RELATIVE_KEY))

    @property
    def calibrate_again(self) -> bool:
        """Whether the firmware's own calibration is to be run again before anything is entered."""
        return bool(self.table.get(CALIBRATE_AGAIN_KEY))

    @property
    def kinematics(self) -> DeltaKinematics:
        """Where the firmware sends the carriages, from mechanical zero of the machine file."""
        return self.numbers.kinematics(self.numbers.zero)

    def objection(self, geometry: Geometry) -> tuple[str, ...]:
        """Return why dimensions would move mechanical zero away from where travel is counted from,
        and the path of the key to blame; empty where they would not.

        The joints of the platform may stand further out than was assumed, but only together with
        those of the carriages.
        """
        layout, reach, arm = geometry.layout, self.numbers.delta_radius, self.numbers.mean_arm
        if not isinstance(layout, LinearDelta):
            return ()
        if any(abs(radius - geometry.r - reach) > _ROUNDING for radius in layout.radius):
            return (
                f"radius_mm less r must stay the firmware's delta_radius, {reach * 1e3:.6g} mm, by "
                f"which travel was counted: with r = {geometry.r * 1e3:.6g} put "
                f"{(reach + geometry.r) * 1e3:.9g} three times",
                "layout",
                "radius_mm",
            )
        if abs(geometry.L - arm) > _ROUNDING:
            return (
                f"L must stay the mean of the firmware's arms, {arm * 1e3:.6f} mm, by which travel "
                f"was counted: give lengths that were measured under [parameters]",
                "geometry_mm",
                "L",
            )
        return ()

    def doubts(self, machine: Any) -> str:
        """Say that the stored arms cannot be those of one set of rods, unless the machine's file
        says that they were measured: by a sigma beside lengths near the stored ones.
        """
        if np.ptp(self.numbers.arm) <= MAX_ROD_SPREAD or machine.spec.measured.rods:
            return ""
        length = next(e.name for e in machine.catalogue.effects if e.controller == "bar_length")
        given = [machine.spec.parameters.get(f"{length}.{tower}") for tower in TOWERS]
        measured = all(
            own is not None and own.sigma > 0
            and abs(own.value - (arm - machine.geometry.L)) <= _EQUAL_ARMS
            for own, arm in zip(given, self.numbers.arm, strict=True)
        )  # fmt: skip
        return "" if measured else unequal_arms_warning(self.numbers)

    def imported(self, names: Collection[str]) -> Iterator[Note]:
        """Return the remarks of the import for a result of readings of these names.

        That two do not go together is found anew where both are read, and matters only to the
        first.
        """
        kept = self.table.get(WARNINGS_KEY)
        for text in kept if isinstance(kept, list) else ():
            if isinstance(text, str) and (
                (two := _DISAGREEING_FILES.match(text)) is None
                or (two[1] in names and two[2] not in names)
            ):
                yield Note(text, "imported")

    def cautions(self, readings: Sequence[Any]) -> Iterator[Note]:
        """Return which readings are not of one plate and one set of the numbers."""
        touched = [one for one in readings if isinstance(one, Readings)]
        found = disagreements(self.numbers, touched, meshes_relative=self.meshes_relative)
        yield from (note for _, _, note in found)

    def assumptions(self, machine: Any, causes: Sequence[Any]) -> Iterator[Note]:
        """Say what was assumed on import and is so still, where causes depend on it."""
        every = [one for cause in causes for one in cause.explanations]
        assumed, geometry = self.table.get(ASSUMED_KEY), machine.geometry
        of_machine = any(not one.catalogue.effect_of(one.name).of_dial for one in every)
        if not (of_machine and isinstance(assumed, Mapping)):
            return
        below = float(geometry.legs[0].platform[2])
        now = {"r": geometry.r, "d": geometry.d, "tool_below": below}
        same = {n: v for n, v in assumed.items() if abs(now.get(n, np.inf) * 1e3 - v) < 1e-6}
        if same:
            sizes = ", ".join(f"{_ASSUMED_SIZES[n]} ({v:g} mm)" for n, v in same.items())
            yield Note(
                f"assumed, as no firmware stores it: {sizes}; sizes of causes that turn the "
                f"platform go with that, and their uncertainty does not count it: measure it and "
                f"correct it in the machine file",
                "assumed",
            )

    def provenance(self, corrections: Any) -> Mapping[str, Any]:
        """Return the table, by its name, that a calibrated machine keeps."""
        table = {key: value for key, value in self.table.items() if key != CORRECTED_KEY}
        new = {} if corrections is None else {CORRECTED_KEY: corrections.kept}
        return {FIRMWARE_NAME: table | new}

    def corrections(self, machine: Any, readings: Sequence[Any]) -> Corrections | None:
        """Return new numbers for a calibrated machine; ``None`` where the readings give none."""
        from orthoglide.firmware.klipper.new_numbers import new_numbers

        return new_numbers(
            self.numbers, machine, readings, self.meshes_relative, self.calibrate_again
        )

    def section(
        self, given: Any, calibrated: Any, corrections: Corrections | None, causes: Sequence[Any]
    ) -> Section:
        """Return what a report says of a calibrated machine."""
        found, again = corrections, _CALIBRATE_FIRST if self.calibrate_again else ""
        first = " ".join(text for text in (again, self.doubts(calibrated)) if text)
        held, of = given.catalogue.base, given.catalogue.effect_of  # what its numbers describe
        causes = [c for c in causes if not all(of(n).name in held for n in c.parameters)]
        beyond = tuple(f"{c.words}: {c.confirm or f'look at {c.look_at}'}" for c in causes)
        numbers = {} if found is None else {"old": found.old.as_dict(), **found.kept}
        facts = {**numbers, "cannot_hold": list(beyond)}
        return Section(first, again, found, _TOUCH_ADVICE, _FIRMWARE_NUMBERS, beyond, facts)

    def paste(self) -> Paste:
        """Return the numbers that a calibrated machine keeps."""
        return make_paste(self.numbers, self.table.get(CORRECTED_KEY))


class Klipper:
    """Support for the firmware, as `orthoglide.add_ons` asks for it."""

    def read(
        self, path: str | os.PathLike[str], *, turned: Mapping[str, float] | None = None
    ) -> Imported:
        """Read a ``printer.cfg``; see `import_printer`."""
        return import_printer(path, turned)

    def stored(self, table: Mapping[str, Any]) -> Printer | None:
        """Return the printer of a table; ``None`` where it was edited and has no numbers."""
        try:
            return Printer(Numbers.from_table(table), table)
        except (KeyError, TypeError, ValueError):
            return None


ADD_ON = Klipper()
