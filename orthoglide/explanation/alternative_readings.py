"""Misreadings: a finite list of alternative data that the readings may stand for.

A sign, a unit, a label, two exchanged columns or labels, a row too early or too late, a dial that
stuck; of a level its sign, its axes, and degrees. None adds columns to the linear model as a cause
does; each is compared as other data of the same machine.

Whole turns of a dial's hand depend on a fit: the small hand, which counts the turns, was not read
or was misread. The missing turns of a setup are rounded from its deletion residual; those of all
setups at once from the residual of the readings, and then from the residual that remains with these
turns corrected.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from orthoglide.explanation.assumed_noise import NO_NOISE_RATIO
from orthoglide.explanation.faults import (
    MISREADING_KINDS,
    Fault,
    Rows,
    factors_and_rows,
    setups_of,
    weighted_rows,
)
from orthoglide.explanation.full_likelihood import Deletion, FullLikelihood
from orthoglide.explanation.linear_model import NOISE_SCALES, TWENTY_TO_ONE
from orthoglide.fit import Problem
from orthoglide.fit.repeats import GRID_TOLERANCE, on_grid
from orthoglide.geometry import Array
from orthoglide.units import INCH, UNIT_MISTAKES

EXPECTED_COUNT = 0.5 / 6
"""Prior mean number of misreadings of each kind: half of one for the six kinds of most sheets."""

NOISE_RATIOS = tuple(
    ratio for scale in NOISE_SCALES if (ratio := float(np.hypot(1.0, scale))) < NO_NOISE_RATIO
)
"""Ratios of a setup's noise to that assumed: on the grid of larger noise of all readings, as far as
it is noise of an instrument."""

_INCH_STEP = 1e-7  # metres: step of readings in inches that were taken for millimetres
_MOST_DIGIT_EVIDENCE = 10.0  # log Bayes factor: one sheet in 20 000 may break any rule
_FEWEST_STUCK = 4  # successive equal readings: fewer are single slips in the search
_LOST_RANGE = 1e-3  # metres in which a lost reading lay: a turn of most hands
_WRITTEN_STEPS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # metres

_DEGREE = np.pi / 180 / 1e-3  # a reading in degrees that was taken for milliradians

RowsBySetup = Mapping[int, Rows]


def setups_to_reinterpret(
    problem: Problem, faults: Sequence[Fault], setups: Sequence[int] | None = None
) -> dict[int, Rows]:
    """Return the weighted rows of each dial's setup, or of those given, in which no misreading was
    found, in the order they were taken.
    """
    misread = {s for f in faults if f.kind in MISREADING_KINDS for s in setups_of(problem, f)}
    chosen = problem.leg_setups if setups is None else setups
    weighted = {s: weighted_rows(problem, s) for s in chosen if s not in misread}
    return {s: rows for s, rows in weighted.items() if len(rows) > 1}


def alternative_readings(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Fault]:
    """Yield every sign, unit, label, exchange, shift and stuck run of dials."""
    generators = (_signs, _units, _labels, _exchanges, _shifts, _stuck)
    return (one for kind in generators for one in _sharing_prior(kind(problem, rows_by_setup)))


def noisy_setups(rows_by_setup: RowsBySetup) -> list[Fault]:
    """Return larger noise of each setup, whose size follows from a fit. That of a single one is the
    noise of all readings, which the search varies.

    They share the prior of that noise, which is rare: its log odds are those by which alternatives
    must win (`RARE_LOG_PRIOR`).
    """
    log_odds, every = -float(np.log(max(len(rows_by_setup), 1))), rows_by_setup.values()
    return [Fault("noisy", rows, log_odds=log_odds) for rows in every if len(every) > 1]


def _sharing_prior(kind: Iterable[Fault]) -> list[Fault]:
    """Return misreadings of one kind with the prior odds of that kind, which they share equally."""
    alternatives = list(kind)
    share = float(np.log(EXPECTED_COUNT / max(len(alternatives), 1)))
    return [replace(one, log_odds=one.log_odds + share) for one in alternatives]


def _each_and_all(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Rows]:
    """Yield the rows of each setup, and those of all setups of a campaign together."""
    by_campaign: dict[int, list[Rows]] = {}
    for rows in rows_by_setup.values():
        by_campaign.setdefault(_campaign_index(problem, rows), []).append(rows)
    yield from rows_by_setup.values()
    yield from (np.sort(np.concatenate(each)) for each in by_campaign.values() if len(each) > 1)


def _signs(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Fault]:
    for rows in _each_and_all(problem, rows_by_setup):
        yield Fault("sign", rows, -1.0)


def _units(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Fault]:
    for rows in _each_and_all(problem, rows_by_setup):
        sigma = problem.reading_sd[rows]
        for factor in UNIT_MISTAKES:
            fault = Fault("unit", rows, factor)
            # The rounding of a reading is rescaled with it, so no precision is gained.
            finest = _finest_step(problem.measured[rows])
            noise = np.hypot(sigma, factor * finest / np.sqrt(12))
            density = float(np.sum(np.log(factor * sigma / noise)))
            yield replace(fault, log_odds=density + _digit_evidence(problem, fault))


def _finest_step(readings: Array) -> float:
    """Return the step in which readings are written, metres; 0 if there is none."""
    return next((step for step in _WRITTEN_STEPS if on_grid(readings, step, 1e-3)), 0.0)


def _labels(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Fault]:
    for s, rows in rows_by_setup.items():
        setup = problem.setups[s]
        for label in set(permutations(range(3), 2)) - {(setup.leg, setup.axis)}:
            if not _is_label_taken(problem, s, label):
                yield Fault("label", rows, label=label)


def _exchanges(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Fault]:
    for a, b in combinations(rows_by_setup.values(), 2):
        if _campaign_index(problem, a) != _campaign_index(problem, b):
            continue
        rows = np.concatenate([a, b])
        if len(a) == len(b):
            yield Fault("exchanged_labels", rows, 0.0)  # exchanged columns: of readings
        # At equal commands in equal order, exchanged labels are the same as exchanged columns.
        commands = problem.dial_column("command")
        if len(a) != len(b) or not np.allclose(commands[a], commands[b], atol=1e-6):
            yield Fault("exchanged_labels", rows, 1.0)


def _shifts(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Fault]:
    for rows in rows_by_setup.values():
        for by in (1, -1):
            # The last of readings that stand too late is lost, or else the first.
            sigma = float(problem.reading_sd[rows[-1 if by > 0 else 0]])
            odds = float(np.log(sigma * np.sqrt(2 * np.pi) / _LOST_RANGE))
            yield Fault("shifted", rows, float(by), log_odds=odds)


def _stuck(problem: Problem, rows_by_setup: RowsBySetup) -> Iterator[Fault]:
    """Yield every run of equal readings over several postures that is long enough."""
    reading_count = sum(map(len, rows_by_setup.values()))
    for rows in rows_by_setup.values():
        commands = problem.dial_column("command")
        finest = max(_finest_step(problem.measured[rows]), 1e-7)
        cuts = np.flatnonzero(np.diff(problem.measured[rows]) != 0) + 1
        for run in np.split(rows, cuts):
            if len(run) < _FEWEST_STUCK:
                continue
            if len(np.unique(commands[run], axis=0)) == 1:
                continue
            sigma = problem.reading_sd[run]
            step = max(float(problem.resolution[run].max()), finest)
            # A stuck dial shows all but the first reading with certainty; a working one with the
            # probability of its rounding step at most.
            odds = float(np.log(np.maximum(sigma * np.sqrt(2 * np.pi) / step, 1.0))[1:].sum())
            odds -= float(np.log(reading_count))  # it may begin at any of them
            if len(run) < len(rows):  # otherwise the first reading is the datum
                odds += float(np.log(sigma[0] * np.sqrt(2 * np.pi) / _LOST_RANGE))
            yield Fault("stuck", run, log_odds=odds)


def _campaign_index(problem: Problem, rows: Rows) -> int:
    return factors_and_rows(problem, rows[:1])[0][0]


def _is_label_taken(problem: Problem, setup: int, label: tuple[int, int]) -> bool:
    """Return whether another dial reads a leg along an axis at the same place and time."""
    rows = np.flatnonzero(problem.setup_of_row == setup)
    k = _campaign_index(problem, rows)
    campaign = problem.campaigns[k]
    times = campaign.order[rows - problem.leg_rows[k].start]
    place = (*label, problem.setups[setup].gauge, problem.setups[setup].bar)
    for number, other in enumerate(campaign.setups):
        if (other.leg, other.axis, other.gauge, other.bar) == place:
            other_times = campaign.order[campaign.setup == number]
            if other_times.min() <= times.max() and times.min() <= other_times.max():
                return True
    return False


def _digit_evidence(problem: Problem, fault: Fault) -> float:
    """Return the log Bayes factor of the digits for a unit: a dial shows multiples of its step in
    its unit.
    """
    step, rows, factor = problem.machine.spec.dial.resolution, fault.rows, fault.size
    if step <= 0 or not on_grid(np.delete(problem.dial_column("reading"), rows), step):
        return 0.0
    readings = problem.measured[rows]
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


def level_readings(problem: Problem) -> dict[str, Fault]:
    """Return other interpretations of the readings of all levels, by the words that name each and
    its remedy; they share their prior odds equally.
    """
    rows = np.flatnonzero(problem.angular)
    axis = problem.column("axis")[rows]
    interpretations = {
        "with the opposite sign: look which way it counts, right-handed about x and y, and put -x "
        "and -y as directions": Fault("sign", rows, -1.0),
        "with x and y exchanged: correct the directions": Fault("exchanged_labels", rows, 1.0),
        "as degrees: put them into milliradians, 17.45 a degree": Fault("unit", rows, _DEGREE),
    }
    for k, name in enumerate("xy" if len(np.unique(axis)) > 1 else ""):
        clause = f"with the opposite sign about {name}: look which way it counts there, and put "
        interpretations[f"{clause}-{name} as direction"] = Fault("sign", rows[axis == k], -1.0)
    return dict(zip(interpretations, _sharing_prior(interpretations.values()), strict=True))


HAND_TURNS = (1e-3, 5e-4, 2e-4, 2.54e-3, 2.54e-4)
"""Travel by one turn of the large hand of a dial, metres; the most usual first."""

_DIVISION_RANGE = (40, 300)
"""Fewest and most divisions of a turn. Dials have 50 (0.5 mm by hundredths) to 200, and 254 appear
where inches were converted (2.54 mm by hundredths); the next ones, 25 and 500, are no dials: 0.254
mm by hundredths and 0.5 mm by thousandths. The limits lie between."""
_USUAL_DIVISIONS = (100, 200)  # divisions of most dials
_ROUNDS = 4  # corrections of the turns: the 1 090 fits of the tests settled within four
_EQUAL_DECIMALS = 9  # decimals of a metre: five turns of 0.2 mm are one of 1 mm


def turn_alternatives(
    problem: Problem,
    likelihoods: Sequence[FullLikelihood],
    deletions: Sequence[Mapping[int, Deletion]],
    rows_by_setup: RowsBySetup,
) -> list[Fault]:
    """Return the likeliest whole turns by which readings of each setup, or of all, are off.

    Args:
        problem: the readings.
        likelihoods: their likelihood under several backgrounds.
        deletions: of each of these, every setup against its prediction by all others.
        rows_by_setup: rows of each setup without a misreading.
    """
    found: dict[bytes, Fault] = {}
    least, most = _DIVISION_RANGE
    steps = {s: float(problem.resolution[rows].max()) for s, rows in rows_by_setup.items()}
    for likelihood, deletion in zip(likelihoods, deletions, strict=True):
        for turn in HAND_TURNS:
            # Dials whose step, 0 if unknown, allows such a hand.
            able = [s for s, step in steps.items() if not step or least <= turn / step <= most]
            dials = {s: rows_by_setup[s] for s in able}
            per_setup = np.zeros((len(dials), len(problem.measured)))
            for off, (s, rows) in zip(per_setup, dials.items(), strict=True):
                off[rows] = turn * _whole_turns(deletion[s].difference, turn)
            for off in (*per_setup, _joint_turns(likelihood, dials, turn)):
                if any(_are_turns(off[rows], problem.station[rows]) for rows in dials.values()):
                    alternative = _turn_alternative(problem, dials, off, turn)
                    found.setdefault((np.round(off, _EQUAL_DECIMALS) + 0.0).tobytes(), alternative)
    return list(found.values())


def _are_turns(off: Array, station: Rows) -> bool:
    """Return whether readings in time order ``(k,)`` may be off by turns.

    A single one is a slip, and a single step is a knocked stand. At least half of the affected
    stations must be off by the same number of turns at every visit, because the hand stands at one
    division.
    """
    affected = np.unique(station[off != 0])
    constant = sum(np.ptp(off[station == s]) == 0 for s in affected)
    steps = np.count_nonzero(np.diff(off))
    return bool(np.count_nonzero(off) > 1 and steps > 1 and 2 * constant >= len(affected))


def _turn_alternative(problem: Problem, dials: RowsBySetup, off: Array, turn: float) -> Fault:
    affected = [rows for rows in dials.values() if off[rows].any()]
    log_cost = sum(_log_cost_of_turns(problem, rows, off[rows], turn) for rows in affected)
    all_rows = np.flatnonzero(off)
    log_odds, sizes = float(np.log(EXPECTED_COUNT)) - log_cost, tuple(off[all_rows].tolist())
    return Fault("turns", all_rows, turn, sizes=sizes, log_odds=log_odds)


def _whole_turns(residual: Array, turn: float) -> Array:
    """Return the whole turns in the residual of a setup ``(k,)``, whose datum is free, relative to
    their most frequent number.
    """
    turns = residual / turn
    datum = np.angle(np.exp(2j * np.pi * turns).sum()) / (2 * np.pi)
    whole = np.rint(turns - datum)
    values, count = np.unique(whole, return_counts=True)
    return np.asarray(whole - values[count.argmax()])


def _joint_turns(likelihood: FullLikelihood, rows: RowsBySetup, turn: float) -> Array:
    """Return the whole turns of all setups at once ``(n,)``, metres; zeros if not converged."""
    residual = likelihood.weighing.metres(likelihood.residual)
    last = np.zeros(len(residual))
    for _ in range(_ROUNDS):
        off = np.zeros(len(residual))
        for setup_rows in rows.values():
            off[setup_rows] = turn * _whole_turns(residual[setup_rows], turn)
        if np.array_equal(off, last):
            return off
        residual, last = off + likelihood.expected_noise(-off), off
    return np.zeros(len(residual))


def _log_cost_of_turns(problem: Problem, rows: Rows, off: Array, turn: float) -> float:
    """Return the log number of equally plausible ways in which a setup is off by turns, up or down:
    by one turn from some station on, if all readings lie within a turn, or each station by up to
    its number of turns. Dials with other or unknown divisions than the usual ones cost more.
    """
    step = float(problem.resolution[rows].max())  # 0 if unknown
    usual = np.isclose(step * np.array(_USUAL_DIVISIONS), turn, rtol=0.01).any()
    unusual = 0.0 if usual else TWENTY_TO_ONE
    stations, index = np.unique(problem.station[rows], return_inverse=True)
    whole = np.zeros(len(stations))
    np.maximum.at(whole, index.reshape(-1), np.abs(off) / turn)
    by_station = np.log(2 * len(stations) * whole[whole > 0]).sum()
    one_turn = float(np.ptp(problem.measured[rows])) < turn
    return unusual + float(min(by_station, np.log(2 * len(stations)) if one_turn else np.inf))
