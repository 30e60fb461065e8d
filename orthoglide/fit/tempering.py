"""Readings that say more than their noise allows, weighed against what is known before as they are.

Where something is left of a fit, its sigmas take the readings for so many times as noisy. Values
that the readings tell no better than the tolerances do are then pulled towards zero by as much more
as these count; the sigmas of a fit that believed its readings would be those of other values.
"""

from __future__ import annotations

from dataclasses import replace

from orthoglide.fit.crosscheck import cross_check
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.nested import solve_nested
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import assessed


def tempered(found: Estimate) -> Estimate:
    """The values where readings are as noisy as the fit leaves them; scores by their own noise. A
    fit that leaves nothing significant is returned as it is.

    Raises:
        SolverError: where the steps do not settle.
        CrossCheckError: where mechanism and reduction disagree.
    """
    problem = found.problem
    if found.sigma_scale == 1.0 or not problem.prior_rows[0].any():
        return found
    heavier, nuisance = _known_better(problem, found.sigma_scale), found.nuisance
    at, more = solve_nested(heavier, nuisance, found.at)
    check = cross_check(heavier, nuisance, at)
    again = assessed(
        problem, nuisance, at, found.method, found.iterations + more, found.optimality, check
    )
    return replace(again, changes=found.changes)


def _known_better(problem: Problem, times: float) -> Problem:
    """The same with everything that is known before known so many times better."""
    unknowns = tuple(replace(u, width=u.width / times) for u in problem.unknowns)
    earlier = problem.earlier
    if earlier is not None:
        earlier = replace(earlier, covariance=earlier.covariance / times**2)
    return replace(problem, unknowns=unknowns, earlier=earlier)
