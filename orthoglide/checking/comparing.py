"""Two states of one machine: what changed between them, what did not, and what is left."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from orthoglide.checking.difference import COLUMNS, Difference, zero_entry_clauses
from orthoglide.checking.plates import PlateMove, plate_moves
from orthoglide.checking.states import (
    State,
    joint_request,
    read_states,
    single_request,
    with_distinct_names,
)
from orthoglide.closing import RunOutcome, build_result, compute_outcome
from orthoglide.effects import Catalogue
from orthoglide.explanation import Located
from orthoglide.explanation.change import Change
from orthoglide.explanation.changes import visits
from orthoglide.explanation.recalibration import account_for_changes
from orthoglide.fit import Problem, assemble, solve
from orthoglide.fit.unknowns import Unknown
from orthoglide.frames import Framed
from orthoglide.machine import Machine, MachineSource
from orthoglide.ordering import ranked
from orthoglide.parameters import Parameter
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.threads import on_one_thread
from orthoglide.verdict import Verdict


@dataclass(frozen=True)
class Check(Framed):
    """What became of a machine.

    Attributes:
        old: names of the campaigns of the old state.
        new: of the new one.
        closed: the machine as it is now, from the new readings alone.
        differences: of the base parameters, of the causes found and of what changed.
        changes: what changed, plates that were probed among it.
        moves: plates that lie elsewhere than before.
        gone: places that were located in the old state and are not in the new one; where there are
            any, or new ones, each state speaks for itself, as no parameter is what changed.
        come: places that are located in the new state alone.
        entered: how zeros that the old readings ask for were entered, a clause each.
    """

    old: tuple[str, ...]
    new: tuple[str, ...]
    closed: RunOutcome
    differences: tuple[Difference, ...]
    changes: tuple[Change, ...] = ()
    moves: tuple[PlateMove, ...] = ()
    gone: tuple[Located, ...] = ()
    come: tuple[Located, ...] = ()
    entered: tuple[str, ...] = ()
    _index = "parameter"

    def __repr__(self) -> str:
        return f"<Check: {self.line}>"

    @property
    def columns(self) -> dict[str, list[Any]]:
        """A row a difference, in the units of files."""
        rows = []
        for d in self.differences:
            sizes = (d.before, d.after, d.after - d.before, d.sigma)
            rows.append((d.parameter, *(v / d.unit.si for v in sizes), d.unit.name, d.changed))
        titles = ("parameter", *COLUMNS)
        return dict(zip(titles, map(list, zip(*rows, strict=True)), strict=True))

    @property
    def plates(self) -> tuple[str, ...]:
        """What changed of probed plates, a sentence each."""
        return tuple(c.message for c in self.changes if c.parameter.setup)

    @property
    def lying(self) -> tuple[str, ...]:
        """Where plates lie elsewhere, a sentence each: the machine or the plate, at equal commands
        one is as good as the other.
        """
        known = "what changed above, " * bool(self.changes)
        return tuple(
            f"{move.words}: {known}an endstop or zero, an arm, the probe or the plate itself was "
            f"moved; these readings cannot tell which"
            for move in self.moves
        )

    @property
    def places(self) -> tuple[str, ...]:
        """Which places were located in one state alone, a sentence each."""
        return (
            *(f"what was located before shows no more: {_located_words(one)}" for one in self.gone),
            *(f"located now, and not before: {_located_words(one)}" for one in self.come),
        )

    @cached_property
    def verdict(self) -> Verdict:
        """Of the machine as it is now, from the new readings alone."""
        return build_result(self.closed, Verdict)

    @cached_property
    def told(self) -> Verdict:
        """The verdict with what changed since the old readings, to draw and to act upon."""
        return build_result(replace(self.closed, changed=self.changes), Verdict)

    @cached_property
    def sentences(self) -> tuple[str, ...]:
        """What changed, largest in sigmas first, and beyond which uncertainty nothing else did."""
        changed = ranked(
            (d for d in self.differences if d.changed), lambda d: abs(d.after - d.before) / d.sigma
        )
        rest = [d for d in self.differences if not d.changed]
        what = "nothing else" if changed or self.plates or self.moves or self.places else "nothing"
        said = (
            (
                f"{what} changed beyond its uncertainty",
                [d.unchanged_clause for d in rest if not d.is_significant],
            ),
            (
                "of these the two states differ, each by itself, but all readings together need no "
                "change of them",
                [d.unchanged_clause for d in rest if d.is_significant],
            ),
        )
        told = (f"{words}: {', '.join(those)}" for words, those in said if those)
        return (*self.places, *self.plates, *map(str, changed), *self.entered, *self.lying, *told)

    @property
    def line(self) -> str:
        """What changed by name, and the verdict of the new readings, in one line."""
        names = [d.words for d in self.differences if d.changed]
        names += ["the plate"] * bool(self.plates)
        names += ["where the plate lies"] * bool(self.moves)
        names += ["what is located"] * bool(self.places)
        what = f"Changed: {', '.join(names)}" if names else "Nothing changed"
        return f"{what}. Verdict {self.closed.word}."

    def __str__(self) -> str:
        return "\n".join(self.sentences)


@on_one_thread
def check(
    old: State | Verdict,
    new: State | Verdict,
    machine: MachineSource | None = None,
    *,
    noise: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Check:
    """Compare two states of a machine by their readings.

    Both states are closed together, so that what never changed is known from all readings, and what
    changed is looked for all at once. Then every parameter of the base and of the causes found is
    given one value before and one after: by how much the others may have changed at most. What is
    left is told from the new readings.

    Args:
        old: readings of the old state, in the order they were taken; paths are read as by
            ``read_readings``. A result, its folder or its ``result.json`` has its readings.
        new: readings of the new one.
        machine: dimensions, tolerances, dial, or the path of its file; where absent a result's,
            else the nominal one.
        noise: standard deviation of one reading, metres; where absent what results were computed
            with, of two the larger.
        seed: of every random draw.
        progress: called with each step.

    Raises:
        InputError: where a side is empty or the campaigns cannot be used.
        NumericsError: where the base model cannot be identified.
    """
    progress = progress or no_progress
    old, new = (s.request if isinstance(s, Verdict) else s for s in (old, new))
    states = read_states(old, new, None if machine is None else Machine.of(machine))
    machine, noise = states.machine, states.noise if noise is None else noise
    before, after = with_distinct_names(states.old, states.new)
    request, past = joint_request(machine, before, after, noise, seed)
    together = compute_outcome(request, progress)
    # A change that is one of several leaves open what there was before: not so the new readings.
    closed = compute_outcome(single_request(request, after), progress)
    old_names, new_names = (tuple(c.name for c in side) for side in (before, after))
    jointly = not past and len(visits(together.before.problem)) > 1
    was, gone, come = None, tuple[Located, ...](), tuple[Located, ...]()
    if not jointly or together.changed or any(map(_has_unnamed, (together, closed))):
        was = compute_outcome(single_request(request, before), progress)
        gone, come = _located_only_in_first(was, closed), _located_only_in_first(closed, was)
        jointly = jointly and not gone and not come
    progress(Step("comparing"))
    if jointly or was is None:
        changes = tuple(c for c in together.changed if np.isfinite(c.after))
        differences = tuple(_joint_differences(together, new_names, changes))
    else:
        differences = tuple(_separate_differences(was, closed))
        between = ", ".join(old_names), ", ".join(new_names)
        changes = tuple(_as_change(d, between, machine.catalogue) for d in differences if d.changed)
    after_all = together.after
    moves = plate_moves(after_all.problem, after_all.x, old_names, new_names)
    told = (
        ()
        if was is None or machine.spec.printer
        else tuple(zero_entry_clauses(was.machine, differences))
    )
    return Check(old_names, new_names, closed, differences, changes, moves, gone, come, told)


def _has_unnamed(closed: RunOutcome) -> bool:
    """Return whether something has no name: then no parameter is what changed, and each state must
    be closed by itself.
    """
    return bool(closed.located) or closed.word == "unexplained"


def _located_only_in_first(one: RunOutcome, other: RunOutcome) -> tuple[Located, ...]:
    """Places located in one state of which none is in the other, that was read at the same places,
    nor any cause of their legs.
    """
    if not _places_read(one) or _places_read(one) != _places_read(other):
        return ()
    known = {curve.name for located in other.located for curve in located.members}
    named = {
        other.catalogue.parameter(n).leg for cause in other.effects for n in cause.all_parameters
    }
    return tuple(
        located
        for located in one.located
        if known.isdisjoint(curve.name for curve in located.members)
        and named.isdisjoint(
            c.place.names.legs[c.place.leg] for c in located.members if c.place.leg >= 0
        )
    )


def _places_read(closed: RunOutcome) -> set[tuple[float, ...]]:
    """Where dials read what, to a tenth of a millimetre."""
    return {
        (s.leg, s.axis, s.bar, round(s.gauge, 3), *command)
        for campaign in closed.request.campaigns
        for s, command in zip(
            (campaign.setups[k] for k in campaign.setup),
            np.round(campaign.command, 4).tolist(),
            strict=True,
        )
    }


def _located_words(located: Located) -> str:
    """Its likeliest place, and what else it may be."""
    first, *others = located.members
    more = [f"{len(others)} other place{'s' * (len(others) > 1)}"] if others else []
    more += ["a fault of the readings"] if located.data else []
    rivals = f" (or {', or '.join(more)})" if more else ""
    return f"{first.words}{rivals}"


def _joint_differences(
    together: RunOutcome, later: Collection[str], changes: Sequence[Change]
) -> Iterator[Difference]:
    """Yield what changed, then all other parameters by a fit of all readings in which each has one
    value before and one in later campaigns.
    """
    names = _compared_parameters(together)
    problem, request = together.before.problem, together.request
    # Rows taken for faulty have lost their weight there.
    kept = [
        f.readings if f.on_legs else replace(f.readings, sigma=f.sigma) for f in problem.factors
    ]
    noise = request.noise if request.campaigns else None
    both = assemble(kept, request.machine, names, per_campaign=names, noise=noise)
    fit = account_for_changes(solve(_with_one_value_per_state(both, later)))
    catalogue, changed = request.machine.catalogue, {c.parameter for c in changes}
    legs = catalogue.legs
    for c in changes:
        if not c.parameter.setup:
            yield Difference(
                c.parameter, c.before, c.after, c.sigma, c.unit, True, c.alternatives_clause, legs
            )
    places: dict[Parameter, list[int]] = {}
    for k, unknown in enumerate(fit.names):
        places.setdefault(catalogue.parameter(unknown).plain, []).append(k)
    for name, at in places.items():
        if len(at) == 2 and name not in changed:
            before, after = fit.x[at].tolist()
            spread = fit.covariance[np.ix_(at, at)]
            sigma = float(np.sqrt(spread[0, 0] + spread[1, 1] - 2 * spread[0, 1]))
            unit = catalogue.effect_of(name).unit
            yield Difference(name, before, after, sigma, unit, False, legs=legs)


def _separate_differences(was: RunOutcome, now: RunOutcome) -> Iterator[Difference]:
    """Parameters as each state's own readings have them, all that they leave open allowed for, as
    other instruments see other errors.
    """
    names = dict.fromkeys([*_compared_parameters(was), *_compared_parameters(now)])
    rivals = {
        name: (*cause.same, *cause.rivals)
        for cause in (*was.effects, *now.effects)
        for name in cause.chosen.parameters
    }
    others = {n: f" (or {', or '.join(e.words for e in es)})" for n, es in rivals.items() if es}
    catalogue, known = now.catalogue, [v.machine.posterior for v in (was, now)]
    for name in names:
        if not all(name in one.names for one in known):
            continue
        at = [one.names.index(name) for one in known]
        before, after = (v.machine.values.get(name, 0.0) for v in (was, now))
        variance = 0.0
        for one, k in zip(known, at, strict=True):
            # What readings did not see is small in a sound machine, and could have been anything.
            alone = 0.0 if one.conditional_variance is None else float(one.conditional_variance[k])
            variance += max(float(one.covariance[k, k]), alone)
        parameter = catalogue.parameter(name)
        unit = catalogue.effect_of(parameter).unit
        sigma, told = float(np.sqrt(variance)), others.get(name, "")
        found = Difference(parameter, before, after, sigma, unit, False, told, catalogue.legs)
        yield replace(found, changed=found.is_significant)


def _with_one_value_per_state(problem: Problem, later: Collection[str]) -> Problem:
    """What every campaign has for itself, joined to one value before and one in the later ones."""
    joined: dict[tuple[str, bool], Unknown] = {}
    for unknown in problem.unknowns:
        at = next(k for k, parts in enumerate(unknown.weights) if parts)
        key = unknown.name.plain, problem.factors[at].name in later
        one = joined.setdefault(key, unknown)
        parts = tuple(a or b for a, b in zip(one.weights, unknown.weights, strict=True))
        joined[key] = replace(one, weights=parts)
    old_first = sorted(joined, key=lambda key: key[1])
    return replace(problem, unknowns=tuple(joined[key] for key in old_first))


def _compared_parameters(closed: RunOutcome) -> list[str]:
    """Parameters of the machine in the base model, of the causes found and of what is seen to have
    changed, without campaigns.
    """
    catalogue = closed.request.machine.catalogue
    base = catalogue.expand(catalogue.base)
    causes = [n for c in closed.effects for n in c.chosen.parameters]
    found = (*map(closed.catalogue.parameter, causes), *(c.parameter for c in closed.changed))
    known = (n.plain for n in found if n.effect in catalogue)  # others are of places
    named = (n for n in known if not catalogue.effect_of(n).of_dial)
    return list(dict.fromkeys(map(str, (*base, *named))))


def _as_change(difference: Difference, between: tuple[str, str], catalogue: Catalogue) -> Change:
    """Return what changed as each state by itself has it."""
    d = difference
    return Change(
        d.parameter, (d.parameter,), "", between, float("nan"), catalogue,
        before=d.before, after=d.after, sigma=d.sigma, sigma_after=d.sigma,
    )  # fmt: skip
