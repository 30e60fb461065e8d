"""Changes between two visits to a machine, as groups of columns of the readings after them.

What the machine was before, and what stays, are the unknowns of a problem with its prior; a change
adds to the readings from one row on. It is a group of the search for causes, and the set that
explains the readings best is looked for about one point, and again about the machine that so
changed, until it stays the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.explanation.linear_model import (
    LinearModel,
    UnknownNoise,
    drop_unseen_directions,
    identity_group,
)
from orthoglide.explanation.mixture import Mixture
from orthoglide.fit.least_squares import linearise, normal_equations, nuisances
from orthoglide.fit.problem import Problem
from orthoglide.fit.unknowns import weight_matrix
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

_ROUNDS = 5
"""Linearisations, each of the machine that changed as the one before says."""

_EXPECTED_CHANGES = float(np.exp(-3.0))
"""Prior mean number of changes of each zero, and of all other parameters together: between two
visits, one in twenty changes."""

SLAB_WIDTHS = (1.0, 3.0, 10.0)
"""Tolerances by which something changes, each less likely by as much as it is wider."""

SLAB_ODDS = tuple(
    np.log(len(SLAB_WIDTHS) / np.array(SLAB_WIDTHS) / np.sum(1 / np.array(SLAB_WIDTHS))).tolist()
)
"""Log prior odds of each of these widths, against all being as likely."""

_MOST_CHANGES = 12  # changes between two visits: more than anybody makes, few enough to search

INDISTINGUISHABLE_CHI2 = 4.0
"""Rise of chi2 within which two causes cannot be told apart: two sigmas (Wilks)."""


@dataclass(frozen=True)
class ChangeCandidate:
    """A parameter that may have changed."""

    parameter: Parameter  # with the campaign from which it has another value, or none
    since: int  # first row after the change
    weights: Mapping[Parameter, float]  # of a tolerance of it, by unknown of the problem, SI
    tolerance: float  # SI


def changeable_parameters(
    problem: Problem, names: Sequence[Parameter]
) -> dict[Parameter, dict[Parameter, float]]:
    """Return what may have changed, each as one tolerance by unknown of the problem, SI.

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
        for member, parts in machine.catalogue.structured_members(kind, setups).items():
            if len(parts) > 1 and set(parts) <= set(names):
                found[member] = {n: w * machine.tolerance(n) for n, w in parts.items()}
    return found


@dataclass(frozen=True)
class ChangeEstimate:
    """One change, and what could have changed in its place."""

    sizes: Mapping[Parameter, float]  # by how much each would have, SI, the change itself first
    sigma: float  # standard deviation of its size, SI
    sigma_between_sets: float  # the part of `sigma` that other sets of changes contribute, SI
    evidence: float  # log Bayes factor in its favour, the others given
    log_odds_against: float  # log prior odds against it

    @property
    def parameter(self) -> Parameter:
        """The parameter that changed."""
        return next(iter(self.sizes))


def most_probable_changes(
    problem: Problem, x: Array, candidates: Sequence[ChangeCandidate], floor: float = 1.0
) -> tuple[ChangeEstimate, ...]:
    """Return the most probable set of changes, the most decisive first; empty if there is none.

    Args:
        problem: what was and what stays, with its prior.
        x: about where its unknowns are ``(P,)``.
        candidates: what may have changed.
        floor: least chi2 per degree of freedom.

    Raises:
        NumericsError: where the machine that so changed cannot be closed.
    """
    found, sizes = frozenset[int](), np.zeros(len(candidates))
    for _ in range(_ROUNDS):
        about = _ChangeModel.at_point(problem, x, candidates, sizes)
        mixture = Mixture(about.linear(floor))
        last, found = found, frozenset(group for group, _ in mixture.best)
        if not found or found == last:
            break
        mean = mixture.likeliest_mean(mixture.best)
        sizes = np.where(np.isin(np.arange(len(candidates)), list(found)), mean[len(x) :], 0.0)
        x = about.unknowns(mean)
    return tuple(_change_estimate(mixture, member, candidates) for member in mixture.strongest)


def _change_estimate(
    mixture: Mixture, member: int, candidates: Sequence[ChangeCandidate]
) -> ChangeEstimate:
    """Return one change of the best state, averaged over the states that contain it."""
    size, sigma, among = mixture.size_and_spread(member)
    sizes = {member: size} | mixture.alternatives_to(member, INDISTINGUISHABLE_CHI2)
    unit = candidates[member].tolerance
    return ChangeEstimate(
        {candidates[k].parameter: v * candidates[k].tolerance for k, v in sizes.items()},
        float(np.hypot(sigma, among)) * unit,
        among * unit,
        mixture.log_weight(mixture.best) - mixture.log_weight(mixture.without(member)),
        float(mixture.cost[member]) - float(np.log(len(SLAB_WIDTHS))),
    )


@dataclass(frozen=True, eq=False)
class _ChangeModel:
    """The readings about one point, whitened and past datums and placements."""

    problem: Problem  # what was and what stays
    candidates: Sequence[ChangeCandidate]  # what may have changed, `c` of them
    columns: Array  # readings by a tolerance of each (m, c)
    residual: Array  # readings less their prediction by the prior mean, unchanged (m,)
    prior_columns: Array  # readings by the unknowns, in standard deviations of their prior (m, P)
    prior_root: Array  # of the prior covariance, in tolerances (P, P)
    prior_mean: Array  # prior mean, in tolerances (P,)
    nuisance_count: int  # number of datums and placements

    @classmethod
    def at_point(
        cls, problem: Problem, x: Array, candidates: Sequence[ChangeCandidate], sizes: Array
    ) -> _ChangeModel:
        """About unknowns ``(P,)`` of a machine that changed by some sizes ``(c,)``."""
        at = linearise(_with_changes(problem, candidates, sizes), x)
        nuisance = nuisances(problem, at.reading_poses)
        here, scale = normal_equations(problem, at, nuisance), problem.tolerance
        root = np.asarray(np.linalg.inv(here.prior * scale))
        known = np.asarray(root @ here.target)
        jacobian = here.jacobian * scale
        weights = weight_matrix(problem.names, [c.weights for c in candidates])
        since = np.array([c.since for c in candidates], dtype=np.intp)
        after = np.arange(len(at.jacobian))[:, None] >= since
        columns = nuisance.project(at.jacobian @ weights * after)
        residual = here.residual + jacobian @ (x / scale - known) + columns @ sizes
        return cls(
            problem,
            candidates,
            columns,
            residual,
            jacobian @ root,
            root,
            known,
            nuisance.unconstrained_count,
        )

    def linear(self, floor: float) -> LinearModel:
        """Return the linear model of a search in which every candidate is a group.

        The prior is a background of one standard deviation, whatever is active, so that no group
        explains what the earlier machine leaves open.
        """
        left, size, _ = np.linalg.svd(self.prior_columns, full_matrices=False)
        share, along = size**2 / (1 + size**2), left.T @ self.residual
        dof = len(self.problem.measured) - self.nuisance_count - float(share.sum())
        chi2 = float(self.residual @ self.residual - along @ (share * along))
        count, c = self.prior_columns.shape[1], len(self.candidates)
        of = self.problem.machine.catalogue.effect_of
        # A zero is entered in a minute, and nothing else of the machine changes as often.
        chance = [
            1.0 if of(one.parameter).controller == "zero" else 1 / c for one in self.candidates
        ]
        groups = [
            replace(
                identity_group(f"change.{k}", [count + k], free_form=False),
                expected=_EXPECTED_CHANGES * chance[k],
            )
            for k in range(c)
        ]
        none = np.zeros(count + c, dtype=bool)
        return drop_unseen_directions(
            LinearModel(
                np.hstack([self.prior_columns, self.columns]), self.residual,
                np.where(np.arange(count + c) < count, np.nan, 0.0), none, none, tuple(groups),
                np.zeros((len(self.residual), 0)), (1.0,), SLAB_WIDTHS, slab_log_odds=SLAB_ODDS, max_active=_MOST_CHANGES,
                unknown_noise=UnknownNoise(chi2, max(dof, 1.0), floor),
            )
        )  # fmt: skip

    def unknowns(self, mean: Array) -> Array:
        """Return the unknowns ``(P,)``, SI, by the mean of all coefficients ``(P + c,)``."""
        return np.asarray(
            (self.prior_mean + self.prior_root @ mean[: len(self.prior_root)])
            * self.problem.tolerance
        )


def _with_changes(problem: Problem, candidates: Sequence[ChangeCandidate], sizes: Array) -> Problem:
    """The problem of a machine that changed by some sizes ``(c,)``: what is free is what stays."""
    place = {unknown.name: unknown for unknown in problem.unknowns}
    held = []
    for k, (rows, values) in enumerate(zip(problem.factor_rows, problem.held, strict=True)):
        now = dict(values)
        for candidate, size in zip(candidates, sizes, strict=True):
            if size and rows.start >= candidate.since:
                for name, weight in candidate.weights.items():
                    for part, share in place[name].weights[k].items():
                        now[part] = now.get(part, 0.0) + share * weight * float(size)
        held.append(now)
    return replace(problem, held=tuple(held))
