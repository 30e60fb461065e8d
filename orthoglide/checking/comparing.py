"""The comparison of two states of one machine: what changed, what did not, and what remains."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from orthoglide.arguments import public
from orthoglide.checking.located import (
    errors_with_size,
    gone_and_come,
    located_only_in_first,
    located_words,
    resized,
    with_uncertain_shapes,
)
from orthoglide.checking.plates import plate_moves
from orthoglide.checking.states import State, read_states, with_distinct_names
from orthoglide.closing import RunOutcome, build_result, compute_outcome
from orthoglide.effects import Effect
from orthoglide.explanation.change import COLUMNS, SIGNIFICANT_SIGMAS, Change, combination
from orthoglide.explanation.change_search import visits
from orthoglide.explanation.recalibration import account_for_changes
from orthoglide.fit import assemble, solve
from orthoglide.frames import Framed
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings, source
from orthoglide.observations.touched_plates import PlateMove
from orthoglide.ordering import ranked
from orthoglide.parameters import Parameter
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import Curve, Located, Request
from orthoglide.text import listed
from orthoglide.threads import on_one_thread
from orthoglide.verdict import Verdict


@dataclass(frozen=True)
class Check(Framed):
    """The comparison of two states of a machine.

    Attributes:
        old: names of the campaigns of the old state.
        new: names of the campaigns of the new state.
        verdict: on the machine as it is now, from the new readings alone.
        with_changes: the same verdict with the changes since the old readings, for drawings,
            actions and ``result.json``.
        differences: differences of the base parameters, of the causes found and of what changed.
        moves: plates that lie elsewhere than before.
        gone: errors located in the old state that show no more.
        come: errors located in the new state that did not show before.
        resized: curves of errors that no parameter of a machine represents, before and now, where
            their sizes differ.
    """

    old: tuple[str, ...]
    new: tuple[str, ...]
    verdict: Verdict
    with_changes: Verdict
    differences: tuple[Change, ...]
    moves: tuple[PlateMove, ...] = ()
    gone: tuple[Located, ...] = ()
    come: tuple[Located, ...] = ()
    resized: tuple[tuple[Curve, Curve], ...] = ()
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
        """A sentence for each error that was located in one state alone, or in both with other
        sizes.
        """
        return (
            *(f"what was located before shows no more: {located_words(one)}" for one in self.gone),
            *(f"located now, and not before: {located_words(one)}" for one in self.come),
            *(
                f"located before and now: {b.words} instead of {a.size_words}"
                for a, b in self.resized
            ),
        )

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
            if self.moves:
                what = f"if only the plate or the probe was moved, {what}"
            sentences.append(f"{what} changed beyond its uncertainty: {', '.join(within)}")
        if beyond:
            sentences.append(
                f"these differ between the two states, each closed by itself, but a fit of all "
                f"readings needs no change of them: {', '.join(beyond)}"
            )
        return tuple(sentences)

    @property
    def line(self) -> str:
        """One line with the names of what changed and the verdict on the new readings."""
        names = [change.words for change in self.changes]
        names += ["where the plate lies"] * bool(self.moves)
        names += ["what is located"] * bool(self.places)
        what = f"Changed: {', '.join(names)}" if names else "Nothing changed"
        return f"{what}. Verdict {self.verdict.word}."

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

    Each state is closed by itself; an error that is located in either has a size in both. Then both
    are closed together, with their data faults corrected, so that all readings determine unchanged
    parameters, and changes are searched jointly. Every parameter of the base and of the causes
    found gets one value before and one after, which bounds the change of all others. The verdict
    is that of the new readings alone.

    Args:
        old: readings of the old state, in the order they were taken; paths are read as by
            ``read_readings``. A result, its folder or its ``result.json`` has its readings.
        new: readings of the new state.
        machine: dimensions, tolerances, dial, or the path of its file; by default that of a result,
            otherwise the nominal one. Of a calibrated machine, what the calibration found is not
            used: both states are found from their own readings.
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
    # A fit with dials assigns all readings of the tool to the last state. If the new state has
    # dials, old readings of the tool are therefore left out.
    with_dials = not all(one.of_tool for one in after)
    kept = [one for one in before if not (with_dials and one.of_tool)]
    request = Request("close-loop", (*kept, *after), states[1].machine, (), noise, seed)
    return _comparison(request, before, after, progress)


def _comparison(
    request: Request, before: Sequence[Readings], after: Sequence[Readings], progress: Progress
) -> Check:
    """Return the comparison of two states; ``request`` has the readings to close together."""
    closed_before, closed = (
        compute_outcome(replace(request, given=tuple(side)), progress) for side in (before, after)
    )
    errors = [*errors_with_size(closed_before, closed)]
    shapes = [one.shape for one in errors if one.shape.name not in request.machine.catalogue]
    machine = request.machine.with_effects(shapes)
    given = tuple(_with_faults_corrected(request.given, (closed_before, closed)))
    together = compute_outcome(replace(request, given=given, machine=machine), progress)
    old_names, new_names = (tuple(c.name for c in side) for side in (before, after))
    jointly = (
        len(request.given) == len(before) + len(after) and len(visits(together.before.problem)) > 1
    )
    gone = located_only_in_first(closed_before, closed)
    come = located_only_in_first(closed, closed_before)
    if not jointly or gone or come:
        files = ", ".join(map(source, before)), ", ".join(map(source, after))
        names = {shape.name for shape in shapes}
        sizes = [change for change in together.changed if change.parameter.effect in names]
        of_shapes = with_uncertain_shapes(sizes, errors)
        differences = (*of_shapes, *_separate_differences(closed_before, closed, files))
    else:
        joint = [*_joint_differences(together, new_names, shapes)]
        differences = tuple(with_uncertain_shapes(joint, errors))
    rivals = {error.shape.name: error.rivals for error in errors}
    differences = tuple(
        replace(d, rivals=rivals.get(d.parameter.effect, d.rivals)) for d in differences
    )
    sized_gone, sized_come, stated = gone_and_come(errors, together.changed)
    progress(Step("comparing"))
    verdict = build_result(closed, Verdict)
    changed = [d for d in differences if d.changed]
    return Check(
        old_names, new_names, verdict,
        verdict_with_changes(closed, changed) if changed else verdict,
        tuple(d for d in differences if d.parameter.effect not in stated),
        plate_moves(together.after.problem, together.after.x, old_names, new_names),
        gone + sized_gone, come + sized_come, tuple(resized(closed_before, closed)),
    )  # fmt: skip


def _with_faults_corrected(
    given: Iterable[Readings], closed: Iterable[RunOutcome]
) -> Iterator[Readings]:
    """Yield the readings with the data faults that each state's own closure corrected, so that the
    fit of all readings cannot explain a fault by a change of the machine.
    """
    factors = (factor for outcome in closed for factor in outcome.before.problem.factors)
    used = {(factor.name, factor.on_legs): factor.readings for factor in factors}
    for table in given:
        yield used.get((table.name, bool(table.on_legs.all())), table)


def verdict_with_changes(closed: RunOutcome, changes: Iterable[Change]) -> Verdict:
    """Return the verdict on the new readings with changes since the old ones. Located errors are
    left out of the alternatives to a parameter, as no drawing shows them.
    """
    changes, catalogue = tuple(changes), closed.request.machine.catalogue

    def drawn(change: Change) -> Change:
        sizes = {p: size for p, size in change.sizes.items() if p.effect in catalogue}
        return replace(change, sizes=sizes) if change.parameter in sizes else change

    not_contained = _changes_not_contained(closed, changes)
    changed = tuple(map(drawn, changes))
    return build_result(replace(closed, changed=changed, not_contained=not_contained), Verdict)


def _changes_not_contained(closed: RunOutcome, changes: Iterable[Change]) -> str:
    """Return a sentence on the structural changes that the fit of the new readings alone does not
    show: its value is nearer to the old one, and differs significantly from the new one. Empty for
    none, and on an Orthoglide.

    Sizes and angles of a controller may be fitted to such a change and hide it from these readings;
    zeros, which are all that the controller of an Orthoglide takes, hardly can.
    """
    machine, catalogue = closed.request.machine, closed.request.machine.catalogue
    if machine.geometry.dialled:
        return ""

    def is_contained(change: Change) -> bool:
        value = closed.values.get(change.parameter, 0.0)
        before, after = abs(value - change.before), abs(value - change.after)
        return after <= max(before, SIGNIFICANT_SIGMAS * change.sigma)

    words = [
        f"the {change.words}"
        for change in changes
        if change.parameter.effect in catalogue
        and change.parameter.effect not in catalogue.base
        and not is_contained(change)
    ]
    if not words:
        return ""
    return (
        f"The new readings alone do not show that {listed(words)} changed, so their fit may assign "
        f"the change to other numbers: enter no number before it is confirmed and corrected, and "
        f"the readings are taken again."
    )


def _joint_differences(
    together: RunOutcome, later: Collection[str], shapes: Iterable[Effect]
) -> Iterator[Change]:
    """Yield the changed parameters, then all others from a fit of all readings with one value
    before and one in later campaigns. ``shapes``: the errors that either state shows.
    """
    changes = [change for change in together.changed if np.isfinite(change.after)]
    yield from changes
    sizes = (name for effect in shapes for name in effect.motions)
    names = [*dict.fromkeys((*_compared_parameters(together), *sizes))]
    problem, request = together.before.problem, together.request
    # Faulty rows have zero weight in these tables.
    tables = [
        f.readings if f.on_legs else replace(f.readings, sigma=f.sigma) for f in problem.factors
    ]
    first_later = next(factor.name for factor in problem.factors if factor.name in later)
    separate = [f"{name}@{first_later}" for name in names]
    noise = request.noise if request.campaigns else None
    problem_of_both = assemble(tables, request.machine, names, per_campaign=separate, noise=noise)
    fit = account_for_changes(solve(problem_of_both, method="nested"))
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
    for states that no fit of all readings compares.
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
        variances = list[float]()
        for posterior in posteriors:
            k, conditional = posterior.names.index(name), posterior.conditional_variance
            # A cause that was not found has a small variance, as machines are mostly sound; if it
            # is there all the same, its variance is the conditional one.
            alone = 0.0 if conditional is None else float(conditional[k])
            variances.append(max(float(posterior.covariance[k, k]), alone))
        sigma, sigma_after = np.sqrt([sum(variances), variances[-1]]).tolist()
        change = Change(
            {catalogue.parameter(name): after - before}, catalogue, "", files, before, after,
            sigma, sigma_after, rivals=rivals.get(name, ()),
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
