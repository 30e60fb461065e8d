"""Changes between campaigns: a parameter with one value before a file and another from it on.

Campaigns are those of dials, in their order; without dials visits with instruments at the tool, of
one file or of several.

All that stays is open beside what may have changed (`change_model`), and beside faults of the data
that the changes found are weighed against.
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
"""Tolerances of the machine's other effects: what they are, they are at all visits."""


def visits(problem: Problem) -> tuple[tuple[str, str, int], ...]:
    """Campaigns from which on something may have changed: name, file, and first row.

    Files of the tool are of one visit until one of their setups comes again; visits that have no
    setup in common could not be told apart.
    """
    if problem.campaigns:
        read = {k: (c.name, c.file) for k, c in enumerate(problem.campaigns)}
    else:
        read, seen = {}, list[set[str]]()
        for k, factor in enumerate(problem.tool_factors):
            setups = set(factor.setup_names)
            if seen and seen[-1].isdisjoint(setups):
                seen[-1] |= setups
            else:
                seen.append(setups)
                read[k] = factor.name, factor.readings.file
        if not seen or not set.intersection(*seen):
            return ()
    rows = problem.factor_rows
    return tuple((name, file or name, rows[k].start) for k, (name, file) in read.items())


def likeliest_changes(estimate: Estimate) -> tuple[list[Change], float]:
    """The changes that explain best what a fit leaves, the most decisive first, and the log odds
    against them before the readings; none where nothing speaks for any.
    """
    problem = estimate.problem
    several = visits(problem)
    if len(several) < 2:
        return [], 0.0
    wide = _with_all_effects(problem)
    candidates = list(_candidates(wide, several))
    floor = 1.0
    if problem.noise.source == "repeats":  # the noise itself, or the rounding where it is unsure
        floor = min(1.0, (problem.noise.resolution / problem.noise.typical) ** 2 / 12)
    try:
        found = most_probable_changes(wide, wide.zero_padded(estimate.x), candidates, floor)
    except NumericsError:
        return [], 0.0
    return list(_as_changes(problem, several, found)), sum(one.log_odds_against for one in found)


def _as_changes(
    problem: Problem, several: Sequence[tuple[str, str, int]], found: Sequence[ChangeEstimate]
) -> Iterator[Change]:
    stems, files = [stem for stem, _, _ in several], [file for _, file, _ in several]
    for one in found:
        since = one.parameter.campaign
        sizes = {name.plain: size for name, size in one.sizes.items() if name.campaign == since}
        first = stems.index(since)
        yield Change(
            one.parameter.plain, tuple(sizes), since, (files[first - 1], files[first]),
            one.evidence, problem.machine.catalogue, sigma=one.sigma, sizes=tuple(sizes.values()),
            size_sigma=one.sigma, sigma_between_sets=one.sigma_between_sets,
        )  # fmt: skip


def _with_all_effects(problem: Problem) -> Problem:
    """Every effect of the catalogue free, those of the machine as wide as is likely at all: what
    they are, they are at all visits.
    """
    effects = [effect.name for effect in excited_effects(problem)]
    catalogue = problem.machine.catalogue
    apart = {split_campaign(name)[0] for name in problem.per_campaign}  # seen to change already

    def widened(unknown: Unknown) -> Unknown:
        effect = catalogue.effect_of(unknown.name)
        return replace(
            unknown, prior_width=1.0 if effect.of_dial and not effect.of_body else _OPEN_PRIOR_WIDTH
        )

    unknowns = share_plate_shapes(with_effects_freed(problem, effects).unknowns, catalogue, apart)
    return replace(problem, unknowns=tuple(map(widened, unknowns)))


def _candidates(
    wide: Problem, several: Sequence[tuple[str, str, int]]
) -> Iterator[ChangeCandidate]:
    """Every parameter of the machine, and without dials of plates and patterns of equal legs too,
    from every campaign but the first on.
    """
    own = {u.name.plain for u in wide.unknowns if u.name.campaign}

    def told(name: Parameter) -> bool:
        effect = wide.machine.catalogue.effect_of(name)
        # Plates of several setups that are one have one shape at all visits.
        return not effect.of_dial or bool(effect.of_body and not name.member)

    kept = [name for name in wide.names if name.plain not in own and told(name)]
    for (name, shares), (stem, _, start) in product(
        changeable_parameters(wide, kept).items(), several[1:]
    ):
        if name not in own and told(name):
            yield ChangeCandidate(name.at(stem), start, shares, wide.machine.tolerance(name))


def with_changes_separate(problem: Problem, changes: Sequence[Change]) -> Problem:
    """The problem with the changed parameters free and separate before and after the change."""
    changed = [change.parameter for change in changes]
    own = (
        *problem.per_campaign,
        *(name for change in changes for name in change.campaign_parameters),
    )
    kept = tuple(u for u in problem.unknowns if u.name.plain not in changed)
    return with_free(replace(problem, unknowns=kept, per_campaign=own), changed)
