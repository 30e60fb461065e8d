"""Linear deltas under Klipper: what the firmware stores, read; and its numbers, to paste.

The formats and equations are those of the firmware's documentation and sources
(klippy/kinematics/delta.py, klippy/extras/delta_calibrate.py, bed_mesh.py); the code is our own.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from orthoglide.add_ons import Corrections, Paste, Section
from orthoglide.firmware.imported import Imported as Imported
from orthoglide.firmware.klipper.importing import import_printer as import_printer
from orthoglide.firmware.klipper.pasting import paste_of
from orthoglide.firmware.klipper.printer import AGAIN, CORRECTED, Printer, printer_of

_FIRST = (
    "Run DELTA_CALIBRATE and SAVE_CONFIG, probe the mesh again and import the new file, before any "
    "number is entered: the stored readings do not go with the stored numbers."
)
_TOUCH = "Touch the plate too, out to its rim, for numbers for the firmware: its z = 0 is the plate"
_HOLDS = "three endstops, one radius, three angles and three arms"


class Klipper:
    """Support for the firmware, as `orthoglide.add_ons` asks for it."""

    def read(
        self, path: str | os.PathLike[str], *, turned: Mapping[str, float] | None = None
    ) -> Imported:
        """Read a ``printer.cfg``; see `import_printer`."""
        return import_printer(path, turned)

    def stored(self, table: Mapping[str, Any]) -> Printer | None:
        """Return the printer of a table of a machine file."""
        return printer_of(table)

    def corrections(self, machine: Any, readings: Sequence[Any]) -> Corrections | None:
        """Return new numbers for a calibrated machine; ``None`` where the readings give none."""
        from orthoglide.firmware.klipper.new_numbers import new_numbers

        printer = machine.spec.printer
        return new_numbers(printer, machine, readings) if isinstance(printer, Printer) else None

    def section(
        self, given: Any, calibrated: Any, corrections: Corrections | None, causes: Sequence[Any]
    ) -> Section | None:
        """Return what a report says of a calibrated machine; ``None`` of another machine."""
        printer, found = given.spec.printer, corrections
        if not isinstance(printer, Printer):
            return None
        again = _FIRST if printer.table.get(AGAIN) else ""
        first = " ".join(text for text in (again, printer.doubts(calibrated)) if text)
        held, of = given.catalogue.base, given.catalogue.effect_of  # what its numbers describe
        causes = [c for c in causes if not all(of(n).name in held for n in c.parameters)]
        beyond = tuple(f"{c.words}: {c.confirm or f'look at {c.look_at}'}" for c in causes)
        numbers = {} if found is None else {"old": found.old.as_dict(), **found.kept}
        facts = {**numbers, "cannot_hold": list(beyond)}
        return Section(first, again, found, _TOUCH, _HOLDS, beyond, facts)

    def paste(self, machine: Any) -> Paste | None:
        """Return the numbers that a calibrated machine keeps."""
        printer = machine.spec.printer
        if not isinstance(printer, Printer):
            return None
        return paste_of(printer.numbers, printer.table.get(CORRECTED))


ADD_ON = Klipper()
