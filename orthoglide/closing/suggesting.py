"""What to measure next, by the outcome of the search."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import combinations

from orthoglide import planning
from orthoglide.closing.outcome import RunOutcome
from orthoglide.planning import Suggestion
from orthoglide.text import MACHINE_OPTION

_MOST_RIVALS = 6  # single causes between which readings are proposed; pairs grow by the square


def next_measurements(outcome: RunOutcome) -> tuple[Suggestion, ...]:
    """Return the readings to take next, most useful first; none after ``identify``."""
    if not outcome.request.searches:
        return ()
    option = outcome.request.machine_option
    return tuple(
        replace(s, **{n: getattr(s, n).replace(MACHINE_OPTION, option) for n in ("reason", "what")})
        for s in _suggestions(outcome)
    )


def _suggestions(outcome: RunOutcome) -> tuple[Suggestion, ...]:
    """Return the suggestions, with the placeholder ``MACHINE_OPTION`` for the machine's file.

    Readings that distinguish a data fault from a less probable cause come first.
    """
    geometry, posterior = outcome.request.machine.geometry, outcome.posterior
    inconclusive, lack_of_fit = not outcome.stands, outcome.lack_of_fit
    largest = lack_of_fit.by_instrument[:1] if inconclusive else []
    at_residual = [*map(planning.suggest_repeating, largest)]
    first: list[Suggestion] = []
    later: list[Suggestion] = []
    by_place: list[Suggestion] = []
    separating: Iterable[Suggestion] = ()
    if posterior is not None:
        credible_sets = [(c.chosen.probability, c.data) for c in outcome.effects]
        credible_sets += [(c.members[0].probability, c.data) for c in outcome.located]
        for probability, faults in credible_sets:
            if faults:
                visits = first if faults[0].probability > probability else later
                visits.append(planning.suggest_deciding_visits(posterior, faults[0]))
        for located in outcome.located:
            by_place += planning.suggest_separating_located_errors(posterior, located)
        if not geometry.dialled:
            separating = planning.suggest_instruments_for_causes(posterior, outcome.effects)
    if not geometry.dialled:
        return (*first, *separating, *by_place, *at_residual, *later)
    rival_sets = [(c.chosen, *c.rivals) for c in outcome.effects if c.rivals]
    rivals, pairs = list[tuple[str, Mapping[str, float]]](), list[tuple[int, int]]()
    motions = outcome.after.problem.machine.catalogue.motions
    for rival_set in rival_sets or [outcome.alone[:_MOST_RIVALS]]:  # pairs only within a set
        pairs += combinations(range(len(rivals), len(rivals) + len(rival_set)), 2)
        # Free-form errors, which the catalogue lacks, are nearly the same with every rival.
        rivals += [
            (e.name, {n: v for n, v in e.machine.items() if n in motions}) for e in rival_set
        ]
    separating = planning.next_measurements(outcome.after, rivals, pairs=pairs, directions=())
    narrowing = planning.next_measurements(outcome.before)
    if inconclusive and lack_of_fit.dials_hold_most:
        at_residual = [planning.suggest_tracing(lack_of_fit.by_dial[0], geometry)]
    return (*first, *at_residual, *later, *separating, *by_place, *narrowing)
