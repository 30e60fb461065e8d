"""Readings that cannot be meant as they stand: another unit throughout, a point that slipped.

Both are refused: with all readings in doubt, or a machine bent by metres, nothing that a fit says
is worth reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

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
from orthoglide.fit.noise import OFF_GRID, off_grid, on_grid
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import solve
from orthoglide.fit.unknowns import with_free
from orthoglide.geometry import Array
from orthoglide.machine_file import Dial
from orthoglide.observations import Campaign, ToolCampaign, source
from orthoglide.ordering import best_of, largest, ranked
from orthoglide.units import INCH

_FEWEST = 8  # different readings: by chance one in eight is on the grid
_MOST = 10  # points of the tool that may have slipped
_SLIPPED = 10.0  # times what all others leave, and their sigma
_ALONE = 2  # points; where more are off together, the machine has a shape
_APART = 3.0  # times as far off as the next: between the points of a bump there is less


def check_units(campaigns: Sequence[Campaign], dial: Dial) -> None:
    """Refuse readings of which only the inches, or only the millimetres, are what a dial shows.

    A dial shows multiples of its step. Multiplied by 25.4 they hardly ever are any more.

    Raises:
        InputError: naming the file, and what to do.
    """
    for campaign in campaigns:
        shown, step = np.unique(campaign.reading), dial.resolution
        if step <= 0 or len(shown) < _FEWEST or np.mean(off_grid(shown, step) < OFF_GRID) > 0.5:
            continue
        for factor, meant, taken in ((1 / INCH, "millimetres", "inches"),
                                     (INCH, "inches", "millimetres")):  # fmt: skip
            if on_grid(shown * factor, step):
                raise InputError(
                    f"{source(campaign)}: the readings are multiples of the dial's step of "
                    f"{dial.resolution * 1e3:g} mm only once they are multiplied by {factor:.4g}: "
                    f"they seem to be {meant} taken for {taken}; give reading_mm in millimetres, "
                    f"or correct resolution in the machine file"
                )


def check_slips(estimate: Estimate) -> None:
    """Refuse points of the tool that are far from where all others put them.

    Points are left out one after the other, the worst first, and the rest identified again: one
    that then is ten times as far off as what the rest leave did not come from this machine.

    Raises:
        InputError: naming the file, the lines and the distances.
    """
    problem = estimate.problem
    first = len(problem.campaigns)
    if not problem.points or estimate.sigma_scale == 1.0:
        return
    point = np.full(len(problem.measured), -1)
    names: list[tuple[int, int]] = []
    for k, factor in enumerate(problem.points):
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
        return
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
        return
    # A cause may be far off the base at a few places: who is off all causes there are?
    rest, spread = _with_everything(again)
    slipped = far(rest, spread)
    if len(slipped) > _ALONE:
        slipped = far(rest, spread, alone=False)
    off = rest / np.hypot(problem.sigma, spread)
    size = {int(p): float(np.linalg.norm(off[point == p])) for p in np.unique(point[point >= 0])}
    beyond = max((one for p, one in size.items() if p not in worst), default=0.0)
    slipped = _apart({p: size[p] for p in worst}, slipped, beyond)
    if slipped:
        raise InputError("; ".join(_said(problem, names[p], rest[point == p]) for p in slipped)
                         + ": correct the row or remove it")  # fmt: skip


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
    nuisance = nuisances(problem, at.slopes)
    here = normal(problem, at, nuisance)
    known, _ = covariance(here.jacobian, here.prior)
    step = -known @ here.gradient
    rest = fit.problem.measured - at.value - at.jacobian @ step
    shown = np.stack([column - nuisance.fitted(column) for column in at.jacobian.T], axis=1)
    variance = np.einsum("np,pq,nq->n", shown, known, shown)
    return rest - nuisance.fitted(rest), np.sqrt(np.maximum(variance, 0.0))


def _least(problem: Problem, name: tuple[int, int], alone: bool) -> float:
    """Least distance that counts, metres or radians, of a point that is off alone or not."""
    points = problem.points[name[0]].points
    if not isinstance(points, ToolCampaign):
        return 0.0
    instrument = points.setups[points.setup[name[1]]].instrument
    scale = 1.0 if instrument.angular else problem.machine.geometry.scale
    return scale * (instrument.slip_alone if alone else instrument.slip)


def _said(problem: Problem, name: tuple[int, int], rest: Array) -> str:
    """Where a point stands, and how far off it is."""
    points = problem.points[name[0]].points
    distance = float(np.linalg.norm(rest)) * 1e3
    turned = isinstance(points, ToolCampaign) and points.angular[name[1]]
    unit = "mrad" if turned else "mm"
    where = f"{source(points)}, line {points.line[name[1]]}"
    label = points.posture[name[1]] if isinstance(points, ToolCampaign) else ""
    place = f" ({label})" if label else ""
    return f"{where}{place}: {distance:.3g} {unit} off what all others say"


def _worst(problem: Problem, at: Linearised, point: NDArray[np.int64], count: int) -> list[int]:
    """Points whose rows agree least with the rest, left out one after the other."""
    nuisance = nuisances(problem, at.slopes)
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
    points = []
    for k, factor in enumerate(problem.points):
        own = [p for j, p in left_out if j == k]
        points.append(factor.silenced(np.isin(factor.point, own)))
    return replace(problem.at_tolerance(), points=tuple(points))
