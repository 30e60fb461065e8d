"""The likeliest of other data that the readings may be, by one factorisation of each.

Whole turns of the dial's hand are among them: nobody read the small hand, which counts them, or
somebody misread it. Where only the large hand was read, all readings of a setup lie within one
turn. How many turns each lacks is rounded from what all other readings foretell of a setup; of all
setups at once, from the machine as it was, then from what the readings with these turns corrected
leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from orthoglide.explanation.alternative_readings import (
    EXPECTED_COUNT,
    AlternativeReadings,
    list_alternative_readings,
    with_misreading_corrected,
)
from orthoglide.explanation.columns import LinearisedModel
from orthoglide.explanation.faults import Fault, Rows, campaign_index
from orthoglide.explanation.full_likelihood import (
    WIDEST_DATUM,
    FullLikelihood,
    in_standard_deviations,
)
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_MOST_READINGS = 10_000  # readings: of more, four matrices of readings by unknowns take over 0.4 GB
_MOST_RANKED = 5  # alternatives that are searched in full

_BACKGROUND_SCALES = ((0.01, 0.003), (0.1, 0.1), (1.0, 0.1), (1.0, 3.0))
"""Tolerances by which everything may be off, and units by which free functions may."""


def rank_alternative_readings(
    known: FullPosterior, order: Mapping[int, Rows]
) -> list[tuple[float, AlternativeReadings]]:
    """The likeliest of other data, those that fit better than the readings as they stand do, with
    by how much.

    Args:
        known: the readings as they stand.
        order: rows of each setup in which no such fault is known, in the order they were taken.
    """
    about = known.linearised
    if len(about.value_at_zero) > _MOST_READINGS:
        return []
    several = list_alternative_readings(about.problem, order)
    if not several:
        return []
    wide = [FullLikelihood.from_linear_model(about, *scales) for scales in _BACKGROUND_SCALES]
    several = [*several, *turn_alternatives(about.problem, wide, order)]
    nothing = np.zeros((len(about.value_at_zero), 1))
    each = np.array([w.log_likelihood(nothing)[0] for w in wide])
    plain = np.logaddexp.reduce(each)
    odd = {s: max(p + w.relabelling_bound(rows) for p, w in zip(each, wide, strict=True)) - plain
           for s, rows in order.items()}  # fmt: skip
    changes = np.stack([one.change for one in several], axis=1)
    by_scale = np.stack([w.log_likelihood(changes) for w in wide])
    scores = np.logaddexp.reduce(by_scale, axis=0)
    # Beside faults that stand out of the readings as they are, or in place of them.
    beside, cost = _with_active_faults_fixed(known)
    if cost:
        again = [FullLikelihood.from_linear_model(beside, *scales) for scales in _BACKGROUND_SCALES]
        plain = max(
            plain, np.logaddexp.reduce([w.log_likelihood(nothing)[0] for w in again]) - cost
        )
        scores = np.maximum(
            scores, np.logaddexp.reduce([w.log_likelihood(changes) for w in again]) - cost
        )
    by_others: dict[tuple[int, ...], int] = {}  # scales that the readings of other setups speak for
    for k, one in enumerate(several):
        if one.labels and one.log_odds + sum(odd[s] for s in one.labels) < 0:
            scores[k] = -np.inf
        elif one.labels:
            setups = one.fault.setups
            if setups not in by_others:
                rest = [
                    p + w.deletion_gain(one.fault.rows) for p, w in zip(each, wide, strict=True)
                ]
                by_others[setups] = int(np.argmax(rest))
            at = by_others[setups]
            scores[k] = _relabelled_log_likelihood(about, wide[at], _BACKGROUND_SCALES[at], one)
        elif len(one.zero_weight):
            change = one.change if one.change.any() else None
            alone = [p + w.deletion_gain(one.zero_weight, change)
                     for p, w in zip(by_scale[:, k], wide, strict=True)]  # fmt: skip
            scores[k] = np.logaddexp.reduce(alone)
    gains = scores + np.array([one.log_odds for one in several]) - plain
    best = descending(gains, LOG_ODDS_MARGIN)[:_MOST_RANKED]
    return [(float(gains[k]), several[k]) for k in best if gains[k] > 0]


def _with_active_faults_fixed(known: FullPosterior) -> tuple[LinearisedModel, float]:
    """Everything with faults of the data that stand out of the readings as they are, and the log
    odds against these.
    """
    about, linear, cost = known.linearised, known.linearised.linear, 0.0
    fixed = linear.fixed_sd.copy()
    for k, tau in known.mixture.best:
        if linear.groups[k].of_data:
            fixed[linear.groups[k].coefficients] = tau
            cost += float(known.mixture.cost[k])
    return replace(about, linear=replace(linear, fixed_sd=fixed)), cost


def _relabelled_log_likelihood(
    about: LinearisedModel,
    wide: FullLikelihood,
    scales: tuple[float, float],
    one: AlternativeReadings,
) -> float:
    """Log likelihood of readings under other labels, of which the places are not known."""
    problem, changed = about.problem, np.sort(one.fault.rows)
    k = campaign_index(problem, changed)
    factor = (
        with_misreading_corrected(problem, one.fault)
        .factors[k]
        .subset(changed - problem.leg_rows[k].start)
    )
    names, matrix = problem.elementary_parameters(k)
    here = factor.linearise(problem.machine.model, problem.values(k, about.point), names)
    jacobian = here.jacobian @ matrix
    count = jacobian.shape[1]
    rows = np.zeros((len(changed), about.rows.shape[1]))
    rows[:, :count] = jacobian * about.units[:count]
    rows[:, ~about.rows.any(axis=0)] = 0.0
    part = wide.weighing.subset(changed)
    columns, expected = in_standard_deviations(about, rows, *scales)
    rest = problem.measured[changed] - here.value + jacobian @ about.point - expected
    own = factor.nuisances(here.reading_poses)
    instrument = part.whiten(own.columns * np.minimum(own.sd, WIDEST_DATUM))
    return wide.relabelled_log_likelihood(
        changed, part.whiten(columns), instrument, part.whiten(rest)
    )


HAND_TURNS = (1e-3, 5e-4, 2e-4, 2.54e-3, 2.54e-4)
"""What the large hand of a dial shows by one turn, metres; the most usual first."""

_DIVISION_RANGE = (40, 300)  # of a turn, that a dial may have
_USUAL_DIVISIONS = (100, 200)  # that most have
_UNUSUAL_PENALTY = 3.0  # log odds against others
_ROUNDS = 4  # of readings with their turns put right
_EQUAL_DECIMALS = 9  # decimals of a metre: five turns of 0.2 mm are one of 1 mm


def turn_alternatives(
    problem: Problem, several: Sequence[FullLikelihood], order: Mapping[int, Rows]
) -> list[AlternativeReadings]:
    """Whole turns that readings of each setup, or of several together, are likeliest to be off.

    Args:
        problem: the readings.
        several: the same on machines of several backgrounds.
        order: rows of each setup in which no such fault is known.
    """
    found: dict[bytes, AlternativeReadings] = {}
    least, most = _DIVISION_RANGE
    for wide in several:
        by_others = {s: wide.deletion_residual(own).difference for s, own in order.items()}
        for turn in HAND_TURNS:
            # What the hand of a dial of some step, 0 where there is none, may show by a turn.
            steps = {s: float(problem.step[own].max()) for s, own in order.items()}
            rows = {s: order[s] for s, d in steps.items() if not d or least <= turn / d <= most}
            alone = np.zeros((len(rows), len(problem.measured)))
            for off, (s, own) in zip(alone, rows.items(), strict=True):
                off[own] = turn * _whole_turns(by_others[s], turn)
            for off in (*alone, _joint_turns(wide, rows, turn)):
                if any(_are_turns(off[own], problem.station[own]) for own in rows.values()):
                    one = _turn_alternative(problem, rows, off, turn)
                    found.setdefault((np.round(off, _EQUAL_DECIMALS) + 0.0).tobytes(), one)
    return list(found.values())


def _are_turns(off: Array, station: Rows) -> bool:
    """Whether readings in time order ``(k,)`` may be turns off: a single one is a slip, all from
    some moment on are a stand that was knocked, and what was at one visit to most places and not at
    the next is no reading of a hand.
    """
    hit = np.unique(station[off != 0])
    alike = sum(np.ptp(off[station == s]) == 0 for s in hit)
    steps = np.count_nonzero(np.diff(off))
    return bool(np.count_nonzero(off) > 1 and steps > 1 and 2 * alike >= len(hit))


def _turn_alternative(
    problem: Problem, rows: Mapping[int, Rows], off: Array, turn: float
) -> AlternativeReadings:
    hit = tuple(s for s, own in rows.items() if off[own].any())
    tried = sum(_log_count_of_turns(problem, rows[s], off[rows[s]], turn) for s in hit)
    spoilt = np.flatnonzero(off)
    fault = Fault("turns", spoilt, hit, turn, sizes=tuple(off[spoilt].tolist()))
    return AlternativeReadings(fault, -off, float(np.log(EXPECTED_COUNT)) - tried)


def _whole_turns(left: Array, turn: float) -> Array:
    """Whole turns in what a fit leaves of a setup's readings ``(k,)``, whatever its datum; none in
    most of them.
    """
    share = left / turn
    datum = np.angle(np.exp(2j * np.pi * share).sum()) / (2 * np.pi)
    whole = np.rint(share - datum)
    values, count = np.unique(whole, return_counts=True)
    return np.asarray(whole - values[count.argmax()])


def _joint_turns(wide: FullLikelihood, rows: Mapping[int, Rows], turn: float) -> Array:
    """Whole turns of all setups at once ``(n,)``, metres; zeros where they do not settle."""
    left = wide.weighing.metres(wide.residual)
    before = np.zeros(len(left))
    for _ in range(_ROUNDS):
        off = np.zeros(len(left))
        for own in rows.values():
            off[own] = turn * _whole_turns(left[own], turn)
        if np.array_equal(off, before):
            return off
        left, before = off + wide.expected_noise(-off), off
    return np.zeros(len(left))


def _log_count_of_turns(problem: Problem, own: Rows, off: Array, turn: float) -> float:
    """Log number of ways in which a setup may be so far off: all within one turn, wherever that
    begins, or each station by as many turns either way.
    """
    divisions = turn / max(float(problem.step[own].max()), 1e-300)
    unusual = 0.0 if np.isclose(divisions, _USUAL_DIVISIONS, rtol=0.01).any() else _UNUSUAL_PENALTY
    stations, first = np.unique(problem.station[own], return_index=True)
    several = np.abs(off[first]) / turn
    each = np.log(2 * len(stations) * several[several > 0]).sum()
    within = float(np.ptp(problem.measured[own])) < turn
    return unusual + float(min(each, np.log(2 * len(stations)) if within else np.inf))
