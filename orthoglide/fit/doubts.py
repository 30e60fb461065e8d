"""Readings of the tool that slipped: far from where all others put them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError, NumericsError
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.least_squares import (
    Linearised,
    covariance,
    fitted_basis,
    linearise,
    normal,
    nuisances,
)
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import solve
from orthoglide.fit.unknowns import with_free
from orthoglide.geometry import Array
from orthoglide.observations import source
from orthoglide.ordering import best_of, largest, ranked

_MOST = 10  # points of the tool that may have slipped
_SLIPPED = 10.0  # times what all others leave, and their sigma
_ALONE = 2  # points; where more are off together, the machine has a shape
_APART = 3.0  # times as far off as the next: between the points of a bump there is less


@dataclass(frozen=True)
class Slip:
    """Rows that were read together and are far from where all others put them."""

    rows: NDArray[np.intp]  # stacked (m,)
    size: float  # how far off they are, metres or radians: of several rows the distance


def check_slips(estimate: Estimate) -> None:
    """Refuse readings of the tool that slipped, as `find_slips` has them.

    Raises:
        InputError: naming the file, the lines and the distances.
    """
    if slips := find_slips(estimate):
        raise InputError(
            "; ".join(_said(estimate.problem, slip) for slip in slips)
            + ": correct the row or remove it, or let close-loop set it aside"
        )


def find_slips(estimate: Estimate) -> tuple[Slip, ...]:
    """Return readings of the tool that are far from where all others put them.

    They are left out one after the other, the worst first, and the rest identified again: one
    that then is ten times as far off as what the rest leave did not come from this machine.
    """
    problem = estimate.problem
    first = len(problem.on_legs)
    if not problem.tool or estimate.sigma_scale == 1.0:
        return ()
    point = np.full(len(problem.measured), -1)
    names: list[tuple[int, int]] = []
    for k, factor in enumerate(problem.tool):
        rows = problem.factor_rows[first + k]
        point[rows] = factor.point + len(names)
        names += [(k, p) for p in range(int(factor.point.max(initial=-1)) + 1)]
    count, tries = min(_MOST, len(names) // 4), list[tuple[Estimate, list[int]]]()
    # One that is far off bends the fit to all; the machine as it was built is no worse then.
    for built in (False, True):
        with suppress(NumericsError):
            at = linearise(problem, problem.start) if built else estimate.at
            worst = _worst(problem, at, point, count)
            left_out = _without(problem, [names[p] for p in worst])
            tries.append((solve(left_out, method="nested", widen=False), worst))
        if tries and tries[-1][0].sigma_scale == 1.0:
            break
    if not tries:
        return ()
    again, worst = best_of(tries, lambda one: -one[0].sigma_scale)
    others = (point >= 0) & ~np.isin(point, worst)

    def far(rest: Array, spread: Array, alone: bool = True) -> list[int]:
        off = rest / np.hypot(problem.sigma, spread)
        limit = _SLIPPED * max(1.0, float(np.sqrt(np.mean(off[others] ** 2))))
        return [
            p
            for p in sorted(worst)
            if np.linalg.norm(off[point == p]) > limit
            and np.linalg.norm(rest[point == p]) > _least(problem, names[p], alone)
        ]

    rest = again.problem.measured - again.predicted
    if not far(rest, np.zeros(len(rest))):
        return ()
    # A cause may be far off the base at a few places: who is off all causes there are?
    rest, spread = _with_everything(again)
    slipped = far(rest, spread)
    if len(slipped) > _ALONE:
        slipped = far(rest, spread, alone=False)
    off = rest / np.hypot(problem.sigma, spread)
    size = {int(p): float(np.linalg.norm(off[point == p])) for p in np.unique(point[point >= 0])}
    beyond = max((one for p, one in size.items() if p not in worst), default=0.0)
    slipped = _apart({p: size[p] for p in worst}, slipped, beyond)
    return tuple(_slip(np.flatnonzero(point == p), rest) for p in slipped)


def _slip(rows: NDArray[np.intp], rest: Array) -> Slip:
    size = rest[rows[0]] if len(rows) == 1 else np.linalg.norm(rest[rows])
    return Slip(rows, float(size))


def _apart(off: Mapping[int, float], slipped: Sequence[int], rest: float) -> list[int]:
    """Those of some points that lie well beyond all others, which are off by ``rest`` at most; off
    by less and less, there is a bump of a bed, or a wave of a rail.
    """
    order = ranked(off, lambda p: off[p])
    least = [*(off[p] for p in order[1:]), rest]
    told = [
        k
        for k, p in enumerate(order)
        if off[p] > _APART * least[k] and set(order[: k + 1]) <= set(slipped)
    ]
    return sorted(order[: told[-1] + 1]) if told else []


def _with_everything(fit: Estimate) -> tuple[Array, Array]:
    """What a fit leaves ``(n,)`` once every effect is free within its tolerance, metres, and how
    well that is known.
    """
    shapes = [f.setups_of for f in fit.problem.factors]
    more = [
        effect.name
        for effect in fit.problem.machine.catalogue.effects
        if not effect.of_dial or any(setups_of(effect) for setups_of in shapes)
    ]
    problem = with_free(fit.problem, more)
    x = np.concatenate([fit.x, problem.start[len(fit.x) :]])
    at = linearise(problem, x)
    nuisance = nuisances(problem, at.seen)
    here = normal(problem, at, nuisance)
    known, _ = covariance(here.jacobian, here.prior)
    step = -known @ here.gradient
    rest = fit.problem.measured - at.value - at.jacobian @ step
    shown = np.stack([column - nuisance.fitted(column) for column in at.jacobian.T], axis=1)
    variance = np.einsum("np,pq,nq->n", shown, known, shown)
    return rest - nuisance.fitted(rest), np.sqrt(np.maximum(variance, 0.0))


def _least(problem: Problem, name: tuple[int, int], alone: bool) -> float:
    """Least distance that counts, metres or radians, of a point that is off alone or not."""
    factor = problem.tool[name[0]]
    row = int(np.flatnonzero(factor.point == name[1])[0])
    instrument = factor.readings.setups[factor.setup[row]].observation
    if factor.readings.by_point:
        return 0.0
    scale = 1.0 if instrument.angular else problem.machine.geometry.scale
    return scale * (instrument.slip_alone if alone else instrument.slip)


def _said(problem: Problem, slip: Slip) -> str:
    """Where readings stand, and how far off they are."""
    k = next(k for k, rows in enumerate(problem.factor_rows) if slip.rows[0] < rows.stop)
    given, row = problem.factors[k].readings, slip.rows[0] - problem.factor_rows[k].start
    unit = given.setups[given.setup[row]].observation.unit
    place = f" ({given.posture[row]})" if given.posture[row] else ""
    return (
        f"{source(given)}, line {given.line[row]}{place}: {abs(slip.size) * 1e3:.3g} {unit} off "
        f"what all others say"
    )


def _worst(problem: Problem, at: Linearised, point: NDArray[np.int64], count: int) -> list[int]:
    """Points whose rows agree least with the rest, left out one after the other."""
    nuisance = nuisances(problem, at.seen)
    here = normal(problem, at, nuisance)
    basis = fitted_basis(problem, nuisance, at)[: len(point)]
    known, _ = covariance(here.jacobian, here.prior)
    rest = problem.measured - at.value + at.jacobian @ (known @ here.gradient)
    rest = problem.weighing.whiten(rest - nuisance.fitted(rest))
    found: list[int] = []
    for _ in range(count):
        # Residuals and leverage of a fit without the points that were left out.
        out = np.isin(point, found)
        inner = np.eye(basis.shape[1]) - basis[out].T @ basis[out]
        inverse = np.asarray(np.linalg.pinv(inner, rcond=1e-9, hermitian=True))
        left = rest + basis @ (inverse @ (basis[out].T @ rest[out]))
        share = np.einsum("nq,nq->n", basis @ inverse, basis)
        square = np.where(out | (point < 0), 0.0, left**2 / np.maximum(1 - share, 1e-3))
        found.append(largest(np.bincount(point[point >= 0], square[point >= 0])))
    return found


def _without(problem: Problem, left_out: Sequence[tuple[int, int]]) -> Problem:
    """The problem with some points of the tool without weight."""
    problem, first = problem.at_tolerance(), len(problem.on_legs)
    factors = list(problem.factors)
    for k, factor in enumerate(problem.tool):
        own = [p for j, p in left_out if j == k]
        factors[first + k] = factor.without_weight(np.isin(factor.point, own))
    return replace(problem, factors=tuple(factors))
