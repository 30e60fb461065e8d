"""What changed between two visits to a machine: columns of the readings after it.

What the machine was before, and what stays, are the unknowns of a problem with its prior; a change
adds to the readings from one row on. The set that explains them best is looked for about one point,
and again about the machine that so changed, until it stays the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.fit.change_search import Found, Hypotheses
from orthoglide.fit.least_squares import Nuisances, linearise, normal, nuisances
from orthoglide.fit.problem import Problem
from orthoglide.fit.unknown import weight_matrix
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

_ROUNDS = 5
"""Linearisations, each of the machine that changed as the one before says."""

# One parameter in twenty changes between two visits: the log odds that a change must overcome,
# and again the logarithm of the number of parameters that could have.
_ODDS = 3.0


@dataclass(frozen=True)
class Candidate:
    """A parameter that may have changed."""

    parameter: Parameter  # with the campaign from which it has another value, or none
    since: int  # first row after the change
    weights: Mapping[Parameter, float]  # of a tolerance of it, by unknown of the problem, SI
    tolerance: float  # SI


def may_change(
    problem: Problem, names: Sequence[Parameter]
) -> dict[Parameter, dict[Parameter, float]]:
    """What may have changed: a tolerance of each, by unknown of the problem, SI.

    Args:
        problem: whose unknowns they are.
        names: single parameters; where no dial was read, patterns of equal legs come beside them,
            and of one plate that several setups touched.
    """
    machine = problem.machine
    found = {name: {name: machine.tolerance(name)} for name in names}
    if problem.campaigns:
        return found
    setups = tuple(dict.fromkeys(name.setup for name in names if name.setup))
    for kind in dict.fromkeys(name.effect for name in names):
        for member, parts in machine.catalogue.structured(kind, setups).items():
            if len(parts) > 1 and set(parts) <= set(names):
                found[member] = {n: w * machine.tolerance(n) for n, w in parts.items()}
    return found


@dataclass(frozen=True)
class Moved:
    """One change, and what could have changed in its place."""

    sizes: Mapping[Parameter, float]  # by how much each would have, SI, the change itself first
    sigma: float  # standard deviation of its size, SI
    among: float  # what this has of other sets that could have changed, SI
    evidence: float  # log Bayes factor in its favour, the others given

    @property
    def parameter(self) -> Parameter:
        """The parameter that changed."""
        return next(iter(self.sizes))


@dataclass(frozen=True)
class Changed:
    """The most probable set of changes."""

    moved: tuple[Moved, ...]  # the most decisive change first
    weight: float  # log odds of all of them against none
    about: Linear  # the readings about the machine that so changed


def what_changed(
    problem: Problem, x: Array, candidates: Sequence[Candidate], floor: float = 1.0
) -> Changed | None:
    """The changes that the readings speak for most; ``None`` where for none.

    Args:
        problem: what was and what stays, with its prior.
        x: about where its unknowns are ``(P,)``.
        candidates: what may have changed.
        floor: least chi2 a degree of freedom.

    Raises:
        NumericsError: where the machine that so changed cannot be closed.
    """
    places: set[int] = set()
    sizes = np.zeros(len(candidates))
    for _ in range(_ROUNDS):
        here = Linear.about(problem, x, candidates, sizes, floor)
        found = here.hypotheses.found()
        if found is None:
            return None
        changed = Changed(tuple(_moved(found, candidates)), found.weight, here)
        if set(found.places) == places:
            break
        places, sizes = set(found.places), np.zeros(len(candidates))
        sizes[list(found.places)] = found.sizes
        x = here.mean(sizes)
    return changed


def _moved(found: Found, candidates: Sequence[Candidate]) -> Iterator[Moved]:
    each = zip(found.places, found.instead, found.sigmas, found.among, found.evidence, strict=True)
    for place, instead, sigma, among, evidence in each:
        sizes = {candidates[k].parameter: v * candidates[k].tolerance for k, v in instead.items()}
        unit = candidates[place].tolerance
        sigma = float(np.hypot(sigma, among)) * unit
        yield Moved(sizes, sigma, float(among) * unit, float(evidence))


@dataclass(frozen=True, eq=False)
class Linear:
    """The readings about one point, whitened and past datums and placements."""

    problem: Problem  # what was and what stays
    candidates: Sequence[Candidate]  # what may have changed, `c` of them
    columns: Array  # readings by a tolerance of each (m, c)
    residual: Array  # readings less what is known foretells, unchanged (m,)
    open_to: Array  # readings by what is known no better, in its standard deviations (m, P)
    root: Array  # of the covariance of what is known, in tolerances (P, P)
    known: Array  # its mean, in tolerances (P,)
    nuisance: Nuisances  # datums and placements
    floor: float  # least chi2 a degree of freedom

    @classmethod
    def about(
        cls,
        problem: Problem,
        x: Array,
        candidates: Sequence[Candidate],
        sizes: Array,
        floor: float,
    ) -> Linear:
        """About unknowns ``(P,)`` of a machine that changed by some sizes ``(c,)``."""
        at = linearise(_with_changes(problem, candidates, sizes), x)
        nuisance = nuisances(problem, at.seen)
        here, scale = normal(problem, at, nuisance), problem.tolerance
        root = np.asarray(np.linalg.inv(here.prior * scale))
        known = np.asarray(root @ here.target)
        jacobian = here.jacobian * scale
        weights = weight_matrix(problem.names, [c.weights for c in candidates])
        since = np.array([c.since for c in candidates], dtype=np.intp)
        after = np.arange(len(at.jacobian))[:, None] >= since
        columns = nuisance.project(at.jacobian @ weights * after)
        residual = here.residual + jacobian @ (x / scale - known) + columns @ sizes
        return cls(
            problem, candidates, columns, residual, jacobian @ root, root, known, nuisance, floor
        )

    @cached_property
    def hypotheses(self) -> Hypotheses:
        """The candidates past all that is open."""
        across = self._whitened(np.column_stack([self.columns, self.residual]))
        inner = self.columns.T @ self.columns - across[:, :-1].T @ across[:, :-1]
        met = self.columns.T @ self.residual - across[:, :-1].T @ across[:, -1]
        of = self.problem.machine.catalogue.effect_of
        # A zero is entered in a minute, and nothing else of the machine changes as often.
        zero = [of(c.parameter).controller == "zero" for c in self.candidates]
        cost = _ODDS + np.where(zero, 0.0, np.log(max(len(zero), 1)))
        taken = len(self._inner) - float(np.sum(np.linalg.inv(self._inner) ** 2))
        dof = max(float(len(self.problem.measured) - self.nuisance.free) - taken, 1.0)
        chi2 = self._chi2(self.residual)
        return Hypotheses(inner, met, cost, chi2, dof, self.floor)

    def evidence(self, change: Array) -> float:
        """Log likelihood of readings that are wrong by some ``(n,)``, metres, where nothing
        changed, against readings that are right.
        """
        left = self._chi2(self.residual + self.nuisance.project(change))
        return float(self.hypotheses.evidence(np.array(left)))

    def _chi2(self, residual: Array) -> float:
        along = self._whitened(residual)
        return float(residual @ residual - along @ along)

    def mean(self, sizes: Array) -> Array:
        """The unknowns ``(P,)`` beside changes of some sizes ``(c,)``, SI."""
        along = self._whitened(self.residual - self.columns @ sizes)
        found = self.known + self.root @ np.linalg.solve(self._inner.T, along)
        return np.asarray(found * self.problem.tolerance)

    def _whitened(self, rows: Array) -> Array:
        return np.asarray(np.linalg.solve(self._inner, self.open_to.T @ rows))

    @cached_property
    def _inner(self) -> Array:
        inside = np.eye(self.open_to.shape[1]) + self.open_to.T @ self.open_to
        return np.asarray(np.linalg.cholesky(inside))


def _with_changes(problem: Problem, candidates: Sequence[Candidate], sizes: Array) -> Problem:
    """The problem of a machine that changed by some sizes ``(c,)``: what is free is what stays."""
    place = {unknown.name: unknown for unknown in problem.unknowns}
    held = []
    for k, (rows, values) in enumerate(zip(problem.factor_rows, problem.held, strict=True)):
        now = dict(values)
        for candidate, size in zip(candidates, sizes, strict=True):
            if size and rows.start >= candidate.since:
                for name, weight in candidate.weights.items():
                    for part, share in place[name].parts[k].items():
                        now[part] = now.get(part, 0.0) + share * weight * float(size)
        held.append(now)
    return replace(problem, held=tuple(held))
