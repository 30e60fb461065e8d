"""Implausible readings: refused before a fit by the kinematics of the machine, suspected after one
by the order of the commands' columns.

Rows of a table are checked on reading (`observations.checks`); these checks take many together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from orthoglide.errors import InputError, NumericsError, OrthoglideError
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.factors import machine_instrument_priors
from orthoglide.fit.least_squares import linearise, nuisances, orthonormal, project_out
from orthoglide.fit.problem import Problem
from orthoglide.fit.repeats import GRID_TOLERANCE, off_grid, on_grid
from orthoglide.fit.solving import solve
from orthoglide.geometry import fit_plane
from orthoglide.instruments import Frame, InstrumentPriors, SetupReadings
from orthoglide.machine import Machine
from orthoglide.machine_file import Dial
from orthoglide.numerals import compact
from orthoglide.observations import Readings, source
from orthoglide.units import INCH, MICROSTEP_RATIOS, PULLEY_RATIOS, UNIT_MISTAKES

_MIN_TOUCHES = 6  # of a plate: a plane goes through three, and as many more decide
_PLATE_FLATNESS, _TOUCH_NOISE = 1e-3, 3e-5
"""Metres: a bed in use for printing is at least as flat; touches are hardly more precise."""

_MIN_MISFIT_RATIO = 10.0  # misfit with travel as it is counted, over the least misfit
_MIN_MISFIT_SHARE = 3e-3  # of the touches' reach: 0.3 mm of 100 mm, ten times their noise
_MIN_REACH = 0.01  # metres between touches and their middle: smaller plates are not calibrated
_TRAVEL_FACTORS = tuple(
    tuple(sign * size for sign in signs)
    for size in (*MICROSTEP_RATIOS, *PULLEY_RATIOS, *UNIT_MISTAKES)
    for signs in product((1.0, -1.0), repeat=3)
)
"""Factors that may correct the travel of the legs: signs with microsteps, pulleys, and units."""

_MAX_TRIED = 60  # touches of a setup by which factors are tried: a plane needs no more

_MIN_READINGS = 8  # different readings, each of which is on the grid with probability 0.12


def check_plausible(tables: Sequence[Readings], machine: Machine, frame: Frame = "rigid") -> None:
    """Refuse readings in another unit or another frame than declared: tables of legs or of the
    tool, taken near a machine, in a tracker's frame that may differ from the machine's.

    Raises:
        InputError: naming the file, the setup, what the readings seem to be and what to do.
    """
    instrument_priors = machine_instrument_priors(machine, frame)
    for readings in tables:
        if readings.of_tool:
            _check_travel(readings, machine)
            _check_unit_and_frame(readings, machine, instrument_priors)
        else:
            _check_dial_unit(readings, machine.spec.dial)


def _check_dial_unit(campaign: Readings, dial: Dial) -> None:
    """Refuse readings that are multiples of the dial's step only in inches, or in millimetres.

    Multiplied by 25.4, multiples of the step hardly ever are multiples of it.
    """
    values, step = np.unique(campaign.reading), dial.resolution
    if step <= 0 or len(values) < _MIN_READINGS:
        return
    if np.mean(off_grid(values, step) < GRID_TOLERANCE) > 0.5:
        return
    units = (1 / INCH, "millimetres", "inches"), (INCH, "inches", "millimetres")
    for factor, intended, assumed in units:
        if on_grid(values * factor, step):
            raise InputError(
                f"{source(campaign)}: the readings are multiples of the dial's step of "
                f"{dial.resolution * 1e3:g} mm only once they are multiplied by {factor:.4g}: "
                f"they seem to be {intended} taken for {assumed}; give reading_mm in millimetres, "
                f"or correct resolution in the machine file"
            )


def _check_travel(readings: Readings, machine: Machine) -> None:
    """Refuse touches of a plate that lie in a plane only with travel counted the other way by some
    legs, or in another unit.

    Misfits are relative to the factor of travel, as travel that is too small makes all of them
    smaller.
    """
    for k, setup in enumerate(readings.setups):
        rows = np.flatnonzero((readings.setup == k) & ~readings.paired)
        if not setup.observation.touches:
            continue
        touches = readings.subset(rows[:: -(-len(rows) // _MAX_TRIED) or 1])
        if len(np.unique(touches.command, axis=0)) < _MIN_TOUCHES:
            continue
        off, reach = _plane_misfit(touches, (1.0, 1.0, 1.0), machine)
        if off < _MIN_MISFIT_SHARE * reach:
            continue
        trials = [(*_plane_misfit(touches, f, machine), f) for f in _TRAVEL_FACTORS]
        likely = [t for t in trials if t[0] < _PLATE_FLATNESS and t[1] > _MIN_REACH]
        misfit, _, factors = min(likely, key=lambda t: t[0] / abs(t[2][0]), default=trials[0])
        if off * abs(factors[0]) > _MIN_MISFIT_RATIO * max(misfit, _TOUCH_NOISE):
            heights = "those of no plane" if np.isfinite(off) else "out of the machine's reach"
            if np.isfinite(off) and reach < _MIN_REACH:
                heights = f"of places within {compact(reach * 1e3, 1)} mm"
            raise InputError(
                f"{source(readings)}, setup {setup.name!r}: the heights are {heights}; with travel "
                f"{_travel_remedy(factors, misfit, machine)}"
            )


def _travel_remedy(factors: tuple[float, ...], misfit: float, machine: Machine) -> str:
    """Return with which factors of travel the touches fit a plane, to a misfit in metres, and what
    to do.
    """
    size, ways, remedies = abs(factors[0]), list[str](), list[str]()
    if min(factors) < 0:
        legs = [machine.geometry.leg_names[k] for k, f in enumerate(factors) if f < 0]
        ways.append("counted the other way" + f" by {' and '.join(legs)}" * (len(legs) < 3))
        given = machine.spec.controller.sign
        signs = [round(s * f / size) for s, f in zip(given, factors, strict=True)]
        remedies.append(f"set sign = {signs} under [controller]")
    if size != 1:
        ways.append(f"multiplied by {size:.4g}")
        remedies.append(
            "look at microsteps, pulleys and the unit of travel, and correct the columns of travel"
        )
    return (
        f"{' and '.join(ways)} they fit a plane to {compact(misfit * 1e3, 1)} mm: "
        f"{'; '.join(remedies)}"
    )


def _plane_misfit(
    readings: Readings, factors: tuple[float, ...], machine: Machine
) -> tuple[float, float]:
    """Return the root mean square of touches about their plane and the largest distance of their
    places from the middle, metres, with the travel of each leg multiplied by a factor; infinite and
    0 if some are out of reach.
    """
    zero = machine.geometry.zero
    try:
        p = machine.forward(zero + (readings.command - zero) * factors)
    except OrthoglideError:  # far from the machine, or not closed there
        return np.inf, 0.0
    _, residual = fit_plane(p, p[:, 2] - readings.sign * readings.reading)
    reach = np.linalg.norm(p[:, :2] - p[:, :2].mean(axis=0), axis=1).max()
    return float(np.sqrt(np.sum(residual**2) / max(len(residual) - 3, 1))), float(reach)


def _check_unit_and_frame(
    readings: Readings, machine: Machine, instrument_priors: InstrumentPriors
) -> None:
    """Refuse setups whose readings fit only in another unit or another frame.

    A machine that runs is within millimetres of the nominal one. Readings that are further from it,
    but near in another unit or frame, would distort any fit.
    """
    p, second = machine.forward(readings.command), np.zeros_like(readings.command)
    second[readings.paired] = machine.forward(readings.second[readings.paired])
    for k, setup in enumerate(readings.setups):
        rows = readings.setup == k
        value = readings.sign[rows] * readings.reading[rows]
        taken = SetupReadings(p[rows], 0 * p[rows], readings.axis[rows], value, value)
        distance = np.linalg.norm(second[rows] - p[rows], axis=1)
        error = setup.observation.find_unit_or_frame_error(taken, distance, instrument_priors)
        if error:
            place = "" if readings.by_point else f", setup {setup.name!r}"
            raise InputError(f"{source(readings)}{place}: {error}")


# After a fit ---------------------------------------------------------------------------------

_MIN_SIGMA_SCALE = 20.0
"""Ratio of residuals to noise from which drives may be exchanged: part errors rarely reach it."""

_TIE_RATIO = 2.0  # two explanations whose residuals differ by less cannot be distinguished


class ExchangedDrives(NamedTuple):
    """Commands that may stand in each other's columns."""

    message: str  # naming the files, and the drives
    exchanged: Problem  # with the commands in the likeliest order
    tied: float  # ratio of residuals to noise up to which another explanation fits as well


def exchanged_drives(estimate: Estimate) -> ExchangedDrives | None:
    """Return the likeliest order of drives if the readings fit much better with it than as given;
    ``None`` if they do not.
    """
    problem, scale = estimate.problem, estimate.sigma_scale
    if scale < _MIN_SIGMA_SCALE or not problem.campaigns:
        return None
    names, campaigns = problem.machine.geometry.leg_names, range(len(problem.campaigns))
    subsets = [tuple(campaigns), *((k,) for k in campaigns if len(campaigns) > 1)]
    orders = [order for order in permutations(range(3)) if order != (0, 1, 2)]
    trials = [
        (sigma_scale_within(_with_drives_exchanged(problem, subset, order), scale), subset, order)
        for subset in subsets
        for order in orders
    ]
    best, subset, order = min(trials)
    tied = _TIE_RATIO * best
    if tied >= scale:
        return None
    files = ", ".join(source(problem.campaigns[k]) for k in subset)
    drives = [f"of drive {names[k]} under {names[order[k]]}" for k in range(3) if order[k] != k]
    exchange = f"with the commands {' and '.join(drives)}"
    if sum(other < tied for other, s, _ in trials if s == subset) > 1:
        exchange = "with the commands in another order of drives (these readings do not show which)"
    return ExchangedDrives(
        f"{files}: the readings fit {scale / best:.0f} times better {exchange}: "
        f"exchange the columns, or else the legs and directions of all dials",
        _with_drives_exchanged(problem, subset, order),
        tied,
    )


def _with_drives_exchanged(
    problem: Problem, subset: tuple[int, ...], order: tuple[int, ...]
) -> Problem:
    """Return the problem with the commands of some campaigns in another order of drives."""
    to, factors = list(order), list(problem.leg_factors)
    for k in subset:
        old = factors[k].readings
        moves = replace(old.moves, command=old.moves.command[:, to])
        new = replace(old, command=old.command[:, to], approach=old.approach[:, to], moves=moves)
        factors[k] = factors[k].with_table(new)
    return problem.with_leg_factors(factors)


def sigma_scale_within(problem: Problem, bound: float) -> float:
    """Return the ratio of residuals to noise; infinite if even a linear fit without priors leaves
    more than ``bound``.
    """
    try:
        linear = linearise(problem, problem.start)
        nuisance = nuisances(problem, linear.reading_poses)
        basis = orthonormal(nuisance.project(linear.jacobian))
        residual = project_out(basis, nuisance.project(problem.measured - linear.value))
        dof = len(problem.measured) - nuisance.unconstrained_count - basis.shape[1]
        if np.sqrt(residual @ residual / max(dof, 1)) > bound:
            return np.inf
        return solve(problem, method="nested").sigma_scale
    except NumericsError:
        return np.inf
