"""What can be noticed about a campaign before any fit.

Each check takes the campaign (or its commands), the machine and ``fail(message, row)``, which
raises. What is no error is returned as a warning.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import LEGS, Array
from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.observations.approach import MOVED, Ints, impossible_approach
from orthoglide.observations.campaign import Campaign

Fail = Callable[[str, int | None], NoReturn]
"""Raises the error for a row, counted from 0."""

DECIMALS = 12
"""Of a metre: to these commands are rounded on their way through the controller's zero and sign, so
that binary fractions leave no trace and files come back as they were written."""

STROKE_SLACK = 1e-6
"""How far a command may lie beyond the stroke, metres."""

HARDLY = 1e-3
"""An axis that moves by no more than this hardly moves, metres; on a stroke of less than ten times
as much, a tenth of that counts."""

DIAL_RANGE = 20e-3
"""More than any dial shows besides what the command itself moves, metres."""

STILL = 2 - 1e-6
"""Steps of the dial: readings that spread by less, in every setup, hardly move."""

NO_READING = 1e-8
"""Readings all below this are a simulated perfect machine's zeros, metres."""

_USUAL = (0.5, 0.25)
"""Where dials stand, in lengths of the leg, whose owner measures from the tool's centre too."""

_RULED = 1e-4
"""How well a place is measured with a ruler or a drawing, metres."""

_SHOWN = 5  # lines named in a warning


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
            f"{', '.join(f'{value * 1e3:.9g}' for value in meant)} mm",
            row,
        )
    axis = int(np.argmin(geometry.in_stroke(rho_of(given, travelled), STROKE_SLACK)))
    limits = geometry.zero + np.array(geometry.stroke)[:, None]
    if travelled:
        limits = controller.from_rho(limits, geometry)
    low, high = sorted(limits[:, axis] * 1e3)
    fail(
        f"the command {given[axis] * 1e3:.9g} mm of axis {names[axis]} is outside its stroke of "
        f"{low:g} to {high:g} mm: correct it, or the stroke in the machine file",
        row,
    )


def check_filled(reading: Array, fail: Fail) -> None:
    """Refuses readings ``(n,)`` of which some were not taken yet."""
    empty = np.flatnonzero(np.isnan(reading))
    if len(empty) == len(reading):
        fail("has no readings yet: fill in reading_mm", 0)
    if len(empty):
        more = f", and in {len(empty) - 1} rows more" if len(empty) > 1 else ""
        fail(f"reading_mm is empty{more}: fill it in or remove the row", int(empty[0]))


def check_sequence(command: Array, order: Ints, lines: Sequence[int], fail: Fail) -> None:
    """Refuses two commands ``(n, 3)``, of readings or moves, at one place in the order ``(n,)``."""
    first: dict[int, int] = {}
    for row, place in enumerate(order.tolist()):
        before = first.setdefault(place, row)
        if np.abs(command[row] - command[before]).max() > MOVED:
            fail(
                f"order {place} stands for another command on line {lines[before]}: "
                "number the postures in the sequence the machine took",
                row,
            )


def check_campaign(campaign: Campaign, machine: MachineFile, fail: Fail) -> tuple[Note, ...]:
    """Refuses a campaign, its commands already checked, that cannot be meant as it stands; ``fail``
    raises.

    Returns:
        Warnings of what is odd but possible.
    """
    for check in _CHECKS:
        check(campaign, machine, fail)
    return tuple(text for notice in _NOTICES for text in notice(campaign, machine))


def _motion(campaign: Campaign, machine: MachineFile, fail: Fail) -> None:
    if np.ptp(campaign.command, axis=0).max() <= MOVED:
        return  # one posture throughout: its own check says it better
    if np.ptp(campaign.command, axis=0).max() <= (least := _hardly(machine)):
        fail(
            f"no axis moves by more than {least * 1e3:g} mm: give the commands in millimetres, not "
            f"metres",
            0,
        )


def _hardly(machine: MachineFile) -> float:
    low, high = machine.geometry.stroke
    return min(HARDLY, (high - low) / 10)


def _gauges(campaign: Campaign, machine: MachineFile, fail: Fail) -> None:
    gauge = campaign.gauge
    tip = campaign.command[np.arange(len(campaign)), campaign.leg]

    def on_leg(place: Array) -> NDArray[np.bool_]:
        return (tip - machine.geometry.L < place) & (place < tip)

    metres = on_leg(gauge * 1e3) & (np.abs(gauge) < HARDLY)
    off = np.flatnonzero(~on_leg(gauge) | metres)
    if len(off) and metres[off[0]]:
        fail("gauge_mm is in metres: give millimetres", int(off[0]))
    if len(off):
        row = int(off[0])
        low, high = (tip[row] - machine.geometry.L) * 1e3, tip[row] * 1e3
        fail(
            f"the gauge at {gauge[row] * 1e3:g} mm is off the leg, which runs from {low:.1f} to "
            f"{high:.1f} mm: correct gauge_mm or the command",
            row,
        )


def _postures(campaign: Campaign, machine: MachineFile, fail: Fail) -> None:
    for place, setup in enumerate(campaign.setups):
        rows = np.flatnonzero(campaign.setup == place)
        if np.ptp(campaign.command[rows], axis=0).max() <= MOVED:
            fail(
                f"setup {setup.name!r} has a single posture and its datum is free: measure a "
                "second one or remove the setup",
                int(rows[0]),
            )


def _duplicates(campaign: Campaign, machine: MachineFile, fail: Fail) -> None:
    seen: dict[Hashable, int] = {}
    visits = np.column_stack([campaign.setup, campaign.repeat, campaign.approach, campaign.load])
    places = np.round(campaign.command, 9)
    for row, key in enumerate(zip(map(tuple, visits), map(tuple, places), strict=True)):
        first = seen.setdefault(key, row)
        if first != row:
            fail(
                f"the reading of line {campaign.line[first]} stands here again (same setup, "
                "command, approach and repeat): remove one, or count it up in column repeat",
                row,
            )


def _clock(campaign: Campaign, machine: MachineFile, fail: Fail) -> None:
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


def _dial(campaign: Campaign, machine: MachineFile, fail: Fail) -> None:
    size = np.nanmax(np.abs(campaign.reading), initial=0.0)
    if NO_READING < size < machine.dial.resolution:
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
        if np.ptp(reading) > limit:
            row = rows[np.argmax(np.abs(reading - np.median(reading)))]
            fail(
                f"reading_mm is {campaign.reading[row] * 1e3:g} in setup {setup.name!r}, whose "
                f"readings span {np.ptp(reading) * 1e3:.4g} mm, more than its leg can move: "
                "correct a slip, or give millimetres",
                int(row),
            )


_CHECKS = (_motion, _gauges, _postures, _duplicates, _clock, _dial)


def _approaches(campaign: Campaign, machine: MachineFile) -> Iterator[Note]:
    if np.array_equal(campaign.approach, campaign.derived_approach):
        return
    wrong = impossible_approach(campaign.command, campaign.approach, campaign.order, campaign.moves)
    if not wrong.any():
        return
    columns = " and ".join(f"approach_{LEGS[k]}" for k in np.flatnonzero(wrong.any(axis=0)))
    lines = tuple(campaign.line[wrong.any(axis=1)].tolist())
    shown = ", ".join(map(str, lines[:_SHOWN])) + (" ..." if len(lines) > _SHOWN else "")
    yield Note(
        f"{columns} cannot come from the order of the rows ({len(lines)} rows: line {shown}): if "
        "the machine made further moves enter them as rows of kind move, else correct the columns",
        "approach",
        lines,
    )


def _still_legs(campaign: Campaign, machine: MachineFile) -> Iterator[Note]:
    for leg in np.unique(campaign.leg):
        span = np.ptp(campaign.command[campaign.leg == leg, leg])
        if span <= _hardly(machine):
            yield Note(
                f"leg {LEGS[leg]} moves by only {span * 1e3:.3g} mm along its own axis in its "
                "setups: they say little about its length and axis",
                "command",
            )


def _gauges_with_r(campaign: Campaign, machine: MachineFile) -> Iterator[Note]:
    length, r = machine.geometry.L, machine.geometry.r
    beyond = campaign.gauge[:, None] - np.multiply(_USUAL, length)
    if r > _RULED and (np.abs(beyond - r) <= _RULED).any(axis=1).all():
        places = " and ".join(f"{place * 1e3:g}" for place in np.unique(campaign.gauge))
        yield Note(
            f"gauge_mm is {places} mm, which is half or a quarter of L with r = {r * 1e3:g} mm "
            "added: it is counted with r removed, as commands are; take r away unless the dials "
            "do stand there",
            "gauge",
        )


def _still_dial(campaign: Campaign, machine: MachineFile) -> Iterator[Note]:
    read = np.isfinite(campaign.reading)
    if not read.any():
        return
    spans = [
        np.ptp(campaign.reading[read & (campaign.setup == place)])
        for place in np.unique(campaign.setup[read])
    ]
    # Two steps of the dial are what rounding and a trembling finger make of a standing one.
    if max(spans) < max(STILL * machine.dial.resolution, NO_READING):
        yield Note(
            f"no setup's readings move by more than {max(spans) * 1e3:.3g} mm: is the dial "
            "touching the leg? Unless the machine is as good as that, such readings say nothing",
            "reading",
        )


def _partly_recorded(campaign: Campaign, machine: MachineFile) -> Iterator[Note]:
    said = {
        "time_s": (campaign.time, "these count as taken at the start"),
        "temperature_C": (campaign.temperature, "these count as no warmer than the first"),
        "sigma_mm": (campaign.sigma, "these take the dial's"),
    }
    for column, (values, consequence) in said.items():
        missing = int(np.isnan(values).sum())
        if 0 < missing < len(values):
            text = f"{column} is empty in {missing} of {len(values)} rows: {consequence}"
            yield Note(text, column, tuple(campaign.line[np.isnan(values)].tolist()))


_NOTICES = (_approaches, _still_legs, _gauges_with_r, _still_dial, _partly_recorded)
