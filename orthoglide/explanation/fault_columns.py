"""Faults of the data as columns: a slip, a stand that was knocked, a dial set to zero anew, an
instrument that was moved, a wrong command.

Each adds columns to the linear model as a cause of the machine does, and one search selects both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from orthoglide.explanation.faults import (
    Fault,
    Rows,
    campaign_index,
    factors_and_rows,
    weighted_rows,
)
from orthoglide.explanation.linear_model import FREE_FORM_PRIOR
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
_MOST_KNOCKS = 64  # moments at which a knock is tried; a longer setup is thinned to as many


FaultKey = tuple[str, tuple[int, ...], tuple[tuple[int, int], ...]]
"""A fault as its kind, its drives, and the table and line of every row."""


@dataclass(frozen=True, eq=False, repr=False)
class FaultColumns:
    """A possible data fault with its columns of the linear model."""

    fault: Fault  # its kind, rows and setups
    columns: Array  # its rows by one unit of each coefficient (rows, q), metres or radians
    unit: float  # unit of a coefficient, metres or radians
    expected_count: float = 1.0  # prior mean number; before `fault_columns`, relative to its kind

    @property
    def name(self) -> str:
        """Identifier; the leading ``!`` keeps it apart from names of parameters."""
        fault = self.fault
        drive = "".join(LEGS[k] for k, _ in fault.commands)
        rows = f"{fault.rows[0]}-{fault.rows[-1]}" if len(fault.rows) > 1 else str(fault.rows[0])
        return f"!{fault.kind}.{'+'.join(map(str, fault.setups))}.{rows}{drive}"

    def key(self, problem: Problem) -> FaultKey:
        """Return an identifier that does not depend on other rows: kind, drives, and lines."""
        lines = tuple((k, int(problem.factors[k].readings.line[row]))
                      for k, row in factors_and_rows(problem, self.fault.rows))  # fmt: skip
        return self.fault.kind, tuple(drive for drive, _ in self.fault.commands), lines

    @property
    def coefficient_count(self) -> int:
        """Number of coefficients."""
        return self.columns.shape[1]

    def with_sizes(self, mean: Array) -> Fault:
        """Return the fault with sizes from the means of its coefficients ``(q,)``."""
        sizes, fault = mean * self.unit, self.fault
        if fault.commands:
            ((drive, _),) = fault.commands
            return replace(fault, size=float(sizes[0]), commands=((drive, float(sizes[0])),))
        if fault.kind == "zeroed":
            return replace(fault, sizes=tuple(sizes.tolist()))
        size = sizes[0] if len(sizes) == 1 else np.linalg.norm(sizes)
        return replace(fault, size=float(size))

    def full_columns(self, n: int) -> Array:
        """Return all readings by its coefficients ``(n, q)``."""
        columns = np.zeros((n, self.coefficient_count))
        columns[self.fault.rows] = self.columns
        return columns


def fault_columns(
    problem: Problem, linearised: Linearised, corrected: Sequence[Fault] = ()
) -> list[FaultColumns]:
    """Return every fault that the readings could have.

    Args:
        problem: the readings, with every parameter free.
        linearised: point of linearisation.
        corrected: wrong commands that are corrected at that point.
    """
    by_command = command_derivatives(problem, linearised.x, linearised.value)
    kinds = [
        [*_slips(problem), *_slips_at_every_visit(problem)],
        list(_knocks(problem)),
        list(_zeroings(problem)),
        list(_moved_instruments(problem, linearised.reading_poses)),
        _wrong_commands(problem, by_command, corrected),
    ]
    kinds = [kind for kind in kinds if kind]
    # Misread dials are one more kind, which `alternative_readings` lists.
    per_kind = _EXPECTED_FAULTS / max(len(kinds) + bool(problem.campaigns), 1)
    faults = list[FaultColumns]()
    for kind in kinds:
        scale = per_kind / sum(one.expected_count for one in kind)
        faults += [replace(one, expected_count=scale * one.expected_count) for one in kind]
    return faults


def _slips(problem: Problem) -> Iterator[FaultColumns]:
    """Yield a slip of every reading; of a point of the tool, of all its coordinates together."""
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        for rows in _grouped(factor.visit_number):
            if not factor.noise.weighted[rows].all():
                continue
            stacked = rows + part.start
            setup = int(problem.setup_of_row[stacked[0]])
            columns = np.eye(len(stacked)) * _SLIP_UNIT
            yield FaultColumns(Fault("outlier", stacked, (setup,)), columns, _SLIP_UNIT)


def _slips_at_every_visit(problem: Problem) -> Iterator[FaultColumns]:
    """Yield an equal error of one dial at all visits to a posture: dirt, a burr, a wrong entry.

    It is a local error of the measured face that no list names, with the prior of such an error.
    """
    posture = posture_of_reading(problem)
    for setup in problem.leg_setups:
        rows = weighted_rows(problem, setup)
        for visits in _grouped(posture[rows]):
            if 1 < len(visits) < len(rows):
                fault = Fault("outlier", rows[visits], (setup,))
                column = np.full((len(visits), 1), _SLIP_UNIT)
                yield FaultColumns(fault, column, _SLIP_UNIT, FREE_FORM_PRIOR)


def _knocks(problem: Problem) -> Iterator[FaultColumns]:
    """Yield a shift of all readings of a dial from some moment on."""
    for setup in problem.leg_setups:
        rows = weighted_rows(problem, setup)
        cuts = range(_FEWEST_BESIDE_KNOCK, len(rows) - _FEWEST_BESIDE_KNOCK + 1)
        for cut in cuts[:: max(len(cuts) // _MOST_KNOCKS, 1)]:
            after = rows[cut:]
            columns = np.full((len(after), 1), _SLIP_UNIT)
            yield FaultColumns(Fault("knocked_stand", after, (setup,)), columns, _SLIP_UNIT)


def _zeroings(problem: Problem) -> Iterator[FaultColumns]:
    """Yield a separate datum at each repeat, for each dial and for all dials of a campaign."""
    first = 0
    for campaign in problem.campaigns:
        last = first + len(campaign.setups)
        each = (_zeroing_of_setup(problem, setup) for setup in range(first, last))
        of_dials = [zeroing for zeroing in each if zeroing is not None]
        first = last
        yield from of_dials
        if len(of_dials) > 1:
            rows = np.concatenate([one.fault.rows for one in of_dials])
            columns = np.asarray(block_diag(*(one.columns for one in of_dials)))
            setups = tuple(s for one in of_dials for s in one.fault.setups)
            yield FaultColumns(Fault("zeroed", rows, setups), columns, _SLIP_UNIT)


def _zeroing_of_setup(problem: Problem, setup: int) -> FaultColumns | None:
    """Return a separate datum of a dial at each repeat; ``None`` unless repeats are in sequence."""
    rows = weighted_rows(problem, setup)
    repeat = problem.dial_column("repeat")[rows]
    starts = np.flatnonzero(np.diff(repeat)) + 1
    if not len(starts) or len(starts) != len(np.unique(repeat)) - 1:
        return None
    stations = len(np.unique(problem.station[rows]))
    if 2 * len(starts) > len(rows) - stations or len(starts) > _MOST_ZEROINGS:
        return None  # too few readings for separate datums, or more resets than anybody makes
    later = rows[starts[0] :]
    columns = (group_ids(repeat[starts[0] :])[:, None] == np.arange(len(starts))) * _SLIP_UNIT
    return FaultColumns(Fault("zeroed", later, (setup,)), columns, _SLIP_UNIT)


def _moved_instruments(
    problem: Problem, reading_poses: tuple[ReadingPoses, ...]
) -> Iterator[FaultColumns]:
    """Yield a shift of an instrument at the tool from some moment on."""
    first = len(problem.leg_setups)
    for number, (k, factor, setup, _) in enumerate(problem.iter_tool_setups(), first):
        readings, start = factor.readings, problem.factor_rows[k].start
        rows = np.flatnonzero((factor.setup == setup) & factor.noise.weighted)
        rows = rows[np.argsort(readings.order[rows], kind="stable")]
        nuisances = factor.nuisances(reading_poses[k]).columns
        nuisances = nuisances[:, nuisances[rows].any(axis=0)]
        if not (width := nuisances.shape[1]):
            continue
        nuisances = nuisances / np.abs(nuisances).max(axis=0) * _SLIP_UNIT
        cuts = [
            cut for cut in range(width + 1, len(rows) - width)
            if readings.order[rows[cut]] != readings.order[rows[cut - 1]]
        ]  # fmt: skip
        for cut in cuts[:: max(len(cuts) // _MOST_KNOCKS, 1)]:
            after = rows[cut:]
            fault = Fault("moved", after + start, (number,))
            yield FaultColumns(fault, nuisances[after], _SLIP_UNIT)


def posture_of_reading(problem: Problem) -> Rows:
    """Return the number of each reading's posture ``(n,)``, -1 for readings without a dial.

    Postures differ by campaign, leg and command, because one leg is measured at a time.
    """
    posture = np.full(len(problem.measured), -1)
    if campaigns := problem.campaigns:
        campaign = np.repeat(np.arange(len(campaigns)), [len(c) for c in campaigns])
        keys = [campaign, problem.dial_column("leg"), problem.dial_column("command")]
        posture[: len(campaign)] = group_ids(np.column_stack(keys))
    return posture


def visit_of_reading(problem: Problem) -> Rows:
    """Return the number of each reading's visit ``(n,)``: readings of several dials at one command
    in one repeat, reached from one side; -1 for readings without a dial.
    """
    visit = posture_of_reading(problem)
    if count := sum(map(len, problem.campaigns)):
        names = ("repeat", "approach")
        keys = [visit[:count], *(problem.dial_column(name) for name in names)]
        visit[:count] = group_ids(np.column_stack(keys))
    return visit


def command_derivatives(problem: Problem, x: Array, predicted: Array) -> Array:
    """Return the derivative of every reading of a dial by the commands of its posture ``(n, 3)``.

    Args:
        problem: the readings.
        x: values of its unknowns ``(P,)``, SI.
        predicted: the readings predicted from ``x`` ``(n,)``, metres.
    """
    derivatives = np.zeros((len(predicted), len(LEGS)))
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.leg_rows, strict=True)):
        values = problem.values(k, x)
        for drive in range(len(LEGS)):
            command = campaign.command + _DIFFERENCE_STEP * np.eye(3)[drive]
            readings = problem.machine.model.readings(values, replace(campaign, command=command))
            derivatives[rows, drive] = (readings - predicted[rows]) / _DIFFERENCE_STEP
    return derivatives


def _wrong_commands(
    problem: Problem, by_command: Array, corrected: Sequence[Fault]
) -> list[FaultColumns]:
    """Return the wrong commands of each drive at every visit to a posture, as in a program, and at
    one of several visits, as typed by hand. A wrong command at a single reading would be a slip.

    Both kinds have the same expected number.
    """
    # Corrections separate a visit from the other visits to its posture, so they are undone.
    undone = [replace(f, commands=tuple((drive, -size) for drive, size in f.commands))
              for f in corrected]  # fmt: skip
    written = with_commands_corrected(problem, undone)
    posture, visit = posture_of_reading(written), visit_of_reading(written)
    unweighted = ~np.concatenate([f.noise.weighted for f in problem.factors])
    posture[unweighted] = visit[unweighted] = -1
    posture_size = _group_sizes(posture)
    visit[posture_size == _group_sizes(visit)] = -1  # the only visit to its posture
    every_visit, one_visit = list[FaultColumns](), list[FaultColumns]()
    for fault in corrected:
        columns = by_command[fault.rows][:, [fault.commands[0][0]]] * _COMMAND_UNIT
        is_part = len(fault.rows) < posture_size[fault.rows[0]]
        (one_visit if is_part else every_visit).append(FaultColumns(fault, columns, _COMMAND_UNIT))
        posture[fault.rows] = visit[fault.rows] = -1
    for commands, group in ((every_visit, posture), (one_visit, visit)):
        for rows in _grouped(group):
            if group[rows[0]] < 0 or len(rows) < 2:
                continue
            setups = tuple(np.unique(problem.setup_of_row[rows]).tolist())
            for drive in range(len(LEGS)):
                fault = Fault("command", rows, setups, commands=((drive, 0.0),))
                columns = by_command[rows][:, [drive]] * _COMMAND_UNIT
                commands.append(FaultColumns(fault, columns, _COMMAND_UNIT))
    return [
        replace(one, expected_count=1 / len(commands))
        for commands in (every_visit, one_visit)
        for one in commands
    ]


def _group_sizes(numbers: Rows) -> Rows:
    """Return the number of rows in the group of each row ``(n,)``."""
    _, group, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    return np.asarray(counts[group])


def _grouped(numbers: Rows) -> list[Rows]:
    """Return the rows of each number, in order."""
    order = np.argsort(numbers, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1)


def with_command_corrected(campaign: Readings, rows: Rows, drive: int, size: float) -> Readings:
    """Return the campaign with the commands of some rows changed, metres, and the approach
    derived again.
    """
    command = campaign.command.copy()
    command[rows, drive] += size
    corrected = replace(campaign, command=command)
    derived = campaign.approach == campaign.derived_approach
    approach = np.where(derived, corrected.derived_approach, campaign.approach)
    return replace(corrected, approach=approach)


def with_commands_corrected(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """Return the problem with the likeliest commands in the rows of wrong commands."""
    factors = list(problem.leg_factors)
    for fault in faults:
        drive, size = fault.commands[0]
        k = campaign_index(problem, fault.rows)
        within = fault.rows - problem.leg_rows[k].start
        table = with_command_corrected(factors[k].readings, within, drive, size)
        factors[k] = factors[k].with_table(table)
    return problem.with_leg_factors(factors)
