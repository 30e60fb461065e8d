"""Linear deltas under Klipper: what the firmware stores, read; and its numbers, to paste.

The formats and equations are those of the firmware's documentation and sources
(klippy/kinematics/delta.py, klippy/extras/delta_calibrate.py, bed_mesh.py); the code is our own.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.add_ons import Corrections, Paste, Section
from orthoglide.firmware.imported import Imported as Imported
from orthoglide.firmware.klipper.importing import import_printer as import_printer
from orthoglide.firmware.klipper.numbers import (
    FIRMWARE_NAME,
    MAX_ROD_SPREAD,
    Numbers,
    make_paste,
    unequal_arms_warning,
)
from orthoglide.geometry import Geometry
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import DeltaKinematics
from orthoglide.notes import Note
from orthoglide.text import sentence

_CALIBRATE_FIRST = (
    "Run DELTA_CALIBRATE and SAVE_CONFIG, probe the mesh again and import the new file, before any "
    "number is entered: the stored readings do not go with the stored numbers."
)
_TOUCH_ADVICE = (
    "Touch the plate too, out to its rim, for numbers for the firmware: its z = 0 is the plate"
)
_FIRMWARE_NUMBERS = "three endstops, one radius, three angles and three arms"
_ROUNDING = 2e-6  # metres by which lengths of the file may be rounded
_FILE = re.compile(r"(\S+)\.csv\b")
_ASSUMED_SIZES = {
    "r": "the effector's radius",
    "d": "the distance of an arm's two rods",
    "tool_below": "how far the nozzle hangs below the joints",
}


@dataclass(frozen=True)
class Printer:
    """The firmware's numbers of one machine and the table in which the import keeps them.

    It is an `orthoglide.add_ons.Printer`, and the class is the `orthoglide.add_ons.AddOn`.
    """

    numbers: Numbers
    table: Mapping[str, Any]
    read = staticmethod(import_printer)

    @classmethod
    def stored(cls, table: Mapping[str, Any]) -> Printer | None:
        """Return the printer of a table; ``None`` if the table was edited and has no numbers."""
        try:
            return cls(Numbers.from_table(table), table)
        except (KeyError, TypeError, ValueError):
            return None

    @property
    def meshes_relative(self) -> bool:
        """Whether the firmware subtracts the height at one place from every mesh."""
        return bool(self.table.get("meshes_relative"))

    @property
    def changed_since(self) -> tuple[str, ...]:
        """What was moved or changed since the calibration, in sentences."""
        texts = self.table.get("changed_since")
        return tuple(sentence(t) for t in texts) if isinstance(texts, list) else ()

    @property
    def kinematics(self) -> DeltaKinematics:
        """Inverse kinematics of the firmware; travel counts from mechanical zero of the machine
        file.
        """
        return self.numbers.kinematics(self.numbers.zero)

    def objection(self, geometry: Geometry) -> tuple[str, ...]:
        """Return why dimensions would move mechanical zero, from which travel is counted, and the
        path of the key to blame; empty if they would not.

        The joints of the platform may lie further out than was assumed, but only together with
        those of the carriages.
        """
        layout, radius, arm = geometry.layout, self.numbers.delta_radius, self.numbers.mean_arm
        if not isinstance(layout, LinearDelta):
            return ()
        if any(abs(given - geometry.r - radius) > _ROUNDING for given in layout.radius):
            return (
                f"radius_mm less r must stay the firmware's delta_radius, {radius * 1e3:.6g} mm, "
                f"by which travel was counted: with r = {geometry.r * 1e3:.6g} put "
                f"{(radius + geometry.r) * 1e3:.9g} three times",
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
        """Return warnings that the stored sizes are not the machine's; empty if they may be."""
        travel, _ = machine.spec.measured.contradictions(machine.geometry.L)
        return f"{travel} {self._doubt_of_rods(machine)}".strip()

    def _doubt_of_rods(self, machine: Any) -> str:
        """Return a warning that the stored arms are not the rods; empty if they may be."""
        if machine.spec.measured.rods or np.ptp(self.numbers.arm) <= MAX_ROD_SPREAD:
            return str(machine.spec.measured.contradictions(machine.geometry.L)[1])
        return unequal_arms_warning(self.numbers)

    def imported(self, names: Collection[str]) -> Iterator[Note]:
        """Yield the remarks of the import for a result of readings of these names.

        A remark that two campaigns disagree is kept only if one of them was read without the other:
        where both are read, it is found again.
        """
        warnings = self.table.get("warnings")
        for text in warnings if isinstance(warnings, list) else ():
            files = _FILE.findall(text) if isinstance(text, str) else []
            if isinstance(text, str) and (
                len(files) < 2 or (files[0] in names) != (files[1] in names)
            ):
                yield Note(text, "imported")

    def assumptions(self, machine: Any, causes: Sequence[Any]) -> Iterator[Note]:
        """Yield a note on sizes that were assumed on import and not changed, if a cause depends on
        them.
        """
        explanations = (e for cause in causes for e in cause.explanations)
        assumed, geometry = self.table.get("assumed_mm"), machine.geometry
        of_machine = any(not e.catalogue.effect_of(e.name).of_dial for e in explanations)
        if not (of_machine and isinstance(assumed, Mapping)):
            return
        below = float(geometry.legs[0].platform[2])
        current = {"r": geometry.r, "d": geometry.d, "tool_below": below}
        sizes = ", ".join(
            f"{_ASSUMED_SIZES[name]} ({value:g} mm)" for name, value in assumed.items()
            if abs(current.get(name, np.inf) * 1e3 - value) < 1e-6
        )  # fmt: skip
        if sizes:
            yield Note(
                f"assumed, as no firmware stores them: {sizes}; sizes of causes that turn the "
                f"platform depend on these, which their uncertainty leaves out: measure them, and "
                f"correct them in the machine file",
                "assumed",
            )

    def provenance(self, corrections: Any) -> Mapping[str, Any]:
        """Return the table that a calibrated machine keeps, by its name."""
        table = {key: value for key, value in self.table.items() if key != "corrected"}
        corrected = {} if corrections is None else {"corrected": corrections.kept}
        return {FIRMWARE_NAME: table | corrected}

    def corrections(self, machine: Any, readings: Sequence[Any]) -> Corrections | None:
        """Return new numbers for a calibrated machine; ``None`` if the readings give none."""
        from orthoglide.firmware.klipper.new_numbers import new_numbers

        return new_numbers(
            self.numbers, machine, readings, self.meshes_relative, bool(self._again(machine))
        )

    def _again(self, machine: Any) -> str:
        """Return that the firmware's own calibration comes first, in sentences; else empty."""
        travel, _ = machine.spec.measured.contradictions(machine.geometry.L)
        again = travel or self.table.get("calibrate_again")
        return f"{travel} {_CALIBRATE_FIRST}".lstrip() if again else ""

    def section(
        self, given: Any, calibrated: Any, corrections: Corrections | None, causes: Sequence[Any]
    ) -> Section:
        """Return the report's section on a calibrated machine."""
        again = self._again(calibrated)
        reasons = self.changed_since or (again,)
        first = " ".join(filter(None, (*reasons, self._doubt_of_rods(calibrated))))
        catalogue, numbers = given.catalogue, dict[str, Any]()
        beyond = tuple(
            f"{c.words}: {c.confirm or f'look at {c.look_at}'}" for c in causes
            if any(catalogue.effect_of(name).name not in catalogue.base for name in c.parameters)
        )  # fmt: skip
        if corrections is not None:
            numbers = {"old": corrections.old.as_dict(), **corrections.kept}
        facts = {**numbers, "cannot_hold": list(beyond)}
        return Section(first, again, corrections, _TOUCH_ADVICE, _FIRMWARE_NUMBERS, beyond, facts)

    def paste(self) -> Paste:
        """Return the numbers that a calibrated machine keeps."""
        return make_paste(self.numbers, self.table.get("corrected"))


ADD_ON = Printer
