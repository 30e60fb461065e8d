"""Which other data the readings may be: the likeliest of a list, by one factorisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from orthoglide.explanation.alternative_readings import Alternative, alternatives, restored
from orthoglide.explanation.columns import Everything
from orthoglide.explanation.everything import FullPosterior
from orthoglide.explanation.faults import Rows, campaign_of
from orthoglide.explanation.turns import turned
from orthoglide.explanation.wide import DATUM, Wide, in_deviations
from orthoglide.ordering import EQUAL_ODDS, descending

_MOST = 10_000  # readings: of more, four matrices of readings by unknowns take over 0.4 GB
_BEST = 5  # alternatives that are searched in full

_SCALES = ((0.01, 0.003), (0.1, 0.1), (1.0, 0.1), (1.0, 3.0))
"""Tolerances by which everything may be off, and units by which free functions may."""


def ranked(known: FullPosterior, order: Mapping[int, Rows]) -> list[tuple[float, Alternative]]:
    """The likeliest of other data, those that fit better than the readings as they stand do, with
    by how much.

    Args:
        known: the readings as they stand.
        order: rows of each setup in which no such fault is known, in the order they were taken.
    """
    about = known.about
    if len(about.value) > _MOST:
        return []
    several = alternatives(about.problem, order)
    if not several:
        return []
    wide = [Wide.of(about, *scales) for scales in _SCALES]
    several = [*several, *turned(about.problem, wide, order)]
    nothing = np.zeros((len(about.value), 1))
    each = np.array([w.score(nothing)[0] for w in wide])
    plain = np.logaddexp.reduce(each)
    odd = {s: max(p + w.odd(rows) for p, w in zip(each, wide, strict=True)) - plain
           for s, rows in order.items()}  # fmt: skip
    changes = np.stack([one.change for one in several], axis=1)
    by_scale = np.stack([w.score(changes) for w in wide])
    scores = np.logaddexp.reduce(by_scale, axis=0)
    # Beside faults that stand out of the readings as they are, or in place of them.
    beside, cost = _with_faults_out(known)
    if cost:
        again = [Wide.of(beside, *scales) for scales in _SCALES]
        plain = max(plain, np.logaddexp.reduce([w.score(nothing)[0] for w in again]) - cost)
        scores = np.maximum(scores, np.logaddexp.reduce([w.score(changes) for w in again]) - cost)
    by_others: dict[tuple[int, ...], int] = {}  # scales that the readings of other setups speak for
    for k, one in enumerate(several):
        if one.labels and one.odds + sum(odd[s] for s in one.labels) < 0:
            scores[k] = -np.inf
        elif one.labels:
            setups = one.fault.setups
            if setups not in by_others:
                rest = [p + w.without(one.fault.rows) for p, w in zip(each, wide, strict=True)]
                by_others[setups] = int(np.argmax(rest))
            at = by_others[setups]
            scores[k] = _labelled(about, wide[at], _SCALES[at], one)
        elif len(one.silent):
            change = one.change if one.change.any() else None
            alone = [p + w.without(one.silent, change)
                     for p, w in zip(by_scale[:, k], wide, strict=True)]  # fmt: skip
            scores[k] = np.logaddexp.reduce(alone)
    gains = scores + np.array([one.odds for one in several]) - plain
    best = descending(gains, EQUAL_ODDS)[:_BEST]
    return [(float(gains[k]), several[k]) for k in best if gains[k] > 0]


def _with_faults_out(known: FullPosterior) -> tuple[Everything, float]:
    """Everything with faults of the data that stand out of the readings as they are, and the log
    odds against these.
    """
    about, linear, cost = known.about, known.about.linear, 0.0
    fixed = linear.fixed.copy()
    for k, tau in known.mixture.best:
        if linear.groups[k].of_data:
            fixed[linear.groups[k].places] = tau
            cost += float(known.mixture.cost[k])
    return replace(about, linear=replace(linear, fixed=fixed)), cost


def _labelled(
    about: Everything, wide: Wide, scales: tuple[float, float], one: Alternative
) -> float:
    """Log likelihood of readings under other labels, of which the places are not known."""
    problem, changed = about.problem, np.sort(one.fault.rows)
    k = campaign_of(problem, changed)
    factor = restored(problem, one.fault).factors[k].subset(changed - problem.rows[k].start)
    names, matrix = problem.elementary(k)
    here = factor.linearise(problem.machine.model, problem.values(k, about.at), names)
    jacobian = here.jacobian @ matrix
    count = jacobian.shape[1]
    rows = np.zeros((len(changed), about.rows.shape[1]))
    rows[:, :count] = jacobian * about.scale[:count]
    rows[:, ~about.rows.any(axis=0)] = 0.0
    part = wide.weighing.part(changed)
    columns, expected = in_deviations(about, rows, *scales)
    rest = problem.measured[changed] - here.value + jacobian @ about.at - expected
    own = factor.nuisances(here.seen)
    instrument = part.whiten(own.columns * np.minimum(own.sd, DATUM))
    return wide.relabelled(changed, part.whiten(columns), instrument, part.whiten(rest))
