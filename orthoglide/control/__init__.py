"""Commands that bring the TCP to the wanted points, and numbers and files for other programs."""

from orthoglide.control.compensation import (
    Compensation as Compensation,
    commands_text as commands_text,
    compensate as compensate,
    read_path as read_path,
)
from orthoglide.control.delta_numbers import DeltaSizes as DeltaSizes, best_sizes as best_sizes
from orthoglide.control.numbers import (
    RULE as RULE,
    ControllerNumbers as ControllerNumbers,
    controller_numbers as controller_numbers,
)
from orthoglide.control.urdf import (
    calibrated_mjcf as calibrated_mjcf,
    calibrated_urdf as calibrated_urdf,
    constant_geometry as constant_geometry,
    export_files as export_files,
)
from orthoglide.control.zero_checks import withholding_reason as withholding_reason
