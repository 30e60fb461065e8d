"""Faults of the data in credible sets: those that are sure, and those that may be a cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.everything import FullPosterior
from orthoglide.explanation.faults import Fault, places
from orthoglide.explanation.outstanding import NAMED, SURE
from orthoglide.explanation.suspects import Key
from orthoglide.fit import Problem
from orthoglide.ordering import descending, largest

EVEN = 0.5  # probability above which something is more probable than not

_NEIGHBOURS = 1.6  # times the distance of the nearest touch: the next across a square's diagonal

_LEAST_SHARE = float(np.exp(-3.0))
"""Smallest probability, relative to the likeliest drive, at which another drive is also reported as
the one whose command is wrong: one in twenty, below which it would not be in a 95 % set."""


def certain_data_faults(posterior: FullPosterior) -> list[Fault]:
    """Return the data faults that are certain enough to correct, with their estimated sizes.

    The fault and its alternatives together are active with a probability of at least 0.9, and data
    faults account for at least 99 % of that. A touch of a plate is left out if a
    neighbouring touch is an outlier too, because the plate then has a shape error.
    """
    mixture, groups = posterior.mixture, posterior.mixture.linear.groups
    instead, data = Alternatives(mixture), np.array([g.of_data for g in groups], dtype=bool)
    by_name = {s.name: s for s in posterior.about.suspects}
    found = []
    for member in mixture.strongest:
        odds = instead.of(member)[:-1] * data
        every = instead.of(member)[:-1].sum()
        if not groups[member].of_data or every < NAMED or odds.sum() < SURE * every:
            continue
        best, *others = descending(odds)
        suspect, at = by_name[groups[best].name], groups[best].places
        mean, _ = instead.moments(member, best, at)
        fault = suspect.sized(mean[at])
        for k in (k for k in others if odds[k] > _LEAST_SHARE * odds[best]):
            other = by_name[groups[k].name]
            same = other.fault.commands and np.array_equal(other.fault.rows, fault.rows)
            if fault.commands and same:
                mean, _ = instead.moments(member, k, groups[k].places)
                more = other.sized(mean[groups[k].places])
                fault = replace(fault, commands=(*fault.commands, *more.commands))
        found.append(fault)
    return [f for f in found if not _beside(posterior.before.problem, f, found)]


def suspected(posterior: FullPosterior) -> list[tuple[Fault, float]]:
    """Return the data faults that are more probable than not, each with its probability, where the
    fault and its alternatives together have less than the 0.9 of a claim.
    """
    mixture, groups = posterior.mixture, posterior.mixture.linear.groups
    instead, data = Alternatives(mixture), np.array([g.of_data for g in groups], dtype=bool)
    by_name, found = {s.name: s for s in posterior.about.suspects}, []
    for member in mixture.strongest:
        odds = instead.of(member)[:-1]
        best = largest(odds)
        if odds.sum() < NAMED and odds[best] > EVEN and data[best]:
            mean, _ = instead.moments(member, best, at := groups[best].places)
            found.append((by_name[groups[best].name].sized(mean[at]), float(odds[best])))
    return found


def unsure(posterior: FullPosterior) -> frozenset[Key]:
    """Return the data faults that the readings do not separate from an error of the machine.

    Something is active with a probability of at least 0.9, but data faults account for less than
    99 % of that probability.
    """
    mixture, groups = posterior.mixture, posterior.mixture.linear.groups
    instead, data = Alternatives(mixture), np.array([g.of_data for g in groups], dtype=bool)
    by_name, problem = {s.name: s for s in posterior.about.suspects}, posterior.about.problem
    found = set()
    for member in mixture.strongest:
        odds = instead.of(member)[:-1]
        if odds.sum() < NAMED or (odds * data).sum() >= SURE * odds.sum():
            continue
        for k in np.flatnonzero(data & (odds > (1 - SURE) * odds.max(initial=0.0))):
            found.add(by_name[groups[k].name].key(problem))
    return frozenset(found)


def _beside(problem: Problem, fault: Fault, others: Sequence[Fault]) -> bool:
    """Whether a touch of a plate lies beside others that are off as well: then the plate has a
    shape, and none of them slipped.
    """
    k, row = places(problem, fault.rows)[0]
    factor = problem.factors[k]
    if fault.kind != "outlier" or not factor.readings.touching[row]:
        return False
    start, place = problem.factor_rows[k].start, factor.place
    off = [f.rows[0] - start for f in others if f.kind == "outlier" and f is not fault
           and f.setups == fault.setups]  # fmt: skip
    apart = np.linalg.norm(place - place[row], axis=1)
    here = apart[(factor.setup == factor.setup[row]) & (apart > 0)]
    return bool(len(here) and any(apart[o] < _NEIGHBOURS * here.min() for o in off))
