"""What can be noticed about a campaign before any fit.

Each check takes the campaign (or its commands), the machine and ``fail(message, row)``, which
raises. What is no error is returned as a warning.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.instruments import (
    OBSERVATIONS,
    PLATE_TURN_COLUMN,
    TOOL_OBSERVATIONS,
    TOOL_OFFSET_COLUMNS,
)
from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.numerals import compact, plain
from orthoglide.observations.approach import MIN_MOVE, Ints
from orthoglide.observations.notices import MIN_AXIS_MOTION, NOTICES, ZERO_READING, min_axis_motion
from orthoglide.observations.readings import Readings
from orthoglide.observations.schema import MAX_ROTATION_SD, MOVE, READINGS
from orthoglide.units import NOISE_LIMITS

Fail = Callable[[str, int | None], NoReturn]
"""Raises the error for a row, counted from 0."""

DECIMALS = 12
"""Of a metre: to these commands are rounded on their way through the controller's zero and sign, so
that binary fractions leave no trace and files come back as they were written."""

STROKE_SLACK = 1e-6
"""How far a command may lie beyond the stroke, metres."""

DIAL_RANGE = 20e-3
"""More than any dial shows besides what the command itself moves, metres."""


def check_commands(values: Array, travelled: bool, machine: MachineFile, fail: Fail) -> Array:
    """Joint coordinates of commands as given, all within the stroke.

    Args:
        values: as in the file ``(n, 3)``, metres.
        travelled: whether they are the controller's values, not joint coordinates.
        machine: whose stroke and controller count.
        fail: raises the error.

    Returns:
        Commands rho ``(n, 3)``, metres.
    """
    geometry, controller = machine.geometry, machine.controller

    def rho_of(given: Array, travel: bool) -> Array:
        return np.round(controller.to_rho(given, geometry), DECIMALS) if travel else given

    def fits(given: Array, travel: bool) -> NDArray[np.bool_]:
        return np.asarray(geometry.in_stroke(rho_of(given, travel), STROKE_SLACK).all(axis=-1))

    outside = np.flatnonzero(~fits(values, travelled))
    if not len(outside):
        return rho_of(values, travelled)
    row, names = int(outside[0]), geometry.leg_names
    given, other = values[row], "rho" if travelled else "travel"
    whose = "joint coordinates rho" if travelled else "the controller's, counted from its own zero"
    if fits(given * 1e3, travelled):
        fail("the command is in metres: give millimetres", row)
    if geometry.layout.zero(geometry.L) and fits(given, not travelled):
        meant = controller.from_rho(given, geometry) if travelled else rho_of(given, True)
        fail(
            f"the command's values are {whose}: name the columns {other}_{names[0]}_mm to "
            f"{other}_{names[2]}_mm, or give {'travel' if travelled else 'rho'} "
            f"{', '.join(compact(value * 1e3, 9) for value in meant)} mm",
            row,
        )
    axis = int(np.argmin(geometry.in_stroke(rho_of(given, travelled), STROKE_SLACK)))
    limits = geometry.zero + np.array(geometry.stroke)[:, None]
    if travelled:
        limits = controller.from_rho(limits, geometry)
    low, high = sorted(limits[:, axis] * 1e3)
    fail(
        f"the command {compact(given[axis] * 1e3, 9)} mm of axis {names[axis]} is outside its "
        f"stroke of {compact(low, 6)} to {compact(high, 6)} mm: correct it, or the stroke in the "
        f"machine file",
        row,
    )


def check_layout(kinds: Sequence[str], machine: MachineFile, fail: Fail) -> None:
    """Refuse readings of legs, by the kinds of the rows, where no dial is set against a leg."""
    if machine.geometry.dialled:
        return
    on_leg = [k for k, kind in enumerate(kinds) if kind == MOVE or OBSERVATIONS[kind].on_leg]
    if len(on_leg) < len(kinds):
        return
    fail(
        f"dials on the legs are read on an Orthoglide only, and this machine's layout is "
        f"{machine.geometry.layout.kind}: name the kind of the reading in column kind "
        f"({', '.join(TOOL_OBSERVATIONS)})",
        next((k for k in on_leg if kinds[k] != MOVE), 0),
    )


def check_firmware(marks: Sequence[str], machine: MachineFile, fail: Fail) -> None:
    """Refuse commands that were computed with other numbers of a firmware than the machine's."""
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


def check_filled(given: Readings, fail: Fail) -> None:
    """Refuse readings of which some were not taken yet."""
    empty = np.flatnonzero(np.isnan(given.reading))
    if not len(empty):
        return
    first = given.setups[given.setup[empty[0]]].observation
    column = READINGS[first.unit].name + " or the height of the touch" * first.touches
    if len(empty) == len(given):
        fail(f"has no readings yet: fill in {column}", 0)
    more = f", and in {len(empty) - 1} rows more" if len(empty) > 1 else ""
    fail(f"{column} is empty{more}: fill it in or remove the row", int(empty[0]))


def check_points(command: Array, p: Array, fail: Fail) -> None:
    """Refuse measured positions of the tool ``(m, 3)`` that cannot be meant as they stand.

    Args:
        command: joint coordinates ``(m, 3)``, metres.
        p: measured, nan where a coordinate is missing, metres.
        fail: raises the error.
    """
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
    """Refuses two commands ``(n, 3)``, of readings or moves, at one place in the order ``(n,)``."""
    first: dict[int, int] = {}
    for row, place in enumerate(order.tolist()):
        before = first.setdefault(place, row)
        if np.abs(command[row] - command[before]).max() > MIN_MOVE:
            fail(
                f"order {place} stands for another command on line {lines[before]}: "
                "number the postures in the sequence the machine took",
                row,
            )


def check_readings(given: Readings, machine: MachineFile, fail: Fail) -> tuple[Note, ...]:
    """Refuse readings, their commands already checked, that cannot be meant as they stand.

    Returns:
        Warnings of what is odd but possible.
    """
    legs, found = given.on_legs, list[Note]()
    if legs.any():
        campaign, at = given.subset(legs), np.flatnonzero(legs)

        def fail_leg(message: str, row: int | None) -> NoReturn:
            fail(message, None if row is None else int(at[row]))

        for check in _CHECKS:
            check(campaign, machine, fail_leg)
        found = [note for notice in NOTICES for note in notice(campaign, machine)]
    for rule in (_check_noise, _check_places, _check_distances, _check_bars, _check_duplicates):
        rule(given, fail)
    return tuple(found)


def _check_noise(given: Readings, fail: Fail) -> None:
    most = np.where(given.angular, MAX_ROTATION_SD, NOISE_LIMITS[1])
    wrong = np.isfinite(given.sigma) & ((given.sigma < NOISE_LIMITS[0]) | (given.sigma > most))
    if wrong.any():
        row = int(np.argmax(wrong))
        fail(
            f"sigma is {given.sigma[row]:g}: give a standard deviation in metres from "
            f"{NOISE_LIMITS[0]:g} to {most[row]:g}, or nan",
            row,
        )


def _check_places(given: Readings, fail: Fail) -> None:
    for place, setup in enumerate(given.setups):
        has, row = setup.observation.setup_columns, int(np.argmax(given.setup == place))
        if (
            any(setup.beside)
            and not set(TOOL_OFFSET_COLUMNS) & set(has)
            and not setup.observation.on_leg
        ):
            empty = ", ".join(TOOL_OFFSET_COLUMNS)
            fail(f"a level shows the same wherever it stands: leave {empty} empty", row)
        if setup.turned and PLATE_TURN_COLUMN not in has:
            fail(
                f"only a plate is turned on its seat ({PLATE_TURN_COLUMN}), nothing of a {setup.kind}",
                row,
            )


def _check_distances(given: Readings, fail: Fail) -> None:
    paired = given.paired & np.isfinite(given.reading)
    near = (np.abs(given.second - given.command) < 1e-6).all(axis=1)
    same = np.flatnonzero(paired & near & (given.reading > 0))
    if len(same):
        fail("the two commands of this distance are the same: correct one", int(same[0]))
    short = np.flatnonzero(paired & (given.reading <= 0))
    if len(short):
        fail("a distance must be above 0: correct it", int(short[0]))
    if paired.any() and given.reading[paired].max() < 1e-3:
        fail("all distances are below 1 mm: give millimetres, not metres", 0)


def _check_bars(given: Readings, fail: Fail) -> None:
    bars = np.flatnonzero(given.about_ball & np.isfinite(given.reading))
    # Lengths, not deviations: these are of any sign and near zero.
    length = np.abs(given.reading[bars])
    turned = given.reading[bars] < 0
    if turned.any() and not turned.all() and length.min() > length.max() / 2:
        wrong = turned if turned.mean() < 0.5 else ~turned
        fail("this length has another sign than the others: correct it", int(bars[wrong][0]))


def _check_motion(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    if np.ptp(campaign.command, axis=0).max() <= MIN_MOVE:
        return  # one posture throughout: its own check says it better
    if np.ptp(campaign.command, axis=0).max() <= (least := min_axis_motion(machine)):
        fail(
            f"no axis moves by more than {least * 1e3:g} mm: give the commands in millimetres, not "
            f"metres",
            0,
        )


def _check_gauges(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    tip = campaign.command[np.arange(len(campaign)), campaign.leg]

    def on_leg(place: Array) -> NDArray[np.bool_]:
        return (tip - machine.geometry.L < place) & (place < tip)

    last = np.array([s.gauges[-1] for s in campaign.setups])[campaign.setup]
    for column, gauge in (("gauge_mm", campaign.gauge), ("gauge2_mm", last)):
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
    for place, setup in enumerate(campaign.setups):
        rows = np.flatnonzero(campaign.setup == place)
        if (
            setup.observation.from_datum
            and np.ptp(campaign.command[rows], axis=0).max() <= MIN_MOVE
        ):
            fail(
                f"setup {setup.name!r} has a single posture and its datum is free: measure a "
                "second one or remove the setup",
                int(rows[0]),
            )


def _check_duplicates(given: Readings, fail: Fail) -> None:
    """Refuse a reading of a visit that was read already. An instrument at the tool is visited as
    often as column order says, a dial on a leg as often as column repeat does.
    """
    seen = dict[Hashable, int]()
    order = np.where(given.on_legs, 0, given.order)
    visits = np.column_stack([np.round(given.stations, 9), given.repeat, order])
    for row, visit in enumerate(map(tuple, visits.tolist())):
        first = seen.setdefault(visit, row)
        if first != row:
            same, remedy = "approach", "count it up in column repeat"
            if not given.on_legs[row]:
                same, remedy = "order", "number the visits in column order"
            fail(
                f"the reading of line {given.line[first]} stands here again (same setup, command, "
                f"{same} and repeat): remove one, or {remedy}",
                row,
            )


def _check_clock(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    rows = np.lexsort((campaign.time, campaign.order))
    rows = rows[np.isfinite(campaign.time[rows])]
    back = np.flatnonzero(np.diff(campaign.time[rows]) < 0)
    if len(back):
        before, row = rows[back[0]], rows[back[0] + 1]
        fail(
            f"time_s runs back from line {campaign.line[before]} to here: count on from the start "
            "of the campaign, and number the rows in column order if they are sorted otherwise",
            int(row),
        )


def _check_dial(campaign: Readings, machine: MachineFile, fail: Fail) -> None:
    size = np.nanmax(np.abs(campaign.reading), initial=0.0)
    if ZERO_READING < size < machine.dial.resolution:
        fail(
            f"all readings are below one step of the dial ({machine.dial.resolution * 1e3:g} mm): "
            "give millimetres, not metres, or correct resolution in the machine file",
            0,
        )
    for place, setup in enumerate(campaign.setups):
        rows = np.flatnonzero((campaign.setup == place) & np.isfinite(campaign.reading))
        if not len(rows):
            continue
        reading = campaign.reading[rows]
        limit = DIAL_RANGE + np.ptp(campaign.command[rows, setup.axis])
        # From nothing where there is no datum.
        datum = [] if setup.observation.from_datum else [0.0]
        every = np.concatenate([reading, datum])
        if np.ptp(every) > limit:
            row = rows[np.argmax(np.abs(reading - np.median(every)))]
            fail(
                f"reading_mm is {compact(campaign.reading[row] * 1e3, 6)} in setup "
                f"{setup.name!r}, whose readings span {np.ptp(every) * 1e3:.4g} mm"
                f"{' from 0' if datum else ''}, more "
                "than its leg can move: correct a slip, or give millimetres",
                int(row),
            )


_CHECKS = (_check_motion, _check_gauges, _check_postures, _check_clock, _check_dial)


def check_given(given: Readings, machine: MachineFile) -> None:
    """Refuse readings for which a file that holds them would be refused.

    Raises:
        InputError: naming the row, counted from 0, and what would be right.
    """

    def fail(message: str, row: int | None = None) -> NoReturn:
        place = "" if row is None else f", row {row} (counted from 0)"
        raise InputError(f"{given.name}{place}: {message} (arrays are in metres and radians)")

    if not isinstance(given, Readings):
        raise InputError(
            f"a {type(given).__name__} holds no readings: give a campaign, which "
            "og.Campaign.from_frame makes of a data frame, TCP points, or the path of a file"
        )
    if not len(given):
        fail("has no readings: give some")
    check_commands(given.command, False, machine, fail)
    check_filled(given, fail)
    if given.by_point:
        points = given.points()
        check_points(points.command, points.p, fail)
    check_readings(given, machine, fail)
