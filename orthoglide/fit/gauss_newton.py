"""Gauss-Newton and Newton steps on the unknowns; the model predicts the readings at each step."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import NumericsError, SolverError, UnreachableError
from orthoglide.fit.least_squares import (
    Linearised,
    NormalEquations,
    Nuisances,
    linearise,
    normal_equations,
)
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array

_MAX_STEPS = 60
# The fit has converged if no unknown moves by more than this many of its conditional standard
# deviations: the printed digits must not depend on the start.
_STEP_TOLERANCE = 1e-10
# Steps, and gradients in the same unit, below which Newton's Hessian is not worth its time.
_NEWTON_THRESHOLD = 1e-7
_ROUNDING_STEP = 1e-4  # a smaller step, times the rms residual, that no longer halves is rounding
_COST_TOLERANCE = 1e-9  # a smaller relative fall of the cost is rounding
_SLOW_RATIO = 0.3  # ratio of successive Gauss-Newton steps from which Newton's are tried
_NEWTON_REACH = 3.0
"""Standard deviations, by the residual, beyond which a Hessian predicts the cost no better than the
Gauss-Newton step does: the line search shortens both, and a Hessian takes far longer."""


def solve_nested(
    problem: Problem, nuisance: Nuisances, start: Linearised
) -> tuple[Linearised, int]:
    """Return the linearisation at the minimum of the cost, and the number of steps from ``start``.

    The problem's model (six bars, Pinocchio or the reduction) predicts the readings with their
    derivatives at every step, so the closed postures are no unknowns of the fit: time and memory
    grow linearly with the number of postures.

    Steps are Gauss-Newton's, or Newton's with differenced gradients where those converge slowly
    near the minimum: along weak directions the curvature of the model outweighs the readings.

    Raises:
        SolverError: where the steps do not converge.
    """
    linear, previous, cost = start, np.inf, np.inf
    for iteration in range(_MAX_STEPS):
        equations = normal_equations(problem, linear, nuisance)
        # An unknown on its bound stays there if the cost falls beyond it.
        free = np.flatnonzero(~(problem.on_bound(linear.x) & (equations.gradient * linear.x < 0)))
        scale = equations.single_sd[free]
        descent = -equations.gradient[free] * scale
        slope = float(np.max(np.abs(descent), initial=0.0))
        step = np.zeros(len(linear.x))
        information = equations.information[np.ix_(free, free)] * scale * scale[:, None]
        step[free] = scale * np.linalg.lstsq(information, descent, rcond=1e-14)[0]
        size = float(np.max(np.abs(step[free]) / scale, initial=0.0))
        rms = max(1.0, float(np.sqrt(equations.cost / len(problem.measured))))
        is_slow = min(slope, size) > _NEWTON_THRESHOLD and size > _SLOW_RATIO * previous
        if is_slow and (size < _NEWTON_REACH * rms or iteration > _MAX_STEPS / 2):
            step[free] = _newton_step(problem, nuisance, equations, free, scale)
            size = float(np.max(np.abs(step[free]) / scale))
        flat = slope <= _NEWTON_THRESHOLD and equations.cost > cost * (1 - _COST_TOLERANCE)
        stalled = size >= previous / 2 and (flat or size <= _ROUNDING_STEP * rms)
        if size <= _STEP_TOLERANCE or stalled:
            return linear, iteration
        linear = _line_search(problem, nuisance, equations, step)
        previous, cost = size, equations.cost
    raise SolverError(
        f"the fit did not converge in {_MAX_STEPS} steps (the last was {size:.2g} sigma): free "
        f"fewer parameters, or keep the priors",
        evidence={"last_step_in_sigmas": size},
    )


def _newton_step(
    problem: Problem, nuisance: Nuisances, equations: NormalEquations, free: NDArray[np.intp],
    scale: Array,
) -> Array:  # fmt: skip
    """Return a Newton step of the ``free`` unknowns, its Hessian from differenced gradients."""
    hessian = np.empty((len(free), len(free)))
    for column, k in enumerate(free):
        # Small against the curvature of the machine, large against rounding.
        width = max(1e-2 * scale[column], 1e-4 * problem.tolerance[k])
        ends = []
        for side in (1, -1):
            x = equations.x.copy()
            x[k] += side * width
            ends.append(normal_equations(problem, linearise(problem, x), nuisance).gradient[free])
        hessian[:, column] = (ends[0] - ends[1]) / (2 * width)
    hessian = (hessian + hessian.T) / 2 * scale * scale[:, None]
    values, vectors = np.linalg.eigh(hessian)
    # Absolute value and floor keep the step a descent where the cost is not convex.
    rotated = vectors.T @ (-equations.gradient[free] * scale)
    return scale * (vectors @ (rotated / np.maximum(np.abs(values), 1e-8)))


def _line_search(
    problem: Problem, nuisance: Nuisances, equations: NormalEquations, step: Array
) -> Linearised:
    """Return the linearisation at the first unknowns along a step, halved up to 30 times and cut at
    the bounds, at which the cost does not rise beyond rounding; else practically at the start.
    """
    allowed = equations.cost + _COST_TOLERANCE * max(equations.cost, 1.0)
    # No unknown moves by more than its bound in one step.
    factor = min(1.0, float(np.min(problem.bound / np.maximum(np.abs(step), 1e-300))))
    for _ in range(30):
        x = np.clip(equations.x + factor * step, -problem.bound, problem.bound)
        with suppress(NumericsError, UnreachableError):
            linear = linearise(problem, x)  # seldom refused, so its derivatives are seldom wasted
            residual = nuisance.project(problem.measured - linear.value)
            if float(residual @ residual) + equations.prior_chi2(x) <= allowed:
                return linear
        factor /= 2
    x = np.clip(equations.x + factor * step, -problem.bound, problem.bound)
    return linearise(problem, x)
