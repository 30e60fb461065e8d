"""Keys of a printer's table in a machine file."""

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

MESHES_RELATIVE_KEY, CORRECTED_KEY = "meshes_relative", "corrected"
"""Keys of the table: whether the height at one place is subtracted from meshes, and new numbers of
a calibrated machine."""

MAX_ROD_SPREAD = 5e-4  # metres: largest difference of rods of one set
