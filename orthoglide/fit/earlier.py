"""A machine that was calibrated before: what that says now, and what has changed since.

The earlier calibration is a prior ``x ~ N(m, C)``. A parameter that changed since is known no
better than its tolerance: ``C + tolerance^2 e e^T``. Which ones have is decided by the evidence of
the new readings, one parameter after the other.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoglide.fit.change import Change
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
    found: list[tuple[Parameter, tuple[Parameter, ...], float]] = []
    start, now = estimate, estimate
    while now.problem.earlier is not None and len(found) < _MOST:
        change = _most_probable(now, {p for p, _, _ in found})
        if change is None:
            break
        found.append(change)
        loosened = _loosened(now.problem, change[0])
        now = solve(loosened, method="nested" if method == "auto" else method, start=now.x)
    if not found:
        return estimate
    last = now.problem.factors[now.problem.last]
    old = Path(now.problem.machine.spec.file).name or "earlier calibration"
    changes = []
    for parameter, members, evidence in found:
        # What the readings cannot tell apart counts as one: the sum of all that stand for it.
        places = [now.names.index(name) for name in members]
        sigma = float(np.sqrt(now.covariance[np.ix_(places, places)].sum()))
        before, sd = _earlier_sum(start.problem, members)
        after, unit = float(now.x[places].sum()), now.unit(parameter)
        apart = float(np.hypot(sigma, sd))
        changes.append(
            Change(
                parameter,
                members,
                "",
                (old, last.name),
                evidence,
                unit,
                before,
                after,
                apart,
                sigma,
            )
        )
    return replace(now, changes=tuple(changes))


def _earlier_sum(problem: Problem, members: tuple[Parameter, ...]) -> tuple[float, float]:
    """Sum of what the earlier calibration said of parameters, and its standard deviation."""
    assert problem.earlier is not None
    places = [problem.earlier.names.index(name) for name in members]
    block = problem.earlier.covariance[np.ix_(places, places)]
    return float(problem.earlier.mean[places].sum()), float(np.sqrt(max(block.sum(), 0.0)))


def _most_probable(
    estimate: Estimate, done: set[Parameter]
) -> tuple[Parameter, tuple[Parameter, ...], float] | None:
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
    known = [k for k, n in enumerate(problem.names) if n in problem.earlier.names and n not in done]
    plain = _evidence(data, spread, along)
    gains = []
    for k in known:
        changed = spread.copy()
        changed[k, k] += 1.0
        gains.append(_evidence(data, changed, along) - plain)
    if not gains:
        return None
    best = int(np.argmax(gains))
    evidence = gains[best] - np.log(len(problem.names)) - _ODDS
    if evidence <= 0:
        return None
    name = problem.names[known[best]]
    near = [problem.names[k] for k, g in zip(known, gains, strict=True) if gains[best] - g < _ALIKE]
    like = [n for n in near if (n.leg, n.direction) == (name.leg, name.direction)]
    return name, (name, *(n for n in like if n != name)), float(evidence)


def _evidence(data: Array, spread: Array, along: Array) -> float:
    """Log marginal likelihood of data of information ``data`` and gradient ``along``."""
    inner = np.eye(len(data)) + data @ spread
    # (data + spread^-1)^-1 along = spread (1 + data spread)^-1 along
    mean = spread @ np.linalg.solve(inner, along)
    return float(along @ mean - np.linalg.slogdet(inner)[1]) / 2


def _loosened(problem: Problem, parameter: Parameter) -> Problem:
    earlier = problem.earlier
    assert earlier is not None
    place = earlier.names.index(parameter)
    covariance = earlier.covariance.copy()
    covariance[place, place] += problem.machine.tolerance(parameter) ** 2
    return replace(problem, earlier=replace(earlier, covariance=covariance))
