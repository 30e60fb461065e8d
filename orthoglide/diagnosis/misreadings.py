"""Readings that mean something else: a sign, a unit, a label, two labels or columns exchanged, a
row too early or too late.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from orthoglide.diagnosis.command_faults import all_put_right
from orthoglide.diagnosis.faults import Fault, Kind, Rows, campaign_of, in_order
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.fit import Problem
from orthoglide.fit.noise import noise_of, overall
from orthoglide.fit.repeats import OFF_GRID, on_grid
from orthoglide.geometry import Array
from orthoglide.observations import Setup
from orthoglide.units import INCH, MISTAKEN

LABELS = ("label", "exchanged_labels")
"""Faults of what the setups are called."""

FACTORS = ("sign", "unit")
"""Faults that multiply what was read."""

_INCHES = 1e-7  # step in which inches are read, taken for millimetres, metres
_DIGITS = 10.0  # log Bayes factor that the digits may add or take at most
_FACTOR = 0.15  # relative error of a fault's factor that the readings themselves may give


@dataclass(frozen=True)
class Misreading:
    """A hypothesis that readings of whole setups mean something else."""

    fault: Fault  # without evidence
    change: Array  # what the residual changes by once it is put right, (n,) metres
    # setups by number as they should be labelled; none where the readings are changed
    labels: Mapping[int, Setup] = field(default_factory=dict)

    def leaves_none(self, before: Problem, after: StationMeans) -> bool:
        """Whether labels, once put right, leave nothing of what they did before.

        An error of the machine that other labels imitate is seldom as large as labels make it.
        """
        x, value = after.signatures.estimate.x, after.signatures.estimate.at.value
        change = np.zeros(len(after.problem.measured))
        for s in self.labels:
            rows = in_order(before, s)
            change[rows] = _readings_as(after.problem, x, rows, before.setups[s]) - value[rows]
        if not self.labels:
            a, b = (in_order(before, s) for s in self.fault.setups)
            change[a], change[b] = value[b] - value[a], value[a] - value[b]
        return abs(_share(after, change)[0]) <= _FACTOR


def misreadings(
    means: StationMeans, setups: Sequence[int], slipped: Sequence[int] = ()
) -> list[Misreading]:
    """Every sign, unit and label, and exchange of two setups of one campaign; and readings a row
    off, which may look like a slip at either end of a setup.

    Args:
        means: of a fit.
        setups: in which no fault is known.
        slipped: in which slips are, and nothing else.
    """
    problem = means.problem
    if not setups and not slipped:
        return []
    measured, value = problem.measured, means.signatures.estimate.at.value
    order = {s: in_order(problem, s) for s in (*setups, *slipped)}
    found: list[Misreading] = []

    def add(kind: Kind, rows: Rows, of: tuple[int, ...], size: float, corrected: Array) -> None:
        change = np.zeros(len(measured))
        change[rows] = corrected - measured[rows]
        found.append(Misreading(Fault(kind, rows, of, size), change))

    for s, rows in order.items():
        fitted = value[rows] + np.mean(measured[rows] - value[rows])  # with its datum
        for by in (1, -1):
            moved, lost = _shifted(rows, by)
            add("shifted", rows, (s,), float(by), np.where(lost, fitted, measured[moved]))

    def relabel(fault: Fault) -> None:
        change, labels = np.zeros(len(measured)), _labels(problem, fault)
        for s, setup in labels.items():
            as_labelled = _readings_as(problem, means.signatures.estimate.x, order[s], setup)
            change[order[s]] = value[order[s]] - as_labelled
        found.append(Misreading(fault, change, labels))

    for s in setups:
        rows = order[s]
        add("sign", rows, (s,), -1.0, -measured[rows])
        for factor in MISTAKEN:
            add("unit", rows, (s,), factor, factor * measured[rows])
        setup = problem.setups[s]
        for leg, axis in set(permutations(range(3), 2)) - {(setup.leg, setup.axis)}:
            fault = Fault("label", rows, (s,), 0.0, label=(leg, axis))
            if not _taken(problem, s, leg, axis):
                relabel(fault)
    commands = problem.of_dials("command")
    campaign = np.repeat(range(len(problem.campaigns)), [len(c.setups) for c in problem.campaigns])
    for one, other in combinations(setups, 2):
        if campaign[one] != campaign[other]:
            continue
        a, b = order[one], order[other]
        rows = np.concatenate([a, b])
        if len(a) == len(b):
            add("exchanged_labels", rows, (one, other), 0.0, measured[np.concatenate([b, a])])
        # At the same commands, in the same order, labels are exchanged with the columns.
        if len(a) != len(b) or not np.allclose(commands[a], commands[b], atol=1e-6):
            relabel(Fault("exchanged_labels", rows, (one, other), 1.0))
    return found


def _shifted(rows: Rows, by: int) -> tuple[Rows, NDArray[np.bool_]]:
    """Rows in which the readings stand that belong in these, one too late or too early, and of
    which rows that is none.
    """
    late, lost = by > 0, np.zeros(len(rows), dtype=bool)
    lost[-1 if late else 0] = True
    moved = [rows[1:], rows[:1]] if late else [rows[-1:], rows[:-1]]
    return np.concatenate(moved), lost


def _readings_as(problem: Problem, x: Array, rows: Rows, setup: Setup) -> Array:
    """What rows of one campaign would read, datums apart, were they of a setup, metres."""
    k = campaign_of(problem, rows)
    under = problem.campaigns[k].subset(rows - problem.rows[k].start)
    under = replace(under, setups=(setup,), setup=np.zeros(len(rows), dtype=np.int64))
    return problem.machine.model.readings(problem.values(k, x), under)


def _taken(problem: Problem, setup: int, leg: int, axis: int) -> bool:
    """Whether another dial reads a leg along an axis, at the same place, while this one is read."""
    rows = in_order(problem, setup)
    k = campaign_of(problem, rows)
    campaign = problem.campaigns[k]
    own = campaign.order[rows - problem.rows[k].start]
    place = (leg, axis, problem.setups[setup].gauge, problem.setups[setup].bar)
    for number, other in enumerate(campaign.setups):
        if (other.leg, other.axis, other.gauge, other.bar) == place:
            order = campaign.order[campaign.setup == number]
            if order.min() <= own.max() and own.min() <= order.max():
                return True
    return False


def restored(problem: Problem, fault: Fault) -> Problem:
    """The problem with the meaning of some readings, or their command, put right."""
    if fault.commands:
        return all_put_right(problem, [fault])
    if labels := _labels(problem, fault):
        numbers = iter(problem.leg_setups)
        tables = (
            replace(c, setups=tuple(labels.get(next(numbers), s) for s in c.setups))
            for c in problem.campaigns
        )
        each = zip(problem.on_legs, tables, strict=True)
        return problem.with_factors([f.with_table(table) for f, table in each])
    measured = problem.measured.copy()
    if fault.kind == "shifted":
        moved, lost = _shifted(fault.rows, int(fault.size))
        measured[fault.rows] = problem.measured[moved]
        return without_weight(problem.with_readings(measured), fault.rows[lost])
    if fault.kind == "exchanged_labels":
        a, b = (in_order(problem, s) for s in fault.setups)
        measured[a], measured[b] = problem.measured[b], problem.measured[a]
    elif fault.kind == "turns":
        measured[fault.rows] -= np.array(fault.sizes)
    else:
        measured[fault.rows] *= fault.size
    return problem.with_readings(measured)


def without_weight(problem: Problem, rows: Rows | NDArray[np.bool_]) -> Problem:
    """The problem with some readings without any weight."""
    silent = np.zeros(len(problem.measured), dtype=bool)
    silent[rows] = True
    each = zip(problem.factors, problem.factor_rows, strict=True)
    return replace(problem, factors=tuple(f.without_weight(silent[part]) for f, part in each))


def with_noise_of_the_rest(problem: Problem) -> Problem:
    """The problem with noise that came from repeats taken from those that have weight still."""
    noise = problem.noise
    renewed = {kind for kind, level in noise.levels.items() if level.source == "repeats"}
    if not renewed:
        return problem
    kept = [f.noise.weighted for f in problem.factors]
    each = list(zip(problem.factors, kept, strict=True))
    again, rows = noise_of(
        [f.readings.subset(own) for f, own in each],
        problem.machine.spec,
        steps=[f.noise.step[own] for f, own in each],
    )
    factors = []
    for (factor, own), new in zip(each, rows, strict=True):
        of_repeats = np.isin(factor.readings.kind, list(renewed))
        changed = factor.with_noise(np.flatnonzero(own & of_repeats), new.of(of_repeats[own]))
        factors.append(changed if factor.on_legs else changed.with_roughness(problem.machine))
    levels = {k: again.levels.get(k, v) if k in renewed else v for k, v in noise.levels.items()}
    of_legs = bool(problem.on_legs)
    if not of_legs:
        total = [f.noise.total[own] for f, own in zip(factors, kept, strict=True)]
        again = replace(noise, typical=overall([f.readings.subset(o) for f, o in each], total))
    one = again if not of_legs or noise.source == "repeats" else noise
    return replace(problem, factors=tuple(factors), noise=replace(one, levels=levels))


def _labels(problem: Problem, fault: Fault) -> dict[int, Setup]:
    """Setups by number as they should be labelled; none where readings mean something else."""
    if fault.kind == "label":
        (s,), (leg, axis) = fault.setups, fault.label
        return {s: replace(problem.setups[s], leg=leg, axis=axis)}
    if fault.kind != "exchanged_labels" or not fault.size:
        return {}
    one, other = fault.setups
    first, second = problem.setups[one], problem.setups[other]
    return {one: replace(second, name=first.name), other: replace(first, name=second.name)}


def digits(problem: Problem, fault: Fault) -> float:
    """Log Bayes factor of the digits: in its own unit a dial shows multiples of its step."""
    step, rows, factor = problem.machine.spec.dial.resolution, fault.rows, fault.size
    if step <= 0 or fault.kind != "unit":
        return 0.0
    readings = problem.measured[rows]
    if not on_grid(np.delete(problem.of_dials("reading"), rows), step):
        return 0.0
    decimal = abs(np.log10(factor) - round(float(np.log10(factor)))) < 1e-9
    own = on_grid(readings * factor, step) or (factor == INCH and on_grid(readings, _INCHES))
    if not own or (on_grid(readings, step) and factor > 1):
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
    share, sigma = _share(means, only(rows, means.problem.measured))
    allowed = _FACTOR * abs(factor)
    return bool(abs(1 - share - factor) <= max(allowed, 3 * min(sigma, allowed)))


def _share(means: StationMeans, change: Array) -> tuple[float, float]:
    """Share of a change of the readings ``(n,)`` that is in the residual, and its sigma."""
    shown = means.shown(change)
    square = max(float(shown @ shown), 1e-300)
    return float(shown @ means.residual) / square, float(1 / np.sqrt(square))
