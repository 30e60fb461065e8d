"""A machine that was calibrated before: what that says now, and what has changed since.

The earlier calibration is a prior ``x ~ N(m, C)``. Of a parameter that changed since it says
nothing any more: it was repaired, or broke, by as much as it likes. Which ones have is decided by
the evidence of the new readings, all at once (`fit.changed`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoglide.fit.change import Change, summed_of
from orthoglide.fit.change_search import WIDTHS
from orthoglide.fit.changed import Candidate, Changed, what_changed
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import Method, solve
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.parameters import Parameter


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
    first = estimate.problem
    known = first.earlier
    if known is None:
        return estimate
    candidates = [
        Candidate(u.name, 0, {u.name: u.tolerance}, u.tolerance)
        for u in first.unknowns
        if u.name in known.names
    ]
    found = what_changed(first, estimate.x, candidates) if candidates else None
    if found is None:
        return estimate
    gone = [one.parameter for one in found.moved]
    method = "nested" if method == "auto" else method
    left = known.without(gone)
    now = solve(_let_go(first, left, gone), method=method, start=estimate.x)
    return replace(now, changes=tuple(_changes(known, left, now, found)))


def _let_go(problem: Problem, left: Posterior, names: Collection[Parameter]) -> Problem:
    """The problem in which some parameters may be anything, and the rest is as known before."""
    wide = tuple(replace(u, width=max(WIDTHS)) if u.name in names else u for u in problem.unknowns)
    return replace(problem, unknowns=wide, earlier=left)


def _changes(known: Posterior, left: Posterior, now: Estimate, found: Changed) -> Iterator[Change]:
    """What was found, with the values of both visits."""
    last, catalogue = now.problem.factors[now.problem.last], now.problem.machine.catalogue
    old = Path(now.problem.machine.spec.file).name or "earlier calibration"
    for one in found.moved:
        summed = summed_of(tuple(one.sizes), catalogue)
        places = [now.names.index(name) for name in summed]
        before, apart = _before(known, left, now, summed)
        _, as_read = _before(known.as_read, left, now, summed)
        sigma = float(np.sqrt(now.covariance[np.ix_(places, places)].sum()))
        yield Change(
            one.parameter, tuple(one.sizes), "", (old, last.name), one.evidence, catalogue,
            before, float(now.x[places].sum()), max(apart, as_read), sigma,
            tuple(one.sizes.values()),
        )  # fmt: skip


def _before(
    known: Posterior, left: Posterior, now: Estimate, members: tuple[Parameter, ...]
) -> tuple[float, float]:
    """Sum of some parameters at the earlier calibration, and the sigma of its change since.

    What both visits leave open alike, where the machine sits as a whole, is in no difference: of
    ``s - w^T x``, s the sum now, x what did not change, and w the regression of the sum upon that;
    or of two sums that know nothing of each other, where that is less.
    """
    at = [known.names.index(name) for name in members]
    kept = [n for n in now.names if n in left.names and n not in members]
    rest = [known.names.index(n) for n in kept]
    sd = np.sqrt(np.maximum(np.diag(known.covariance), 1e-300))
    unit = known.covariance / sd / sd[:, None]
    across = (unit[np.ix_(rest, at)] * sd[at]).sum(axis=1)
    among = np.linalg.pinv(unit[np.ix_(rest, rest)], rcond=1e-9, hermitian=True)
    unknown = known.covariance[np.ix_(at, at)].sum() - across @ among @ across
    weights = np.zeros(len(now.names))
    weights[[now.names.index(n) for n in kept]] = -(among @ across) / sd[rest]
    weights[[now.names.index(n) for n in members]] = 1.0
    given = weights @ now.covariance @ weights + max(unknown, 0.0)
    alone = np.where(weights == 1.0, 1.0, 0.0)
    apart = alone @ now.covariance @ alone + known.covariance[np.ix_(at, at)].sum()
    return float(known.mean[at].sum()), float(np.sqrt(min(given, apart)))
