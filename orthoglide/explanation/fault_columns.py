"""Faults of the data as columns: a slip, a stand that was knocked, a dial set to zero anew, an
instrument that was moved or drifts, a wrong command.

Each adds columns to the linear model as a cause of the machine does, and one search selects both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from orthoglide.explanation.corrections import COMMAND_UNIT, with_faults_corrected
from orthoglide.explanation.faults import (
    Fault,
    Kind,
    Rows,
    factors_and_rows,
    lines_of,
    split_by_datum,
    weighted_rows,
)
from orthoglide.explanation.linear_model import FREE_FORM_PRIOR
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import Linearised
from orthoglide.geometry import LEGS, Array
from orthoglide.observations.arrays import group_ids
from orthoglide.prediction import MeasurementModel, ReadingPoses

_SLIP_UNIT = 5e-4
"""Unit of the coefficients of all kinds but commands and drifts, metres or radians. With the scales
of the slab it covers a tenth of a millimetre to some millimetres, as fingers and stands slip."""

_DRIFT_UNIT = 5e-5
"""Unit of the change of a drifting instrument over its readings, metres or radians: 0.3 m of steel
grow by 0.03 mm as they warm by ten kelvin, and stands creep by a tenth of a millimetre."""

_UNITS = {"command": COMMAND_UNIT, "drifted": _DRIFT_UNIT}
_DIFFERENCE_STEP = 1e-5
"""Metres, of a difference quotient. With bars of 0.3 m its error is 2e-5 of the derivative, half
the step over their length; its rounding is a millionth of that."""

_EXPECTED_FAULTS = 0.5
"""Prior mean number of data faults in all readings, in equal shares of the kinds that are possible
for these readings."""

_PILLAR_WIDTH = 0.01
"""Metres within which ends of distances are sides of one pillar: those of the firmware's part are
9 mm wide."""

_MOST_ZEROINGS = 12
"""Times that a dial is set to zero anew: once a repeat, of which sheets ask for three and careful
people take ten."""

_SHIFTS = 64
"""Least number of moments of a shift that are tried, if so many are possible. The nearest one is
a 128th of the readings away at most: it explains 97 % of what the right one explains, ``(1/2 - d) /
(1/2 + d)`` for a shift in the middle."""

_POSTURE = ("leg", "command")
"""What readings of one posture have in common; one leg is measured at a time."""

_VISIT = (*_POSTURE, "repeat", "approach")
"""What readings of several dials at one visit to a posture have in common."""

FaultKey = tuple[str, int | None, tuple[tuple[int, int], ...]]
"""A fault as its kind, its drive, and the table and line of every row."""


@dataclass(frozen=True, eq=False, repr=False)
class FaultColumns:
    """A possible data fault with its columns of the linear model."""

    fault: Fault  # its kind and rows
    columns: Array  # change of its rows by one unit of each coefficient (rows, q), metres, radians
    unit: float  # unit of a coefficient, metres or radians
    expected_count: float  # prior mean number

    @property
    def name(self) -> str:
        """Identifier; the leading ``!`` keeps it apart from names of parameters."""
        kind, rows, drive = self.fault.kind, self.fault.rows, self.fault.drive
        span = f"{rows[0]}-{rows[-1]}:{len(rows)}" if len(rows) > 1 else str(rows[0])
        return f"!{kind}.{span}{'' if drive is None else LEGS[drive]}"

    def key(self, problem: Problem) -> FaultKey:
        """Return an identifier that does not depend on other rows: kind, drive, and lines."""
        return self.fault.kind, self.fault.drive, lines_of(problem, self.fault)

    @property
    def coefficient_count(self) -> int:
        """Number of coefficients."""
        return self.columns.shape[1]

    def with_sizes(self, mean: Array) -> Fault:
        """Return the fault with sizes from the means of its coefficients ``(q,)``."""
        sizes = mean * self.unit
        if self.fault.kind == "zeroed":
            return replace(self.fault, sizes=tuple(sizes.tolist()))
        if self.fault.kind == "drifted":
            excess = tuple((self.columns @ mean).tolist())
            return replace(self.fault, size=float(np.linalg.norm(sizes)), sizes=excess)
        return replace(
            self.fault, size=float(sizes[0] if len(sizes) == 1 else np.linalg.norm(sizes))
        )

    def change(self, fault: Fault) -> Array:
        """Return the change of its rows by the fault with one size ``(rows,)``, metres, radians."""
        return np.asarray(self.columns[:, 0] * fault.size / self.unit)

    def full_columns(self, n: int) -> Array:
        """Return the derivative of all readings by its coefficients ``(n, q)``."""
        columns = np.zeros((n, self.coefficient_count))
        columns[self.fault.rows] = self.columns
        return columns


@dataclass(frozen=True, eq=False, repr=False)
class FaultFamily:
    """Possible data faults of one kind, with equally many rows and coefficients each: there may be
    one for every reading.
    """

    kind: Kind
    rows: Rows  # of each fault (N, k)
    columns: Array  # change of these rows by one unit of each coefficient (N, k, q)
    expected_count: float = 1.0  # prior mean number of each, or its frequency relative to others
    drives: Rows | None = None  # of each fault, if its commands are wrong (N,)
    corrected: bool = False  # whether the readings are linearised at corrected commands
    unit: float = 1.0  # of a coefficient, metres or radians

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, k: int) -> FaultColumns:
        drive = None if self.drives is None else int(self.drives[k])
        fault = Fault(self.kind, self.rows[k], drive=drive)
        return FaultColumns(fault, self.columns[k], self.unit, self.expected_count)

    def __iter__(self) -> Iterator[FaultColumns]:
        return (self[k] for k in range(len(self)))


def fault_families(
    problem: Problem, linearised: Linearised, corrected: Sequence[Fault] = ()
) -> list[FaultFamily]:
    """Return every fault that the readings could have.

    Args:
        problem: the readings, with every parameter free.
        linearised: point of linearisation.
        corrected: wrong commands that are corrected at that point.
    """
    by_command = command_derivatives(problem, linearised.x, linearised.value, corrected)
    families = [
        *_slips(problem),
        *_slips_at_every_visit(problem),
        *_displaced_ends(problem),
        *_shifts_and_drifts(problem, linearised.reading_poses),
        *_zeroings(problem),
        *_wrong_commands(problem, by_command, corrected),
    ]
    totals = dict.fromkeys((family.kind for family in families), 0.0)
    for family in families:
        totals[family.kind] += family.expected_count * len(family)
    # Dials may be misread besides (`alternative_readings`), which leaves less for these kinds.
    per_kind = _EXPECTED_FAULTS / max(len(totals) + bool(problem.campaigns), 1)
    for k, family in enumerate(families):
        unit = _UNITS.get(family.kind, _SLIP_UNIT)
        expected_count = per_kind * family.expected_count / totals[family.kind]
        families[k] = replace(
            family, columns=family.columns * unit, unit=unit, expected_count=expected_count
        )
    return families


def _slips(problem: Problem) -> Iterator[FaultFamily]:
    """Yield a slip at every reading; a point of the tool slips in all its coordinates at once."""
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        for rows in _grouped(factor.visit_number):
            weighted = part.start + rows[factor.noise.weighted[rows].all(axis=1)]
            if len(weighted):
                columns = np.tile(np.eye(rows.shape[1]), (len(weighted), 1, 1))
                yield FaultFamily("outlier", weighted, columns)


def _slips_at_every_visit(problem: Problem) -> Iterator[FaultFamily]:
    """Yield an equal error of one dial at all visits to a posture: dirt, a burr, a wrong entry.

    Its prior is `FREE_FORM_PRIOR` times that of a slip.
    """
    posture = _group_numbers(problem, *_POSTURE)
    for setup in problem.leg_setups:
        rows = weighted_rows(problem, setup)
        for visits in _grouped(posture[rows]):
            if 1 < visits.shape[1] < len(rows):
                columns = np.ones((*visits.shape, 1))
                yield FaultFamily("outlier", rows[visits], columns, FREE_FORM_PRIOR)


def _displaced_ends(problem: Problem) -> Iterator[FaultFamily]:
    """Yield a pillar or hole that is displaced along the plate, as one that leans is.

    At least three distances end there, and fewer than half of all. Its prior is that of a slip:
    thin printed pillars lean and have blobs as often as a distance is written down wrong.
    """
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        readings, rows = factor.readings, factor.readings.paired & factor.noise.weighted
        if not rows.any():
            continue
        ends = (readings.command[rows], readings.second[rows])
        p, q = (problem.machine.forward(end)[:, :2] for end in ends)
        along = (p - q) / np.linalg.norm(p - q, axis=1)[:, None]
        along, row = np.concatenate([along, -along]), np.tile(part.start + np.flatnonzero(rows), 2)
        place = np.concatenate([p, q])
        near = np.linalg.norm(place[:, None] - place, axis=2) < _PILLAR_WIDTH
        for each in _grouped(connected_components(near)[1]):
            if 2 < each.shape[1] < rows.sum() / 2:
                yield FaultFamily("outlier", row[each], along[each])


def _shifts_and_drifts(
    problem: Problem, reading_poses: tuple[ReadingPoses, ...]
) -> Iterator[FaultFamily]:
    """Yield a shift of all readings of a dial, or of an instrument at the tool, from some moment
    on, and a drift of each instrument at the tool: its nuisances change evenly over its readings.

    Dials have an effect of the catalogue for a drift. A calliper stands nowhere, and does neither.
    """
    order = problem.column("order")
    for number, setup in enumerate(problem.setups):
        if not len(rows := weighted_rows(problem, number)) or setup.observation.paired:
            continue
        k, _ = factors_and_rows(problem, rows[:1])[0]
        factor, in_factor = problem.factors[k], rows - problem.factor_rows[k].start
        kind: Kind = "knocked_stand"
        columns = np.ones((len(rows), 1))
        if not factor.on_legs:
            kind, nuisances = "moved", factor.nuisances(reading_poses[k]).columns
            nuisances = nuisances[:, nuisances[in_factor].any(axis=0)]
            columns = nuisances[in_factor] / np.abs(nuisances).max(axis=0)
        width = columns.shape[1]
        # Fewer readings on either side are slips, or do not determine the datum.
        cuts = [
            cut for cut in range(width + 1, len(rows) - width if width else 0)
            if order[rows[cut]] != order[rows[cut - 1]]
        ]  # fmt: skip
        for cut in cuts[:: max(len(cuts) // _SHIFTS, 1)]:
            yield FaultFamily(kind, rows[None, cut:], columns[None, cut:])
        # A drift has the nuisances twice, themselves and their rates, if there are any.
        determined = len(rows) > 2 * width + 1 > 1
        if determined and not factor.on_legs and setup.name not in factor.drifting:
            drift = columns[:, : setup.observation.drifting_count]
            drift = drift * factor.progress[in_factor, None]
            yield FaultFamily("drifted", rows[None], drift[None])


def _zeroings(problem: Problem) -> Iterator[FaultFamily]:
    """Yield a separate datum at each repeat, for each dial and for all with repeats together."""
    setup = problem.setup_of_row
    repeat = problem.column("repeat")
    for part in problem.leg_rows:
        weighted = [weighted_rows(problem, s) for s in np.unique(setup[part])]
        dials = [later for rows in weighted if len(later := _later_repeats(problem, rows))]
        for rows in [*dials, np.concatenate(dials)] if len(dials) > 1 else dials:
            datums = split_by_datum("zeroed", rows, setup, repeat)
            columns = np.stack([np.isin(rows, datum) for datum in datums], axis=1)
            yield FaultFamily("zeroed", rows[None], columns[None].astype(float))


def _later_repeats(problem: Problem, rows: Rows) -> Rows:
    """Return the rows of a dial after its first repeat if it may have been set to zero anew at
    each; empty if not.
    """
    repeat = problem.dial_column("repeat")[rows]
    starts = np.flatnonzero(np.diff(repeat)) + 1
    in_sequence = len(starts) == len(np.unique(repeat)) - 1
    spare_readings = len(rows) - len(np.unique(problem.station[rows]))
    # Too few readings for separate datums, or more resets than anybody makes.
    if not in_sequence or 2 * len(starts) > spare_readings or len(starts) > _MOST_ZEROINGS:
        return rows[:0]
    return rows[starts[0] :] if len(starts) else rows[:0]


def _group_numbers(problem: Problem, *columns: str) -> Rows:
    """Return the number of each reading's group ``(n,)``: readings of one campaign with equal
    entries in the columns. Those without a dial, which come last, are in no group: -1.
    """
    numbers = np.full(len(problem.measured), -1)
    if campaigns := problem.campaigns:
        campaign = np.repeat(np.arange(len(campaigns)), [len(c) for c in campaigns])
        keys = [campaign, *(problem.dial_column(name) for name in columns)]
        numbers[: len(campaign)] = group_ids(np.column_stack(keys))
    return numbers


def command_derivatives(
    problem: Problem, x: Array, predicted: Array, corrected: Sequence[Fault] = ()
) -> Array:
    """Return the derivative of every reading of a dial by the commands of its posture ``(n, 3)``.

    That of a corrected command is the secant from the command as written: at zero travel, for
    example, a drive's command moves the dials on its own leg to second order only.

    Args:
        problem: the readings.
        x: values of its unknowns ``(P,)``, SI.
        predicted: the readings predicted from ``x`` ``(n,)``, metres.
        corrected: wrong commands that are corrected in the readings.
    """
    derivatives, model = np.zeros((len(predicted), len(LEGS))), problem.machine.model
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.leg_rows, strict=True)):
        values = problem.values(k, x)
        for drive in range(len(LEGS)):
            command = campaign.command + _DIFFERENCE_STEP * np.eye(3)[drive]
            moved = MeasurementModel(replace(campaign, command=command))
            readings = moved.predict(model, values)
            derivatives[rows, drive] = (readings - predicted[rows]) / _DIFFERENCE_STEP
    for fault in corrected:
        if abs(fault.size) > _DIFFERENCE_STEP:
            written = with_faults_corrected(problem, [replace(fault, size=-fault.size)]).campaigns
            as_written = [
                MeasurementModel(campaign).predict(model, problem.values(k, x))
                for k, campaign in enumerate(written)
            ]
            change = predicted[fault.rows] - np.concatenate(as_written)[fault.rows]
            derivatives[fault.rows, fault.drive] = change / fault.size
    return derivatives


def _wrong_commands(
    problem: Problem, by_command: Array, corrected: Sequence[Fault]
) -> Iterator[FaultFamily]:
    """Yield the wrong commands of each drive at every visit to a posture, as in a program, and at
    one of several visits, as typed by hand. A wrong command at a single reading would be a slip.

    Both have equal shares of the prior.
    """
    # Corrections separate a visit from the other visits to its posture, so they are undone.
    written = with_faults_corrected(problem, [replace(f, size=-f.size) for f in corrected])
    posture, visit = _group_numbers(written, *_POSTURE), _group_numbers(written, *_VISIT)
    posture[~problem.weighted] = visit[~problem.weighted] = -1
    posture_size = _group_sizes(posture)
    visit[posture_size == _group_sizes(visit)] = -1  # the only visit to its posture
    is_part = [len(f.rows) < posture_size[f.rows[0]] for f in corrected]
    for fault in corrected:
        posture[fault.rows] = visit[fault.rows] = -1
    for one_visit, group in ((False, posture), (True, visit)):
        families = [
            _commands(by_command, fault.rows[None], np.array([fault.drive]), corrected=True)
            for fault, part in zip(corrected, is_part, strict=True) if part == one_visit
        ]  # fmt: skip
        for each in _grouped(group):
            visits = each[group[each[:, 0]] >= 0]
            if len(visits) and visits.shape[1] > 1:
                rows = np.repeat(visits, len(LEGS), axis=0)
                families.append(_commands(by_command, rows, np.tile(range(len(LEGS)), len(visits))))
        count = sum(map(len, families))
        yield from (replace(family, expected_count=1 / count) for family in families)


def _commands(
    by_command: Array, rows: Rows, drives: Rows, *, corrected: bool = False
) -> FaultFamily:
    """Return wrong commands of rows ``(N, k)``, each of one drive ``(N,)``."""
    columns = by_command[rows, drives[:, None]][..., None]
    return FaultFamily("command", rows, columns, drives=drives, corrected=corrected)


def _group_sizes(numbers: Rows) -> Rows:
    """Return the number of rows in the group of each row ``(n,)``; numbers are -1 or more."""
    return np.asarray(np.bincount(numbers + 1)[numbers + 1])


def _grouped(numbers: Rows) -> Iterator[Rows]:
    """Yield rows ``(N, k)`` of N groups of k rows each, for successive numbers of equal size."""
    order = np.argsort(numbers, kind="stable")
    starts = np.flatnonzero(np.diff(numbers[order], prepend=-2, append=-2))
    sizes = np.diff(starts)
    for part in np.split(np.arange(len(sizes)), np.flatnonzero(np.diff(sizes)) + 1):
        if len(part):
            yield order[starts[part[0]] : starts[part[-1] + 1]].reshape(len(part), -1)
