"""Faults of the data in credible sets: those that are sure, and those that may be a cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.credible_sets import CREDIBLE_WITH_DATA_FAULT, LEAST_CLAIMED_PROBABILITY
from orthoglide.explanation.fault_columns import FaultColumns, FaultKey
from orthoglide.explanation.faults import Fault, factors_and_rows
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.ordering import descending, largest

EVEN_PROBABILITY = 0.5  # probability above which something is more probable than not

_NEIGHBOUR_DISTANCE = (
    1.6  # times the distance of the nearest touch: the next across a square's diagonal
)

_LEAST_SHARE = float(np.exp(-3.0))
"""Smallest probability, relative to the likeliest drive, at which another drive is also reported as
the one whose command is wrong: one in twenty, below which it would not be in a 95 % set."""


@dataclass(frozen=True, eq=False)
class _FaultReader:
    """Reads data faults from a posterior."""

    posterior: FullPosterior

    @cached_property
    def is_data_fault(self) -> NDArray[np.bool_]:
        """Which groups are data faults ``(groups,)``."""
        groups = self.posterior.mixture.linear.groups
        return np.array([g.of_data for g in groups], dtype=bool)

    @cached_property
    def alternatives(self) -> Alternatives:
        return Alternatives(self.posterior.mixture)

    @cached_property
    def columns_by_name(self) -> dict[str, FaultColumns]:
        return {s.name: s for s in self.posterior.linearised.suspects}

    def members(self) -> Iterator[tuple[int, Array]]:
        """Yield each group of the best state, with the probability of every group in its place."""
        for member in self.posterior.mixture.strongest:
            yield member, self.alternatives.probabilities(member)[:-1]

    def fault_columns(self, group: int) -> FaultColumns:
        """Return the data fault of a group."""
        return self.columns_by_name[self.posterior.mixture.linear.groups[group].name]

    def fault(self, member: int, group: int) -> Fault:
        """Return the data fault of a group in the place of a member, with its estimated size."""
        at = self.posterior.mixture.linear.groups[group].coefficients
        mean, _ = self.alternatives.moments(member, group, at)
        return self.fault_columns(group).with_sizes(mean[at])


def certain_data_faults(posterior: FullPosterior) -> list[Fault]:
    """Return the data faults that are certain enough to correct, with their estimated sizes.

    The fault and its alternatives together are active with a probability of at least 0.9, and data
    faults account for at least 99 % of that. A touch of a plate is left out if a neighbouring touch
    is an outlier too, because the plate then has a shape error.
    """
    reader, found = _FaultReader(posterior), list[Fault]()
    for member, every in reader.members():
        odds = every * reader.is_data_fault
        if (
            not reader.is_data_fault[member]
            or every.sum() < LEAST_CLAIMED_PROBABILITY
            or odds.sum() < CREDIBLE_WITH_DATA_FAULT * every.sum()
        ):
            continue
        best, *others = descending(odds)
        fault = reader.fault(member, best)
        for k in (k for k in others if odds[k] > _LEAST_SHARE * odds[best]):
            other = reader.fault_columns(k).fault
            if fault.commands and other.commands and np.array_equal(other.rows, fault.rows):
                more = reader.fault(member, k).commands
                fault = replace(fault, commands=(*fault.commands, *more))
            elif other.kind != fault.kind and not fault.alternatives:
                fault = replace(fault, alternatives=(reader.fault(member, k),))
        found.append(fault)
    return [f for f in found if not _has_faulty_neighbour(posterior.before.problem, f, found)]


def probable_faults(posterior: FullPosterior) -> list[tuple[Fault, float]]:
    """Return the data faults that are more probable than not, each with its probability, where the
    fault and its alternatives together have less than the 0.9 of a claim.
    """
    reader, found = _FaultReader(posterior), list[tuple[Fault, float]]()
    for member, odds in reader.members():
        best = largest(odds)
        if (
            odds.sum() < LEAST_CLAIMED_PROBABILITY
            and odds[best] > EVEN_PROBABILITY
            and reader.is_data_fault[best]
        ):
            found.append((reader.fault(member, best), float(odds[best])))
    return found


def ambiguous_faults(posterior: FullPosterior) -> frozenset[FaultKey]:
    """Return the data faults that the readings do not separate from an error of the machine.

    Something is active with a probability of at least 0.9, but data faults account for less than
    99 % of that probability.
    """
    reader, found = _FaultReader(posterior), set[FaultKey]()
    for _, odds in reader.members():
        if (
            odds.sum() < LEAST_CLAIMED_PROBABILITY
            or (odds * reader.is_data_fault).sum() >= CREDIBLE_WITH_DATA_FAULT * odds.sum()
        ):
            continue
        near = odds > (1 - CREDIBLE_WITH_DATA_FAULT) * odds.max(initial=0.0)
        for k in np.flatnonzero(reader.is_data_fault & near).tolist():
            found.add(reader.fault_columns(k).key(posterior.linearised.problem))
    return frozenset(found)


def _has_faulty_neighbour(problem: Problem, fault: Fault, others: Sequence[Fault]) -> bool:
    """Whether a touch of a plate lies beside others that are off as well: then the plate has a
    shape, and none of them slipped.
    """
    k, row = factors_and_rows(problem, fault.rows)[0]
    factor = problem.factors[k]
    if fault.kind != "outlier" or not factor.readings.touching[row]:
        return False
    start, place = problem.factor_rows[k].start, factor.normalized_plate_xy
    off = [f.rows[0] - start for f in others if f.kind == "outlier" and f is not fault
           and f.setups == fault.setups]  # fmt: skip
    apart = np.linalg.norm(place - place[row], axis=1)
    here = apart[(factor.setup == factor.setup[row]) & (apart > 0)]
    return bool(len(here) and any(apart[o] < _NEIGHBOUR_DISTANCE * here.min() for o in off))
