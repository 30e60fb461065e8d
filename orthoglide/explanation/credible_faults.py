"""Faults of the data in credible sets: those that are sure, and those that may be a cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.everything import FullPosterior
from orthoglide.explanation.faults import Fault, places
from orthoglide.explanation.outstanding import NAMED, SURE
from orthoglide.explanation.suspects import Key, Suspect
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.ordering import descending, largest

EVEN = 0.5  # probability above which something is more probable than not

_NEIGHBOURS = 1.6  # times the distance of the nearest touch: the next across a square's diagonal

_LEAST_SHARE = float(np.exp(-3.0))
"""Smallest probability, relative to the likeliest drive, at which another drive is also reported as
the one whose command is wrong: one in twenty, below which it would not be in a 95 % set."""


@dataclass(frozen=True, eq=False)
class _Reader:
    """Reads data faults from a posterior."""

    posterior: FullPosterior

    @cached_property
    def data(self) -> NDArray[np.bool_]:
        """Which groups are data faults ``(groups,)``."""
        groups = self.posterior.mixture.linear.groups
        return np.array([g.of_data for g in groups], dtype=bool)

    @cached_property
    def alternatives(self) -> Alternatives:
        return Alternatives(self.posterior.mixture)

    @cached_property
    def by_name(self) -> dict[str, Suspect]:
        return {s.name: s for s in self.posterior.about.suspects}

    def members(self) -> Iterator[tuple[int, Array]]:
        """Yield each group of the best state, with the probability of every group in its place."""
        for member in self.posterior.mixture.strongest:
            yield member, self.alternatives.of(member)[:-1]

    def suspect(self, group: int) -> Suspect:
        """Return the data fault of a group."""
        return self.by_name[self.posterior.mixture.linear.groups[group].name]

    def fault(self, member: int, group: int) -> Fault:
        """Return the data fault of a group in the place of a member, with its estimated size."""
        at = self.posterior.mixture.linear.groups[group].places
        mean, _ = self.alternatives.moments(member, group, at)
        return self.suspect(group).sized(mean[at])


def certain_data_faults(posterior: FullPosterior) -> list[Fault]:
    """Return the data faults that are certain enough to correct, with their estimated sizes.

    The fault and its alternatives together are active with a probability of at least 0.9, and data
    faults account for at least 99 % of that. A touch of a plate is left out if a neighbouring touch
    is an outlier too, because the plate then has a shape error.
    """
    reader, found = _Reader(posterior), list[Fault]()
    for member, every in reader.members():
        odds = every * reader.data
        if not reader.data[member] or every.sum() < NAMED or odds.sum() < SURE * every.sum():
            continue
        best, *others = descending(odds)
        fault = reader.fault(member, best)
        for k in (k for k in others if odds[k] > _LEAST_SHARE * odds[best]):
            other = reader.suspect(k).fault
            if fault.commands and other.commands and np.array_equal(other.rows, fault.rows):
                more = reader.fault(member, k).commands
                fault = replace(fault, commands=(*fault.commands, *more))
        found.append(fault)
    return [f for f in found if not _beside(posterior.before.problem, f, found)]


def suspected(posterior: FullPosterior) -> list[tuple[Fault, float]]:
    """Return the data faults that are more probable than not, each with its probability, where the
    fault and its alternatives together have less than the 0.9 of a claim.
    """
    reader, found = _Reader(posterior), list[tuple[Fault, float]]()
    for member, odds in reader.members():
        best = largest(odds)
        if odds.sum() < NAMED and odds[best] > EVEN and reader.data[best]:
            found.append((reader.fault(member, best), float(odds[best])))
    return found


def unsure(posterior: FullPosterior) -> frozenset[Key]:
    """Return the data faults that the readings do not separate from an error of the machine.

    Something is active with a probability of at least 0.9, but data faults account for less than
    99 % of that probability.
    """
    reader, found = _Reader(posterior), set[Key]()
    for _, odds in reader.members():
        if odds.sum() < NAMED or (odds * reader.data).sum() >= SURE * odds.sum():
            continue
        near = odds > (1 - SURE) * odds.max(initial=0.0)
        for k in np.flatnonzero(reader.data & near).tolist():
            found.add(reader.suspect(k).key(posterior.about.problem))
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
