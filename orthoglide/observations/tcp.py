"""TCP points measured by a tracker or a CMM: to judge by, or to fit where that is asked for."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.frames import Framed
from orthoglide.geometry import Array
from orthoglide.layout import ORTHOGLIDE, LegNames
from orthoglide.machine_file import AnyMachine, machine_file_of
from orthoglide.observations.approach import Ints
from orthoglide.observations.arrays import MAYBE, MAYBE_VECTOR, VECTOR, WHOLE, hold
from orthoglide.observations.checks import HARDLY, Fail
from orthoglide.observations.columns import (
    APPROACHED,
    DIRECTION_OF_MOVE,
    MM,
    NAN,
    POINT,
    RHO,
    ROW_COLUMNS,
    TRAVEL,
    by_leg,
    columns,
    command_names,
    commands,
    of_commands,
)
from orthoglide.observations.table import Column, Table, number, read_table, rows_table

_ARRAYS = {
    "command": VECTOR,
    "p": MAYBE_VECTOR,
    "sigma": MAYBE,
    "approach": VECTOR,
    "line": WHOLE,
}
_COORDINATE = Column(number(MM), NAN)


@dataclass(frozen=True, eq=False)
class TcpPoints(Framed):
    """Measured TCP positions, each in the instrument's own frame.

    Attributes:
        command: commanded joint coordinates ``(n, 3)``, metres, r removed.
        p: measured TCP ``(n, 3)``, metres, nan where a coordinate is missing.
        sigma: standard deviation of a coordinate ``(n,)``, metres, nan where none is declared.
        approach: direction of each axis' last move ``(n, 3)``; 0: the middle of the dead band.
        line: line in the file ``(n,)``, header line 1.
        file: the file's name as the caller gave it.
        sha256: digest of the file.
        warnings: what was noticed on reading and is no error.
        legs: how the machine's legs and commands are called.
    """

    command: Array
    p: Array
    sigma: Array
    approach: Array
    line: Ints
    file: str = ""
    sha256: str = ""
    warnings: tuple[str, ...] = ()
    legs: LegNames = ORTHOGLIDE.names

    def __post_init__(self) -> None:
        hold(self, self.name, _ARRAYS, "p")

    def __len__(self) -> int:
        return len(self.p)

    @property
    def name(self) -> str:
        """Of the file, without its folder and ending."""
        return Path(self.file).stem or "points"

    @property
    def columns(self) -> dict[str, list[Any]]:
        """A row a point: the command and what was measured, in millimetres."""
        values = np.hstack([self.command, self.p, self.sigma[:, None]]) * 1e3
        names = (*of_commands(self.legs), *POINT, "sigma_mm")
        return {name: values[:, k].tolist() for k, name in enumerate(names)}

    def __repr__(self) -> str:
        return f"<TcpPoints: {len(self)} points{f' of {self.file}' if self.file else ''}>"


def read_tcp(path: str | os.PathLike[str], machine_file: AnyMachine | None = None) -> TcpPoints:
    """Reads TCP points.

    Args:
        path: the CSV file, as for `read_campaign`.
        machine_file: the machine whose layout, stroke and controller count, or its file; the
            nominal one if None.

    Returns:
        The points; a coordinate left empty is nan.

    Raises:
        FileError: naming the line and what would be right.
    """
    return _tcp(read_table(path), machine_file)


def tcp_from_rows(
    rows: Sequence[Mapping[str, str]],
    machine_file: AnyMachine | None = None,
    *,
    file: str,
    lines: Sequence[int] = (),
    sha256: str = "",
) -> TcpPoints:
    """TCP points from rows of text; arguments as for `readings_from_rows`.

    Raises:
        FileError: as `read_tcp`.
    """
    return _tcp(rows_table(rows, file, lines, sha256), machine_file)


def _tcp(table: Table, machine_file: AnyMachine | None) -> TcpPoints:
    machine = machine_file_of(machine_file)
    names, approach = command_names(table, machine), by_leg(APPROACHED, machine.geometry.leg_names)
    known = (*names, *RHO, *TRAVEL, *approach, *POINT, "sigma_mm")
    warnings = table.check_names(known, (*names, *POINT))
    points = TcpPoints(
        command=commands(table, names, machine),
        p=columns(table, POINT, _COORDINATE),
        sigma=np.array(table.values("sigma_mm", ROW_COLUMNS["sigma_mm"])),
        approach=columns(table, approach, DIRECTION_OF_MOVE),
        line=np.array(table.lines),
        file=table.file,
        sha256=table.sha256,
        warnings=warnings,
        legs=machine.geometry.layout.names,
    )
    check_points(points, table.fail)
    return points


def check_points(points: TcpPoints, fail: Fail) -> None:
    """Refuses TCP points that cannot be meant as they stand; ``fail`` raises."""
    missing = np.isnan(points.p).all(axis=1)
    if missing.any():
        fail("all of p_x_mm, p_y_mm, p_z_mm are empty: remove the row", int(np.argmax(missing)))
    commanded = np.ptp(points.command, axis=0).max()
    measured = max(np.ptp(p[np.isfinite(p)]) if np.isfinite(p).any() else 0.0 for p in points.p.T)
    if commanded > HARDLY and not commanded / 100 <= measured <= 100 * commanded:
        other = "millimetres, not metres" if measured < commanded else "a thousandth of each"
        fail(
            f"the points lie within {measured * 1e3:.3g} mm while the commands span "
            f"{commanded * 1e3:.3g} mm: give {other}",
            0,
        )
