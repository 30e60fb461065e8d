"""Rival explanations of the same readings, each with what the readings leave uncertain of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.effects import BASE_FAMILIES, elementary, family_of, is_dial
from orthoglide.errors import InputError
from orthoglide.fit import Estimate, Problem, with_free
from orthoglide.fit.least_squares import Linearised, Nuisances, linearise, normal
from orthoglide.geometry import Array

Values = Mapping[str, float]


@dataclass(frozen=True)
class Explanation:
    """One way to explain the readings at hand.

    Attributes:
        name: of the cause.
        values: all parameters of machine and dials, SI.
        parts: elementary parameters of the machine that its unknowns set.
        weights: of these for each unknown ``(E, P)``.
        covariance: of the unknowns ``(P, P)``, SI, tolerances as priors.
    """

    name: str
    values: Values
    parts: tuple[str, ...]
    weights: Array
    covariance: Array

    def spread(self, names: Sequence[str]) -> Array:
        """Covariance of elementary parameters ``(n, n)``, SI; zero where none of its unknowns."""
        place = {n: k for k, n in enumerate(names)}
        matrix = np.zeros((len(names), self.weights.shape[1]))
        for part, row in zip(self.parts, self.weights, strict=True):
            matrix[place[part]] = row
        return matrix @ self.covariance @ matrix.T


def explanation(
    name: str, fit: Estimate | Values, like: Estimate, scale: float = 1.0
) -> Explanation:
    """An explanation from its own fit, or from its values.

    Args:
        name: of the cause: a parameter, a structured member, or any other name.
        fit: an estimate of the last campaign's machine, or all its parameters, SI.
        like: the fit whose readings, datums and base unknowns count where there are values only.
        scale: of the noise, where lack of fit remains.
    """
    if isinstance(fit, Estimate):
        return _described(name, fit.problem, fit.at, fit.nuisance, scale)
    problem = _problem(name, fit, like.problem)
    last = len(problem.campaigns) - 1
    x = np.array([_value(dict(u.parts[last]), fit) for u in problem.unknowns])
    return _described(name, problem, linearise(problem, x), like.nuisance, scale)


def _described(
    name: str, problem: Problem, at: Linearised, nuisance: Nuisances, scale: float
) -> Explanation:
    here = normal(replace(problem, priors=True), at, nuisance)
    unit = problem.tolerance
    information = here.information * unit * unit[:, None] / scale**2
    covariance = np.linalg.inv(information) * unit * unit[:, None]
    last = len(problem.campaigns) - 1
    parts, weights = problem.elementary(last)
    kept = [k for k, p in enumerate(parts) if not is_dial(p)]
    return Explanation(
        name,
        problem.values(last, at.x),
        tuple(parts[k] for k in kept),
        weights[kept],
        covariance,
    )


def _problem(name: str, values: Values, like: Problem) -> Problem:
    """The readings at hand with the unknowns of another explanation."""
    last = len(like.campaigns) - 1
    own = _own(name, values, like)
    kept = tuple(
        u
        for u in like.unknowns
        if family_of(u.name).name in BASE_FAMILIES
        or u.name == name
        or (u.parts[last] and set(u.parts[last]) <= set(values) and not set(u.parts[last]) & own)
    )
    covered = {p for u in kept for p in u.parts[last]}
    missing = [n for n, v in values.items() if v and n not in covered]
    added = [name] if own and own >= set(missing) and missing else missing
    held: tuple[dict[str, float], ...] = tuple({} for _ in like.campaigns)
    return with_free(replace(like, unknowns=kept, held=held), added)


def _own(name: str, values: Values, like: Problem) -> set[str]:
    """Elementary parameters that a name stands for, as far as it is one of a parameter."""
    setups = tuple(s.name for c in like.campaigns for s in c.setups)
    try:
        return set(elementary(name.partition("@")[0], setups))
    except InputError:
        return {n for n in values if n.startswith(f"{name}.")}


def _value(parts: Mapping[str, float], values: Values) -> float:
    """The unknown that sets its parts to these values, in the least squares."""
    weight = np.array(list(parts.values()))
    given = np.array([values.get(p, 0.0) for p in parts])
    return float(weight @ given / (weight @ weight)) if len(weight) else 0.0
