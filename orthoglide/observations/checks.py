"""Checks of readings before any fit.

A check calls ``fail(message, row)``, which raises; a ``_note_*`` function yields warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError, check_type
from orthoglide.geometry import Array
from orthoglide.instruments import OBSERVATIONS, TOOL_OBSERVATIONS
from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.numerals import compact, plain
from orthoglide.observations.approach import MIN_MOVE, Ints
from orthoglide.observations.readings import Readings
from orthoglide.observations.schema import (
    MAX_ROTATION_SD,
    MOVE,
    READINGS,
    SIGMAS,
    TEMPERATURE,
    TIME,
)
from orthoglide.units import NOISE_LIMITS

Fail = Callable[[str, int | None], NoReturn]
"""Raises the error for a row, counted from 0."""

DECIMALS = 12
"""Decimals of a metre to which commands are rounded on conversion from controller values: files are
read back exactly as they were written."""

STROKE_SLACK = 1e-6
"""Tolerated excess of a command over the stroke, metres."""

MIN_AXIS_MOTION = 1e-3
"""Least range of commands over which an axis counts as moving, metres, or a tenth of the stroke if
that is less."""

DIAL_RANGE = 20e-3
"""Upper limit of the range of a dial, without the motion of the command, metres."""

_STILL_DIAL_STEPS = 2 - 1e-6  # rounding and touching make a still dial vary by up to two steps
_ZERO_READING = 1e-8  # metres: smaller readings are zeros of a simulated perfect machine


def check_given(readings: Readings, machine: MachineFile) -> None:
    """Refuse readings that would be refused in a file.

    Raises:
        InputError: naming the row, counted from 0, and what would be right.
    """

    def fail(message: str, row: int | None = None) -> NoReturn:
        at_row = "" if row is None else f", row {row} (counted from 0)"
        raise InputError(f"{readings.name}{at_row}: {message} (arrays are in metres and radians)")

    expected = "a campaign, which og.Campaign.from_frame makes of a data frame, or a file's path"
    check_type("the readings", readings, Readings, expected)
    if not len(readings):
        fail("has no readings: give some")
    check_commands(readings.command, False, machine, fail)
    check_filled(readings, fail)
    if readings.by_point:
        points = readings.points()
        check_points(points.command, points.p, fail)
    check_readings(readings, machine, fail)


def check_commands(values: Array, are_travel: bool, machine: MachineFile, fail: Fail) -> Array:
    """Return commands ``(n, 3)``, metres, as joint coordinates; refuse those outside the stroke.

    ``are_travel`` says that they are the controller's values, which are converted.
    """
    geometry, controller = machine.geometry, machine.controller

    def rho_of(command: Array, is_travel: bool) -> Array:
        return np.round(controller.to_rho(command, geometry), DECIMALS) if is_travel else command

    def fits(command: Array, is_travel: bool) -> NDArray[np.bool_]:
        return np.asarray(geometry.in_stroke(rho_of(command, is_travel), STROKE_SLACK).all(axis=-1))

    outside = np.flatnonzero(~fits(values, are_travel))
    if not len(outside):
        return rho_of(values, are_travel)
    row, names = int(outside[0]), geometry.leg_names
    command, other = values[row], "rho" if are_travel else "travel"
    whose = "joint coordinates rho" if are_travel else "the controller's, counted from its own zero"
    if fits(command * 1e3, are_travel):
        fail("the command is in metres: give millimetres", row)
    if geometry.layout.zero(geometry.L) and fits(command, not are_travel):
        intended = controller.from_rho(command, geometry) if are_travel else rho_of(command, True)
        fail(
            f"the command's values are {whose}: name the columns {other}_{names[0]}_mm to "
            f"{other}_{names[2]}_mm, or give {'travel' if are_travel else 'rho'} "
            f"{', '.join(compact(value * 1e3, 9) for value in intended)} mm",
            row,
        )
    axis = int(np.argmin(geometry.in_stroke(rho_of(command, are_travel), STROKE_SLACK)))
    limits = geometry.zero + np.array(geometry.stroke)[:, None]
    if are_travel:
        limits = controller.from_rho(limits, geometry)
    low, high = sorted(limits[:, axis] * 1e3)
    fail(
        f"the command {compact(command[axis] * 1e3, 9)} mm of axis {names[axis]} is outside its "
        f"stroke of {compact(low, 6)} to {compact(high, 6)} mm: correct it, or the stroke in the "
        f"machine file",
        row,
    )


def check_layout(kinds: Sequence[str], machine: MachineFile, fail: Fail) -> None:
    """Refuse rows of kinds that read legs on a machine without dials on its legs."""
    rows = [k for k, kind in enumerate(kinds) if kind != MOVE and OBSERVATIONS[kind].on_leg]
    if rows and not machine.geometry.dialled:
        fail(
            f"dials on the legs are read on an Orthoglide only, and this machine's layout is "
            f"{machine.geometry.layout.kind}: name the kind of the reading in column kind "
            f"({', '.join(TOOL_OBSERVATIONS)})",
            rows[0],
        )


def check_firmware(marks: Sequence[str], machine: MachineFile, fail: Fail) -> None:
    """Refuse commands that were computed with another firmware's numbers than the machine's."""
    if not machine.firmware:
        return
    for row, mark in enumerate(marks):
        if mark and mark != machine.firmware:
            fail(
                f"was imported with other numbers of the firmware ({mark}) than "
                f"{machine.file or 'the machine file'} ({machine.firmware}): take the machine.toml "
                f"of its own import, and leave out the campaigns of the other numbers",
                row,
            )


def check_filled(readings: Readings, fail: Fail) -> None:
    """Refuse tables in which readings are missing."""
    empty = np.flatnonzero(np.isnan(readings.reading))
    if not len(empty):
        return
    observation = readings.setups[readings.setup[empty[0]]].observation
    column = READINGS[observation.unit].name + " or the height of the touch" * observation.touches
    if len(empty) == len(readings):
        fail(f"has no readings yet: fill in {column}", 0)
    further = f", and in {len(empty) - 1} rows more" if len(empty) > 1 else ""
    fail(f"{column} is empty{further}: fill it in or remove the row", int(empty[0]))


def check_points(command: Array, p: Array, fail: Fail) -> None:
    """Refuse implausible positions ``p`` of the tool ``(m, 3)``, metres, nan where not measured."""
    missing = np.isnan(p).all(axis=1)
    if missing.any():
        fail("all of p_x_mm, p_y_mm, p_z_mm are empty: remove the row", int(np.argmax(missing)))
    commanded = np.ptp(command, axis=0).max()
    measured = max(np.ptp(q[np.isfinite(q)]) if np.isfinite(q).any() else 0.0 for q in p.T)
    if commanded > MIN_AXIS_MOTION and not commanded / 100 <= measured <= 100 * commanded:
        other = "millimetres, not metres" if measured < commanded else "a thousandth of each"
        fail(
            f"the points lie within {measured * 1e3:.3g} mm while the commands span "
            f"{commanded * 1e3:.3g} mm: give {other}",
            0,
        )


def check_sequence(command: Array, order: Ints, lines: Sequence[int], fail: Fail) -> None:
    """Refuse two commands ``(n, 3)``, of readings or moves, at one place in the order ``(n,)``."""
    first_rows: dict[int, int] = {}
    for row, position in enumerate(order.tolist()):
        first_row = first_rows.setdefault(position, row)
        if np.abs(command[row] - command[first_row]).max() > MIN_MOVE:
            fail(
                f"order {position} stands for another command on line {lines[first_row]}: "
                "number the postures in the sequence the machine took",
                row,
            )


def check_readings(readings: Readings, machine: MachineFile, fail: Fail) -> tuple[Note, ...]:
    """Refuse implausible readings, whose commands are checked already, and return warnings."""
    on_legs, warnings = readings.on_legs, list[Note]()
    if on_legs.any():
        campaign, leg_rows = readings.subset(on_legs), np.flatnonzero(on_legs)

        def fail_leg(message: str, row: int | None) -> NoReturn:
            fail(message, None if row is None else int(leg_rows[row]))

        for check in _CHECKS:
            check(campaign, machine, fail_leg)
        warnings += [*_note_still_dial(campaign, machine), *_note_partly_recorded(campaign)]
        warnings += _note_late_clock(campaign)
    for rule in (_check_noise, _check_distances, _check_bars, _check_duplicates):
        rule(readings, fail)
    return tuple(warnings)


def max_dial_span(campaign: Readings, index: int) -> float:
    """Return the largest span of a setup's readings: the dial's range and the motion of the
    command, metres.
    """
    motion = campaign.command[campaign.setup == index, campaign.setups[index].axis]
    return DIAL_RANGE + float(np.ptp(motion))


def _check_noise(readings: Readings, fail: Fail) -> None:
    max_sigma = np.where(readings.angular, MAX_ROTATION_SD, NOISE_LIMITS[1])
    wrong = np.isfinite(readings.sigma) & (
        (readings.sigma < NOISE_LIMITS[0]) | (readings.sigma > max_sigma)
    )
    if wrong.any():
        row = int(np.argmax(wrong))
        fail(
            f"sigma is {readings.sigma[row]:g}: give a standard deviation in metres from "
            f"{NOISE_LIMITS[0]:g} to {max_sigma[row]:g}, or nan",
            row,
        )


def _check_distances(readings: Readings, fail: Fail) -> None:
    coincident = (np.abs(readings.second - readings.command) < MIN_MOVE).all(axis=1)
    coinciding = np.flatnonzero(readings.paired & coincident)
    if len(coinciding):
        fail("the two commands of this distance are the same: correct one", int(coinciding[0]))
    rows = np.flatnonzero(readings.paired & np.isfinite(readings.reading))
    distances = readings.reading[rows]
    if (distances <= 0).any():
        fail("a distance must be above 0: correct it", int(rows[np.argmax(distances <= 0)]))
    if len(rows) and distances.max() < 1e-3:
        fail("all distances are below 1 mm: give millimetres, not metres", int(rows[0]))


def _check_bars(readings: Readings, fail: Fail) -> None:
    bars = np.flatnonzero(
        readings.which(lambda s: s.observation.about_ball) & np.isfinite(readings.reading)
    )
    # Only lengths are checked: deviations are near zero and of any sign.
    length = np.abs(readings.reading[bars])
    negative = readings.reading[bars] < 0
    if negative.any() and not negative.all() and length.min() > length.max() / 2:
        wrong = negative if negative.mean() < 0.5 else ~negative
        fail("this length has another sign than the others: correct it", int(bars[wrong][0]))


def _check_duplicates(readings: Readings, fail: Fail) -> None:
    """Refuse two readings of one visit. Column order numbers the visits of instruments at the tool,
    column repeat those of dials on a leg.
    """
    first_rows = dict[Hashable, int]()
    order = np.where(readings.on_legs, 0, readings.order)
    visits = np.column_stack([np.round(readings.stations, 9), readings.repeat, order])
    for row, visit in enumerate(map(tuple, visits.tolist())):
        first = first_rows.setdefault(visit, row)
        if first != row:
            reason, remedy = "approach", "count it up in column repeat"
            if not readings.on_legs[row]:
                reason, remedy = "order", "number the visits in column order"
            fail(
                f"the reading of line {readings.line[first]} stands here again (same setup, "
                f"command, {reason} and repeat): remove one, or {remedy}",
                row,
            )


def _check_motion(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    # `_check_postures` reports a single posture
    low, high = machine.geometry.stroke
    limit = min(MIN_AXIS_MOTION, (high - low) / 10)
    if MIN_MOVE < np.ptp(campaign.command, axis=0).max() <= limit:
        fail(
            f"no axis moves by more than {limit * 1e3:g} mm: give the commands in millimetres, "
            f"not metres",
            0,
        )


def _check_gauges(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    tip = campaign.command[np.arange(len(campaign)), campaign.leg]

    def on_leg(gauge: Array) -> NDArray[np.bool_]:
        return (tip - machine.geometry.L < gauge) & (gauge < tip)

    second_gauges = np.array([s.gauges[-1] for s in campaign.setups])[campaign.setup]
    for column, gauge in (("gauge_mm", campaign.gauge), ("gauge2_mm", second_gauges)):
        metres = on_leg(gauge * 1e3) & (np.abs(gauge) < MIN_AXIS_MOTION)
        off = np.flatnonzero(~on_leg(gauge) | metres)
        if len(off) and metres[off[0]]:
            fail(f"{column} is in metres: give millimetres", int(off[0]))
        if len(off):
            row = int(off[0])
            low, high = (tip[row] - machine.geometry.L) * 1e3, tip[row] * 1e3
            fail(
                f"the gauge at {compact(gauge[row] * 1e3, 6)} mm is off the leg, which runs from "
                f"{plain(low, 1)} to {plain(high, 1)} mm: correct {column} or the command",
                row,
            )


def _check_postures(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    for index, setup in enumerate(campaign.setups):
        rows = np.flatnonzero(campaign.setup == index)
        is_single = np.ptp(campaign.command[rows], axis=0).max() <= MIN_MOVE
        if setup.observation.from_datum and is_single:
            fail(
                f"setup {setup.name!r} has a single posture and its datum is free: measure a "
                "second one or remove the setup",
                int(rows[0]),
            )


def _check_clock(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    rows = np.lexsort((campaign.time, campaign.order))
    rows = rows[np.isfinite(campaign.time[rows])]
    decreases = np.flatnonzero(np.diff(campaign.time[rows]) < 0)
    if len(decreases):
        before, row = rows[decreases[0] : decreases[0] + 2].tolist()
        fail(
            f"time_s decreases from line {campaign.line[before]} to here: give seconds since the "
            "start of the campaign; if the rows are not in the order measured, number them in "
            "column order",
            row,
        )


def _check_dial(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    size = np.nanmax(np.abs(campaign.reading), initial=0.0)
    if _ZERO_READING < size < machine.dial.resolution:
        fail(
            f"all readings are below one step of the dial ({machine.dial.resolution * 1e3:g} mm): "
            "give millimetres, not metres, or correct resolution in the machine file",
            0,
        )
    for index, setup in enumerate(campaign.setups):
        rows = np.flatnonzero((campaign.setup == index) & np.isfinite(campaign.reading))
        if not len(rows):
            continue
        reading = campaign.reading[rows]
        datum = [] if setup.observation.from_datum else [0.0]  # else readings are absolute
        values = np.concatenate([reading, datum])
        if (span := np.ptp(values)) > (limit := max_dial_span(campaign, index)):
            row = rows[np.argmax(np.abs(reading - np.median(values)))]
            fail(
                f"reading_mm is {compact(campaign.reading[row] * 1e3, 6)}, and the readings of "
                f"setup {setup.name!r} span {span * 1e3:.4g} mm{' from 0' if datum else ''}; a "
                f"dial there can show at most {limit * 1e3:.4g} mm (its range and the motion of "
                f"the command): correct this reading, or give millimetres",
                int(row),
            )


_CHECKS = (_check_motion, _check_gauges, _check_postures, _check_clock, _check_dial)


def _note_still_dial(campaign: Readings, machine: MachineFile) -> Iterator[Note]:
    read = np.isfinite(campaign.reading) & campaign.which(lambda s: s.observation.from_datum)
    if not read.any():
        return
    spans = [
        np.ptp(campaign.reading[read & (campaign.setup == index)])
        for index in np.unique(campaign.setup[read])
    ]
    if max(spans) < max(_STILL_DIAL_STEPS * machine.dial.resolution, _ZERO_READING):
        yield Note(
            f"no setup's readings vary by more than {max(spans) * 1e3:.3g} mm: check that the dial "
            "touches the leg. If the dial does not touch, these readings contain no information",
            "reading",
        )


def _note_partly_recorded(campaign: Readings) -> Iterator[Note]:
    consequences = {
        TIME: "rows without one count as taken at the start",
        TEMPERATURE: "rows without one count as no warmer than the first row",
        SIGMAS["mm"]: "rows without one get the noise of the dial",
    }
    for column, consequence in consequences.items():
        absent = np.isnan(getattr(campaign, column.attribute))
        if absent.any() and not absent.all():
            text = f"{column.name} is empty in {absent.sum()} of {len(absent)} rows: {consequence}"
            yield Note(text, column.name, tuple(campaign.line[absent].tolist()))


def _note_late_clock(campaign: Readings) -> Iterator[Note]:
    """Note a clock that starts later than the session is long: bars that warm from its zero would
    have grown before the first reading.
    """
    time = campaign.time[np.isfinite(campaign.time)]
    if len(time) and time.min() > np.ptp(time):
        yield Note(
            f"{TIME.name} starts at {time.min():.6g} s: give seconds since the start of the "
            f"session, not a time of day, as effects that grow with time count from 0",
            TIME.name,
        )
