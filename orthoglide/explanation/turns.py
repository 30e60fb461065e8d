"""Readings that are whole turns of the dial's hand off: nobody read the small hand, which counts
them, or somebody misread it.

Where only the large hand was read, all readings of a setup lie within one turn. How many turns each
lacks is rounded from what all other readings foretell of a setup; of all setups at once, from the
machine as it was, then from what the readings with these turns put right leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from orthoglide.explanation.alternative_readings import EXPECTED, Alternative
from orthoglide.explanation.faults import Fault, Rows
from orthoglide.explanation.wide import Wide
from orthoglide.fit import Problem
from orthoglide.geometry import Array

TURNS = (1e-3, 5e-4, 2e-4, 2.54e-3, 2.54e-4)
"""What the large hand of a dial shows by one turn, metres; the most usual first."""

_DIVISIONS = (40, 300)  # of a turn, that a dial may have
_USUAL = (100, 200)  # that most have
_UNUSUAL = 3.0  # log odds against others
_ROUNDS = 4  # of readings with their turns put right
_SAME = 9  # decimals of a metre: five turns of 0.2 mm are one of 1 mm


def turned(
    problem: Problem, several: Sequence[Wide], order: Mapping[int, Rows]
) -> list[Alternative]:
    """Whole turns that readings of each setup, or of several together, are likeliest to be off.

    Args:
        problem: the readings.
        several: the same on machines of several backgrounds.
        order: rows of each setup in which no such fault is known.
    """
    found: dict[bytes, Alternative] = {}
    least, most = _DIVISIONS
    for wide in several:
        by_others = {s: wide.foretold(own).off for s, own in order.items()}
        for turn in TURNS:
            # What the hand of a dial of some step, 0 where there is none, may show by a turn.
            steps = {s: float(problem.step[own].max()) for s, own in order.items()}
            rows = {s: order[s] for s, d in steps.items() if not d or least <= turn / d <= most}
            alone = np.zeros((len(rows), len(problem.measured)))
            for off, (s, own) in zip(alone, rows.items(), strict=True):
                off[own] = turn * _whole(by_others[s], turn)
            for off in (*alone, _together(wide, rows, turn)):
                if any(_turns(off[own], problem.station[own]) for own in rows.values()):
                    one = _alternative(problem, rows, off, turn)
                    found.setdefault((np.round(off, _SAME) + 0.0).tobytes(), one)
    return list(found.values())


def _turns(off: Array, station: Rows) -> bool:
    """Whether readings in time order ``(k,)`` may be turns off: a single one is a slip, all from
    some moment on are a stand that was knocked, and what was at one visit to most places and not at
    the next is no reading of a hand.
    """
    hit = np.unique(station[off != 0])
    alike = sum(np.ptp(off[station == s]) == 0 for s in hit)
    steps = np.count_nonzero(np.diff(off))
    return bool(np.count_nonzero(off) > 1 and steps > 1 and 2 * alike >= len(hit))


def _alternative(
    problem: Problem, rows: Mapping[int, Rows], off: Array, turn: float
) -> Alternative:
    hit = tuple(s for s, own in rows.items() if off[own].any())
    tried = sum(_tried(problem, rows[s], off[rows[s]], turn) for s in hit)
    spoilt = np.flatnonzero(off)
    fault = Fault("turns", spoilt, hit, turn, sizes=tuple(off[spoilt].tolist()))
    return Alternative(fault, -off, float(np.log(EXPECTED)) - tried)


def _whole(left: Array, turn: float) -> Array:
    """Whole turns in what a fit leaves of a setup's readings ``(k,)``, whatever its datum; none in
    most of them.
    """
    share = left / turn
    datum = np.angle(np.exp(2j * np.pi * share).sum()) / (2 * np.pi)
    whole = np.rint(share - datum)
    values, count = np.unique(whole, return_counts=True)
    return np.asarray(whole - values[count.argmax()])


def _together(wide: Wide, rows: Mapping[int, Rows], turn: float) -> Array:
    """Whole turns of all setups at once ``(n,)``, metres; zeros where they do not settle."""
    left = wide.weighing.metres(wide.residual)
    before = np.zeros(len(left))
    for _ in range(_ROUNDS):
        off = np.zeros(len(left))
        for own in rows.values():
            off[own] = turn * _whole(left[own], turn)
        if np.array_equal(off, before):
            return off
        left, before = off + wide.noise(-off), off
    return np.zeros(len(left))


def _tried(problem: Problem, own: Rows, off: Array, turn: float) -> float:
    """Log number of ways in which a setup may be so far off: all within one turn, wherever that
    begins, or each station by as many turns either way.
    """
    divisions = turn / max(float(problem.step[own].max()), 1e-300)
    unusual = 0.0 if np.isclose(divisions, _USUAL, rtol=0.01).any() else _UNUSUAL
    stations, first = np.unique(problem.station[own], return_index=True)
    several = np.abs(off[first]) / turn
    each = np.log(2 * len(stations) * several[several > 0]).sum()
    within = float(np.ptp(problem.measured[own])) < turn
    return unusual + float(min(each, np.log(2 * len(stations)) if within else np.inf))
