"""Changes between two visits to a machine, as groups of columns of the readings after them.

The unknowns of a problem with its prior describe the machine before and whatever stays. A change
adds to the readings from one row on, and is a group of the search for causes. The most probable set
is searched at one point of linearisation, and again at the machine with these changes, until the
set stays the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from orthoglide.errors import NumericsError
from orthoglide.explanation.change import Change
from orthoglide.explanation.linear_model import (
    LinearModel,
    UnknownNoise,
    drop_unseen_directions,
    identity_group,
)
from orthoglide.explanation.mixture import Mixture
from orthoglide.fit import Estimate, Problem, with_effects_freed, with_free
from orthoglide.fit.excitation import excited_effects
from orthoglide.fit.least_squares import linearise, normal_equations, nuisances
from orthoglide.fit.unknowns import Unknown, share_plate_shapes, weight_matrix
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter, split_campaign

_ROUNDS = 5
"""Largest number of linearisations, each of the machine with the changes found before."""

_EXPECTED_CHANGES = float(np.exp(-3.0))
"""Prior mean number of changes of each zero, and of all other parameters together: between two
visits, one in twenty changes."""

SLAB_WIDTHS = (1.0, 3.0, 10.0)
"""Prior widths of a change, in tolerances, each with a probability inversely proportional to it."""

SLAB_ODDS = tuple(
    np.log(len(SLAB_WIDTHS) / np.array(SLAB_WIDTHS) / np.sum(1 / np.array(SLAB_WIDTHS))).tolist()
)
"""Log prior odds of each width, relative to equal probabilities."""

_MOST_CHANGES = 12  # largest number of changes between two visits

INDISTINGUISHABLE_CHI2 = 4.0
"""Rise of chi2 within which two causes are indistinguishable: two sigmas (Wilks)."""


@dataclass(frozen=True)
class ChangeCandidate:
    """A parameter that may have changed."""

    parameter: Parameter  # with the campaign from which it has another value, or none
    since: int  # first row after the change
    weights: Mapping[Parameter, float]  # one tolerance of it, by unknown of the problem, SI
    tolerance: float  # SI


def changeable_parameters(
    problem: Problem, names: Sequence[Parameter]
) -> dict[Parameter, dict[Parameter, float]]:
    """Return the parameters that may have changed, each with one tolerance by unknown, SI.

    Args:
        problem: the problem with these unknowns.
        names: single parameters; without dials, patterns of equal legs and of a plate that several
            setups touched are added.
    """
    machine = problem.machine
    changeable = {name: {name: machine.tolerance(name)} for name in names}
    if problem.campaigns:
        return changeable
    setups = tuple(dict.fromkeys(name.setup for name in names if name.setup))
    for effect in dict.fromkeys(name.effect for name in names):
        for member, parts in machine.catalogue.structured_members(effect, setups).items():
            if len(parts) > 1 and set(parts) <= set(names):
                changeable[member] = {n: w * machine.tolerance(n) for n, w in parts.items()}
    return changeable


@dataclass(frozen=True)
class ChangeEstimate:
    """One change with its alternatives."""

    sizes: Mapping[Parameter, float]  # size of each alternative, SI, the change itself first
    sigma: float  # standard deviation of its size, SI
    sigma_between_sets: float  # part of `sigma` from other sets of changes, SI
    evidence: float  # log Bayes factor in its favour, given the other changes
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
        problem: the machine before and whatever stays, with its prior.
        x: first point of linearisation ``(P,)``.
        candidates: parameters that may have changed.
        floor: least chi2 per degree of freedom.

    Raises:
        NumericsError: if the machine with these changes cannot be closed.
    """
    active, sizes = frozenset[int](), np.zeros(len(candidates))
    for _ in range(_ROUNDS):
        model = _ChangeModel.at_point(problem, x, candidates, sizes)
        mixture = Mixture(model.linear(floor))
        previous, active = active, frozenset(group for group, _ in mixture.best)
        if not active or active == previous:
            break
        mean = mixture.likeliest_mean(mixture.best)
        sizes = np.where(np.isin(np.arange(len(candidates)), list(active)), mean[len(x) :], 0.0)
        x = model.unknowns(mean)
    return tuple(
        _change_estimate(mixture, member, candidates) for member in mixture.groups_by_importance
    )


def _change_estimate(
    mixture: Mixture, member: int, candidates: Sequence[ChangeCandidate]
) -> ChangeEstimate:
    """Return one change of the best state, averaged over the states that contain it."""
    size, sigma, between_sets = mixture.size_and_spread(member)
    sizes = {member: size} | mixture.alternatives_to(member, INDISTINGUISHABLE_CHI2)
    unit = candidates[member].tolerance
    return ChangeEstimate(
        {candidates[k].parameter: v * candidates[k].tolerance for k, v in sizes.items()},
        float(np.hypot(sigma, between_sets)) * unit,
        between_sets * unit,
        mixture.log_weight(mixture.best) - mixture.log_weight(mixture.without(member)),
        float(mixture.prior_log_odds_against[member]),
    )


@dataclass(frozen=True, eq=False)
class _ChangeModel:
    """The linearised readings, whitened and with datums and placements projected out."""

    problem: Problem  # the machine before and whatever stays
    candidates: Sequence[ChangeCandidate]  # (c,)
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
        """Linearise at unknowns ``(P,)`` of a machine that changed by some sizes ``(c,)``."""
        linearised = linearise(_with_changes(problem, candidates, sizes), x)
        nuisance = nuisances(problem, linearised.reading_poses)
        equations, scale = normal_equations(problem, linearised, nuisance), problem.tolerance
        root = np.asarray(np.linalg.inv(equations.prior * scale))
        prior_mean = np.asarray(root @ equations.target)
        jacobian = equations.jacobian * scale
        weights = weight_matrix(problem.names, [c.weights for c in candidates])
        since = np.array([c.since for c in candidates], dtype=np.intp)
        after = np.arange(len(linearised.jacobian))[:, None] >= since
        columns = nuisance.project(linearised.jacobian @ weights * after)
        residual = equations.residual + jacobian @ (x / scale - prior_mean) + columns @ sizes
        return cls(
            problem, candidates, columns, residual, jacobian @ root, root, prior_mean,
            nuisance.unconstrained_count,
        )  # fmt: skip

    def linear(self, floor: float) -> LinearModel:
        """Return the linear model of a search in which every candidate is a group.

        The prior is a background of one standard deviation in every state, so that no group
        explains what is uncertain of the earlier machine.
        """
        directions, singular, _ = np.linalg.svd(self.prior_columns, full_matrices=False)
        share, projected = singular**2 / (1 + singular**2), directions.T @ self.residual
        dof = len(self.problem.measured) - self.nuisance_count - float(share.sum())
        chi2 = float(self.residual @ self.residual - projected @ (share * projected))
        count, c = self.prior_columns.shape[1], len(self.candidates)
        effect_of, groups = self.problem.machine.catalogue.effect_of, []
        for k, candidate in enumerate(self.candidates):
            # A zero is easily entered, so it changes more often than anything else.
            chance = 1.0 if effect_of(candidate.parameter).controller == "zero" else 1 / c
            group = identity_group(f"change.{k}", [count + k], free_form=False)
            groups.append(replace(group, expected=_EXPECTED_CHANGES * chance))
        no_columns = np.zeros(count + c, dtype=bool)
        return drop_unseen_directions(
            LinearModel(
                np.hstack([self.prior_columns, self.columns]), self.residual,
                np.where(np.arange(count + c) < count, np.nan, 0.0), no_columns, no_columns,
                tuple(groups), np.zeros((len(self.residual), 0)), (1.0,), SLAB_WIDTHS,
                slab_log_odds=SLAB_ODDS, max_active=_MOST_CHANGES,
                unknown_noise=UnknownNoise(chi2, max(dof, 1.0), floor),
            )
        )  # fmt: skip

    def unknowns(self, mean: Array) -> Array:
        """Return the unknowns ``(P,)``, SI, by the mean of all coefficients ``(P + c,)``."""
        x = self.prior_mean + self.prior_root @ mean[: len(self.prior_root)]
        return np.asarray(x * self.problem.tolerance)


def _with_changes(problem: Problem, candidates: Sequence[ChangeCandidate], sizes: Array) -> Problem:
    """Return the problem of a machine that changed by some sizes ``(c,)``, now held values."""
    unknowns = {unknown.name: unknown for unknown in problem.unknowns}
    held = []
    for k, (rows, values) in enumerate(zip(problem.factor_rows, problem.held, strict=True)):
        changed = dict(values)
        for candidate, size in zip(candidates, sizes, strict=True):
            if size and rows.start >= candidate.since:
                for name, weight in candidate.weights.items():
                    for part, share in unknowns[name].weights[k].items():
                        changed[part] = changed.get(part, 0.0) + share * weight * float(size)
        held.append(changed)
    return replace(problem, held=tuple(held))


_OPEN_PRIOR_WIDTH = 3.0
"""Prior width of the machine's effects, in tolerances, with one value at all visits."""


def visits(problem: Problem) -> tuple[tuple[str, str, int], ...]:
    """Return the first campaign of each visit: name, file, and first row.

    Files of the tool belong to one visit until one of their setups occurs again. Visits without a
    common setup cannot be compared.
    """
    if problem.campaigns:
        starts = {k: (c.name, c.file) for k, c in enumerate(problem.campaigns)}
    else:
        starts, setups_by_visit = {}, list[set[str]]()
        for k, factor in enumerate(problem.tool_factors):
            setups = set(factor.setup_names)
            if setups_by_visit and setups_by_visit[-1].isdisjoint(setups):
                setups_by_visit[-1] |= setups
            else:
                setups_by_visit.append(setups)
                starts[k] = factor.name, factor.readings.file
        if not setups_by_visit or not set.intersection(*setups_by_visit):
            return ()
    rows = problem.factor_rows
    return tuple((name, file or name, rows[k].start) for k, (name, file) in starts.items())


def likeliest_changes(estimate: Estimate) -> tuple[list[Change], float]:
    """Return the most probable changes, the most decisive first, and the prior log odds against
    them.
    """
    problem = estimate.problem
    visit_starts = visits(problem)
    if len(visit_starts) < 2:
        return [], 0.0
    full_problem = _with_all_effects(problem)
    candidates = list(_candidates(full_problem, visit_starts))
    floor = 1.0
    if problem.noise.source == "repeats":  # reliable down to the rounding
        floor = min(1.0, (problem.noise.resolution / problem.noise.typical) ** 2 / 12)
    try:
        start = full_problem.zero_padded(estimate.x)
        estimates = most_probable_changes(full_problem, start, candidates, floor)
    except NumericsError:
        return [], 0.0
    cost = sum(change.log_odds_against for change in estimates)
    return list(_as_changes(problem, visit_starts, estimates)), cost


def _as_changes(
    problem: Problem,
    visit_starts: Sequence[tuple[str, str, int]],
    estimates: Sequence[ChangeEstimate],
) -> Iterator[Change]:
    names, files, _ = zip(*visit_starts, strict=True)
    for one in estimates:
        since = one.parameter.campaign
        sizes = {name.plain: size for name, size in one.sizes.items() if name.campaign == since}
        first = names.index(since)
        yield Change(
            one.parameter.plain, tuple(sizes), since, (files[first - 1], files[first]),
            one.evidence, problem.machine.catalogue, sigma=one.sigma, sizes=tuple(sizes.values()),
            size_sigma=one.sigma, sigma_between_sets=one.sigma_between_sets,
        )  # fmt: skip


def _with_all_effects(problem: Problem) -> Problem:
    """Return the problem with every effect of the catalogue free, those of the machine with wide
    priors and one value at all visits.
    """
    effects = [effect.name for effect in excited_effects(problem)]
    catalogue = problem.machine.catalogue
    per_visit = {split_campaign(name)[0] for name in problem.per_campaign}  # changed already

    def widened(unknown: Unknown) -> Unknown:
        effect = catalogue.effect_of(unknown.name)
        of_dial = effect.of_dial and not effect.of_body
        return replace(unknown, prior_width=1.0 if of_dial else _OPEN_PRIOR_WIDTH)

    freed = with_effects_freed(problem, effects)
    unknowns = share_plate_shapes(freed.unknowns, catalogue, per_visit)
    return replace(problem, unknowns=tuple(map(widened, unknowns)))


def _candidates(
    full_problem: Problem, visit_starts: Sequence[tuple[str, str, int]]
) -> Iterator[ChangeCandidate]:
    """Yield every parameter of the machine from every campaign but the first on; without dials also
    patterns of equal legs and of plates.
    """
    machine = full_problem.machine
    per_campaign = {u.name.plain for u in full_problem.unknowns if u.name.campaign}

    def may_change(name: Parameter) -> bool:
        effect = machine.catalogue.effect_of(name)
        # Setups that share a plate have one shape at all visits.
        of_machine = not effect.of_dial or bool(effect.of_body and not name.member)
        return of_machine and name not in per_campaign

    eligible = [name for name in full_problem.names if may_change(name.plain)]
    changeable = changeable_parameters(full_problem, eligible).items()
    for (name, weights), (campaign, _, start) in product(changeable, visit_starts[1:]):
        if may_change(name):
            yield ChangeCandidate(name.at(campaign), start, weights, machine.tolerance(name))


def with_changes_separate(problem: Problem, changes: Sequence[Change]) -> Problem:
    """Return the problem with changed parameters free, and separate before and after the change."""
    changed = [change.parameter for change in changes]
    added = (name for change in changes for name in change.campaign_parameters)
    per_campaign = (*problem.per_campaign, *added)
    kept = tuple(u for u in problem.unknowns if u.name.plain not in changed)
    return with_free(replace(problem, unknowns=kept, per_campaign=per_campaign), changed)
