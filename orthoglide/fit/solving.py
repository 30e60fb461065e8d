"""Solving a problem: by programme, nested closures or the reduction; verified and cross-checked."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Literal

import numpy as np

from orthoglide.errors import InputError, NumericsError, SolverError, UnidentifiableError
from orthoglide.fit.crosscheck import CrossCheck, cross_check, reduction_fit
from orthoglide.fit.estimate import Estimate
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
from orthoglide.fit.nested import solve_nested
from orthoglide.fit.notes import notes
from orthoglide.fit.problem import Problem
from orthoglide.fit.scores import LACK_OF_FIT, FittedRows, score
from orthoglide.geometry import Array
from orthoglide.ordering import canonical_basis

Method = Literal["auto", "nlp", "nested", "pinocchio", "reduction"]

_MANY, _SOME = 20_000, 2_000  # readings from which a fit starts from a fit of some

NLP_POSTURES = 200
"""Up to this many distinct postures the programme carries the closures as constraints."""

NLP_UNKNOWNS = 30
"""Up to this many unknowns: the time to build its exact Hessian grows with their square."""

_OPTIMALITY_TOLERANCE = (
    1e-4  # sigmas that a Newton step may still make where a solver says it is done
)

_PLACEMENT_ROUNDS = 3  # of a fit about the instruments as the last one has them
_MAX_CHI2_RATIO = 0.5  # share of chi2 that a round may leave for another to be worth its time
_WIDENING_ROUNDS, _WIDENING_RATIO = (
    8,
    1.2,
)  # rounds, and the growth of a value that asks for one more


def solve(
    problem: Problem, *, method: Method = "auto", start: Array | None = None, widen: bool = True
) -> Estimate:
    """Solve a problem, verify the answer and cross-check it; see :func:`identify`.

    A value that ends far beyond its tolerance shows that the tolerance was no knowledge of this
    machine: its prior is widened to the value's own size (the scale of a normal prior that fits it
    best), so that it does not pull on the readings. Where something is left of them even so, the
    value was bent by what the model lacks, and the tolerances hold. So they do with
    ``widen=False``, where readings are still in doubt themselves.
    """
    first = _fit_and_place(problem, method, start)
    wide = widen_priors(first, method) if widen else first
    return wide if wide.sigma_scale == 1.0 else first


def _fit_and_place(problem: Problem, method: Method, start: Array | None) -> Estimate:
    """A fit, and again with instruments' frames brought to the machine found.

    Their turns are fitted linearly, and the squares of some milliradians are more than such
    instruments' noise.
    """
    found = _solve(problem, method, start)
    for _ in range(_PLACEMENT_ROUNDS):
        near = update_instrument_poses(found.problem, found.at)
        if near is found.problem:
            break
        last, found = found, _solve(near, method, found.x)
        if found.scores.chi2 > _MAX_CHI2_RATIO * last.scores.chi2:
            break  # not the instruments' place is what these readings have wrong, if anything
    return found


def widen_priors(found: Estimate, method: Method = "auto") -> Estimate:
    """A fit again with the priors of values beyond their tolerances as wide as these are far; the
    same where none is, or where there are no priors.

    From a fit so near a few Gauss-Newton steps take less than a programme takes to be built.
    """
    method = "nested" if method == "auto" else method
    for _ in range(_WIDENING_ROUNDS if found.problem.priors else 0):
        problem = found.problem
        width = np.array([u.prior_width for u in problem.unknowns])
        size = np.abs(problem.without_entered_mean(found.x)) / problem.tolerance
        wider = problem.is_implausible(found.x) & (size > _WIDENING_RATIO * width)
        if not wider.any():
            break
        unknowns = [
            replace(u, prior_width=float(w)) if more else u
            for u, w, more in zip(problem.unknowns, size, wider, strict=True)
        ]
        try:
            found = _fit_and_place(replace(problem, unknowns=tuple(unknowns)), method, found.x)
        except NumericsError:
            break
    return found


def refit_with_residual_noise(found: Estimate) -> Estimate:
    """The values where readings are as noisy as the fit leaves them; scores by their own noise. A
    fit that leaves nothing significant is returned as it is.

    Where something is left of a fit, its sigmas take the readings for so many times as noisy.
    Values that the readings tell no better than the tolerances do are then pulled towards zero by
    as much more as these count; the sigmas of a fit that believed its readings would be those of
    other values.

    Raises:
        SolverError: where the steps do not settle.
        CrossCheckError: where mechanism and reduction disagree.
    """
    problem = found.problem
    if found.sigma_scale == 1.0 or not problem.prior_rows[0].any():
        return found
    # Everything that is known before is known so many times better.
    times, earlier, nuisance = found.sigma_scale, problem.earlier_posterior, found.nuisance
    if earlier is not None:
        earlier = replace(earlier, covariance=earlier.covariance / times**2)
    unknowns = tuple(replace(u, prior_width=u.prior_width / times) for u in problem.unknowns)
    heavier = replace(problem, unknowns=unknowns, earlier_posterior=earlier)
    at, more = solve_nested(heavier, nuisance, found.at)
    check = cross_check(heavier, nuisance, at)
    again = make_estimate(
        problem, nuisance, at, found.method, found.iterations + more, found.optimality, check
    )
    return replace(again, changes=found.changes)


def _solve(problem: Problem, method: Method, start: Array | None) -> Estimate:
    if method == "reduction" and not problem.reduction_applies:
        others = dict.fromkeys(s.kind for s in problem.setups if s.observation.dials != 1)
        if others:
            raise InputError(
                f"the reduction predicts dials only, each by itself: leave out the readings of "
                f"kind {', '.join(others)}, or take another method"
            )
        raise InputError("the reduction has joint offsets and leg lengths only: free nothing else")
    begin = _initial_values(problem, method) if start is None else start
    first = linearise(problem, begin)
    # Slopes at a first Gauss-Newton step: nearer to the fitted machine than the nominal one.
    nuisance = nuisances(problem, first.reading_poses)
    began = normal_equations(problem, first, nuisance)
    _check_determined(problem, began)
    known = np.vstack([began.prior, np.diag(1 / problem.tolerance)])
    x = begin - covariance(began.jacobian, known)[0] @ began.gradient
    near = linearise(problem, np.clip(x, -problem.bound, problem.bound))
    if start is not None and normal_equations(problem, near, nuisance).cost > began.cost:
        near = first  # from a fit nearby the step went too far
    nuisance = nuisances(problem, near.reading_poses)
    began = normal_equations(problem, first, nuisance)
    at, iterations, used = _run_method(problem, nuisance, began, near, method)
    optimality = _check_solution(problem, nuisance, at, began)
    if used == "nlp":
        # IPOPT stops where its own tolerances are met, which is not the same place on every
        # processor; what was verified is brought to the minimum by the steps that are left.
        with suppress(SolverError):
            settled = solve_nested(problem, nuisance, at)[0]
            at, optimality = settled, _check_solution(problem, nuisance, settled, began)
    check = cross_check(problem, nuisance, at)
    return make_estimate(problem, nuisance, at, used, iterations, optimality, check)


def _initial_values(problem: Problem, method: Method) -> Array:
    """Return the initial values ``(P,)``; of very many readings, a fit to a subset."""
    count = sum(map(len, problem.campaigns))
    if count < _MANY or method == "reduction":
        return problem.start
    every = count // _SOME
    thinned = []
    for factor in problem.leg_factors:
        some = [np.flatnonzero(factor.setup == s)[::every] for s in range(len(factor.setup_names))]
        thinned.append(factor.subset(np.sort(np.concatenate(some))))
    thin = problem.with_leg_factors(thinned)
    try:
        return solve(thin, method="nested", widen=False).x
    except (NumericsError, InputError):
        return problem.start


def _check_determined(problem: Problem, here: NormalEquations) -> None:
    """Refuse what these readings cannot determine, by directions of as few unknowns as can be."""
    _, unseen = covariance(here.jacobian, here.prior)
    if not len(unseen):
        return
    norm = np.linalg.norm(here.jacobian, axis=0)
    # By what each unknown does to the readings, as metres and radians do not compare.
    seen = np.where(norm > 0, norm, 1.0)
    found = list[dict[str, float]]()
    for shares in canonical_basis(unseen * seen):
        kept = np.abs(shares) >= 0.05 * np.abs(shares).max()
        direction = shares / seen / np.linalg.norm(shares / seen)
        each = zip(problem.names, direction, kept, strict=True)
        found.append({name: float(v) for name, v, k in each if k})
    names = "; ".join(dict.fromkeys(" with ".join(f) for f in found))
    raise UnidentifiableError(
        f"these readings do not determine {names}: free fewer parameters, measure more "
        f"postures, or let the tolerances act as priors",
        directions=tuple(found),
    )


def _run_method(
    problem: Problem, nuisance: Nuisances, began: NormalEquations, near: Linearised, method: Method
) -> tuple[Linearised, int, str]:
    """Where a method ends, linearised by ourselves; ``near`` is one step on from ``began``."""
    if method == "reduction":
        x, iterations = _solve_by_reduction(problem, nuisance)
        return linearise(problem, x), iterations, "reduction"
    if method == "pinocchio":
        reference = replace(problem, machine=problem.machine.by_pinocchio())
        at, steps = solve_nested(reference, nuisance, linearise(reference, near.x))
        return linearise(problem, at.x), steps + 1, "pinocchio"
    elastic = problem.elastic
    if elastic and method == "nlp":
        raise InputError("the programme closes unloaded loops: take the nested method under load")
    postures = sum(len(np.unique(f.conditions().command, axis=0)) for f in problem.factors)
    large = postures > NLP_POSTURES or len(problem.names) > NLP_UNKNOWNS
    # A programme is worth its time where the reduction checks it too.
    other = not problem.legs_only
    if method == "nested" or (method == "auto" and (large or elastic or other)):
        at, steps = solve_nested(problem, nuisance, near)
        return at, steps + 1, "nested"
    from orthoglide.fit.nlp import Nlp

    programme = Nlp(problem, nuisance, 1 / np.sqrt(np.diag(began.information)))
    joints = programme.start_joints(problem, began.x)
    result = programme.solve(problem.measured, began.x, joints)
    return linearise(problem, result.x), result.iterations, "nlp"


def _solve_by_reduction(problem: Problem, nuisance: Nuisances) -> tuple[Array, int]:
    """The reduction's fit; unknowns that leave their bounds are held there, and the rest again."""
    x, iterations = problem.start, 0
    held = np.zeros(len(x), dtype=bool)
    while True:
        fit = reduction_fit(problem, nuisance, start=x, held=held)
        x, iterations = fit.values[:-1], iterations + fit.iterations
        beyond = np.abs(x) > problem.bound
        if not beyond.any():
            return x, iterations
        x, held = np.clip(x, -problem.bound, problem.bound), held | beyond


def _check_solution(
    problem: Problem, nuisance: Nuisances, at: Linearised, began: NormalEquations
) -> float:
    """Our own word on the solver's success: loops closed, no better than where it began, settled.

    The linearisation has closed every posture by itself, or raised. What is left of a Gauss-Newton
    step is measured in sigmas; unknowns on a bound cannot move further.
    """
    here = normal_equations(problem, at, nuisance)
    if not here.cost <= began.cost * (1 + 1e-9) + 1e-9:
        raise SolverError(
            "the solver ended with a worse fit than it started from",
            evidence={"chi2": here.cost, "chi2_start": began.cost},
        )
    inside = np.abs(at.x) < problem.bound * (1 - 1e-6)
    scale = 1 / np.sqrt(np.maximum(np.diag(here.information), 1e-300))
    # In sigmas of each unknown alone: the gradient itself, the weak directions left out of account.
    left = np.abs(here.gradient * scale)[inside]
    optimality = float(left.max(initial=0.0))
    if optimality > _OPTIMALITY_TOLERANCE * max(1.0, float(np.sqrt(here.cost))):
        raise SolverError(
            f"the solver stopped {optimality:.2g} sigmas before the minimum; check the readings",
            evidence={"optimality": optimality},
        )
    return optimality


def make_estimate(
    problem: Problem,
    nuisance: Nuisances,
    at: Linearised,
    method: str,
    iterations: int,
    optimality: float,
    check: CrossCheck | None = None,
) -> Estimate:
    """An estimate from where a method ended: scores, covariance, warnings."""
    here = normal_equations(problem, at, nuisance)
    rows = FittedRows.from_fit(problem, nuisance, at)
    scores = score(rows, at)
    scale = 1.0
    if scores.dof > 0 and scores.lack_of_fit_p < LACK_OF_FIT:
        scale = max(float(np.sqrt(scores.chi2 / scores.dof)), 1.0)
    # What is left makes the readings worse witnesses, not the tolerances wider.
    spread, _ = covariance(here.jacobian / scale, here.prior)
    weak = weak_directions(problem, here.jacobian, spread, scale=scale)
    estimate = Estimate(
        problem, at.x, spread, scale, scores, weak, check, method, iterations, optimality, (), at,
        nuisance, rows,
    )  # fmt: skip
    return replace(estimate, warnings=notes(estimate))
