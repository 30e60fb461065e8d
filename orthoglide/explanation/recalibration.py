"""A machine that was calibrated before: what that says now, and what has changed since.

The earlier calibration is a prior ``x ~ N(m, C)``. Of a parameter that changed since it says
nothing any more: it was repaired, or broke, by as much as it likes. Which ones have is decided by
the evidence of the new readings, all at once (`change_model`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoglide.explanation.change import Change, summed_members
from orthoglide.explanation.change_model import (
    SLAB_WIDTHS,
    ChangeCandidate,
    ChangeEstimate,
    changeable_parameters,
    most_probable_changes,
)
from orthoglide.fit.assembling import with_free
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.excitation import excited_effects
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import Method, solve
from orthoglide.fit.unknowns import share_plate_shapes
from orthoglide.machine_file import MachineFile, Posterior
from orthoglide.parameters import Parameter

_UNCHANGED_PLATE_WIDTH, _BENT_PLATE_WIDTH = 0.02, 0.1
"""Tolerances by which a plate may differ without a change: it is what it was, and what readings
showed of it then stands in the machine's own numbers; and by which none is an ideal bowl."""


_AMBIGUITY_CLAUSES = {
    "averaged_over": "could not tell causes apart ({} among them) and has their average",
    "located": "has a curve for what it had no name for ({})",
}


def ambiguity_clause(spec: MachineFile) -> str:
    """Return a clause on what an earlier calibration left ambiguous; empty if nothing."""
    for kept, words in _AMBIGUITY_CLAUSES.items():
        several = spec.provenance.get(kept, ())
        if isinstance(several, Sequence) and several:
            return words.format(", ".join(map(str, several)))
    return ""


def account_for_changes(estimate: Estimate, method: Method = "auto") -> Estimate:
    """The fit with everything let go that has changed since the earlier calibration that is its
    prior; as it is where there is none, or nothing has changed.
    """
    first = estimate.problem
    known = first.earlier_posterior
    if known is None or not first.has_earlier_calibration:
        return estimate
    found = _find_changes(estimate, known)
    if not found:
        return estimate
    gone = [one.parameter for one in found]
    method = "nested" if method == "auto" else method
    left = known.without(gone)
    free = _with_parameters_released(first, left, gone)
    now = solve(free, method=method, start=free.zero_padded(estimate.x))
    return replace(now, changes=tuple(_reported_changes(known, left, now, found)))


def _find_changes(estimate: Estimate, known: Posterior) -> tuple[ChangeEstimate, ...]:
    """What changed; beside plates that are bent a little where that leaves as much to tell, for a
    shape that is not quite a bowl's must not rule the plate out.
    """
    wide = _with_plate_shapes(estimate.problem, _UNCHANGED_PLATE_WIDTH)
    found = _search_changes(estimate, known, wide)
    if not found or len(wide.unknowns) == len(estimate.x):
        return found
    loose = _search_changes(
        estimate, known, _with_plate_shapes(estimate.problem, _BENT_PLATE_WIDTH)
    )
    return loose if len(loose) == len(found) else found


def _search_changes(
    estimate: Estimate, known: Posterior, wide: Problem
) -> tuple[ChangeEstimate, ...]:
    """Return the changes of calibrated parameters; without dials also of plates and patterns."""
    first = estimate.problem
    names = [name for name in first.names if name in known.names]
    if not names:
        return ()
    several = changeable_parameters(wide, [*names, *wide.names[len(first.names) :]])
    candidates = [ChangeCandidate(n, 0, s, wide.machine.tolerance(n)) for n, s in several.items()]
    return most_probable_changes(wide, wide.zero_padded(estimate.x), candidates)


def _with_plate_shapes(problem: Problem, bent: float) -> Problem:
    """The problem with the shapes of probed plates, of which a calibration keeps nothing, and which
    may differ by ``bent`` tolerances without a change; with dials, who know the machine, as it is.
    """
    if problem.campaigns:
        return problem
    shapes = [effect.name for effect in excited_effects(problem) if effect.of_body]
    wide = with_free(problem, shapes, release=False)
    added = share_plate_shapes(wide.unknowns[len(problem.unknowns) :], problem.machine.catalogue)
    narrow = (replace(unknown, prior_width=bent) for unknown in added)
    return replace(problem, unknowns=(*problem.unknowns, *narrow))


def _with_parameters_released(
    problem: Problem, left: Posterior, names: Collection[Parameter]
) -> Problem:
    """The problem in which some parameters may be anything, and the rest is as known before.

    A pattern that changed is an unknown beside its legs, by how much each is not what it was.
    """
    more = [name for name in names if name not in problem.names]
    wide = with_free(problem, more, release=False) if more else problem
    unknowns = (
        replace(u, prior_width=max(SLAB_WIDTHS)) if u.name.plain in names else u
        for u in wide.unknowns
    )
    return replace(wide, unknowns=tuple(unknowns), earlier_posterior=left)


def _reported_changes(
    known: Posterior, left: Posterior, now: Estimate, found: Sequence[ChangeEstimate]
) -> Iterator[Change]:
    """Yield the changes found, with the values of both visits."""
    last, catalogue = now.problem.factors[now.problem.last_factor], now.problem.machine.catalogue
    spec = now.problem.machine.spec
    old, unclear = Path(spec.file).name or "earlier calibration", bool(ambiguity_clause(spec))
    for one in found:
        average = unclear and catalogue.effect_of(one.parameter).controller != "zero"
        if one.parameter in known.names:
            summed = summed_members(tuple(one.sizes), catalogue)
            places = [now.names.index(name) for name in summed]
            before, apart = _value_before(known, left, now, summed)
            unseen = 0.0
            if (
                known.conditional_variance is not None
            ):  # were it alone off by about its tolerance then
                several = (known.conditional_variance[known.names.index(name)] for name in summed)
                unseen = float(np.sqrt(max(several)))
            apart = math.hypot(apart, unseen, one.sigma_between_sets)
            sigma = float(np.sqrt(now.covariance[np.ix_(places, places)].sum()))
            after = float(now.x[places].sum())
            if average:  # the search knows by how much, from what no average does
                before, apart = after - next(iter(one.sizes.values())), one.sigma
        else:
            before = 0.0  # of a plate, which was taken for flat; of a pattern its share
            if not catalogue.effect_of(one.parameter).of_body:
                weights = catalogue.elementary_weights(one.parameter)
                shares = (w * known.mean[known.names.index(part)] for part, w in weights.items())
                before = float(sum(shares) / sum(w * w for w in weights.values()))
            place = [n.plain for n in now.problem.names].index(one.parameter)
            after = before + float(now.x[place])
            sigma = float(np.sqrt(now.covariance[place, place]))
            apart, unseen = math.hypot(sigma, one.sigma_between_sets), 0.0
        yield Change(
            one.parameter, tuple(one.sizes), "", (old, last.name), one.evidence, catalogue,
            before, after, apart, sigma, tuple(one.sizes.values()), unseen_before=unseen,
            vague=average,
        )  # fmt: skip


def _value_before(
    known: Posterior, left: Posterior, now: Estimate, members: tuple[Parameter, ...]
) -> tuple[float, float]:
    """Sum of some parameters at the earlier calibration, and the sigma of its change since.

    What both visits leave open alike, where the machine sits as a whole, is in no difference: of
    ``s - w^T x``, s the sum now, x what did not change, and w the regression of the sum upon that;
    or of two sums that know nothing of each other, where that is less.
    """
    at = [known.names.index(name) for name in members]
    kept = [n for n in now.names if n in left.names and n not in members]
    rest = [known.names.index(n) for n in kept]
    sd = np.sqrt(np.maximum(np.diag(known.covariance), 1e-300))
    unit = known.covariance / sd / sd[:, None]
    across = (unit[np.ix_(rest, at)] * sd[at]).sum(axis=1)
    among = np.linalg.pinv(unit[np.ix_(rest, rest)], rcond=1e-9, hermitian=True)
    unknown = known.covariance[np.ix_(at, at)].sum() - across @ among @ across
    slope, places = (among @ across) / sd[rest], [now.names.index(n) for n in kept]
    alone = np.isin(now.names, members).astype(float)
    weights = alone.copy()
    weights[places] = -slope
    given = weights @ now.covariance @ weights + max(unknown, 0.0)
    apart = alone @ now.covariance @ alone + known.covariance[np.ix_(at, at)].sum()
    before = float(known.mean[at].sum())
    if given < apart:  # what did not change tells more of what there was than the calibration did
        before += float(slope @ (now.x[places] - known.mean[rest]))
    return before, float(np.sqrt(min(given, apart)))
