"""Paths in, commands and exports out."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.control.compensation import Compensation
from orthoglide.control.numbers import controller_numbers
from orthoglide.control.urdf import calibrated_mjcf, calibrated_urdf
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.tree import load
from orthoglide.notes import Note
from orthoglide.observations.schema import POINT
from orthoglide.observations.table import read_table
from orthoglide.text import csv_text
from orthoglide.urdf import closures_text, file_names, parallel_robot_files

_SHORTEST_PATH = 1e-3  # metres: a path within it is hardly one


@dataclass(frozen=True, eq=False)
class PathPoints:
    """A path as it was read."""

    p: Array  # TCP points (n, 3), metres, in the order of the rows
    line: tuple[int, ...]  # line of each in the file (n,), header line 1
    file: str  # its name as the caller gave it
    warnings: tuple[Note, ...]  # what was noticed and is no error


def read_path(path: str | os.PathLike[str]) -> PathPoints:
    """Return a path of TCP points: columns ``p_x_mm``, ``p_y_mm``, ``p_z_mm``, rows in their order.

    Args:
        path: the CSV file.

    Raises:
        FileError: naming the line and what would be right.
    """
    table = read_table(path)
    warnings = table.check_names(POINT.names(), POINT.names())
    p = table.array(replace(POINT, empty_value=None))
    if len(p) > 1 and 0 < np.abs(p).max() < _SHORTEST_PATH:
        limit = f"{_SHORTEST_PATH * 1e3:g} mm"
        text = f"all points lie within {limit} of the middle: are they metres?"
        warnings = (*warnings, Note(text, "units"))
    return PathPoints(p, table.lines, table.file, warnings)


def commands_text(found: Compensation) -> str:
    """Return commands as CSV: points, commands, and expected errors; empty where unknown."""
    columns = []
    for name, values in found.columns.items():
        number_format = "+.0f" if name.startswith("approach") else "z.6f"
        columns.append(["" if math.isnan(v) else format(v, number_format) for v in values])
    return csv_text(tuple(found.columns), zip(*columns, strict=True))


def export_files(
    machine: MachineSource, *, zeros_only: bool = False, force: bool = False
) -> dict[str, str]:
    """Return the files for other programs by name.

    These are numbers for the controller, as text and as JSON; the calibrated URDF and its loop
    closures, in the package's form and as ``robot.urdf`` with ``robot.yaml``; and MJCF for MuJoCo.
    With ``zeros_only`` they are the zeros and nothing else.

    Args:
        machine: calibrated, or the path of its file.
        zeros_only: as for `controller_numbers`.
        force: as for `controller_numbers`.

    Raises:
        InputError: where the verdict says not to act on the machine's numbers.
    """
    machine = Machine.of(machine)
    numbers = controller_numbers(machine, zeros_only=zeros_only, force=force)
    numbers_files = {
        "controller.txt": numbers.text(),
        "controller.json": json.dumps(numbers.as_dict(), indent=2) + "\n",
    }
    if zeros_only:
        return numbers_files
    urdf, closures, mjcf = file_names(machine.geometry)
    tree = calibrated_urdf(machine)
    loops = load(machine.spec.urdf or machine.geometry).loops
    return {
        **numbers_files,
        urdf: tree,
        closures: closures_text(loops, urdf),
        mjcf: calibrated_mjcf(machine),
        **parallel_robot_files(machine.geometry, tree, loops),
    }
