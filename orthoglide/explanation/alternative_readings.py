"""Misreadings: a finite list of alternative data that the readings may stand for.

A sign, a unit, a label, two exchanged columns or labels, a row too early or too late, whole turns
of a dial's hand, a dial that stuck. None adds columns to the linear model as a cause does; each is
compared as other data of the same machine.
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
"""Prior mean number of misreadings of each kind, equal to that of a kind of `fault_columns`."""

_INCH_STEP = 1e-7  # metres: step of readings in inches that were taken for millimetres
_MOST_DIGIT_EVIDENCE = 10.0  # largest log Bayes factor of the digits, for or against
_FEWEST_STUCK = 4  # successive equal readings over several postures that a stuck dial may give
_LOST_RANGE = 1e-3  # metres: range of a reading that was lost
_WRITTEN_STEPS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # metres


@dataclass(frozen=True, eq=False, repr=False)
class AlternativeReadings:
    """Other data that the readings may stand for."""

    fault: Fault
    change: Array  # corrected less given readings (n,), metres
    # log odds before the fit: of the kind, of the digits, and of the density of rescaled readings
    log_odds: float
    # corrected setups by number; empty if the readings are changed
    labels: Mapping[int, Setup] = field(default_factory=dict)
    # rows without information
    zero_weight: Rows = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def setups_to_reinterpret(problem: Problem, faults: Sequence[Fault]) -> dict[int, Rows]:
    """Return the weighted rows of each dial's setup in which no misreading was found, in the order
    they were taken.
    """
    misread = {s for f in faults if f.kind in MISREADING_KINDS for s in f.setups}
    weighted = {s: weighted_rows(problem, s) for s in problem.leg_setups if s not in misread}
    return {s: rows for s, rows in weighted.items() if len(rows) > 1}


def list_alternative_readings(
    problem: Problem, rows_by_setup: Mapping[int, Rows]
) -> list[AlternativeReadings]:
    """Return every sign, unit, label, exchange, shift and stuck run of dials."""
    generators = (_signs, _units, _labels, _exchanges, _shifts, _stuck)
    kinds = [list(generator(problem, rows_by_setup)) for generator in generators]
    return [
        replace(one, log_odds=one.log_odds + float(np.log(EXPECTED_COUNT / len(kind))))
        for kind in kinds
        for one in kind
    ]


MISREADING_KINDS = ("sign", "label", "exchanged_labels", "shifted", "unit", "turns", "stuck")
"""Kinds of faults that are misreadings."""

RowsBySetup = Mapping[int, Rows]


def _reading_change(problem: Problem, rows: Rows, readings: Array) -> Array:
    change = np.zeros(len(problem.measured))
    change[rows] = readings - problem.measured[rows]
    return change


def _signs(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[AlternativeReadings]:
    for setup, rows in rows_by_setup.items():
        change = _reading_change(problem, rows, -problem.measured[rows])
        yield AlternativeReadings(Fault("sign", rows, (setup,), -1.0), change, 0.0)


def _units(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[AlternativeReadings]:
    for setup, rows in rows_by_setup.items():
        sigma = np.hypot(problem.sigma, problem.shared_rounding_sd)[rows]
        for factor in UNIT_MISTAKES:
            fault = Fault("unit", rows, (setup,), factor)
            # The rounding of a reading is rescaled with it, so no precision is gained.
            finest = _finest_step(problem.measured[rows])
            noise = np.hypot(sigma, factor * finest / np.sqrt(12))
            density = float(np.sum(np.log(factor * sigma / noise)))
            change = _reading_change(problem, rows, factor * problem.measured[rows])
            yield AlternativeReadings(fault, change, density + digit_evidence(problem, fault))


def _finest_step(readings: Array) -> float:
    """Return the step in which readings are written, metres; 0 if there is none."""
    return next((step for step in _WRITTEN_STEPS if on_grid(readings, step, 1e-3)), 0.0)


def _labels(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[AlternativeReadings]:
    for s, rows in rows_by_setup.items():
        setup = problem.setups[s]
        for leg, axis in set(permutations(range(3), 2)) - {(setup.leg, setup.axis)}:
            if not _is_label_taken(problem, s, leg, axis):
                fault = Fault("label", rows, (s,), label=(leg, axis))
                labels = corrected_labels(problem, fault)
                yield AlternativeReadings(fault, np.zeros(len(problem.measured)), 0.0, labels)


def _exchanges(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[AlternativeReadings]:
    commands = problem.dial_column("command") if problem.campaigns else np.zeros((0, 3))
    campaign_of_setup = [k for k, c in enumerate(problem.campaigns) for _ in c.setups]
    measured = problem.measured
    for first, second in combinations(rows_by_setup, 2):
        if campaign_of_setup[first] != campaign_of_setup[second]:
            continue
        a, b = rows_by_setup[first], rows_by_setup[second]
        rows = np.concatenate([a, b])
        if len(a) == len(b):
            change = _reading_change(problem, rows, measured[np.concatenate([b, a])])
            fault = Fault("exchanged_labels", rows, (first, second), 0.0)
            yield AlternativeReadings(fault, change, 0.0)
        # At equal commands in equal order, exchanged labels are the same as exchanged columns.
        if len(a) != len(b) or not np.allclose(commands[a], commands[b], atol=1e-6):
            fault = Fault("exchanged_labels", rows, (first, second), 1.0)
            labels = corrected_labels(problem, fault)
            yield AlternativeReadings(fault, np.zeros(len(measured)), 0.0, labels)


def _shifts(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[AlternativeReadings]:
    for setup, rows in rows_by_setup.items():
        for by in (1, -1):
            sources, lost = _shifted_rows(rows, by)
            fault = Fault("shifted", rows, (setup,), float(by))
            sigma = float(np.hypot(problem.sigma, problem.shared_rounding_sd)[rows[lost]].sum())
            odds = float(np.log(sigma * np.sqrt(2 * np.pi) / _LOST_RANGE))
            change = _reading_change(problem, rows, problem.measured[sources])
            yield AlternativeReadings(fault, change, odds, zero_weight=rows[lost])


def _stuck(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[AlternativeReadings]:
    """Yield the longest runs of equal readings over several postures."""
    if not problem.campaigns:
        return
    commands, unchanged = problem.dial_column("command"), np.zeros(len(problem.measured))
    for setup, rows in rows_by_setup.items():
        finest = max(_finest_step(problem.measured[rows]), 1e-7)
        cuts = np.flatnonzero(np.diff(problem.measured[rows]) != 0) + 1
        for run in np.split(rows, cuts):
            if len(run) < _FEWEST_STUCK or len(np.unique(commands[run], axis=0)) == 1:
                continue
            sigma = np.hypot(problem.sigma, problem.shared_rounding_sd)[run]
            step = max(float(problem.resolution[run].max()), finest)
            # A stuck dial shows all but the first reading with certainty; a working one with the
            # probability of its rounding step at most.
            odds = float(np.log(np.maximum(sigma * np.sqrt(2 * np.pi) / step, 1.0))[1:].sum())
            if len(run) < len(rows):  # otherwise the first reading is the datum
                odds += float(np.log(sigma[0] * np.sqrt(2 * np.pi) / _LOST_RANGE))
            fault = Fault("stuck", run, (setup,))
            yield AlternativeReadings(fault, unchanged, odds, zero_weight=run)


def _shifted_rows(rows: Rows, by: int) -> tuple[Rows, NDArray[np.bool_]]:
    """Return the rows where the readings of these rows were written, one too late (``by`` > 0) or
    too early, and which reading was lost.
    """
    lost = np.zeros(len(rows), dtype=bool)
    lost[-1 if by > 0 else 0] = True
    return np.roll(rows, -1 if by > 0 else 1), lost


def _is_label_taken(problem: Problem, setup: int, leg: int, axis: int) -> bool:
    """Return whether another dial reads a leg along an axis at the same place and time."""
    rows = rows_in_order(problem, setup)
    k = campaign_index(problem, rows)
    campaign = problem.campaigns[k]
    times = campaign.order[rows - problem.leg_rows[k].start]
    place = (leg, axis, problem.setups[setup].gauge, problem.setups[setup].bar)
    for number, other in enumerate(campaign.setups):
        if (other.leg, other.axis, other.gauge, other.bar) == place:
            other_times = campaign.order[campaign.setup == number]
            if other_times.min() <= times.max() and times.min() <= other_times.max():
                return True
    return False


def corrected_labels(problem: Problem, fault: Fault) -> dict[int, Setup]:
    """Return the corrected setups by number; empty if no label is wrong."""
    if fault.kind == "label":
        (s,), (leg, axis) = fault.setups, fault.label
        return {s: replace(problem.setups[s], leg=leg, axis=axis)}
    if fault.kind != "exchanged_labels" or not fault.size:
        return {}
    a, b = fault.setups
    first, second = problem.setups[a], problem.setups[b]
    return {a: replace(second, name=first.name), b: replace(first, name=second.name)}


def digit_evidence(problem: Problem, fault: Fault) -> float:
    """Return the log Bayes factor of the digits: a dial shows multiples of its step in its unit."""
    step, rows, factor = problem.machine.spec.dial.resolution, fault.rows, fault.size
    if step <= 0 or fault.kind != "unit":
        return 0.0
    readings = problem.measured[rows]
    if not on_grid(np.delete(problem.dial_column("reading"), rows), step):
        return 0.0
    decimal = abs(np.log10(factor) - round(float(np.log10(factor)))) < 1e-9
    on_own_grid = on_grid(readings * factor, step) or (
        factor == INCH and on_grid(readings, _INCH_STEP)
    )
    if not on_own_grid or (on_grid(readings, step) and factor > 1):
        # A misplaced decimal point moves the grid too; a conversion may have been rounded again.
        return -_MOST_DIGIT_EVIDENCE if decimal else 0.0
    value_count = len(np.unique(readings)) - 1
    chance = 2 * GRID_TOLERANCE if factor > 1 else max(factor, 2 * GRID_TOLERANCE)
    return min(-value_count * float(np.log(chance)), _MOST_DIGIT_EVIDENCE)


# -- the data as they should have been -------------------------------------------------------------


def with_misreading_corrected(problem: Problem, fault: Fault) -> Problem:
    """Return the problem with a misreading corrected and an unchanged number of rows."""
    if labels := corrected_labels(problem, fault):
        numbers = iter(problem.leg_setups)
        tables = (
            replace(c, setups=tuple(labels.get(next(numbers), s) for s in c.setups))
            for c in problem.campaigns
        )
        pairs = zip(problem.leg_factors, tables, strict=True)
        return problem.with_leg_factors([f.with_table(table) for f, table in pairs])
    measured = problem.measured.copy()
    if fault.kind == "stuck":
        return without_weight(problem, fault.rows)
    if fault.kind == "shifted":
        sources, lost = _shifted_rows(fault.rows, int(fault.size))
        measured[fault.rows] = problem.measured[sources]
        return without_weight(problem.with_leg_readings(measured), fault.rows[lost])
    if fault.kind == "exchanged_labels":
        a, b = (rows_in_order(problem, s) for s in fault.setups)
        measured[a], measured[b] = problem.measured[b], problem.measured[a]
    elif fault.kind == "turns":
        measured[fault.rows] -= np.array(fault.sizes)
    else:
        measured[fault.rows] *= fault.size
    return problem.with_leg_readings(measured)


def without_weight(problem: Problem, rows: Rows | NDArray[np.bool_]) -> Problem:
    """Return the problem with zero weight of some readings."""
    zero_weight = np.zeros(len(problem.measured), dtype=bool)
    zero_weight[rows] = True
    pairs = zip(problem.factors, problem.factor_rows, strict=True)
    return replace(problem, factors=tuple(f.without_weight(zero_weight[part]) for f, part in pairs))


def with_noise_reestimated(problem: Problem, excluded: NDArray[np.bool_] | None = None) -> Problem:
    """Return the problem with the noise of repeats estimated again from weighted rows.

    Rows ``excluded`` ``(n,)`` do not contribute, but get the median of that noise.
    """
    noise = problem.noise
    kinds = {kind for kind, level in noise.levels.items() if level.source == "repeats"}
    for factor in problem.factors:  # a plate's roughness needs no repeats
        kinds |= set(np.array(factor.readings.kind)[factor.noise.from_repeats].tolist())
    if not kinds:
        return problem
    left_out = np.zeros(len(problem.measured), dtype=bool) if excluded is None else excluded
    parts = zip(problem.factors, problem.factor_rows, strict=True)
    pairs = [(f, f.noise.weighted & ~left_out[part]) for f, part in parts]
    tables = [f.readings.subset(used) for f, used in pairs]
    steps = [f.noise.step[used] for f, used in pairs]
    noise_again, rows = noise_of(tables, problem.machine.spec, steps=steps)
    factors = []
    for (factor, used), new in zip(pairs, rows, strict=True):
        of_kinds = np.isin(factor.readings.kind, list(kinds))
        changed = factor.with_noise(np.flatnonzero(used & of_kinds), new.subset(of_kinds[used]))
        unused = factor.noise.weighted & ~used & of_kinds
        changed = _with_median_noise(changed, unused, used & of_kinds)
        factors.append(changed if factor.on_legs else changed.with_roughness(problem.machine))
    levels = {k: noise_again.levels.get(k, v) if k in kinds else v for k, v in noise.levels.items()}
    on_legs = bool(problem.leg_factors)
    if not on_legs:
        total = [f.noise.total[used] for f, (_, used) in zip(factors, pairs, strict=True)]
        noise_again = replace(noise, typical=rms_noise(tables, total))
    basis = noise_again if not on_legs or noise.source == "repeats" else noise
    kept_noise = replace(basis, levels=levels, refuted=noise.refuted)
    return replace(problem, factors=tuple(factors), noise=kept_noise)


def _with_median_noise(
    factor: Factor, rows: NDArray[np.bool_], reference: NDArray[np.bool_]
) -> Factor:
    """Return the factor with the median noise of the reference rows in other rows."""
    if not rows.any() or not reference.any():
        return factor
    order = np.argsort(factor.noise.sigma[reference])
    median_row = np.flatnonzero(reference)[order[len(order) // 2]]
    median = factor.noise.subset(np.full(int(rows.sum()), median_row))
    return factor.with_noise(np.flatnonzero(rows), median)
