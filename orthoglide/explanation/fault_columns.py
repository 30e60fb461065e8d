"""Faults of the data as columns: a slip, a stand that was knocked, a dial set to zero anew, an
instrument that was moved, a wrong command.

Each adds to the readings as a cause of the machine does, and stands out in the same search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orthoglide.explanation.faults import (
    Fault,
    Rows,
    campaign_index,
    factors_and_rows,
    weighted_rows,
)
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import Linearised
from orthoglide.geometry import LEGS, Array
from orthoglide.observations import Readings
from orthoglide.observations.arrays import group_ids
from orthoglide.prediction import ReadingPoses

_SLIP_UNIT = 5e-4
"""Unit of the coefficient of a slip, metres or radians. With the scales of the slab it covers a
tenth of a millimetre to some millimetres, the range in which fingers and stands slip."""

_COMMAND_UNIT = 1e-3  # metres: mistyped commands are seldom off by less than a millimetre
_DIFFERENCE_STEP = 1e-5  # metres, of a difference quotient

_EXPECTED_FAULTS = 0.5
"""Faults that are expected in some campaign, shared by the kinds that its readings may have."""

_FEWEST_BESIDE_KNOCK = 2  # readings on either side of a knock: fewer are slips
_MOST_ZEROINGS = 12  # times that a dial is set to zero anew
_MOST_KNOCKS = (
    64  # moments at which a knock is tried; setups n times as long: at every n-th reading
)


FaultKey = tuple[str, tuple[int, ...], tuple[tuple[int, int], ...]]
"""A fault by its kind, drives, and table and line of every row."""


@dataclass(frozen=True, eq=False, repr=False)
class FaultColumns:
    """A fault that the data may have."""

    fault: Fault  # its kind, rows and setups
    columns: Array  # its rows by a unit of each of its coefficients (rows, q), metres or radians
    unit: float  # of a coefficient, metres or radians
    expected_count: float = 0.0  # faults like it, before the readings are seen

    @property
    def name(self) -> str:
        """Identifier; the leading ``!`` keeps it apart from names of parameters."""
        fault = self.fault
        drive = "".join(LEGS[k] for k, _ in fault.commands)
        rows = f"{fault.rows[0]}-{fault.rows[-1]}" if len(fault.rows) > 1 else str(fault.rows[0])
        return f"!{fault.kind}.{'+'.join(map(str, fault.setups))}.{rows}{drive}"

    def key(self, problem: Problem) -> FaultKey:
        """What it is, whichever other rows there are: kind, drives, and the lines of its rows."""
        lines = tuple((k, int(problem.factors[k].readings.line[row]))
                      for k, row in factors_and_rows(problem, self.fault.rows))  # fmt: skip
        return self.fault.kind, tuple(drive for drive, _ in self.fault.commands), lines

    @property
    def coefficient_count(self) -> int:
        """Number of coefficients."""
        return self.columns.shape[1]

    def with_sizes(self, mean: Array) -> Fault:
        """The fault with coefficients of some means ``(q,)``."""
        sizes, fault = mean * self.unit, self.fault
        if fault.commands:
            ((drive, _),) = fault.commands
            return replace(fault, size=float(sizes[0]), commands=((drive, float(sizes[0])),))
        if fault.kind == "zeroed":
            return replace(fault, sizes=tuple(sizes.tolist()))
        size = sizes[0] if len(sizes) == 1 else np.linalg.norm(sizes)
        return replace(fault, size=float(size))

    def full_columns(self, n: int) -> Array:
        """All readings by its coefficients ``(n, q)``."""
        found = np.zeros((n, self.columns.shape[1]))
        found[self.fault.rows] = self.columns
        return found


def fault_columns(
    problem: Problem, here: Linearised, corrected: Sequence[Fault] = ()
) -> list[FaultColumns]:
    """Every fault that the readings could have.

    Args:
        problem: the readings, with every parameter free.
        here: where they are linearised.
        corrected: wrong commands that are put right there.
    """
    by_command = command_derivatives(problem, here.x, here.value)
    kinds = (
        [*_slips(problem), *_slips_at_every_visit(problem)], list(_knocks(problem)), list(_zeroings(problem)),
        list(_moved_instruments(problem, here.reading_poses)), list(_wrong_commands(problem, by_command, corrected)),
    )  # fmt: skip
    # Readings of dials may mean something else, too, which is a kind besides.
    each = _EXPECTED_FAULTS / max(sum(map(bool, kinds)) + bool(problem.campaigns), 1)
    return [replace(s, expected_count=each / len(kind)) for kind in kinds for s in kind]


def _slips(problem: Problem) -> Iterator[FaultColumns]:
    """Every reading alone, of points of the tool all coordinates together."""
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        point = factor.visit_number
        order = np.argsort(point, kind="stable")
        cuts = np.flatnonzero(np.diff(point[order])) + 1
        for rows in np.split(order, cuts):
            if not factor.noise.weighted[rows].all():
                continue
            own = rows + part.start
            setup = int(problem.setup_of_row[own[0]])
            yield FaultColumns(
                Fault("outlier", own, (setup,)), np.eye(len(own)) * _SLIP_UNIT, _SLIP_UNIT
            )


def _slips_at_every_visit(problem: Problem) -> Iterator[FaultColumns]:
    """One dial at one station, off by the same amount at all visits: a burr, or a mistyped sheet."""
    for setup in problem.leg_setups:
        rows = weighted_rows(problem, setup)
        for visits in (rows[problem.station[rows] == k] for k in np.unique(problem.station[rows])):
            if 1 < len(visits) < len(rows):
                column = np.full((len(visits), 1), _SLIP_UNIT)
                yield FaultColumns(Fault("outlier", visits, (setup,)), column, _SLIP_UNIT)


def _knocks(problem: Problem) -> Iterator[FaultColumns]:
    """All readings of a dial from some moment on."""
    for setup in problem.leg_setups:
        rows = weighted_rows(problem, setup)
        places = range(_FEWEST_BESIDE_KNOCK, len(rows) - _FEWEST_BESIDE_KNOCK + 1)
        step = max(len(places) // _MOST_KNOCKS, 1)
        for cut in places[::step]:
            after = rows[cut:]
            shown = np.full((len(after), 1), _SLIP_UNIT)
            yield FaultColumns(Fault("knocked_stand", after, (setup,)), shown, _SLIP_UNIT)


def _zeroings(problem: Problem) -> Iterator[FaultColumns]:
    """A dial whose readings have another zero at each repeat, or all of a campaign."""
    first = 0
    for campaign in problem.campaigns:
        own = range(first, first + len(campaign.setups))
        first += len(campaign.setups)
        each = [anew for s in own if (anew := _zeroing_of_setup(problem, s)) is not None]
        yield from each
        if len(each) > 1:
            rows = np.concatenate([one.fault.rows for one in each])
            widths = np.cumsum([0, *(one.columns.shape[1] for one in each)])
            shown = np.zeros((len(rows), int(widths[-1])))
            at = 0
            for one, (a, b) in zip(each, pairwise(widths), strict=True):
                shown[at : at + len(one.columns), a:b] = one.columns
                at += len(one.columns)
            setups = tuple(s for one in each for s in one.fault.setups)
            yield FaultColumns(Fault("zeroed", rows, setups), shown, _SLIP_UNIT)


def _zeroing_of_setup(problem: Problem, setup: int) -> FaultColumns | None:
    """A dial whose readings have another zero at each repeat, where repeats follow each other."""
    rows = weighted_rows(problem, setup)
    repeat = problem.dial_column("repeat")[rows]
    starts = np.flatnonzero(np.diff(repeat)) + 1
    if not len(starts) or len(starts) != len(np.unique(repeat)) - 1:
        return None
    stations = len(np.unique(problem.station[rows]))
    if 2 * len(starts) > len(rows) - stations or len(starts) > _MOST_ZEROINGS:
        return None  # too short for a datum of their own, or more resets than anybody makes
    later = rows[starts[0] :]
    shown = (group_ids(repeat[starts[0] :])[:, None] == np.arange(len(starts))) * _SLIP_UNIT
    return FaultColumns(Fault("zeroed", later, (setup,)), shown, _SLIP_UNIT)


def _moved_instruments(problem: Problem, seen: tuple[ReadingPoses, ...]) -> Iterator[FaultColumns]:
    """An instrument at the tool that stands elsewhere from some moment on."""
    first = len(problem.leg_setups)
    for number, (k, factor, setup, _) in enumerate(problem.tool_setups, first):
        readings, start = factor.readings, problem.factor_rows[k].start
        rows = np.flatnonzero((factor.setup == setup) & factor.noise.weighted)
        rows = rows[np.argsort(readings.order[rows], kind="stable")]
        own = factor.nuisances(seen[k]).columns
        own = own[:, own[rows].any(axis=0)]
        width = max(own.shape[1], 1)
        if not own.shape[1]:
            continue
        own = own / np.abs(own).max(axis=0) * _SLIP_UNIT
        places = [
            cut for cut in range(width + 1, len(rows) - width)
            if readings.order[rows[cut]] != readings.order[rows[cut - 1]]
        ]  # fmt: skip
        for cut in places[:: max(len(places) // _MOST_KNOCKS, 1)]:
            after = rows[cut:]
            yield FaultColumns(Fault("moved", after + start, (number,)), own[after], _SLIP_UNIT)


def posture_of_reading(problem: Problem) -> Rows:
    """Posture of each reading ``(n,)``: one for each campaign, leg and command, as a leg is
    measured at a time; -1 where no dial is.
    """
    campaigns = problem.campaigns
    number = np.repeat(np.arange(len(campaigns)), [len(c) for c in campaigns])
    found = np.full(len(problem.measured), -1)
    if len(number):
        told = [number, problem.dial_column("leg"), problem.dial_column("command")]
        found[: len(number)] = group_ids(np.column_stack(told))
    return found


def command_derivatives(problem: Problem, x: Array, value: Array) -> Array:
    """Return the derivative of every reading of a dial by the commands of its posture ``(n, 3)``.

    Args:
        problem: with dials.
        x: its unknowns ``(P,)``, SI.
        value: the readings there ``(n,)``, metres.
    """
    found = np.zeros((len(value), len(LEGS)))
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.leg_rows, strict=True)):
        values = problem.values(k, x)
        for drive in range(len(LEGS)):
            moved = replace(
                campaign, command=campaign.command + _DIFFERENCE_STEP * np.eye(3)[drive]
            )
            read = problem.machine.model.readings(values, moved)
            found[rows, drive] = (read - value[rows]) / _DIFFERENCE_STEP
    return found


def _wrong_commands(
    problem: Problem, by_command: Array, corrected: Sequence[Fault]
) -> Iterator[FaultColumns]:
    """Every posture's command on every drive; with one reading in a posture, a wrong command is the
    same as a slip.
    """
    posture = posture_of_reading(problem)
    weighted = np.concatenate([f.noise.weighted for f in problem.factors])
    posture[~weighted] = -1
    for fault in corrected:
        shown = by_command[fault.rows][:, [fault.commands[0][0]]] * _COMMAND_UNIT
        yield FaultColumns(fault, shown, _COMMAND_UNIT)
        posture[fault.rows] = -1
    order = np.argsort(posture, kind="stable")
    order = order[posture[order] >= 0]
    cuts = np.flatnonzero(np.diff(posture[order])) + 1
    for rows in np.split(order, cuts):
        if len(rows) < 2:
            continue
        setups = tuple(np.unique(problem.setup_of_row[rows]).tolist())
        for drive in range(len(LEGS)):
            fault = Fault("command", rows, setups, commands=((drive, 0.0),))
            yield FaultColumns(fault, by_command[rows][:, [drive]] * _COMMAND_UNIT, _COMMAND_UNIT)


def with_command_corrected(campaign: Readings, rows: Rows, drive: int, size: float) -> Readings:
    """The campaign with another command in some rows, metres, and the approach that follows."""
    command = campaign.command.copy()
    command[rows, drive] += size
    moved = replace(campaign, command=command)
    derived = campaign.approach == campaign.derived_approach
    approach = np.where(derived, moved.derived_approach, campaign.approach)
    return replace(moved, approach=approach)


def with_commands_corrected(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """The problem with the likeliest commands in the rows of faults of that kind."""
    factors = list(problem.leg_factors)
    for fault in faults:
        drive, size = fault.commands[0]
        k = campaign_index(problem, fault.rows)
        within = fault.rows - problem.leg_rows[k].start
        moved = with_command_corrected(factors[k].readings, within, drive, size)
        factors[k] = factors[k].with_table(moved)
    return problem.with_leg_factors(factors)
