"""A machine that was calibrated before: what that says now, and what has changed since.

The earlier calibration is a prior ``x ~ N(m, C)``. Of a parameter that changed since it says
nothing any more: it was repaired, or broke, by as much as it likes. Which ones have is decided by
the evidence of the new readings, one parameter after the other: ``C + (s tolerance)^2 e e^T`` with
s of 1, 3 or 10 against ``C``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoglide.fit.change import Change, summed_of
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.least_squares import normal
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import Method, solve
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.parameters import Parameter

# One parameter in twenty changes between two visits: the log odds that a change must overcome,
# and again the logarithm of the number of parameters that could have.
_ODDS = 3.0
_ALIKE = 2.0  # log Bayes factor within which two changes cannot be told apart
_MOST = 12
_SIZES = (1.0, 3.0, 10.0)  # tolerances by which something changes


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
    found: list[tuple[tuple[Parameter, ...], float]] = []
    now = estimate
    while now.problem.earlier is not None and len(found) < _MOST:
        change = _most_probable(now)
        if change is None:
            break
        found.append(change)
        now = solve(
            _let_go(now.problem, change[0][0]),
            method="nested" if method == "auto" else method,
            start=now.x,
        )
    if not found:
        return estimate
    last = now.problem.factors[now.problem.last]
    old = Path(now.problem.machine.spec.file).name or "earlier calibration"
    changes = []
    for members, evidence in found:
        summed = summed_of(members, now.problem)
        places = [now.names.index(name) for name in summed]
        sigma = float(np.sqrt(now.covariance[np.ix_(places, places)].sum()))
        before, apart = _before(estimate.problem.earlier, now, summed)
        changes.append(
            Change(
                members[0],
                members,
                "",
                (old, last.name),
                evidence,
                now.problem.machine.catalogue,
                before,
                float(now.x[places].sum()),
                apart,
                sigma,
            )
        )
    return replace(now, changes=tuple(changes))


def _let_go(problem: Problem, name: Parameter) -> Problem:
    """The problem in which a parameter may be anything."""
    assert problem.earlier is not None
    wide = tuple(replace(u, width=max(_SIZES)) if u.name == name else u for u in problem.unknowns)
    return replace(problem, unknowns=wide, earlier=problem.earlier.without([name]))


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


def _most_probable(
    estimate: Estimate,
) -> tuple[tuple[Parameter, ...], float] | None:
    """The change that the readings speak for most, with those like it, and its evidence."""
    problem = estimate.problem
    assert problem.earlier is not None
    here = normal(problem, estimate.at, estimate.nuisance)
    scale = problem.tolerance
    noise = estimate.sigma_scale**2
    data = here.jacobian.T @ here.jacobian / noise * scale * scale[:, None]
    root = np.linalg.inv(here.prior * scale)
    spread: Array = root @ root.T
    mean = np.linalg.solve(here.prior * scale, here.target)
    along = here.jacobian.T @ here.residual / noise * scale + data @ (here.x / scale - mean)
    known = [k for k, n in enumerate(problem.names) if n in problem.earlier.names]
    plain = _evidence(data, spread, along)
    if not known:
        return None
    gains = [
        max(_evidence(data, _wider(spread, k, size), along) for size in _SIZES) - plain
        for k in known
    ]
    best = int(np.argmax(gains))
    evidence = gains[best] - np.log(len(_SIZES) * len(problem.names)) - _ODDS
    if evidence <= 0:
        return None
    name = problem.names[known[best]]
    near = [problem.names[k] for k, g in zip(known, gains, strict=True) if gains[best] - g < _ALIKE]
    like = [n for n in near if (n.leg, n.direction) == (name.leg, name.direction)]
    # A zero is entered in a minute, and nothing else of the machine changes as often.
    zero = [problem.machine.catalogue.effect_of(n).controller == "zero" for n in like]
    order = sorted(range(len(like)), key=lambda k: (not zero[k], like[k] != name))
    return tuple(like[k] for k in order), float(evidence)


def _wider(spread: Array, k: int, size: float) -> Array:
    changed = spread.copy()
    changed[k, k] += size**2
    return changed


def _evidence(data: Array, spread: Array, along: Array) -> float:
    """Log marginal likelihood of data of information ``data`` and gradient ``along``."""
    inner = np.eye(len(data)) + data @ spread
    # (data + spread^-1)^-1 along = spread (1 + data spread)^-1 along
    mean = spread @ np.linalg.solve(inner, along)
    return float(along @ mean - np.linalg.slogdet(inner)[1]) / 2
