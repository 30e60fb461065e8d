"""Data faults in credible sets: certain, probable, and ambiguous with a cause of the machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from orthoglide.explanation.credible_sets import CREDIBLE_WITH_DATA_FAULT, LEAST_CLAIMED_PROBABILITY
from orthoglide.explanation.fault_columns import FaultKey
from orthoglide.explanation.faults import Fault, factors_and_rows, setups_of
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.explanation.linear_model import TWENTY_TO_ONE
from orthoglide.fit import Problem
from orthoglide.fit.repeats import NEIGHBOUR_DISTANCE
from orthoglide.ordering import descending, largest

EVEN_PROBABILITY = 0.5  # probability above which something is more probable than not

_LEAST_SHARE = float(np.exp(-TWENTY_TO_ONE))
"""Smallest probability, relative to the likeliest drive, at which another drive is also reported as
the one whose command is wrong."""


class CredibleFaults(NamedTuple):
    """Data faults of a posterior, with their estimated sizes."""

    # Certain enough to correct: with its alternatives active with a probability of at least 0.9, of
    # which data faults account for at least 99 %. A touch of a plate is left out if a neighbouring
    # touch is an outlier too, because the plate then has a shape error.
    certain: list[Fault]
    # more probable than not, each with its probability, but with its alternatives below 0.9
    probable: list[tuple[Fault, float]]
    # in credible sets of which data faults account for less than 99 %
    ambiguous: frozenset[FaultKey]


def credible_faults(posterior: FullPosterior) -> CredibleFaults:
    """Return the data faults of a posterior by how certain they are."""
    mixture, problem = posterior.mixture, posterior.before.problem
    groups = mixture.linear.groups
    is_data_fault = np.array([g.of_data for g in groups], dtype=bool)
    certain, probable, ambiguous = list[Fault](), list[tuple[Fault, float]](), set[FaultKey]()

    for member in mixture.groups_by_importance:
        probabilities = posterior.alternatives.probabilities(member)[:-1]
        of_data, total = probabilities * is_data_fault, probabilities.sum()
        if total < LEAST_CLAIMED_PROBABILITY:
            best = largest(probabilities)
            if of_data[best] > EVEN_PROBABILITY:
                fault = posterior.data_fault(member, best)
                probable.append((fault, float(probabilities[best])))
        elif of_data.sum() < CREDIBLE_WITH_DATA_FAULT * total:
            least = (1 - CREDIBLE_WITH_DATA_FAULT) * probabilities.max(initial=0.0)
            columns = [groups[k].source for k in np.flatnonzero(of_data > least)]
            ambiguous |= {one.key(posterior.linearised.problem) for one in columns}
        elif is_data_fault[member]:
            order = descending(of_data)
            least = _LEAST_SHARE * of_data[order[0]]
            likely = [k for k in order if of_data[k] > least]
            certain.append(_joined([posterior.data_fault(member, k) for k in likely]))
    certain = [f for f in certain if not _has_faulty_neighbour(problem, f, certain)]
    return CredibleFaults(certain, probable, frozenset(ambiguous))


def _joined(faults: Sequence[Fault]) -> Fault:
    """Return the first of alternative faults, with the other drives whose command may be wrong, and
    the likeliest fault of another kind.
    """
    fault, *others = faults
    of_drives = [f for f in others if f.drive is not None and np.array_equal(f.rows, fault.rows)]
    of_other_kind = [f for f in others if f.kind != fault.kind][:1]
    drives = of_drives if fault.drive is not None else []
    return replace(fault, alternatives=(*drives, *of_other_kind))


def _has_faulty_neighbour(problem: Problem, fault: Fault, others: Sequence[Fault]) -> bool:
    """Return whether a neighbour of an outlying touch of a plate is an outlier too. Then the plate
    has a shape error, and none of the touches slipped.
    """
    k, row = factors_and_rows(problem, fault.rows)[0]
    factor = problem.factors[k]
    if fault.kind != "outlier" or not factor.readings.touching[row]:
        return False
    start, position = problem.factor_rows[k].start, factor.normalized_plate_xy
    setups = setups_of(problem, fault)
    outliers = [f.rows[0] - start for f in others if f.kind == "outlier" and f is not fault
                and setups_of(problem, f) == setups]  # fmt: skip
    distances = np.linalg.norm(position - position[row], axis=1)
    in_setup = distances[(factor.setup == factor.setup[row]) & (distances > 0)]
    limit = NEIGHBOUR_DISTANCE * in_setup.min(initial=np.inf)
    return bool(np.isfinite(limit) and (distances[outliers] < limit).any())
