"""The comparison of two states of one machine: what changed, what did not, and what remains."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from orthoglide.arguments import public
from orthoglide.checking.plates import plate_moves
from orthoglide.checking.states import State, read_states, with_distinct_names
from orthoglide.closing import RunOutcome, build_result, compute_outcome
from orthoglide.explanation.change import COLUMNS, Change, combination
from orthoglide.explanation.change_search import visits
from orthoglide.explanation.recalibration import account_for_changes
from orthoglide.fit import assemble, solve
from orthoglide.frames import Framed
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations.touched_plates import PlateMove
from orthoglide.ordering import ranked
from orthoglide.parameters import Parameter
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import Located, Request
from orthoglide.threads import on_one_thread
from orthoglide.verdict import Verdict


@dataclass(frozen=True)
class Check(Framed):
    """The comparison of two states of a machine.

    Attributes:
        old: names of the campaigns of the old state.
        new: names of the campaigns of the new state.
        closed: the machine as it is now, from the new readings alone.
        differences: of the base parameters, of the causes found and of what changed.
        moves: plates that lie elsewhere than before.
        gone: errors located in the old state alone; if there are any, or any new ones, each state
            is closed by itself, because no parameter describes the change.
        come: errors located in the new state alone.
    """

    old: tuple[str, ...]
    new: tuple[str, ...]
    closed: RunOutcome
    differences: tuple[Change, ...]
    moves: tuple[PlateMove, ...] = ()
    gone: tuple[Located, ...] = ()
    come: tuple[Located, ...] = ()
    _index = "parameter"

    def __repr__(self) -> str:
        return f"<Check: {self.line}>"

    @property
    def columns(self) -> dict[str, list[Any]]:
        """Columns of a table with one row per difference, in the units of files."""
        rows = []
        for d in self.differences:
            sizes = (d.before, d.after, d.difference, d.sigma)
            rows.append((d.parameter, *(v / d.unit.si for v in sizes), d.unit.name, d.changed))
        titles = ("parameter", *COLUMNS)
        return dict(zip(titles, map(list, zip(*rows, strict=True)), strict=True))

    @property
    def changes(self) -> tuple[Change, ...]:
        """The differences that exceed their uncertainty."""
        return tuple(d for d in self.differences if d.changed)

    @property
    def lying(self) -> tuple[str, ...]:
        """A sentence for each plate that lies elsewhere, because of the machine or the plate."""
        known = "what changed above, " * bool(self.changes)
        return tuple(
            f"{move.words}: {known}an endstop or zero, an arm, the probe or the plate itself was "
            f"moved; these readings cannot tell which"
            for move in self.moves
        )

    @property
    def places(self) -> tuple[str, ...]:
        """A sentence for each error that was located in one state alone."""
        return (
            *(f"what was located before shows no more: {_located_words(one)}" for one in self.gone),
            *(f"located now, and not before: {_located_words(one)}" for one in self.come),
        )

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict on the machine as it is now, from the new readings alone."""
        return build_result(self.closed, Verdict)

    @cached_property
    def with_changes(self) -> Verdict:
        """The verdict with the changes since the old readings, for drawings and actions."""
        return build_result(replace(self.closed, changed=self.changes), Verdict)

    @cached_property
    def sentences(self) -> tuple[str, ...]:
        """What changed, largest in sigmas first, and the uncertainty of unchanged parameters."""
        changed = ranked(self.changes, lambda d: abs(d.difference) / d.sigma)
        unchanged = [d for d in self.differences if not d.changed]
        what = "nothing else" if changed or self.moves or self.places else "nothing"
        within = [d.unchanged_clause for d in unchanged if not d.is_significant]
        beyond = [d.unchanged_clause for d in unchanged if d.is_significant]
        sentences = [*self.places, *(change.what for change in changed), *self.lying]
        if within:
            sentences.append(f"{what} changed beyond its uncertainty: {', '.join(within)}")
        if beyond:
            sentences.append(
                f"of these the two states differ, each by itself, but all readings together need "
                f"no change of them: {', '.join(beyond)}"
            )
        return tuple(sentences)

    @property
    def line(self) -> str:
        """One line with the names of what changed and the verdict on the new readings."""
        names = [change.words for change in self.changes]
        names += ["where the plate lies"] * bool(self.moves)
        names += ["what is located"] * bool(self.places)
        what = f"Changed: {', '.join(names)}" if names else "Nothing changed"
        return f"{what}. Verdict {self.closed.word}."

    def __str__(self) -> str:
        return "\n".join(self.sentences)


@public
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

    Both states are closed together, so that all readings determine unchanged parameters, and
    changes are searched jointly. Then every parameter of the base and of the causes found gets one
    value before and one after, which bounds the change of all others. The verdict is that of the
    new readings alone.

    Args:
        old: readings of the old state, in the order they were taken; paths are read as by
            ``read_readings``. A result, its folder or its ``result.json`` has its readings.
        new: readings of the new state.
        machine: dimensions, tolerances, dial, or the path of its file; by default that of a result,
            otherwise the nominal one.
        noise: standard deviation of one reading, metres; by default the largest of the results.
        seed: of every random draw.
        progress: called with each step.

    Raises:
        InputError: if a side is empty or the campaigns cannot be used.
        NumericsError: if the base model cannot be identified.
    """
    progress = progress or no_progress
    old, new = (s.request if isinstance(s, Verdict) else s for s in (old, new))
    states = read_states(old, new, None if machine is None else Machine.of(machine))
    if noise is None:
        noise = max((s.noise for s in states if s.noise is not None), default=None)
    before, after = with_distinct_names(*(state.given for state in states))
    # A fit has the dials first and assigns readings of the tool to the last state, so old ones are
    # omitted if the new state has dials.
    with_dials = not all(one.of_tool for one in after)
    kept = [one for one in before if not (with_dials and one.of_tool)]
    request = Request("close-loop", (*kept, *after), states[1].machine, (), noise, seed)
    together = compute_outcome(request, progress)
    # Alternatives of a change make the old state ambiguous, but not the new one.
    closed = compute_outcome(replace(request, given=tuple(after)), progress)
    old_names, new_names = (tuple(c.name for c in side) for side in (before, after))
    jointly = len(kept) == len(before) and len(visits(together.before.problem)) > 1
    differences = _joint_differences(together, new_names)
    gone = come = tuple[Located, ...]()
    # No parameter describes the change of an error that has no name.
    unnamed = any(one.located or one.word == "unexplained" for one in (together, closed))
    if not jointly or together.changed or unnamed:
        closed_before = compute_outcome(replace(request, given=tuple(before)), progress)
        gone = _located_only_in_first(closed_before, closed)
        come = _located_only_in_first(closed, closed_before)
        if not jointly or gone or come:
            files = ", ".join(old_names), ", ".join(new_names)
            differences = _separate_differences(closed_before, closed, files)
    progress(Step("comparing"))
    moves = plate_moves(together.after.problem, together.after.x, old_names, new_names)
    return Check(old_names, new_names, closed, tuple(differences), moves, gone, come)


def _located_only_in_first(first: RunOutcome, second: RunOutcome) -> tuple[Located, ...]:
    """Return the errors located in the first state that neither a located error nor a cause at
    their legs explains in the second; none if the states were read at different places.
    """
    if not _places_read(first) or _places_read(first) != _places_read(second):
        return ()
    curves = {curve.name for located in second.located for curve in located.members}
    legs = {
        second.catalogue.parameter(n).leg for cause in second.effects for n in cause.all_parameters
    }
    return tuple(
        located
        for located in first.located
        if curves.isdisjoint(curve.name for curve in located.members)
        and legs.isdisjoint(curve.leg for curve in located.members)
    )


def _places_read(closed: RunOutcome) -> set[tuple[float, ...]]:
    """Return the setups and commands of all dials, rounded to a tenth of a millimetre."""
    return {
        (s.leg, s.axis, s.bar, round(s.gauge, 3), *command)
        for campaign in closed.request.campaigns
        for k, command in zip(campaign.setup, np.round(campaign.command, 4).tolist(), strict=True)
        for s in (campaign.setups[k],)
    }


def _located_words(located: Located) -> str:
    """Return the likeliest place of a located error, and its alternatives."""
    first, *others = located.members
    alternatives = [f"{len(others)} other place{'s' * (len(others) > 1)}"] if others else []
    alternatives += ["a fault of the readings"] if located.data else []
    rivals = f" (or {', or '.join(alternatives)})" if alternatives else ""
    return f"{first.words}{rivals}"


def _joint_differences(together: RunOutcome, later: Collection[str]) -> Iterator[Change]:
    """Yield the changed parameters, then all others from a fit of all readings with one value
    before and one in later campaigns.
    """
    changes = [change for change in together.changed if np.isfinite(change.after)]
    yield from changes
    names = _compared_parameters(together)
    problem, request = together.before.problem, together.request
    # Faulty rows have zero weight in these tables.
    tables = [
        f.readings if f.on_legs else replace(f.readings, sigma=f.sigma) for f in problem.factors
    ]
    first_later = next(factor.name for factor in problem.factors if factor.name in later)
    separate = [f"{name}@{first_later}" for name in names]
    noise = request.noise if request.campaigns else None
    problem_of_both = assemble(tables, request.machine, names, per_campaign=separate, noise=noise)
    fit = account_for_changes(solve(problem_of_both))
    catalogue, changed = request.machine.catalogue, {c.parameter for c in changes}
    places: dict[Parameter, list[int]] = {}
    for k, unknown in enumerate(fit.names):
        places.setdefault(catalogue.parameter(unknown).plain, []).append(k)
    for name, columns in places.items():
        if len(columns) == 2 and name not in changed:
            before, after = fit.x[columns].tolist()
            difference, sigma = combination(fit, columns, (-1.0, 1.0))
            yield Change(
                {name: difference}, catalogue, before=before, after=after, sigma=sigma,
                changed=False,
            )  # fmt: skip


def _separate_differences(
    closed_before: RunOutcome, closed_now: RunOutcome, files: tuple[str, str]
) -> Iterator[Change]:
    """Yield the parameters that both states determine by themselves, with the uncertainty of each,
    because different instruments see different errors.
    """
    names = dict.fromkeys([*_compared_parameters(closed_before), *_compared_parameters(closed_now)])
    rivals = {
        name: tuple(one.words for one in (*cause.same, *cause.rivals))
        for cause in (*closed_before.effects, *closed_now.effects)
        for name in cause.chosen.parameters
    }
    catalogue, machines = closed_now.catalogue, (closed_before.machine, closed_now.machine)
    posteriors = [machine.posterior for machine in machines]
    for name in names:
        if not all(name in posterior.names for posterior in posteriors):
            continue
        before, after = (machine.values.get(name, 0.0) for machine in machines)
        variance = 0.0
        for posterior in posteriors:
            k, conditional = posterior.names.index(name), posterior.conditional_variance
            # An error that readings did not show is small in a sound machine, but may be large.
            alone = 0.0 if conditional is None else float(conditional[k])
            variance += max(float(posterior.covariance[k, k]), alone)
        sigma = float(np.sqrt(variance))
        change = Change(
            {catalogue.parameter(name): after - before}, catalogue, "", files, before, after,
            sigma, sigma, rivals=rivals.get(name, ()),
        )  # fmt: skip
        yield replace(change, changed=change.is_significant)


def _compared_parameters(closed: RunOutcome) -> list[str]:
    """Return the machine's parameters of the base model, of the causes found and of the changes,
    without campaigns.
    """
    catalogue = closed.request.machine.catalogue
    base = catalogue.expand(catalogue.base)
    causes = [n for c in closed.effects for n in c.chosen.parameters]
    parameters = (*map(closed.catalogue.parameter, causes), *(c.parameter for c in closed.changed))
    # The parameters of free-form errors are not in the catalogue.
    named = (n.plain for n in parameters
             if n.effect in catalogue and not catalogue[n.effect].of_dial)  # fmt: skip
    return list(dict.fromkeys(map(str, (*base, *named))))
