"""Commands that stand in each other's columns: no machine reads as these dials then do."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np

from orthoglide.errors import InputError, NumericsError
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import solve
from orthoglide.observations import source

_FAR = 20.0
"""Times the noise by which an exchange is off, and more: a machine's own errors are rarely."""

_BETTER = 10.0  # times nearer by which the readings must fit with the commands put right
_ALIKE = 2.0  # times as far off as the best: one dial alone need not tell which exchange it was


def check_columns(estimate: Estimate) -> None:
    """Refuse campaigns whose readings fit only with the commands of drives exchanged.

    Raises:
        InputError: naming the files, and the drives.
    """
    problem, now = estimate.problem, estimate.sigma_scale
    if now < _FAR or not problem.campaigns:
        return
    names, several = problem.machine.geometry.leg_names, range(len(problem.campaigns))
    which = [tuple(several), *((k,) for k in several if len(several) > 1)]
    orders = [order for order in permutations(range(3)) if order != (0, 1, 2)]
    tried = [(_off(problem, some, order), some, order) for some in which for order in orders]
    best, some, order = min(tried)
    if best * _BETTER < now:
        files = ", ".join(source(problem.campaigns[k]) for k in some)
        moved = [f"of drive {names[k]} under {names[order[k]]}" for k in range(3) if order[k] != k]
        told = f"with the commands {' and '.join(moved)}"
        if sum(some == s and off < _ALIKE * best for off, s, _ in tried) > 1:
            told = "with the commands in another order of drives, which they cannot tell"
        raise InputError(
            f"{files}: the readings fit {now / best:.0f} times better {told}: "
            f"exchange the columns, or else the legs and directions of all dials"
        )


def _off(problem: Problem, some: tuple[int, ...], order: tuple[int, ...]) -> float:
    """Times the noise by which readings are off with some campaigns' drives exchanged."""
    factors, at = list(problem.on_legs), list(order)
    for k in some:
        c = factors[k].readings
        moves = replace(c.moves, command=c.moves.command[:, at])
        c = replace(c, command=c.command[:, at], approach=c.approach[:, at], moves=moves)
        factors[k] = factors[k].with_table(c)
    try:
        return solve(problem.with_factors(factors), method="nested").sigma_scale
    except NumericsError:
        return np.inf
