"""``identify``: from readings to parameters, solved, verified and cross-checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from orthoglide.effects import BASE_FAMILIES
from orthoglide.errors import InputError, SolverError, UnidentifiableError
from orthoglide.fit.crosscheck import cross_check, reduction_fit
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.least_squares import (
    Linearised,
    Nuisances,
    covariance,
    linearise,
    normal,
    nuisances,
)
from orthoglide.fit.nested import solve_nested
from orthoglide.fit.noise import noise_of
from orthoglide.fit.problem import Problem, build_problem
from orthoglide.fit.scores import Scores, score
from orthoglide.fit.weakness import sparse_basis, weak_directions
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, Given, as_campaigns
from orthoglide.prediction import Conditions

Method = Literal["auto", "nlp", "nested", "reduction"]

NLP_POSTURES = 200
"""Up to this many distinct postures the programme carries the closures as constraints."""

_OPTIMAL = 1e-4  # sigmas that a Newton step may still make where a solver says it is done
_LACK = 0.01  # probability below which what is left counts as lack of fit
_EXACT = 1e-2  # of the noise; leaves a ten-thousandth of what a free datum takes up


def identify(
    campaigns: Given | Sequence[Given],
    machine: Machine | None = None,
    free: Sequence[str] = BASE_FAMILIES,
    *,
    own: Sequence[str] = (),
    priors: bool = True,
    noise: float | None = None,
    bounds: Mapping[str, float] | None = None,
    weighting: Literal["readings", "deviations"] = "readings",
    method: Method = "auto",
) -> Estimate:
    """Identify parameters of the general mechanism from dial readings.

    Args:
        campaigns: one or several; paths are read as by ``read_campaign``.
        machine: dimensions, tolerances and what is known already; nominal where absent.
        free: families, parameters or structured members to identify.
        own: which of them each campaign has for itself; the rest is shared.
        priors: whether the machine's tolerances act as priors about zero.
        noise: standard deviation of one reading, metres; see ``noise_of`` where absent.
        bounds: by parameter or family, SI: values stay within plus and minus.
        weighting: ``"readings"`` weighs every reading by its noise, with a free datum a setup;
            ``"deviations"`` is the papers' ordinary least squares on differences from each
            setup's first posture, which takes that posture's reading and the dials' places for
            exact.
        method: ``"nlp"``, ``"nested"``, ``"reduction"`` (the analytic PSS model); ``"auto"`` takes
            the programme up to ``NLP_POSTURES`` postures, and nests the closure beyond.

    Raises:
        InputError: where what is asked makes no sense.
        UnidentifiableError: where the readings cannot determine it, naming what.
        SolverError: where no solver reaches an answer that passes our own checks.
        CrossCheckError: where mechanism and reduction disagree by more than 1e-6 mm.
    """
    machine = machine or Machine.nominal()
    several = as_campaigns(campaigns, machine.spec)
    level = noise_of(several, machine.spec.dial, noise)
    problem = build_problem(machine, several, free, level, own=own, priors=priors, bounds=bounds)
    _check_own(problem)
    if weighting == "deviations":
        problem = _anchored(problem)
    return solve(problem, method=method)


def _check_own(problem: Problem) -> None:
    for name in problem.own:
        plain = name.partition("@")[0]
        free = (u.partition("@")[0] for u in problem.names)
        if not any(n == plain or n.startswith(f"{plain}.") for n in free):
            raise InputError(f"{name} is own to each campaign but not free: free it too")


def _averaged(campaign: Campaign) -> Campaign:
    """One row a setup and posture, as the papers average their repeats."""
    table = np.column_stack([campaign.setup, campaign.command])
    _, first, station = np.unique(table, axis=0, return_index=True, return_inverse=True)
    station = station.reshape(-1)
    mean = np.bincount(station, campaign.reading) / np.bincount(station)
    kept = np.sort(first)
    return campaign.subset(kept).with_readings(mean[station[kept]])


def _anchored(problem: Problem) -> Problem:
    """Averaged readings, equal weights, each setup's first posture and the dials' places exact."""
    campaigns = tuple(_averaged(c) for c in problem.campaigns)
    sigmas = []
    for campaign in campaigns:
        sigma = np.full(len(campaign), problem.noise.typical)
        _, first = np.unique(campaign.setup, return_index=True)
        sigma[first] *= _EXACT
        sigmas.append(sigma)
    noise = replace(problem.noise, sigma=tuple(sigmas), common=0.0)
    return replace(problem, campaigns=campaigns, noise=noise, placement=0.0)


def solve(problem: Problem, *, method: Method = "auto", start: Array | None = None) -> Estimate:
    """Solve a problem, verify the answer and cross-check it; see :func:`identify`."""
    if method == "reduction" and not problem.representable:
        raise InputError("the reduction has joint offsets and leg lengths only: free nothing else")
    begin = problem.start if start is None else start
    first = linearise(problem, begin)
    # Slopes at a first Gauss-Newton step: nearer to the fitted machine than the nominal one.
    nuisance = nuisances(problem, first.by_gauge)
    _determined(problem, first, nuisance)
    near = linearise(problem, _one_step(problem, first, nuisance))
    nuisance = nuisances(problem, near.by_gauge)
    at, iterations, used = _solved(problem, nuisance, first, near, method)
    optimality = _verified(problem, nuisance, at, first)
    return _estimate(problem, nuisance, at, first, used, iterations, optimality)


def _one_step(problem: Problem, first: Linearised, nuisance: Nuisances) -> Array:
    here = normal(problem, first, nuisance)
    spread, _ = covariance(here.jacobian, np.maximum(here.prior, 1 / problem.tolerance))
    step = spread @ -here.gradient
    return np.asarray(np.clip(first.x + step, -problem.bound, problem.bound))


def _determined(problem: Problem, first: Linearised, nuisance: Nuisances) -> None:
    """Refuse what these readings cannot determine."""
    here = normal(problem, first, nuisance)
    _, unseen = covariance(here.jacobian, here.prior)
    if len(unseen):
        found = _undetermined(problem.names, here.jacobian, unseen)
        names = "; ".join(dict.fromkeys(" with ".join(f) for f in found))
        raise UnidentifiableError(
            f"these readings do not determine {names}: free fewer parameters, measure more "
            f"postures, or let the tolerances act as priors",
            directions=found,
        )


def _undetermined(
    names: tuple[str, ...], jacobian: Array, unseen: Array
) -> tuple[dict[str, float], ...]:
    """Undetermined directions by unknown, SI: as few unknowns in each as can be."""
    norm = np.linalg.norm(jacobian, axis=0)
    # By what each unknown does to the readings, as metres and radians do not compare.
    seen = np.where(norm > 0, norm, 1.0)
    found = []
    for shares in sparse_basis(unseen * seen):
        kept = np.abs(shares) >= 0.05 * np.abs(shares).max()
        direction = shares / seen / np.linalg.norm(shares / seen)
        found.append({n: float(v) for n, v, k in zip(names, direction, kept, strict=True) if k})
    return tuple(found)


def _solved(
    problem: Problem, nuisance: Nuisances, first: Linearised, near: Linearised, method: Method
) -> tuple[Linearised, int, str]:
    """Where a method ends, linearised by ourselves; ``near`` is one step on from ``first``."""
    if method == "reduction":
        x, iterations = _reduced(problem, nuisance)
        return linearise(problem, x), iterations, "reduction"
    elastic = _elastic(problem)
    if elastic and method == "nlp":
        raise InputError("the programme closes unloaded loops: take the nested method under load")
    large = posture_count(problem) > NLP_POSTURES
    if method == "nested" or (method == "auto" and (large or elastic)):
        nested = solve_nested(problem, nuisance, near)
        return nested.at, nested.iterations + 1, "nested"
    from orthoglide.fit.nlp import Nlp

    here = normal(problem, first, nuisance)
    programme = Nlp(problem, nuisance, 1 / np.sqrt(np.diag(here.information)))
    joints = programme.start_joints(problem, first.x)
    result = programme.solve(problem.measured, first.x, joints)
    return linearise(problem, result.x), result.iterations, "nlp"


def _reduced(problem: Problem, nuisance: Nuisances) -> tuple[Array, int]:
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


def _elastic(problem: Problem) -> bool:
    """Whether stiffness moves any of the postures."""
    model = problem.machine.model
    return any(model.is_elastic(Conditions.of(c)) for c in problem.campaigns)


def posture_count(problem: Problem) -> int:
    """Distinct commands of all campaigns: at least as many postures has the programme."""
    return sum(len(np.unique(c.command, axis=0)) for c in problem.campaigns)


def _verified(problem: Problem, nuisance: Nuisances, at: Linearised, first: Linearised) -> float:
    """Our own word on the solver's success: loops closed, no better than where it began, settled.

    The linearisation has closed every posture by itself, or raised. What is left of a Gauss-Newton
    step is measured in sigmas; unknowns on a bound cannot move further.
    """
    here = normal(problem, at, nuisance)
    began = normal(problem, first, nuisance)
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
    if optimality > _OPTIMAL * max(1.0, float(np.sqrt(here.cost))):
        raise SolverError(
            f"the solver stopped {optimality:.2g} sigmas before the minimum; check the readings",
            evidence={"optimality": optimality},
        )
    return optimality


def _estimate(
    problem: Problem,
    nuisance: Nuisances,
    at: Linearised,
    first: Linearised,
    method: str,
    iterations: int,
    optimality: float,
) -> Estimate:
    here = normal(problem, at, nuisance)
    _, unseen = covariance(here.jacobian, here.prior)
    rank = len(problem.unknowns) - len(unseen)
    scores = score(problem, nuisance, at, here.cost, rank)
    scale = 1.0
    if scores.dof > 0 and scores.lack_of_fit_p < _LACK:
        scale = float(np.sqrt(scores.chi2 / scores.dof))
    # What is left makes the readings worse witnesses, not the tolerances wider.
    spread, _ = covariance(here.jacobian / scale, here.prior)
    check = cross_check(problem, nuisance, at.x, at.value)
    weak = weak_directions(problem.names, here.jacobian, spread, scale=scale)
    estimate = Estimate(
        problem, at.x, spread, scale, scores, _nominal_scores(problem, nuisance, first),
        weak, check, method, iterations, optimality, (), at, nuisance,
    )  # fmt: skip
    return replace(estimate, warnings=_warnings(estimate))


def _nominal_scores(problem: Problem, nuisance: Nuisances, first: Linearised) -> Scores:
    zero = linearise(problem, np.zeros(len(problem.unknowns))) if first.x.any() else first
    residual = nuisance.project(problem.measured - zero.value)
    nothing = Linearised(zero.x, zero.value, np.zeros((len(zero.value), 0)), zero.by_gauge)
    fixed = replace(problem, unknowns=())
    return score(fixed, nuisance, nothing, float(residual @ residual), 0)


def _warnings(estimate: Estimate) -> tuple[str, ...]:
    problem, scores = estimate.problem, estimate.scores
    found = [w for c in problem.campaigns for w in c.warnings]
    if estimate.sigma_scale > 1:
        found.append(
            f"the residuals are {estimate.sigma_scale:.1f} times the noise of "
            f"{problem.noise.typical * 1e3:.3f} mm (chi2 {scores.chi2:.0f} on {scores.dof} degrees "
            f"of freedom): the model lacks something, and all sigmas take the readings for "
            f"{estimate.sigma_scale:.1f} times as noisy"
        )
    found.extend(
        f"{name} ended on its bound: it is not identified; check the readings and the units"
        for name in estimate.on_bound
    )
    found.extend(
        f"{name} is {abs(value) / tolerance:.1f} times its tolerance"
        for (name, value), tolerance in zip(estimate.values.items(), problem.tolerance, strict=True)
        if abs(value) > 4 * tolerance
    )
    check = estimate.check
    if check is not None and not check.second_order:
        found.append(
            f"the linear system (11) fits readings that differ by {check.linear * 1e3:.3g} mm, "
            f"more than second-order terms explain: treat the result with care"
        )
    return tuple(found)
