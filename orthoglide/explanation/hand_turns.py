"""Whole turns of a dial's hand by which readings are off.

The small hand, which counts the turns, was not read or was misread. If only the large hand was
read, all readings of a setup lie within one turn. The missing turns of a setup are rounded from its
deletion residual; those of all setups at once from the residual of the readings, and then from the
residual that remains with these turns corrected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from orthoglide.explanation.alternative_readings import EXPECTED_COUNT, RowsBySetup
from orthoglide.explanation.faults import Fault, Rows
from orthoglide.explanation.full_likelihood import Deletion, FullLikelihood
from orthoglide.explanation.linear_model import TWENTY_TO_ONE
from orthoglide.fit import Problem
from orthoglide.geometry import Array

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
