"""Keys of a printer's table in a machine file, and doubts about its numbers."""

from __future__ import annotations

import numpy as np

from orthoglide.firmware.klipper.numbers import Numbers

FIRMWARE_NAME = "klipper"
"""Name of the table of a machine file, and of the entry point."""

CALIBRATION = "calibration"
"""Name of the readings of [delta_calibrate]: heights and distances. They are stored as steps from
the endstops and, unlike meshes, are valid for any numbers of the firmware."""

WARNINGS_KEY, CALIBRATE_AGAIN_KEY = "warnings", "calibrate_again"
"""Keys of the table: sentences of the import, and whether the firmware's own calibration has to be
run again before any number is entered."""

CHANGED_KEY = "changed_since"
"""Key of the table: those sentences that say what was moved or changed since that calibration."""

MESHES_RELATIVE_KEY, ASSUMED_KEY, CORRECTED_KEY = "meshes_relative", "assumed_mm", "corrected"
"""Keys of the table: whether the height at one place is subtracted from meshes, what the firmware
does not store, and new numbers of a calibrated machine."""

MAX_ROD_SPREAD = 5e-4  # metres: largest difference of rods of one set
_EQUAL_ARMS = 5e-5  # metres: largest difference of arms that are taken as equal


def unequal_arms_warning(numbers: Numbers) -> str:
    """Return a warning on stored arms that differ; empty if they are equal."""
    if (spread := float(np.ptp(numbers.arm))) <= _EQUAL_ARMS:
        return ""
    arms = ", ".join(f"{v * 1e3:.3f}" for v in numbers.arm)
    doubt = ", more than rods of one set do. Measure the rods before you trust any of its numbers"
    return (
        f"The arms that the firmware stores ({arms} mm) differ by {spread * 1e3:.2f} mm"
        f"{doubt * (spread > MAX_ROD_SPREAD)}. Their common length is free, and they are taken "
        f"as equal to within {_EQUAL_ARMS * 1e3:g} mm of each other: if you did measure them, give "
        f"the sigma of your measurement under [parameters] of the machine file."
    )
