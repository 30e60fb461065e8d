"""Changes between two visits to a machine, as groups of columns of the readings after them.

The unknowns of a problem with its prior describe the machine before and whatever stays. A change
adds to the readings from one row on, and is a group of the search for causes. The most probable set
is searched at one point of linearisation, and again at the machine with these changes, until the
set stays the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from orthoglide.effects import Catalogue, Effect
from orthoglide.errors import NumericsError
from orthoglide.explanation.change import Change
from orthoglide.explanation.compression import MergedRows, WhitenedReadings
from orthoglide.explanation.linear_model import (
    BACKGROUND_SCALES,
    TWENTY_TO_ONE,
    LinearModel,
    drop_unseen_directions,
    identity_group,
)
from orthoglide.explanation.mixture import Mixture
from orthoglide.fit import Estimate, Problem, with_effects_freed, with_free
from orthoglide.fit.assembling import excited_effects
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.fit.problem import CERTAIN_SIGMAS, MAX_TOLERANCES
from orthoglide.fit.unknowns import Unknown, share_plate_shapes
from orthoglide.geometry import Array
from orthoglide.observations import source
from orthoglide.parameters import Parameter, split_campaign

_ROUNDS = 5
"""Largest number of linearisations, each of the machine with the changes found before."""

_EXPECTED_CHANGES = float(np.exp(-TWENTY_TO_ONE))
"""Prior mean number of changes of each zero, and of all other parameters together: between two
visits, one in twenty changes."""

_MOST_CHANGES = 12
"""Largest number of changes between two visits: of three zeros and three lengths, as after new bars
and endstops, and of as many other parameters as a machine has active causes (`LinearModel`)."""

_DIAL_SCALES = tuple(scale for scale in BACKGROUND_SCALES if scale <= 1.0)
"""Scales of the errors of dials, in tolerances: of sound ones, and of any within tolerance."""

INDISTINGUISHABLE_CHI2 = CERTAIN_SIGMAS**2
"""Rise of chi2 within which two causes are indistinguishable (Wilks)."""


def possible_changes(
    problem: Problem, names: Sequence[Parameter], starts: Sequence[tuple[str, int]]
) -> list[Unknown]:
    """Return the changes of parameters, one at every start, as further unknowns.

    Args:
        problem: the problem with these unknowns.
        names: single parameters, and sizes of free-form errors; without dials, patterns of equal
            legs and of a plate that several setups touched are added.
        starts: the campaign that begins after a change, or none, and the index of its factor.
    """
    machine, catalogue = problem.machine, problem.machine.catalogue
    unknowns: dict[str, Unknown] = {unknown.name: unknown for unknown in problem.unknowns}
    weights_of: dict[Parameter, Mapping[Any, float]] = {
        name: {name: 1.0} if name in unknowns else catalogue.elementary_weights(name)
        for name in names
    }
    if not problem.campaigns:
        setups = tuple(dict.fromkeys(name.setup for name in names if name.setup))
        for effect in dict.fromkeys(name.effect for name in names):
            for member, parts in catalogue.structured_members(effect, setups).items():
                if len(parts) > 1 and set(parts) <= set(names):
                    weights_of[member] = parts
    changes = list[Unknown]()
    for (name, weights), (campaign, first) in product(weights_of.items(), starts):
        tolerance = machine.tolerance(name)
        moved: list[dict[str, float]] = [{} for _ in problem.factors]
        for k, (part, weight) in product(range(first, len(moved)), weights.items()):
            for elementary, share in unknowns[part].weights[k].items():
                size = share * weight * machine.tolerance(part) / tolerance
                moved[k][elementary] = moved[k].get(elementary, 0.0) + size
        changes.append(Unknown(name.at(campaign), tuple(moved), tolerance, 0.0, np.inf))
    return changes


def most_probable_changes(
    problem: Problem, x: Array, possible: Sequence[Unknown]
) -> tuple[Change, ...]:
    """Return the most probable set of changes, the most decisive first; empty if there is none.

    Args:
        problem: the machine before and whatever stays, with its prior.
        x: first point of linearisation ``(P,)``.
        possible: changes that are considered.

    Raises:
        NumericsError: if the machine with these changes cannot be closed.
    """
    active, sizes, count = frozenset[int](), np.zeros(len(possible)), len(x)
    for _ in range(_ROUNDS):
        linear, prior_mean, prior_root = _linear_model(problem, x, possible, sizes)
        mixture = Mixture(linear)
        previous, active = active, frozenset(group for group, _ in mixture.best)
        if not active or active == previous:
            break
        mean = mixture.likeliest_mean(mixture.best)
        sizes = np.where(np.isin(np.arange(len(possible)), list(active)), mean[count:], 0.0)
        x = prior_mean + prior_root @ mean[:count]
    return tuple(
        _change(mixture, member, possible, problem.machine.catalogue)
        for member in mixture.groups_by_importance
    )


def _change(
    mixture: Mixture, member: int, possible: Sequence[Unknown], catalogue: Catalogue
) -> Change:
    """Return one change of the best state, averaged over the states that contain it.

    Its alternatives are parameters that changed at the same time.
    """
    size, sigma, between_sets = mixture.size_and_spread(member)
    sizes = {member: size} | mixture.alternatives_to(member, INDISTINGUISHABLE_CHI2)
    since, unit = possible[member].name.campaign, possible[member].tolerance
    sigma = float(np.hypot(sigma, between_sets)) * unit
    return Change(
        {
            possible[k].name.plain: of_member * possible[k].tolerance
            for k, of_member in sizes.items()
            if possible[k].name.campaign == since
        },
        catalogue,
        since,
        sigma=sigma,
        evidence=mixture.log_weight(mixture.best) - mixture.log_weight(mixture.without(member)),
        log_odds_against=float(mixture.prior_log_odds_against[member]),
        size_sigma=sigma,
        sigma_between_sets=between_sets * unit,
    )


def _linear_model(
    problem: Problem, x: Array, possible: Sequence[Unknown], sizes: Array
) -> tuple[LinearModel, Array, Array]:
    """Return the model of a search in which every change is a group, linearised at unknowns
    ``(P,)`` of a machine that changed by some sizes ``(c,)``, in tolerances.

    The prior holds in every state, so that no group explains what is uncertain of the earlier
    machine. Its mean ``(P,)`` and a root of its covariance ``(P, P)``, SI, come second and third.
    The size of the errors of dials is learned: dials that are all off by their tolerances, each
    otherwise at each visit, would absorb most changes of a zero. Noise is the less likely the
    larger it is, because it may fit as well as several changes together.
    """
    count, c, scale = len(x), len(possible), problem.tolerance
    extended = replace(problem, unknowns=(*problem.unknowns, *possible))
    unit = extended.tolerance[count:]
    linearised = linearise(extended, np.concatenate([x, sizes * unit]))
    prior, target = problem.prior_rows
    prior_root = np.asarray(scale[:, None] * np.linalg.inv(prior * scale))
    prior_mean = np.asarray(prior_root @ target)
    jacobian, changes = np.hsplit(linearised.jacobian, [count])
    columns = np.hstack([jacobian @ prior_root, changes * unit])
    residual = problem.measured - linearised.value + jacobian @ (x - prior_mean)
    residual += columns[:, count:] @ sizes
    rows = MergedRows((), np.arange(len(residual))).beside([columns])
    nuisance = nuisances(extended, linearised.reading_poses)
    readings = WhitenedReadings.of(problem, nuisance, rows, residual)
    effect_of, groups = problem.machine.catalogue.effect_of, []
    for k, change in enumerate(possible):
        # A zero is easily entered, so it changes more often than anything else.
        chance = 1.0 if effect_of(change.name).controller == "zero" else 1 / c
        group = identity_group(f"change.{k}", [count + k], free_form=False)
        groups.append(replace(group, expected=_EXPECTED_CHANGES * chance))
    no_columns = np.zeros(count + c, dtype=bool)
    of_machine = np.array([not _is_of_dial(effect_of(name)) for name in problem.names])
    learned = ~prior_root[of_machine].any(axis=0)
    linear = LinearModel(
        **vars(readings), fixed_sd=np.append(np.where(learned, np.nan, 1.0), np.zeros(c)),
        free_form=no_columns, plate_shapes=no_columns, groups=tuple(groups),
        background_scales=_DIAL_SCALES if learned.any() else (1.0,), max_active=_MOST_CHANGES,
        noise_decay=1.0,
    )  # fmt: skip
    return drop_unseen_directions(linear), prior_mean, prior_root


def _is_of_dial(effect: Effect) -> bool:
    """Return whether an effect belongs to one mounting of a dial, which no later visit repeats."""
    return effect.of_dial and not effect.of_body


def visits(problem: Problem) -> tuple[tuple[str, str, int], ...]:
    """Return the first campaign of each visit: name, file, and index of its factor.

    Files of the tool belong to one visit until one of their setups occurs again. Visits without a
    common setup cannot be compared.
    """
    tables, starts = [factor.readings for factor in problem.factors], list[int]()
    if problem.campaigns:
        starts += range(len(problem.campaigns))
    else:
        setups_by_visit = list[set[str]]()
        for k, factor in enumerate(problem.factors):
            setups = set(factor.setup_names)
            if setups_by_visit and setups_by_visit[-1].isdisjoint(setups):
                setups_by_visit[-1] |= setups
            else:
                setups_by_visit.append(setups)
                starts.append(k)
        if not set.intersection(*setups_by_visit):
            return ()
    return tuple((tables[k].name, source(tables[k]), k) for k in starts)


def likeliest_changes(estimate: Estimate) -> list[Change]:
    """Return the most probable changes, the most decisive first."""
    problem = estimate.problem
    visit_starts = visits(problem)
    if len(visit_starts) < 2:
        return []
    full_problem = _with_all_effects(problem)
    try:
        start = full_problem.zero_padded(estimate.x)
        possible = _changes_between_visits(full_problem, visit_starts)
        changes = most_probable_changes(full_problem, start, possible)
    except NumericsError:
        return []
    pairs = pairwise(visit_starts)
    files = {name: (before, after) for (_, before, _), (name, after, _) in pairs}
    return [replace(change, files=files[change.since]) for change in changes]


def _with_all_effects(problem: Problem) -> Problem:
    """Return the problem with every effect of the catalogue free, those of the machine with one
    value at all visits and priors as wide as the largest plausible error.
    """
    effects = [effect.name for effect in excited_effects(problem)]
    catalogue = problem.machine.catalogue
    per_visit = {split_campaign(name)[0] for name in problem.per_campaign}  # changed already

    def widened(unknown: Unknown) -> Unknown:
        of_dial = _is_of_dial(catalogue.effect_of(unknown.name))
        return replace(unknown, prior_width=1.0 if of_dial else MAX_TOLERANCES)

    freed = with_effects_freed(problem, effects)
    unknowns = share_plate_shapes(freed.unknowns, catalogue, per_visit)
    return replace(problem, unknowns=tuple(map(widened, unknowns)))


def _changes_between_visits(
    full_problem: Problem, visit_starts: Sequence[tuple[str, str, int]]
) -> list[Unknown]:
    """Return the changes of every parameter of the machine from every campaign but the first on."""
    catalogue = full_problem.machine.catalogue
    per_campaign = {u.name.plain for u in full_problem.unknowns if u.name.campaign}

    def may_change(name: Parameter) -> bool:
        effect = catalogue.effect_of(name)
        # Setups that share a plate have one shape at all visits.
        of_machine = not effect.of_dial or bool(effect.of_body and not name.member)
        return of_machine and name not in per_campaign

    eligible = [name for name in full_problem.names if may_change(name.plain)]
    starts = [(campaign, first) for campaign, _, first in visit_starts[1:]]
    possible = possible_changes(full_problem, eligible, starts)
    return [change for change in possible if may_change(change.name.plain)]


def with_changes_separate(problem: Problem, changes: Sequence[Change]) -> Problem:
    """Return the problem with changed parameters free, and separate before and after the change."""
    changed = [change.parameter for change in changes]
    added = (name for change in changes for name in change.campaign_parameters)
    per_campaign = (*problem.per_campaign, *added)
    kept = tuple(u for u in problem.unknowns if u.name.plain not in changed)
    return with_free(replace(problem, unknowns=kept, per_campaign=per_campaign), changed)
