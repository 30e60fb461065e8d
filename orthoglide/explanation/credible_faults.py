"""Data faults in credible sets: certain, probable, and ambiguous with a cause of the machine."""

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

_NEIGHBOUR_DISTANCE = 1.6  # in distances of the nearest touch: includes a square's diagonal

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

    def members(self) -> Iterator[tuple[int, Array, bool]]:
        """Yield each group of the best state, the probability of every group in its place, and
        whether these amount to the 0.9 of a claim.
        """
        for member in self.posterior.mixture.groups_by_importance:
            probabilities = self.alternatives.probabilities(member)[:-1]
            yield member, probabilities, probabilities.sum() >= LEAST_CLAIMED_PROBABILITY

    def is_of_data(self, probabilities: Array) -> bool:
        """Return whether data faults account for at least 99 % of the probability of groups."""
        of_data = probabilities[self.is_data_fault].sum()
        return bool(of_data >= CREDIBLE_WITH_DATA_FAULT * probabilities.sum())

    def fault_columns(self, group: int) -> FaultColumns:
        """Return the data fault of a group."""
        return self.columns_by_name[self.posterior.mixture.linear.groups[group].name]

    def fault(self, member: int, group: int) -> Fault:
        """Return the data fault of a group in the place of a member, with its estimated size."""
        coefficients = self.posterior.mixture.linear.groups[group].coefficients
        mean, _ = self.alternatives.moments(member, group, coefficients)
        return self.fault_columns(group).with_sizes(mean[coefficients])


def certain_data_faults(posterior: FullPosterior) -> list[Fault]:
    """Return the data faults that are certain enough to correct, with their estimated sizes.

    The fault and its alternatives together are active with a probability of at least 0.9, and data
    faults account for at least 99 % of that. A touch of a plate is left out if a neighbouring touch
    is an outlier too, because the plate then has a shape error.
    """
    reader, faults = _FaultReader(posterior), list[Fault]()
    for member, probabilities, claimed in reader.members():
        if not (claimed and reader.is_data_fault[member] and reader.is_of_data(probabilities)):
            continue
        of_data = probabilities * reader.is_data_fault
        best, *others = descending(of_data)
        fault = reader.fault(member, best)
        for k in (k for k in others if of_data[k] > _LEAST_SHARE * of_data[best]):
            other = reader.fault_columns(k).fault
            if fault.commands and other.commands and np.array_equal(other.rows, fault.rows):
                commands = reader.fault(member, k).commands
                fault = replace(fault, commands=(*fault.commands, *commands))
            elif other.kind != fault.kind and not fault.alternatives:
                fault = replace(fault, alternatives=(reader.fault(member, k),))
        faults.append(fault)
    return [f for f in faults if not _has_faulty_neighbour(posterior.before.problem, f, faults)]


def probable_faults(posterior: FullPosterior) -> list[tuple[Fault, float]]:
    """Return the data faults that are more probable than not, each with its probability, where the
    fault and its alternatives together have less than the 0.9 of a claim.
    """
    reader, faults = _FaultReader(posterior), list[tuple[Fault, float]]()
    for member, probabilities, claimed in reader.members():
        best = largest(probabilities)
        likely = probabilities[best] > EVEN_PROBABILITY
        if likely and not claimed and reader.is_data_fault[best]:
            faults.append((reader.fault(member, best), float(probabilities[best])))
    return faults


def ambiguous_faults(posterior: FullPosterior) -> frozenset[FaultKey]:
    """Return the data faults that the readings do not separate from an error of the machine.

    Something is active with a probability of at least 0.9, but data faults account for less than
    99 % of that probability.
    """
    reader, keys = _FaultReader(posterior), set[FaultKey]()
    for _, probabilities, claimed in reader.members():
        if not claimed or reader.is_of_data(probabilities):
            continue
        comparable = probabilities > (1 - CREDIBLE_WITH_DATA_FAULT) * probabilities.max(initial=0.0)
        for k in np.flatnonzero(reader.is_data_fault & comparable).tolist():
            keys.add(reader.fault_columns(k).key(posterior.linearised.problem))
    return frozenset(keys)


def _has_faulty_neighbour(problem: Problem, fault: Fault, others: Sequence[Fault]) -> bool:
    """Return whether a neighbour of an outlying touch of a plate is an outlier too. Then the plate
    has a shape error, and none of the touches slipped.
    """
    k, row = factors_and_rows(problem, fault.rows)[0]
    factor = problem.factors[k]
    if fault.kind != "outlier" or not factor.readings.touching[row]:
        return False
    start, position = problem.factor_rows[k].start, factor.normalized_plate_xy
    outliers = [f.rows[0] - start for f in others
                if f.kind == "outlier" and f is not fault and f.setups == fault.setups]  # fmt: skip
    distances = np.linalg.norm(position - position[row], axis=1)
    in_setup = distances[(factor.setup == factor.setup[row]) & (distances > 0)]
    limit = _NEIGHBOUR_DISTANCE * in_setup.min(initial=np.inf)
    return bool(np.isfinite(limit) and (distances[outliers] < limit).any())
