"""Readings that mean something else: a sign, a unit, a label, two labels or columns exchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from orthoglide.diagnosis.faults import Fault, Kind, Rows, in_order
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.fit import Problem
from orthoglide.fit.noise import OFF_GRID, off_grid
from orthoglide.geometry import Array
from orthoglide.observations import Setup
from orthoglide.units import MISTAKEN

_DIGITS = 10.0  # log Bayes factor that the digits may add or take at most
_FACTOR = 0.15  # relative error of a sign's or unit's factor that the readings themselves may give


@dataclass(frozen=True)
class Misreading:
    """A hypothesis that readings of whole setups mean something else.

    Attributes:
        fault: without evidence.
        change: what the residual changes by once it is put right, ``(n,)`` metres.
        labels: whether the setups' labels are exchanged, and the readings stay.
    """

    fault: Fault
    change: Array
    labels: bool = False

    def corrected(self, problem: Problem) -> Problem:
        """The problem with the fault taken back."""
        if self.fault.kind == "label":
            (setup,) = self.fault.setups
            return _labelled(problem, {setup: _as_label(_setup(problem, setup), self.fault.label)})
        if self.labels:
            one, other = self.fault.setups
            a, b = _setup(problem, one), _setup(problem, other)
            exchanged = {one: replace(b, name=a.name), other: replace(a, name=b.name)}
            return _labelled(problem, exchanged)
        return problem.with_readings(problem.measured + self.change)


def misreadings(means: StationMeans, setups: Sequence[int]) -> list[Misreading]:
    """Every sign, unit and label, and exchange of two setups of one campaign."""
    problem = means.problem
    if not setups:
        return []
    measured, value = problem.measured, means.signatures.estimate.at.value
    found: list[Misreading] = []

    def add(kind: Kind, rows: Rows, of: tuple[int, ...], size: float, corrected: Array) -> None:
        change = np.zeros(len(measured))
        change[rows] = corrected - measured[rows]
        found.append(Misreading(Fault(kind, rows, of, size), change))

    order = {s: in_order(problem, s) for s in setups}
    for s, rows in order.items():
        add("sign", rows, (s,), -1.0, -measured[rows])
        for factor in MISTAKEN:
            add("unit", rows, (s,), factor, factor * measured[rows])
    found += _labels(problem, means.signatures.estimate.x, value, order)
    commands = np.concatenate([c.command for c in problem.campaigns])
    predicted = _under_each_label(problem, means.signatures.estimate.x)
    for one, other in combinations(setups, 2):
        a, b = order[one], order[other]
        if not np.isfinite(predicted[a, other]).all():
            continue  # of another campaign
        rows, crossed = np.concatenate([a, b]), np.concatenate([b, a])
        if len(a) == len(b):
            add("exchanged_labels", rows, (one, other), 0.0, measured[crossed])
        # At the same commands, in the same order, labels are exchanged with the columns.
        if len(a) != len(b) or not np.allclose(commands[a], commands[b], atol=1e-6):
            change = np.zeros(len(measured))
            change[a] = value[a] - predicted[a, other]
            change[b] = value[b] - predicted[b, one]
            fault = Fault("exchanged_labels", rows, (one, other), 1.0)
            found.append(Misreading(fault, change, labels=True))
    return found


def _under_each_label(problem: Problem, x: Array) -> Array:
    """What every row would read, datums apart, were it of each setup ``(n, setups)``, metres.

    Setups of other campaigns: nan.
    """
    predicted = np.full((len(problem.measured), problem.setup_count), np.nan)
    first = 0
    for k, (campaign, rows) in enumerate(zip(problem.campaigns, problem.rows, strict=True)):
        values = problem.values(k, x)
        for place in range(len(campaign.setups)):  # one after the other: large campaigns
            under = replace(campaign, setup=np.full(len(campaign), place))
            predicted[rows, first + place] = problem.machine.model.readings(values, under)
        first += len(campaign.setups)
    return predicted


def _labels(
    problem: Problem, x: Array, value: Array, order: Mapping[int, Rows]
) -> Iterator[Misreading]:
    """Every other leg and axis of every setup."""
    for s, rows in order.items():
        setup = _setup(problem, s)
        k = next(k for k, part in enumerate(problem.rows) if rows[0] < part.stop)
        campaign, values = problem.campaigns[k], problem.values(k, x)
        here = rows - problem.rows[k].start
        for leg, axis in permutations(range(3), 2):
            if (leg, axis) == (setup.leg, setup.axis):
                continue
            other = _as_label(setup, (leg, axis))
            under = replace(campaign.subset(here), setups=(other,), setup=np.zeros(len(here), int))
            change = np.zeros(len(value))
            change[rows] = value[rows] - problem.machine.model.readings(values, under)
            yield Misreading(Fault("label", rows, (s,), 0.0, label=(leg, axis)), change)


def _as_label(setup: Setup, label: tuple[int, int]) -> Setup:
    leg, axis = label
    return replace(setup, leg=leg, axis=axis)


def _setup(problem: Problem, setup: int) -> Setup:
    """Of all setups, numbered over all campaigns."""
    return [s for c in problem.campaigns for s in c.setups][setup]


def _labelled(problem: Problem, labels: Mapping[int, Setup]) -> Problem:
    """The problem with other labels of some setups, numbered over all campaigns."""
    numbers = iter(range(problem.setup_count))
    campaigns = tuple(
        replace(c, setups=tuple(labels.get(next(numbers), s) for s in c.setups))
        for c in problem.campaigns
    )
    return replace(problem, campaigns=campaigns)


def digits(problem: Problem, fault: Fault) -> float:
    """Log Bayes factor of the digits: in its own unit a dial shows multiples of its step."""
    step, rows, factor = problem.machine.spec.dial.resolution, fault.rows, fault.size
    if step <= 0 or fault.kind != "unit":
        return 0.0

    def on_grid(readings: Array) -> bool:
        return bool((off_grid(readings, step) < OFF_GRID).all())

    readings = problem.measured[rows]
    dials = np.concatenate([c.reading for c in problem.campaigns])
    if not on_grid(np.delete(dials, rows)):
        return 0.0
    decimal = abs(np.log10(factor) - round(float(np.log10(factor)))) < 1e-9
    if not on_grid(readings * factor) or (on_grid(readings) and factor > 1):
        # A point put elsewhere moves the grid along; a conversion may have been rounded again.
        return -_DIGITS if decimal else 0.0
    values = len(np.unique(readings)) - 1
    chance = 2 * OFF_GRID if factor > 1 else max(factor, 2 * OFF_GRID)
    return min(-values * float(np.log(chance)), _DIGITS)


def only(rows: Rows, readings: Array) -> Array:
    """Readings ``(n,)`` with zeros in all but some rows."""
    return np.where(np.isin(np.arange(len(readings)), rows), readings, 0.0)


def factor_fits(means: StationMeans, rows: Rows, factor: float) -> bool:
    """Whether the factor that fits best is this one: flat readings would fit any small factor."""
    shown = means.shown(only(rows, means.problem.measured))
    square = max(float(shown @ shown), 1e-300)
    best, sigma = 1 - float(shown @ means.residual) / square, 1 / np.sqrt(square)
    allowed = _FACTOR * abs(factor)
    return bool(abs(best - factor) <= max(allowed, 3 * min(sigma, allowed)))
