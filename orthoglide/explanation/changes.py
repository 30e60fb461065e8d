"""Changes between campaigns: a parameter with one value before a file and another from it on.

Campaigns are those of dials, in their order, or without dials the visits with instruments at the
tool, each of one or several files.

Parameters that stay are free beside those that may have changed (`change_model`). The changes found
are compared with data faults.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

from orthoglide.errors import NumericsError
from orthoglide.explanation.change import Change
from orthoglide.explanation.change_model import (
    ChangeCandidate,
    ChangeEstimate,
    changeable_parameters,
    most_probable_changes,
)
from orthoglide.fit import Estimate, Problem, with_effects_freed, with_free
from orthoglide.fit.excitation import excited_effects
from orthoglide.fit.unknowns import Unknown, share_plate_shapes
from orthoglide.parameters import Parameter, split_campaign

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
