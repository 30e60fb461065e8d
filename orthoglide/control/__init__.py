"""What a calibration is for: commands that bring the TCP where it should be, and the numbers and
files that a controller or another program takes of a calibrated machine.
"""

from orthoglide.control.acting import withheld
from orthoglide.control.checking import ZeroCheck
from orthoglide.control.compensation import (
    NOT_COVERED,
    Compensation,
    compensate,
)
from orthoglide.control.files import PathPoints, commands_text, export_files, read_path
from orthoglide.control.numbers import RULE, ControllerNumbers, DriveNumbers, controller_numbers
from orthoglide.control.urdf import calibrated_urdf, held_by_urdf
