"""Linear deltas under Klipper: what the firmware stores, read; and its numbers, to paste.

The formats and equations are those of the firmware's documentation and sources
(klippy/kinematics/delta.py, klippy/extras/delta_calibrate.py, bed_mesh.py); the code is our own.
"""

from orthoglide.klipper.corrections import (
    Corrections,
    corrections,
    unseen_by_firmware,
)
from orthoglide.klipper.firmware import Firmware, firmware_of, rods_words
from orthoglide.klipper.importing import Imported, import_printer
