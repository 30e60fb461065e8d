"""The identification with the closure nested: Newton on the unknowns alone, for many postures.

Every step closes all postures and takes the readings' derivatives from the constraint Jacobians,
so that time and memory grow linearly with the number of postures.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import ClosureError, SolverError
from orthoglide.fit.least_squares import (
    Linearised,
    NormalEquations,
    Nuisances,
    linearise,
    normal_equations,
    predict,
)
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array

_MAX_STEPS = 60
# Steps, in standard deviations of what the readings leave of each unknown: digits that are printed
# do not depend on where a fit started.
_STEP_TOLERANCE = 1e-10
_NEWTON_THRESHOLD = 1e-7  # steps from which second derivatives are not worth their time
_ROUNDING_STEP = 1e-4  # steps that no longer shrink are rounding of the closures: times the misfit
_COST_TOLERANCE = (
    1e-9  # of the cost: less is lost in its rounding, and so are steps along weak directions
)
_SLOW_RATIO = 0.3  # Gauss-Newton that shrinks its steps less than this is worth second derivatives


def solve_nested(
    problem: Problem, nuisance: Nuisances, start: Linearised
) -> tuple[Linearised, int]:
    """Minimise the cost over the unknowns, from the linearisation ``start``.

    Gauss-Newton, and Newton with differenced gradients where that is slow: along weak directions
    the curvature of the model outweighs the readings.

    Returns:
        The linearisation where it ended, and how many steps that took.

    Raises:
        SolverError: where the steps do not settle.
    """
    at, previous, cost = start, np.inf, np.inf
    for iteration in range(_MAX_STEPS):
        here = normal_equations(problem, at, nuisance)
        # On its bound and pushed outward an unknown stays; the others settle among themselves.
        free = np.flatnonzero(~(problem.on_bound(at.x) & (here.gradient * at.x < 0)))
        scale = 1 / np.sqrt(np.maximum(np.diag(here.information), 1e-300))[free]
        slope = float(np.max(np.abs(here.gradient[free]) * scale, initial=0.0))
        step = np.zeros(len(at.x))
        inner = here.information[np.ix_(free, free)] * scale * scale[:, None]
        right = -here.gradient[free] * scale
        step[free] = scale * np.linalg.lstsq(inner, right, rcond=1e-14)[0]
        size = float(np.max(np.abs(step[free]) / scale, initial=0.0))
        if slope > _NEWTON_THRESHOLD and size > _NEWTON_THRESHOLD and size > _SLOW_RATIO * previous:
            step[free] = _newton_step(problem, nuisance, here, free, scale)
            size = float(np.max(np.abs(step[free]) / scale))
        misfit = max(1.0, float(np.sqrt(here.cost / len(problem.measured))))
        flat = slope <= _NEWTON_THRESHOLD and here.cost > cost * (1 - _COST_TOLERANCE)
        stalled = size >= previous / 2 and (flat or size <= _ROUNDING_STEP * misfit)
        if size <= _STEP_TOLERANCE or stalled:
            return at, iteration
        at = linearise(problem, _line_search(problem, nuisance, here, step))
        previous, cost = size, here.cost
    raise SolverError(
        "the identification did not settle; free fewer parameters, or keep the priors",
        evidence={"last_step_in_sigmas": size},
    )


def _newton_step(
    problem: Problem,
    nuisance: Nuisances,
    here: NormalEquations,
    free: NDArray[np.intp],
    scale: Array,
) -> Array:
    hessian = np.empty((len(free), len(free)))
    for column, k in enumerate(free):
        # Small against the curvature of the machine, large against rounding.
        width = max(1e-2 * scale[column], 1e-4 * problem.tolerance[k])
        ends = []
        for side in (1, -1):
            x = here.x.copy()
            x[k] += side * width
            ends.append(normal_equations(problem, linearise(problem, x), nuisance).gradient[free])
        hessian[:, column] = (ends[0] - ends[1]) / (2 * width)
    hessian = (hessian + hessian.T) / 2 * scale * scale[:, None]
    values, vectors = np.linalg.eigh(hessian)
    # Modulus and floor keep the step a descent where the cost is not convex.
    turned = vectors.T @ (-here.gradient[free] * scale)
    return scale * (vectors @ (turned / np.maximum(np.abs(values), 1e-8)))


def _line_search(
    problem: Problem, nuisance: Nuisances, here: NormalEquations, step: Array
) -> Array:
    """Halve the step until the cost falls; unknowns stay within their bounds."""
    allowed = here.cost + _COST_TOLERANCE * max(here.cost, 1.0)
    factor = min(1.0, float(np.min(problem.bound / np.maximum(np.abs(step), 1e-300))))
    for _ in range(30):
        x = np.clip(here.x + factor * step, -problem.bound, problem.bound)
        with suppress(ClosureError):
            residual = nuisance.project(problem.measured - predict(problem, x))
            if float(residual @ residual) + here.prior_chi2(x) <= allowed:
                return x
        factor /= 2
    return np.asarray(np.clip(here.x + factor * step, -problem.bound, problem.bound))
