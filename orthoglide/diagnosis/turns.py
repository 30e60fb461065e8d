"""Readings that are whole turns of the dial's hand off: nobody read the small hand, which counts
them, or somebody misread it.

Where only the large hand was read, all readings of a setup lie within one turn. How many turns each
lacks is rounded from what a fit leaves: of one setup, a fit to all others; of all setups at once,
the machine as it was before the fit, then fits to the readings with these turns put right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from orthoglide.diagnosis.command_faults import begun
from orthoglide.diagnosis.faults import Fault, Rows, in_order
from orthoglide.diagnosis.misreadings import Misreading
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.diagnosis.stuck_faults import left_by_others
from orthoglide.fit import Problem
from orthoglide.geometry import Array

TURNS = (1e-3, 5e-4, 2e-4, 2.54e-3, 2.54e-4)
"""What the large hand of a dial shows by one turn, metres; the most usual first."""

_DIVISIONS = (40, 300)  # of a turn, that a dial may have
_USUAL = (100, 200)  # that most have
_UNUSUAL = 3.0  # log odds against others
_ROUNDS = 4  # of fits to readings with their turns put right
_SAME = 9  # decimals of a metre: five turns of 0.2 mm are one of 1 mm


def turned(means: StationMeans, setups: Sequence[int]) -> list[Misreading]:
    """Whole turns that readings of each setup, or of several together, are likeliest to be off.

    The evidence that each begins with is the logarithm of how many alike there are.
    """
    problem = means.problem
    base = begun(means)
    each = {s: in_order(problem, s) for s in setups}
    by_others = {s: left_by_others(base, own) for s, own in each.items()}
    found: dict[bytes, Misreading] = {}
    least, most = _DIVISIONS
    for turn in TURNS:
        # What the hand of a dial of some step, 0 where there is none, may show by a turn.
        steps = {s: float(problem.step[own].max()) for s, own in each.items()}
        rows = {s: each[s] for s, d in steps.items() if not d or least <= turn / d <= most}
        alone = np.zeros((len(rows), len(problem.measured)))
        for off, (s, own) in zip(alone, rows.items(), strict=True):
            off[own] = turn * _whole(by_others[s], turn)
        for off in (*alone, _together(base, rows, turn)):
            if off.any():
                hit = tuple(s for s, own in rows.items() if off[own].any())
                tried = sum(_tried(problem, rows[s], off[rows[s]], turn) for s in hit)
                spoilt = np.flatnonzero(off)
                sizes = tuple(off[spoilt].tolist())
                fault = Fault("turns", spoilt, hit, turn, -tried, sizes=sizes)
                found.setdefault((np.round(off, _SAME) + 0.0).tobytes(), Misreading(fault, -off))
    return list(found.values())


def _whole(left: Array, turn: float) -> Array:
    """Whole turns in what a fit leaves of a setup's readings ``(k,)``, whatever its datum; none in
    most of them.
    """
    share = left / turn
    datum = np.angle(np.exp(2j * np.pi * share).sum()) / (2 * np.pi)
    whole = np.rint(share - datum)
    values, count = np.unique(whole, return_counts=True)
    return np.asarray(whole - values[count.argmax()])


def _together(base: Signatures, rows: Mapping[int, Rows], turn: float) -> Array:
    """Whole turns of all setups at once ``(n,)``, metres; zeros where they do not settle."""
    estimate = base.estimate
    left = estimate.problem.measured - estimate.at.value
    before = np.zeros(len(left))
    for _ in range(_ROUNDS):
        off = np.zeros(len(left))
        for own in rows.values():
            off[own] = turn * _whole(left[own], turn)
        if np.array_equal(off, before):
            return off
        fitted = (base.residual - base.whiten(off))[: base.count]
        left, before = off + estimate.nuisance.weighing.metres(fitted), off
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
