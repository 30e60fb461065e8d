"""Readings that mean something else than they seem to: a finite list.

A sign, a unit, a label, two columns or labels exchanged, a row too early or too late, whole turns
of a dial's hand, a dial that stuck. None adds to the readings as a cause does; each is weighed as
other data about the same machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.faults import Fault, Rows, campaign_index, rows_in_order, weighted_rows
from orthoglide.fit import Factor, Problem
from orthoglide.fit.noise import noise_of, rms_noise
from orthoglide.fit.repeats import GRID_TOLERANCE, on_grid
from orthoglide.geometry import Array
from orthoglide.observations import Setup
from orthoglide.units import INCH, UNIT_MISTAKES

EXPECTED_COUNT = 0.5 / 6
"""Of each kind, before the readings are seen: as many as of a kind of fault that adds to them."""

_INCH_STEP = 1e-7  # step in which inches are read, taken for millimetres, metres
_MOST_DIGIT_EVIDENCE = 10.0  # log Bayes factor that the digits may add or take at most
_FEWEST_STUCK = (
    4  # readings one after the other, over several postures, that may be of a dial that stuck
)
_LOST_RANGE = 1e-3  # metres: range over which a reading that was lost may have been


@dataclass(frozen=True, eq=False, repr=False)
class AlternativeReadings:
    """Other data that the readings may be."""

    fault: Fault
    change: Array  # what is added to the readings to put them right (n,), metres
    # log odds before the machine is asked: of the kind, the digits, and of what a unit does to the
    # density of readings
    log_odds: float
    # setups by number as they should be labelled; none where the readings are changed
    labels: Mapping[int, Setup] = field(default_factory=dict)
    zero_weight: Rows = field(
        default_factory=lambda: np.zeros(0, dtype=np.int64)
    )  # rows that say nothing


def setups_to_reinterpret(problem: Problem, known: Sequence[Fault]) -> dict[int, Rows]:
    """Rows of setups of dials that count, in the order they were taken, where no fault is known by
    which they mean something else.
    """
    touched = {s for f in known if f.kind in MISREADING_KINDS for s in f.setups}
    order = {s: weighted_rows(problem, s) for s in problem.leg_setups if s not in touched}
    return {s: rows for s, rows in order.items() if len(rows) > 1}


def list_alternative_readings(
    problem: Problem, order: Mapping[int, Rows]
) -> list[AlternativeReadings]:
    """Every sign, unit, label, exchange, shift and stuck run of dials."""
    setups = list(order)
    kinds = (
        list(_signs(problem, setups, order)), list(_units(problem, setups, order)),
        list(_labels(problem, setups, order)), list(_exchanges(problem, setups, order)),
        list(_shifts(problem, setups, order)), list(_stuck(problem, setups, order)),
    )  # fmt: skip
    return [
        replace(one, log_odds=one.log_odds + float(np.log(EXPECTED_COUNT / len(kind))))
        for kind in kinds
        for one in kind
    ]


MISREADING_KINDS = ("sign", "label", "exchanged_labels", "shifted", "unit", "turns", "stuck")
"""Kinds of faults by which readings mean something else."""

RowsBySetup = Mapping[int, Rows]


def _reading_change(problem: Problem, rows: Rows, to: Array) -> Array:
    change = np.zeros(len(problem.measured))
    change[rows] = to - problem.measured[rows]
    return change


def _signs(
    problem: Problem, setups: Sequence[int], order: RowsBySetup
) -> Iterator[AlternativeReadings]:
    for s in setups:
        rows = order[s]
        change = _reading_change(problem, rows, -problem.measured[rows])
        yield AlternativeReadings(Fault("sign", rows, (s,), -1.0), change, 0.0)


def _units(
    problem: Problem, setups: Sequence[int], order: RowsBySetup
) -> Iterator[AlternativeReadings]:
    for s in setups:
        rows = order[s]
        sigma = np.hypot(problem.sigma, problem.common)[rows]
        for factor in UNIT_MISTAKES:
            fault = Fault("unit", rows, (s,), factor)
            # A reading's own rounding is enlarged with it: it tells no more than it did.
            finest = _finest_step(problem.measured[rows])
            noise = np.hypot(sigma, factor * finest / np.sqrt(12))
            density = float(np.sum(np.log(factor * sigma / noise)))
            change = _reading_change(problem, rows, factor * problem.measured[rows])
            yield AlternativeReadings(fault, change, density + digit_evidence(problem, fault))


def _finest_step(readings: Array) -> float:
    """The step in which readings are written, metres."""
    for step in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
        if on_grid(readings, step, 1e-3):
            return step
    return 0.0


def _labels(
    problem: Problem, setups: Sequence[int], order: RowsBySetup
) -> Iterator[AlternativeReadings]:
    for s in setups:
        setup = problem.setups[s]
        for leg, axis in set(permutations(range(3), 2)) - {(setup.leg, setup.axis)}:
            if not _is_label_taken(problem, s, leg, axis):
                fault = Fault("label", order[s], (s,), label=(leg, axis))
                yield AlternativeReadings(
                    fault, np.zeros(len(problem.measured)), 0.0, corrected_labels(problem, fault)
                )


def _exchanges(
    problem: Problem, setups: Sequence[int], order: RowsBySetup
) -> Iterator[AlternativeReadings]:
    commands = problem.dial_column("command") if problem.campaigns else np.zeros((0, 3))
    home = np.repeat(range(len(problem.campaigns)), [len(c.setups) for c in problem.campaigns])
    measured = problem.measured
    for one, other in combinations(setups, 2):
        if home[one] != home[other]:
            continue
        a, b = order[one], order[other]
        rows = np.concatenate([a, b])
        if len(a) == len(b):
            change = _reading_change(problem, rows, measured[np.concatenate([b, a])])
            yield AlternativeReadings(
                Fault("exchanged_labels", rows, (one, other), 0.0), change, 0.0
            )
        # At the same commands, in the same order, labels are exchanged with the columns.
        if len(a) != len(b) or not np.allclose(commands[a], commands[b], atol=1e-6):
            fault = Fault("exchanged_labels", rows, (one, other), 1.0)
            yield AlternativeReadings(
                fault, np.zeros(len(measured)), 0.0, corrected_labels(problem, fault)
            )


def _shifts(
    problem: Problem, setups: Sequence[int], order: RowsBySetup
) -> Iterator[AlternativeReadings]:
    for s in setups:
        rows = order[s]
        for by in (1, -1):
            moved, lost = _shifted_rows(rows, by)
            fault = Fault("shifted", rows, (s,), float(by))
            sigma = float(np.hypot(problem.sigma, problem.common)[rows[lost]].sum())
            odds = float(np.log(sigma * np.sqrt(2 * np.pi) / _LOST_RANGE))
            change = _reading_change(problem, rows, problem.measured[moved])
            yield AlternativeReadings(fault, change, odds, zero_weight=rows[lost])


def _stuck(
    problem: Problem, setups: Sequence[int], order: RowsBySetup
) -> Iterator[AlternativeReadings]:
    """Longest runs of equal readings over several postures."""
    if not problem.campaigns:
        return
    commands, none = problem.dial_column("command"), np.zeros(len(problem.measured))
    for s in setups:
        rows = order[s]
        cuts = np.flatnonzero(np.diff(problem.measured[rows]) != 0) + 1
        for run in np.split(rows, cuts):
            if len(run) >= _FEWEST_STUCK and len(np.unique(commands[run], axis=0)) > 1:
                sigma = np.hypot(problem.sigma, problem.common)[run]
                step = max(
                    float(problem.step[run].max()), _finest_step(problem.measured[rows]), 1e-7
                )
                # All but the first are certain, of a dial that stuck; of one that works they are at
                # most, as it rounds.
                odds = float(np.log(np.maximum(sigma * np.sqrt(2 * np.pi) / step, 1.0))[1:].sum())
                if len(run) < len(rows):  # else that is the datum
                    odds += float(np.log(sigma[0] * np.sqrt(2 * np.pi) / _LOST_RANGE))
                yield AlternativeReadings(Fault("stuck", run, (s,)), none, odds, zero_weight=run)


def _shifted_rows(rows: Rows, by: int) -> tuple[Rows, NDArray[np.bool_]]:
    """Rows in which the readings stand that belong in these, one too late or too early, and of
    which rows that is none.
    """
    late, lost = by > 0, np.zeros(len(rows), dtype=bool)
    lost[-1 if late else 0] = True
    moved = [rows[1:], rows[:1]] if late else [rows[-1:], rows[:-1]]
    return np.concatenate(moved), lost


def _is_label_taken(problem: Problem, setup: int, leg: int, axis: int) -> bool:
    """Whether another dial reads a leg along an axis, at the same place, while this one is read."""
    rows = rows_in_order(problem, setup)
    k = campaign_index(problem, rows)
    campaign = problem.campaigns[k]
    own = campaign.order[rows - problem.leg_rows[k].start]
    place = (leg, axis, problem.setups[setup].gauge, problem.setups[setup].bar)
    for number, other in enumerate(campaign.setups):
        if (other.leg, other.axis, other.gauge, other.bar) == place:
            order = campaign.order[campaign.setup == number]
            if order.min() <= own.max() and own.min() <= order.max():
                return True
    return False


def corrected_labels(problem: Problem, fault: Fault) -> dict[int, Setup]:
    """Setups by number as they should be labelled; none where readings mean something else."""
    if fault.kind == "label":
        (s,), (leg, axis) = fault.setups, fault.label
        return {s: replace(problem.setups[s], leg=leg, axis=axis)}
    if fault.kind != "exchanged_labels" or not fault.size:
        return {}
    one, other = fault.setups
    first, second = problem.setups[one], problem.setups[other]
    return {one: replace(second, name=first.name), other: replace(first, name=second.name)}


def digit_evidence(problem: Problem, fault: Fault) -> float:
    """Log Bayes factor of the digits: in its own unit a dial shows multiples of its step."""
    step, rows, factor = problem.machine.spec.dial.resolution, fault.rows, fault.size
    if step <= 0 or fault.kind != "unit":
        return 0.0
    readings = problem.measured[rows]
    if not on_grid(np.delete(problem.dial_column("reading"), rows), step):
        return 0.0
    decimal = abs(np.log10(factor) - round(float(np.log10(factor)))) < 1e-9
    own = on_grid(readings * factor, step) or (factor == INCH and on_grid(readings, _INCH_STEP))
    if not own or (on_grid(readings, step) and factor > 1):
        # A point put elsewhere moves the grid along; a conversion may have been rounded again.
        return -_MOST_DIGIT_EVIDENCE if decimal else 0.0
    values = len(np.unique(readings)) - 1
    chance = 2 * GRID_TOLERANCE if factor > 1 else max(factor, 2 * GRID_TOLERANCE)
    return min(-values * float(np.log(chance)), _MOST_DIGIT_EVIDENCE)


# -- the data as they should have been -------------------------------------------------------------


def with_misreading_corrected(problem: Problem, fault: Fault) -> Problem:
    """The problem with the meaning of some readings put right, as many rows."""
    if labels := corrected_labels(problem, fault):
        numbers = iter(problem.leg_setups)
        tables = (
            replace(c, setups=tuple(labels.get(next(numbers), s) for s in c.setups))
            for c in problem.campaigns
        )
        each = zip(problem.leg_factors, tables, strict=True)
        return problem.with_leg_factors([f.with_table(table) for f, table in each])
    measured = problem.measured.copy()
    if fault.kind == "stuck":
        return without_weight(problem, fault.rows)
    if fault.kind == "shifted":
        moved, lost = _shifted_rows(fault.rows, int(fault.size))
        measured[fault.rows] = problem.measured[moved]
        return without_weight(problem.with_readings(measured), fault.rows[lost])
    if fault.kind == "exchanged_labels":
        a, b = (rows_in_order(problem, s) for s in fault.setups)
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


def with_noise_reestimated(problem: Problem, but: NDArray[np.bool_] | None = None) -> Problem:
    """The problem with noise that came from repeats taken from those that have weight still, but
    for some rows ``(n,)``, which get that noise too.
    """
    noise = problem.noise
    renewed = {kind for kind, level in noise.levels.items() if level.source == "repeats"}
    for factor in problem.factors:  # a plate's roughness shows without any repeat
        renewed |= set(np.array(factor.readings.kind)[factor.noise.from_repeats].tolist())
    if not renewed:
        return problem
    silent = np.zeros(len(problem.measured), dtype=bool) if but is None else but
    kept = [
        f.noise.weighted & ~silent[part]
        for f, part in zip(problem.factors, problem.factor_rows, strict=True)
    ]
    each = list(zip(problem.factors, kept, strict=True))
    again, rows = noise_of(
        [f.readings.subset(own) for f, own in each],
        problem.machine.spec,
        steps=[f.noise.step[own] for f, own in each],
    )
    factors = []
    for (factor, own), new in zip(each, rows, strict=True):
        of_repeats = np.isin(factor.readings.kind, list(renewed))
        changed = factor.with_noise(np.flatnonzero(own & of_repeats), new.subset(of_repeats[own]))
        changed = _with_median_noise(
            changed, factor.noise.weighted & ~own & of_repeats, own & of_repeats
        )
        factors.append(changed if factor.on_legs else changed.with_roughness(problem.machine))
    levels = {k: again.levels.get(k, v) if k in renewed else v for k, v in noise.levels.items()}
    of_legs = bool(problem.leg_factors)
    if not of_legs:
        total = [f.noise.total[own] for f, own in zip(factors, kept, strict=True)]
        again = replace(noise, typical=rms_noise([f.readings.subset(o) for f, o in each], total))
    one = again if not of_legs or noise.source == "repeats" else noise
    kept_noise = replace(one, levels=levels, refuted=noise.refuted)
    return replace(problem, factors=tuple(factors), noise=kept_noise)


def _with_median_noise(
    factor: Factor, rows: NDArray[np.bool_], others: NDArray[np.bool_]
) -> Factor:
    """Some rows with the noise that most of others have."""
    if not rows.any() or not others.any():
        return factor
    noise = factor.noise
    most = np.flatnonzero(others)[np.argsort(noise.sigma[others])[others.sum() // 2]]
    return factor.with_noise(np.flatnonzero(rows), noise.subset(np.full(int(rows.sum()), most)))
