"""Linear deltas under Klipper: what the firmware stores, read; and its numbers, to paste.

The formats and equations are those of the firmware's documentation and sources
(klippy/kinematics/delta.py, klippy/extras/delta_calibrate.py, bed_mesh.py); the code is our own.
"""

from orthoglide.klipper.agreeing import RELATIVE as RELATIVE, disagreements as disagreements
from orthoglide.klipper.corrections import (
    FIRST as FIRST,
    Corrections as Corrections,
    corrections_of as corrections_of,
)
from orthoglide.klipper.importing import (
    ASSUMED as ASSUMED,
    Imported as Imported,
    import_printer as import_printer,
)
from orthoglide.klipper.rods import doubted_rods as doubted_rods
from orthoglide.klipper.stored import CALIBRATION as CALIBRATION
from orthoglide.klipper.told import AGAIN as AGAIN, imported as imported
