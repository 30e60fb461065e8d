"""Solving a problem: by programme, nested closures or the reduction; verified and cross-checked."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Literal

import numpy as np

from orthoglide.errors import InputError, NumericsError, SolverError, UnidentifiableError
from orthoglide.fit.crosscheck import CrossCheck, by_reduction, cross_check
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.gauss_newton import solve_nested
from orthoglide.fit.least_squares import (
    Linearised,
    NormalEquations,
    Nuisances,
    covariance,
    linearise,
    normal_equations,
    nuisances,
    update_instrument_poses,
    weak_directions,
)
from orthoglide.fit.notes import notes
from orthoglide.fit.problem import Problem
from orthoglide.fit.scores import LACK_OF_FIT, FittedRows, score
from orthoglide.geometry import Array
from orthoglide.ordering import canonical_basis

Method = Literal["auto", "nlp", "nested", "pinocchio", "reduction"]

NLP_POSTURES = 200
"""Up to this many distinct postures the programme carries the closures as constraints."""

NLP_UNKNOWNS = 30
"""Up to this many unknowns: the time to build its exact Hessian grows with their square."""

_OPTIMALITY_TOLERANCE = 1e-4  # sigmas: largest Newton step left where a solver has converged
_PLACEMENT_ROUNDS = 3  # fits about the instrument poses of the fit before, at most
_MAX_CHI2_RATIO = 0.5  # a round that leaves more of chi2 is the last
_WIDENING_ROUNDS = 8
_WIDENING_RATIO = 1.2  # growth of a value, in prior widths, that asks for another round


def solve(
    problem: Problem, *, method: Method = "auto", start: Array | None = None, widen: bool = True
) -> Estimate:
    """Solve a problem, verify the answer and cross-check it; see :func:`identify`.

    A value far beyond its tolerance shows that the tolerance does not apply to this machine. Its
    prior is widened to the size of the value (the scale of a normal prior that fits it best), so
    that it does not pull on the readings. If lack of fit remains even so, the value was bent by
    errors that the model lacks, and the tolerances stay. They also stay with ``widen=False``, for
    readings that are still in doubt themselves.
    """
    first = _fit_and_place(problem, method, start)
    wide = widen_priors(first, method) if widen else first
    return wide if wide.sigma_scale == 1.0 else first


def _fit_and_place(problem: Problem, method: Method, start: Array | None) -> Estimate:
    """Return a fit, repeated with the instruments' frames moved to the machine that was found.

    Rotations of frames are fitted linearly, and the squares of some milliradians exceed the noise
    of such instruments.
    """
    estimate = _solve(problem, method, start)
    for _ in range(_PLACEMENT_ROUNDS):
        placed = update_instrument_poses(estimate.problem, estimate.at)
        if placed is estimate.problem:
            break
        previous, estimate = estimate, _solve(placed, method, estimate.x)
        if estimate.scores.chi2 > _MAX_CHI2_RATIO * previous.scores.chi2:
            break  # the poses of the instruments are not what these readings have wrong
    return estimate


def widen_priors(estimate: Estimate, method: Method = "auto") -> Estimate:
    """Return a fit whose priors are as wide as the values that exceed their tolerances; the given
    one where there are none, or no priors.
    """
    # From a fit so near, a few Gauss-Newton steps take less time than building a programme.
    method = "nested" if method == "auto" else method
    for _ in range(_WIDENING_ROUNDS if estimate.problem.use_tolerance_priors else 0):
        problem = estimate.problem
        width = np.array([u.prior_width for u in problem.unknowns])
        size = np.abs(problem.without_common_error(estimate.x)) / problem.tolerance
        wider = problem.is_implausible(estimate.x) & (size > _WIDENING_RATIO * width)
        if not wider.any():
            break
        unknowns = [
            replace(u, prior_width=float(new_width)) if is_wider else u
            for u, new_width, is_wider in zip(problem.unknowns, size, wider, strict=True)
        ]
        problem = replace(problem, unknowns=tuple(unknowns))
        previous = estimate
        try:
            estimate = _fit_and_place(problem, method, estimate.x)
        except NumericsError:
            break
        ratio = estimate.scores.chi2 / previous.scores.chi2
        if estimate.sigma_scale != 1.0 and ratio > _MAX_CHI2_RATIO:
            break  # the tolerances are not what these readings have wrong
    return estimate


def refit_with_residual_noise(estimate: Estimate) -> Estimate:
    """Return the fit to readings as noisy as its residuals, with the scores of their assumed noise;
    the given one without lack of fit.

    The sigmas of a fit with lack of fit count its readings as ``sigma_scale`` times as noisy. The
    values must be those of the same noise: priors then pull more on values that the readings
    determine no better than the tolerances do.

    Raises:
        SolverError: where the steps do not settle.
        CrossCheckError: where mechanism and reduction disagree.
    """
    problem = estimate.problem
    if estimate.sigma_scale == 1.0 or not problem.prior_rows[0].any():
        return estimate
    # Noisier readings weigh as much against the prior as a narrower prior against the readings.
    scale, earlier, nuisance = estimate.sigma_scale, problem.earlier_posterior, estimate.nuisance
    if earlier is not None:
        earlier = replace(earlier, covariance=earlier.covariance / scale**2)
    unknowns = tuple(replace(u, prior_width=u.prior_width / scale) for u in problem.unknowns)
    reweighted = replace(problem, unknowns=unknowns, earlier_posterior=earlier)
    linear, steps = solve_nested(reweighted, nuisance, estimate.at)
    check, steps = cross_check(reweighted, nuisance, linear), steps + estimate.iterations
    refitted = make_estimate(
        problem, nuisance, linear, estimate.method, steps, estimate.optimality, check
    )
    return replace(refitted, changes=estimate.changes)


def _solve(problem: Problem, method: Method, start: Array | None) -> Estimate:
    if method == "reduction" and not problem.reduction_applies:
        raise InputError(
            "the reduction predicts dials only, each by itself, from offsets and leg lengths: "
            "leave out other readings and free nothing else, or take another method"
        )
    first = linearise(problem, problem.start if start is None else start)
    # Nuisances are frozen after a first Gauss-Newton step, nearer to the machine than nominal.
    nuisance = nuisances(problem, first.reading_poses)
    initial = normal_equations(problem, first, nuisance)
    _check_determined(problem, initial)
    prior_rows = np.vstack([initial.prior, np.diag(1 / problem.tolerance)])
    x = first.x - covariance(initial.jacobian, prior_rows)[0] @ initial.gradient
    stepped = linearise(problem, np.clip(x, -problem.bound, problem.bound))
    if start is not None and normal_equations(problem, stepped, nuisance).cost > initial.cost:
        stepped = first  # from a fit nearby the step went too far
    nuisance = nuisances(problem, stepped.reading_poses)
    initial = normal_equations(problem, first, nuisance)
    linear, iterations, method_used = _run_method(problem, nuisance, initial, stepped, method)
    optimality = _check_solution(problem, nuisance, linear, initial)
    if method_used == "nlp":
        # IPOPT ends wherever its tolerances are met, which depends on the processor: further steps
        # bring the verified solution to the minimum.
        with suppress(SolverError):
            refined = solve_nested(problem, nuisance, linear)[0]
            optimality = _check_solution(problem, nuisance, refined, initial)
            linear = refined
    check = cross_check(problem, nuisance, linear)
    return make_estimate(problem, nuisance, linear, method_used, iterations, optimality, check)


def _check_determined(problem: Problem, equations: NormalEquations) -> None:
    """Refuse unknowns that the readings cannot determine, as directions of few unknowns."""
    _, undetermined = covariance(equations.jacobian, equations.prior)
    if not len(undetermined):
        return
    norm = np.linalg.norm(equations.jacobian, axis=0)
    # In units of each unknown's effect on the readings: metres and radians do not compare.
    column_norm = np.where(norm > 0, norm, 1.0)
    directions = list[dict[str, float]]()
    for shares in canonical_basis(undetermined * column_norm):
        reported = np.abs(shares) >= 0.05 * np.abs(shares).max()
        direction = shares / column_norm / np.linalg.norm(shares / column_norm)
        chosen = np.flatnonzero(reported)
        directions.append({problem.names[k]: float(direction[k]) for k in chosen})
    names = "; ".join(dict.fromkeys(map(" with ".join, directions)))
    raise UnidentifiableError(
        f"these readings do not determine {names}: free fewer parameters, measure more "
        f"postures, or let the tolerances act as priors",
        directions=tuple(directions),
    )


def _run_method(
    problem: Problem,
    nuisance: Nuisances,
    initial: NormalEquations,
    start: Linearised,
    method: Method,
) -> tuple[Linearised, int, str]:
    """Return the linearisation at a method's solution, its iterations, and the method used;
    ``start`` is one Gauss-Newton step further than ``initial``.
    """
    if method in ("reduction", "pinocchio"):
        by_method = replace(problem, machine=problem.machine.by_pinocchio())
        if method == "reduction":
            by_method = by_reduction(problem)
        linear, steps = solve_nested(by_method, nuisance, linearise(by_method, start.x))
        return linearise(problem, linear.x), steps + 1, method
    elastic = problem.elastic
    if elastic and method == "nlp":
        raise InputError("the programme closes unloaded loops: take the nested method under load")
    postures = sum(len(np.unique(f.conditions().command, axis=0)) for f in problem.factors)
    is_large = postures > NLP_POSTURES or len(problem.names) > NLP_UNKNOWNS
    # A programme is worth its time only where the reduction checks it too: for readings of legs.
    unsuited = is_large or elastic or bool(problem.tool_factors)
    if method == "nested" or (method == "auto" and unsuited):
        linear, steps = solve_nested(problem, nuisance, start)
        return linear, steps + 1, "nested"
    from orthoglide.fit.nlp import solve_programme

    x, iterations = solve_programme(problem, nuisance, initial)
    return linearise(problem, x), iterations, "nlp"


def _check_solution(
    problem: Problem, nuisance: Nuisances, linear: Linearised, initial: NormalEquations
) -> float:
    """Return the size of the next Newton step, sigmas, after checking a solver's answer.

    The cost must not exceed the initial one, and the step must be small. The linearisation itself
    has closed every posture. Unknowns on a bound cannot move further.
    """
    equations = normal_equations(problem, linear, nuisance)
    if not equations.cost <= initial.cost * (1 + 1e-9) + 1e-9:
        raise SolverError(
            "the solver ended with a worse fit than it started from",
            evidence={"chi2": equations.cost, "chi2_start": initial.cost},
        )
    # In sigmas of each unknown alone, so that weak directions do not count.
    step = np.abs(equations.gradient * equations.single_sd)
    optimality = float(step[~problem.on_bound(linear.x)].max(initial=0.0))
    if optimality > _OPTIMALITY_TOLERANCE * max(1.0, float(np.sqrt(equations.cost))):
        raise SolverError(
            f"the solver stopped {optimality:.2g} sigmas before the minimum; check the readings",
            evidence={"optimality": optimality},
        )
    return optimality


def make_estimate(
    problem: Problem,
    nuisance: Nuisances,
    linear: Linearised,
    method: str,
    iterations: int,
    optimality: float,
    check: CrossCheck | None = None,
) -> Estimate:
    """Return the estimate at a solution, with scores, covariance and warnings."""
    equations = normal_equations(problem, linear, nuisance)
    rows = FittedRows.from_fit(problem, nuisance, linear)
    scores = score(rows, equations)
    scale = 1.0
    if scores.dof > 0 and scores.lack_of_fit_p < LACK_OF_FIT:
        scale = max(float(np.sqrt(scores.chi2 / scores.dof)), 1.0)
    # Lack of fit makes the readings noisier, not the tolerances wider.
    posterior, _ = covariance(equations.jacobian / scale, equations.prior)
    weak = weak_directions(problem, equations.jacobian, posterior, scale=scale)
    estimate = Estimate(
        problem, linear.x, posterior, scale, scores, weak, check, method, iterations, optimality,
        (), linear, nuisance, rows,
    )  # fmt: skip
    return replace(estimate, warnings=notes(estimate))
