"""Compensation: a path of TCP points into commands, and the accuracy to expect of them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.accuracy import output_sigmas, tcp_slopes
from orthoglide.arguments import public
from orthoglide.control.zero_checks import checked_for_use
from orthoglide.errors import ClosureError, InputError, UnreachableError, as_float_array
from orthoglide.frames import Framed
from orthoglide.geometry import LEGS, Array
from orthoglide.layout import ORTHOGLIDE, LegNames
from orthoglide.layout.leg import triple
from orthoglide.machine import Machine, MachineSource
from orthoglide.notes import Note
from orthoglide.numerals import compact, plain
from orthoglide.observations.approach import derive_approach
from orthoglide.observations.checks import STROKE_SLACK
from orthoglide.observations.schema import APPROACH, PLACE, POINT, TRAVEL
from orthoglide.observations.table import native_command_names, read_table
from orthoglide.prediction import Conditions
from orthoglide.text import csv_text

_SHORTEST_PATH = 1e-3  # metres: a path within it is hardly one

RESOLUTION = 1e-9
"""Metres: commands are rounded to this, the last digit that files show."""

NOT_COVERED = (
    "the orientation of the machine as a whole, which the readings cannot see",
    "effects that the machine file has no parameter for",
    "temperature and load other than those given, and drift since the calibration",
    "scatter from run to run: servo lag, play that follows no rule",
)
"""What the expected accuracy does not cover."""

_ERROR_COLUMNS = ("residual_mm", "shape_mm", "place_mm", "expected_mm", "uncompensated_mm",
         "uncompensated_shape_mm")  # fmt: skip
_NO_UNCERTAINTY = (
    "the machine file states no uncertainty of its parameters, so the accuracy of these commands "
    "is unknown: give the calibrated.toml of a result"
)
_STROKE_MARGIN = 0.02  # metres, more than any effect moves a command


@dataclass(frozen=True, eq=False)
class Compensation(Framed):
    """Commands for a path, row by row.

    Attributes:
        wanted: TCP points ``(n, 3)``, metres.
        rho: commands ``(n, 3)``, metres, rounded: joint coordinates of the Orthoglide, travel from
            mechanical zero of other layouts.
        travel: commands as the controller counts them ``(n, 3)``, metres.
        approach: direction in which each drive arrives ``(n, 3)``, +1 or -1.
        predicted: TCP that the commands reach on this machine ``(n, 3)``, metres.
        uncompensated: TCP ``(n, 3)`` that the nominal machine's commands would reach, metres.
        shape_sigma: standard deviation of the TCP along each base axis ``(n, 3)``, metres, after
            the best translation over the workspace; from the covariance of the parameters, or from
            their standard deviations if there is none; nan if the machine file states neither.
        place_sigma: standard deviation of that translation ``(3,)``, metres.
        independent: whether the parameters were assumed to be independent.
        legs: names of the legs.
        sent: TCP that the controller of a delta computes from the commands ``(n, 3)``, metres;
            ``None`` for other machines.
    """

    wanted: Array
    rho: Array
    travel: Array
    approach: Array
    predicted: Array
    uncompensated: Array
    shape_sigma: Array
    place_sigma: Array
    independent: bool
    legs: LegNames = ORTHOGLIDE.names
    sent: Array | None = None

    def __len__(self) -> int:
        return len(self.wanted)

    def __repr__(self) -> str:
        before, after = (_rms(e) * 1e3 for e in (self.shape_before, self.shape))
        accuracy = f": {after:.3f} mm rms off to expect, {before:.3f} mm by the nominal commands"
        return f"<Compensation of {len(self)} points{accuracy if self.is_known else ''}>"

    @property
    def is_known(self) -> bool:
        """Whether anything is known of the machine's parameters."""
        return bool(np.isfinite(self.place_sigma).all())

    @property
    def columns(self) -> dict[str, list[Any]]:
        """Columns of a table with one row per point, by name: the wanted point; the commands (of
        the Orthoglide also as joint coordinates); for a delta, the point that its controller
        computes; the direction in which each drive arrives, +1 or -1; standard deviations along the
        axes; and the expected errors. Lengths are in millimetres.
        """
        legs = self.legs.legs
        errors = [self.residual, self.shape, np.full(len(self), self.place), self.accuracy]
        errors += [self.error_before, self.shape_before]
        groups: dict[tuple[str, ...], Array] = {
            POINT.names(): self.wanted * 1e3,
            native_command_names(self.legs): self.rho * 1e3,
            TRAVEL.names(legs): self.travel * 1e3,  # replaces rho on other layouts
            **({} if self.sent is None else {PLACE.names(): self.sent * 1e3}),
            APPROACH.names(legs): self.approach,
            tuple(f"sigma_{axis}_mm" for axis in LEGS): self.shape_sigma * 1e3,
            _ERROR_COLUMNS: np.column_stack(errors) * 1e3,
        }
        return {n: v[:, k].tolist() for names, v in groups.items() for k, n in enumerate(names)}

    @property
    def residual(self) -> Array:
        """Distance of the predicted TCP from the wanted ``(n,)``, metres: mostly rounding."""
        return np.linalg.norm(self.predicted - self.wanted, axis=1)

    @property
    def error_before(self) -> Array:
        """Distance by which the nominal machine's commands would miss ``(n,)``, metres."""
        return np.linalg.norm(self.uncompensated - self.wanted, axis=1)

    @property
    def shape_before(self) -> Array:
        """Expected distance after the best translation by the nominal commands, rms ``(n,)``."""
        error = self.uncompensated - self.wanted
        return np.sqrt(np.sum((error - error.mean(axis=0)) ** 2 + self.shape_sigma**2, axis=1))

    @property
    def shape(self) -> Array:
        """Expected distance from the wanted point after the best translation, rms ``(n,)``."""
        return np.sqrt(np.sum(self.shape_sigma**2, axis=1) + self.residual**2)

    @property
    def place(self) -> float:
        """Expected length of that translation, root mean square, metres."""
        return float(np.linalg.norm(self.place_sigma))

    @property
    def accuracy(self) -> Array:
        """Expected distance from the wanted point, shape and place, rms ``(n,)``, metres."""
        return np.hypot(self.shape, self.place)

    def __str__(self) -> str:
        if not self.is_known:
            return "\n".join([f"{len(self)} points", _NO_UNCERTAINTY, *_GENERAL_NOTES])
        before, shape = self.shape_before * 1e3, self.shape * 1e3
        method = (
            "from the parameters' standard deviations, taken as independent; this is too large if "
            "the readings determine some parameters only together"
            if self.independent
            else "from the parameters' covariance"
        )
        lines = [
            f"{len(self)} points: error of the TCP to expect after the best translation, one "
            f"standard deviation ({method}); a report states its mean over the workspace instead",
            f"with nominal commands: {_rms(before):.4f} mm rms, {before.max():.4f} mm at the worst "
            f"point",
            f"with these commands: {_rms(shape):.4f} mm rms, {shape.max():.4f} mm at the worst "
            f"point",
            f"uncertainty of that translation: {self.place * 1e3:.2f} mm; a datum on the workpiece "
            f"removes it",
            *_GENERAL_NOTES,
        ]
        return "\n".join(lines)


_GENERAL_NOTES = (
    "the commands are in the controller's present count: leave its zeros as they are",
    "not covered: " + "; ".join(NOT_COVERED),
)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@public
def compensate(
    machine: MachineSource,
    points: ArrayLike,
    *,
    start: ArrayLike | None = None,
    time: ArrayLike = 0.0,
    warming: ArrayLike = 0.0,
    load: ArrayLike = 0.0,
    resolution: float = RESOLUTION,
    force: bool = False,
) -> Compensation:
    """Return commands that bring the TCP to the wanted points, with all errors of the machine.

    Points are taken in their order: lost motion depends on the direction of a drive's last move.

    Args:
        machine: calibrated, or the path of its file.
        points: TCP ``(n, 3)``, metres, in the order in which they are gone through; also what
            ``read_path`` returns.
        start: TCP ``(3,)`` before the first point; where absent, all drives arrive at it in +.
        time: seconds, a number or ``(n,)``.
        warming: kelvin above the calibration's first reading, a number or ``(n,)``.
        load: newtons at the TCP along base -z, a number or ``(n,)``.
        resolution: of the commands, metres.
        force: compensate even if the verdict stored with the machine advises against it.

    Raises:
        InputError: if that verdict says not to act on the machine's numbers, or if a point is not
            finite.
        UnreachableError: naming the row of the first point outside reach or stroke.
    """
    machine = checked_for_use(machine, force)
    wanted = _checked_path(points)
    columns = Conditions.from_commands(wanted, time=time, warming=warming, load=load)
    conditions = {"time": columns.time, "warming": columns.warming, "load": columns.load}
    perfect = machine.with_only({})
    nominal = _inverse(perfect, wanted, {})
    before = None if start is None else _inverse(perfect, np.array([triple("start", start)]), {})
    rho = _commands_along_path(machine, wanted, nominal, before, conditions, resolution)
    counts = machine.spec.controller.from_rho(rho, machine.geometry) / resolution
    travel = np.round(np.round(counts) * resolution, 12)
    rho = machine.spec.controller.to_rho(travel, machine.geometry)
    _check_stroke(machine, rho)
    approach = _arrival_directions(rho, before, 4 * resolution)  # no rounding turns a drive
    nominal_approach = _arrival_directions(nominal, before, resolution)
    at = Conditions.from_commands(rho, approach=approach, **conditions)
    kinematics = machine.spec.kinematics
    return Compensation(
        wanted,
        rho,
        travel,
        approach,
        machine.forward(rho, approach=approach, **conditions),
        machine.forward(nominal, approach=nominal_approach, **conditions),
        *_shape_and_offset_sigmas(machine, at),
        machine.spec.posterior is None,
        machine.geometry.layout.names,
        None if kinematics is None else kinematics.places(rho),
    )


def _checked_path(points: ArrayLike) -> Array:
    """Return TCP points ``(n, 3)``, metres."""
    wanted = as_float_array("a path", points)
    if wanted.ndim != 2 or wanted.shape[1] != 3 or not len(wanted):
        raise InputError(f"a path has the shape (n, 3), n at least 1, not {wanted.shape}")
    bad_rows = np.flatnonzero(~np.isfinite(wanted).all(axis=1))
    if bad_rows.size:
        raise InputError(f"row {bad_rows[0] + 1} of the path is not finite: give numbers in metres")
    return wanted


def _shape_and_offset_sigmas(machine: Machine, conditions: Conditions) -> tuple[Array, Array]:
    """Return sigmas after the best translation over the workspace ``(n, 3)``, and of that
    translation ``(3,)``; nan if no parameter is known.
    """
    names = machine.posterior.names
    if not names:
        return np.full((len(conditions.command), 3), np.nan), np.full(3, np.nan)
    slopes, offset = tcp_slopes(machine, names, conditions), tcp_slopes(machine, names).mean(axis=0)
    return output_sigmas(machine, slopes - offset), output_sigmas(machine, offset)


def _inverse(
    machine: Machine, wanted: Array, conditions: Mapping[str, Array], first_row: int = 0
) -> Array:
    """Return the commands of all points of a path, or of those from a row on; an error names the
    first row out of reach.
    """
    try:
        return machine.inverse(wanted, **conditions)
    except (UnreachableError, ClosureError) as error:
        if len(wanted) > 1:  # the first half that fails has that row
            half, commands = len(wanted) // 2, list[Array]()
            for rows in (slice(half), slice(half, None)):
                at = {name: values[rows] for name, values in conditions.items()}
                row = first_row + (rows.start or 0)
                commands.append(_inverse(machine, wanted[rows], at, row))
            return np.concatenate(commands)
        raise UnreachableError(
            f"row {first_row + 1} of the path is out of reach: {error}",
            leg=getattr(error, "leg", ""),
            excess=float(getattr(error, "excess", 0.0)),
            index=(first_row,),
        ) from error


def _check_stroke(machine: Machine, rho: Array, slack: float = STROKE_SLACK) -> None:
    """Refuse the first command beyond the stroke by more than a slack, metres."""
    outside = np.argwhere(~machine.geometry.in_stroke(rho, slack))
    if not len(outside):
        return
    row, axis = (int(k) for k in outside[0])
    travel, (low, high) = rho[row, axis] - machine.geometry.zero[axis], machine.geometry.stroke
    excess = float(max(low - travel, travel - high))
    raise UnreachableError(
        f"row {row + 1} of the path needs carriage {machine.geometry.leg_names[axis]} at "
        f"{plain(travel * 1e3, 3)} mm from mechanical zero, {excess * 1e3:.3f} mm beyond its "
        f"stroke of {compact(low * 1e3, 6)} to {compact(high * 1e3, 6)} mm: move the point "
        "towards the middle",
        leg=machine.geometry.leg_names[axis],
        excess=excess,
        index=(row,),
    )


def _arrival_directions(rho: Array, before: Array | None, min_move: float) -> Array:
    """Return the directions in which drives arrive, reversed at any step back of ``min_move``."""
    path = rho if before is None else np.concatenate([before, rho])
    approach = derive_approach(path, np.arange(len(path)), min_move=min_move)
    return approach[len(path) - len(rho) :]


def _commands_along_path(
    machine: Machine,
    wanted: Array,
    nominal: Array,
    before: Array | None,
    conditions: dict[str, Array],
    resolution: float,
) -> Array:
    """Return commands, each for the side from which its drive arrives along the path.

    Commands in the middle of the lost motion turn where the path turns, and the lost motion moves
    them farther in the same direction. Where a controller compensates too much, the lost motion is
    negative and a drive may not turn at all: the prediction includes that.
    """
    # Points far outside the stroke are refused before effects are solved for there.
    _check_stroke(machine, nominal, _STROKE_MARGIN)
    middle = _inverse(machine, wanted, {**conditions, "approach": np.zeros_like(wanted)})
    approach = _arrival_directions(middle, before, 2 * resolution)
    return _inverse(machine, wanted, {**conditions, "approach": approach})


# -- files -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PathPoints:
    """A path as it was read; numpy takes it as the array of its points."""

    p: Array  # TCP points (n, 3), metres, in the order of the rows
    line: tuple[int, ...]  # line of each in the file (n,), header line 1
    file: str  # its name as the caller gave it
    warnings: tuple[Note, ...]  # what was noticed and is no error

    def __len__(self) -> int:
        return len(self.p)

    def __repr__(self) -> str:
        return f"<PathPoints of {self.file}: {len(self)} points>"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.p, dtype=dtype)


@public
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
