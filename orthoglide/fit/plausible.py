"""Readings that cannot be meant as they stand are refused: before any fit by what the machine can
do, and after one by the columns of its commands.

What a table and the machine file alone show was checked when the readings were read or given
(`observations.checks`); here the machine itself says what is possible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from orthoglide.errors import InputError, NumericsError
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.factors import machine_instrument_priors
from orthoglide.fit.problem import Problem
from orthoglide.fit.repeats import GRID_TOLERANCE, off_grid, on_grid
from orthoglide.fit.solving import solve
from orthoglide.geometry import Array
from orthoglide.instruments import Frame, InstrumentPriors, SetupReadings
from orthoglide.machine import Machine
from orthoglide.machine_file import Dial
from orthoglide.numerals import compact
from orthoglide.observations import Readings, source
from orthoglide.units import INCH

_MIN_TOUCHES = 5  # of a plate: a plane goes through three
_PLATE_FLATNESS, _TOUCH_NOISE = 1e-3, 1e-4
"""Metres: a bed that somebody prints on is as flat, and touches are hardly better."""

_MIN_MISFIT_RATIO = 10.0  # times by which touches are off as they are counted
_MIN_READINGS = 8  # different readings: by chance one in eight is on the grid


def check_plausible(given: Sequence[Readings], machine: Machine, frame: Frame = "rigid") -> None:
    """Refuse readings in another unit or another frame than they are said to be.

    Args:
        given: tables, each of legs or of the tool.
        machine: near which they were taken.
        frame: how a tracker's may differ from the machine's.

    Raises:
        InputError: naming the file, the setup, what the readings seem to be and what to do.
    """
    beliefs = machine_instrument_priors(machine, frame)
    for readings in given:
        if readings.of_tool:
            _check_travel_sign(readings, machine)
            _check_unit_and_frame(readings, machine, beliefs)
        else:
            _check_dial_unit(readings, machine.spec.dial)


def _check_dial_unit(campaign: Readings, dial: Dial) -> None:
    """Refuse readings of which only the inches, or only the millimetres, are what a dial shows.

    A dial shows multiples of its step. Multiplied by 25.4 they hardly ever are any more.
    """
    shown, step = np.unique(campaign.reading), dial.resolution
    if (
        step <= 0
        or len(shown) < _MIN_READINGS
        or np.mean(off_grid(shown, step) < GRID_TOLERANCE) > 0.5
    ):
        return
    for factor, meant, taken in ((1 / INCH, "millimetres", "inches"),
                                 (INCH, "inches", "millimetres")):  # fmt: skip
        if on_grid(shown * factor, step):
            raise InputError(
                f"{source(campaign)}: the readings are multiples of the dial's step of "
                f"{dial.resolution * 1e3:g} mm only once they are multiplied by {factor:.4g}: "
                f"they seem to be {meant} taken for {taken}; give reading_mm in millimetres, "
                f"or correct resolution in the machine file"
            )


def _check_travel_sign(readings: Readings, machine: Machine) -> None:
    """Refuse touches of a plate that lie in a plane only with travel counted the other way."""
    for k, setup in enumerate(readings.setups):
        rows = (readings.setup == k) & ~readings.paired
        if not setup.observation.touches or rows.sum() < _MIN_TOUCHES:
            continue
        own, zero = readings.subset(rows), machine.geometry.zero
        now, other = (_plane_residual(own, command, machine)
                      for command in (own.command, 2 * zero - own.command))  # fmt: skip
        if other < _PLATE_FLATNESS and now > _MIN_MISFIT_RATIO * max(other, _TOUCH_NOISE):
            found = "those of no plane" if np.isfinite(now) else "out of the machine's reach"
            raise InputError(
                f"{source(readings)}, setup {setup.name!r}: the heights are {found}; with travel "
                f"counted the other way they fit a plane to {compact(other * 1e3, 1)} mm: set "
                f"sign = {[-s for s in machine.spec.controller.sign]} under [controller]"
            )


def _plane_residual(readings: Readings, command: Array, machine: Machine) -> float:
    """Root mean square of touches about the plane through them, metres; infinite where the machine
    does not reach some.
    """
    try:
        p = machine.forward(command)
    except NumericsError:
        return float("inf")
    height = p[:, 2] - readings.sign * readings.reading
    plane = np.column_stack([np.ones(len(p)), p[:, :2]])
    rest = height - plane @ np.linalg.lstsq(plane, height)[0]
    return float(np.sqrt(np.sum(rest**2) / max(len(rest) - 3, 1)))


def _check_unit_and_frame(readings: Readings, machine: Machine, beliefs: InstrumentPriors) -> None:
    """Refuse setups whose readings fit only in another unit or another frame.

    A machine that its owner can run stands within millimetres of the nominal one. Readings that are
    further from it, and near once a unit or a frame is exchanged, are refused before any fit: a fit
    would bend the machine for them.
    """
    p, second = machine.forward(readings.command), np.zeros_like(readings.command)
    second[readings.paired] = machine.forward(readings.second[readings.paired])
    for k, setup in enumerate(readings.setups):
        rows = readings.setup == k
        value = readings.sign[rows] * readings.reading[rows]
        taken = SetupReadings(p[rows], np.zeros_like(p[rows]), readings.axis[rows], value, value)
        apart = np.linalg.norm(second[rows] - p[rows], axis=1)
        if said := setup.observation.find_unit_or_frame_error(taken, apart, beliefs):
            where = "" if readings.by_point else f", setup {setup.name!r}"
            raise InputError(f"{source(readings)}{where}: {said}")


# After a fit ---------------------------------------------------------------------------------

_MIN_SIGMA_SCALE = 20.0
"""Times the noise by which an exchange is off, and more: a machine's own errors are rarely."""

_MIN_IMPROVEMENT = 10.0  # times nearer by which the readings must fit with the commands put right
_TIE_RATIO = 2.0  # times as far off as the best: one dial alone need not tell which exchange it was


def check_drive_order(estimate: Estimate) -> None:
    """Refuse campaigns whose readings fit only with the commands of drives exchanged.

    Raises:
        InputError: naming the files, and the drives.
    """
    problem, now = estimate.problem, estimate.sigma_scale
    if now < _MIN_SIGMA_SCALE or not problem.campaigns:
        return
    names, several = problem.machine.geometry.leg_names, range(len(problem.campaigns))
    which = [tuple(several), *((k,) for k in several if len(several) > 1)]
    orders = [order for order in permutations(range(3)) if order != (0, 1, 2)]
    tried = [
        (_scale_with_exchanged_drives(problem, some, order), some, order)
        for some in which
        for order in orders
    ]
    best, some, order = min(tried)
    if best * _MIN_IMPROVEMENT < now:
        files = ", ".join(source(problem.campaigns[k]) for k in some)
        moved = [f"of drive {names[k]} under {names[order[k]]}" for k in range(3) if order[k] != k]
        told = f"with the commands {' and '.join(moved)}"
        if sum(some == s and off < _TIE_RATIO * best for off, s, _ in tried) > 1:
            told = "with the commands in another order of drives, which they cannot tell"
        raise InputError(
            f"{files}: the readings fit {now / best:.0f} times better {told}: "
            f"exchange the columns, or else the legs and directions of all dials"
        )


def _scale_with_exchanged_drives(
    problem: Problem, some: tuple[int, ...], order: tuple[int, ...]
) -> float:
    """Times the noise by which readings are off with some campaigns' drives exchanged."""
    factors, at = list(problem.leg_factors), list(order)
    for k in some:
        c = factors[k].readings
        moves = replace(c.moves, command=c.moves.command[:, at])
        c = replace(c, command=c.command[:, at], approach=c.approach[:, at], moves=moves)
        factors[k] = factors[k].with_table(c)
    try:
        return solve(problem.with_leg_factors(factors), method="nested").sigma_scale
    except NumericsError:
        return np.inf
