"""A machine that was calibrated before: what that says now, and what has changed since.

The earlier calibration is a prior ``x ~ N(m, C)``. Of a parameter that changed since it says
nothing any more: it was repaired, or broke, by as much as it likes. Which ones have is decided by
the evidence of the new readings (`fit.change_search`), all at once, and again at the fit that lets
them go.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoglide.fit.change import Change, summed_of
from orthoglide.fit.change_search import WIDTHS, Found, Hypotheses, costs
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.least_squares import normal
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import Method, solve
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.parameters import Parameter

_ROUNDS = 4
"""Fits, each about the changes that the one before let go, until these stay the same."""


def earlier_of(machine: Machine) -> Posterior | None:
    """What an earlier calibration says of a machine; ``None`` where its file gives no sigmas."""
    known = machine.posterior
    return known if np.diag(known.covariance).any() else None


def account_for_changes(estimate: Estimate, method: Method = "auto") -> Estimate:
    """The fit with everything let go that has changed since the earlier calibration.

    Args:
        estimate: the fit with the earlier calibration as its prior; returned as it is where there
            is none, or nothing has changed.
        method: to solve again with.
    """
    first, now = estimate.problem, estimate
    if first.earlier is None or not set(first.names) & set(first.earlier.names):
        return estimate
    names: tuple[Parameter, ...] = ()
    for _ in range(_ROUNDS):
        again = _hypotheses(first, now).found()
        if again is None:
            return estimate
        found, before = again, names
        names = tuple(first.names[k] for k in found.places)
        if set(names) == set(before):
            break
        now = solve(
            _let_go(first, names), method="nested" if method == "auto" else method, start=now.x
        )
    return replace(now, changes=tuple(_changes(first, now, found)))


def _hypotheses(problem: Problem, fit: Estimate) -> Hypotheses:
    """What may have changed, weighed about a fit.

    Args:
        problem: with the whole of what was known earlier as its prior.
        fit: of the same unknowns.
    """
    assert problem.earlier is not None
    here, scale = normal(problem, fit.at, fit.nuisance), problem.tolerance
    columns, root = here.jacobian * scale, np.linalg.inv(here.prior * scale)
    # Readings less what the earlier calibration foretells, and what it leaves open of them.
    residual = here.residual + columns @ (here.x / scale - root @ here.target)
    open_to = columns @ root
    data, along = columns.T @ columns, columns.T @ residual
    met = open_to.T @ residual
    taken = np.linalg.solve(
        np.eye(len(scale)) + open_to.T @ open_to,
        np.column_stack([open_to.T @ columns, met]),
    )
    known = [name in problem.earlier.names for name in problem.names]
    return Hypotheses(
        data - (columns.T @ open_to) @ taken[:, :-1],
        along - (columns.T @ open_to) @ taken[:, -1],
        np.where(known, costs(problem.names, problem.machine.catalogue), np.inf),
        float(residual @ residual - met @ taken[:, -1]),
        float(len(problem.measured) - fit.nuisance.free),
    )


def _let_go(problem: Problem, names: Collection[Parameter]) -> Problem:
    """The problem in which some parameters may be anything."""
    assert problem.earlier is not None
    wide = tuple(replace(u, width=max(WIDTHS)) if u.name in names else u for u in problem.unknowns)
    return replace(problem, unknowns=wide, earlier=problem.earlier.without(names))


def _changes(first: Problem, now: Estimate, found: Found) -> Iterator[Change]:
    """What was found, with the values of both visits."""
    last, catalogue = now.problem.factors[now.problem.last], now.problem.machine.catalogue
    old = Path(now.problem.machine.spec.file).name or "earlier calibration"
    names = first.names
    for place, evidence, size, rivals in zip(
        found.places, found.evidence, found.sizes, found.rivals, strict=True
    ):
        sizes = {place: float(size), **rivals}
        members = tuple(names[k] for k in sizes)
        summed = summed_of(members, now.problem)
        places = [now.names.index(name) for name in summed]
        before, apart = _before(first.earlier, now, summed)
        sigma = float(np.sqrt(now.covariance[np.ix_(places, places)].sum()))
        yield Change(
            members[0], members, "", (old, last.name), float(evidence), catalogue,
            before, float(now.x[places].sum()), apart, sigma,
            tuple(v * first.tolerance[k] for k, v in sizes.items()),
        )  # fmt: skip


def _before(
    known: Posterior | None, now: Estimate, members: tuple[Parameter, ...]
) -> tuple[float, float]:
    """Sum of some parameters at the earlier calibration, and the sigma of its change since.

    What both visits leave open alike, where the machine sits as a whole, is in no difference: of
    ``s - w^T x``, s the sum now, x what did not change, and w the regression of the sum upon that;
    or of two sums that know nothing of each other, where that is less.
    """
    assert known is not None
    assert now.problem.earlier is not None
    at = [known.names.index(name) for name in members]
    kept = [n for n in now.names if n in now.problem.earlier.names and n not in members]
    rest = [known.names.index(n) for n in kept]
    sd = np.sqrt(np.maximum(np.diag(known.covariance), 1e-300))
    unit = known.covariance / sd / sd[:, None]
    across = (unit[np.ix_(rest, at)] * sd[at]).sum(axis=1)
    among = np.linalg.pinv(unit[np.ix_(rest, rest)], rcond=1e-9, hermitian=True)
    left = known.covariance[np.ix_(at, at)].sum() - across @ among @ across
    weights = np.zeros(len(now.names))
    weights[[now.names.index(n) for n in kept]] = -(among @ across) / sd[rest]
    weights[[now.names.index(n) for n in members]] = 1.0
    given = weights @ now.covariance @ weights + max(left, 0.0)
    alone = np.where(weights == 1.0, 1.0, 0.0)
    apart = alone @ now.covariance @ alone + known.covariance[np.ix_(at, at)].sum()
    return float(known.mean[at].sum()), float(np.sqrt(min(given, apart)))
