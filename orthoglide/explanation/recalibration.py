"""Changes of a machine since an earlier calibration.

The earlier calibration is a prior ``x ~ N(m, C)``. It says nothing of a parameter that changed by
repair or damage since then. The evidence of the new readings decides jointly which parameters
changed (`change_search`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from orthoglide.explanation.change import Change, combination
from orthoglide.explanation.change_search import most_probable_changes, possible_changes
from orthoglide.explanation.linear_model import SLAB_SCALES
from orthoglide.fit.assembling import excited_effects, with_free
from orthoglide.fit.estimate import Estimate
from orthoglide.fit.problem import Problem
from orthoglide.fit.solving import Method, solve
from orthoglide.fit.unknowns import share_plate_shapes
from orthoglide.machine_file import MachineFile, Posterior
from orthoglide.parameters import Parameter, effect_name

_UNCHANGED_PLATE_WIDTH, _BENT_PLATE_WIDTH = 0.02, 0.1
"""Prior widths of a plate's shape, in tolerances: of an unchanged plate, whose shape the earlier
calibration contains, and of one that may differ from an ideal bowl."""

_AMBIGUITY_CLAUSES = {
    "averaged_over": "could not separate several causes ({} among them) and contains their average",
    "located": "represents an unexplained error by a curve ({})",
}


def _ambiguity_clause(spec: MachineFile) -> str:
    """Return a clause on what an earlier calibration left ambiguous; empty if nothing."""
    for key, words in _AMBIGUITY_CLAUSES.items():
        ambiguous = spec.provenance.get(key, ())
        if isinstance(ambiguous, Sequence) and ambiguous:
            return words.format(", ".join(map(str, ambiguous)))
    return ""


def doubt_of_earlier(problem: Problem) -> str:
    """Return a clause on why changes since an earlier calibration are uncertain or not searched
    for; empty if there is no reason.
    """
    spec = problem.machine.spec
    if spec.is_inconclusive:
        return (
            "was partial, and its values lack the causes that it found: they are only where the "
            "fit starts, and changes since then are not searched for"
        )
    clause = _ambiguity_clause(spec) if problem.has_earlier_calibration else ""
    return f"{clause}, so changes since then are uncertain" if clause else ""


def account_for_changes(estimate: Estimate, method: Method = "auto") -> Estimate:
    """Return the fit with the parameters released that changed since the earlier calibration; the
    same fit if there was none, or nothing changed.
    """
    problem = estimate.problem
    earlier = problem.earlier_posterior
    if earlier is None or not problem.has_earlier_calibration:
        return estimate
    changes = _find_changes(estimate, earlier)
    if not changes:
        return estimate
    changed = [change.parameter for change in changes]
    method = "nested" if method == "auto" else method
    released = _with_parameters_released(problem, earlier, changed)
    fit = solve(released, method=method, start=released.zero_padded(estimate.x))
    with_values = (_with_both_values(change, earlier, changed, fit) for change in changes)
    return replace(fit, changes=tuple(with_values))


def _find_changes(estimate: Estimate, earlier: Posterior) -> tuple[Change, ...]:
    """Return the changes of calibrated parameters; without dials also of plates and patterns.

    The changes found beside slightly bent plates are returned if these are as many, because a plate
    need not be an ideal bowl to be a cause; otherwise those beside unchanged plates.
    """
    calibrated, catalogue = estimate.problem, estimate.problem.machine.catalogue
    varied = [name for name in calibrated.names if name in earlier.names]
    size_of = {
        part: member
        for effect in catalogue.values() if effect.shape
        for member, weights in catalogue.structured_members(effect.name).items()
        if set(weights) <= {*varied}  # a coefficient may be missing from a file edited by hand
        for part in weights
    }  # fmt: skip
    names = [*dict.fromkeys(size_of.get(name, name) for name in varied)]

    def search(problem: Problem) -> tuple[Change, ...]:
        bent = _effects_found(problem.machine.spec)
        shapes = [n for n in problem.names[len(calibrated.names) :] if n.effect not in bent]
        possible = possible_changes(problem, [*names, *shapes], [("", 0)])
        return most_probable_changes(problem, problem.zero_padded(estimate.x), possible)

    flat = _with_plate_shapes(calibrated, _UNCHANGED_PLATE_WIDTH)
    changes = search(flat) if names else ()
    if not changes or len(flat.unknowns) == len(calibrated.unknowns):
        return changes
    with_bent_plates = search(_with_plate_shapes(calibrated, _BENT_PLATE_WIDTH))
    return with_bent_plates if len(with_bent_plates) == len(changes) else changes


def _with_plate_shapes(problem: Problem, width: float) -> Problem:
    """Return the problem with free shapes of probed plates, which a calibration does not contain,
    with a prior width in tolerances; with dials the same problem.
    """
    if problem.campaigns:
        return problem
    shapes = [effect.name for effect in excited_effects(problem) if effect.of_body]
    extended = with_free(problem, shapes, release=False)
    new_unknowns = share_plate_shapes(
        extended.unknowns[len(problem.unknowns) :], problem.machine.catalogue
    )
    bent = _effects_found(problem.machine.spec)
    with_widths = (
        replace(u, prior_width=max(SLAB_SCALES) if u.name.effect in bent else width)
        for u in new_unknowns
    )
    return replace(problem, unknowns=(*problem.unknowns, *with_widths))


def _effects_found(spec: MachineFile) -> set[str]:
    """Return the effects that an earlier calibration found; those of a plate are in no machine
    file, so they are neither small nor a change where the plate is touched again.
    """
    found = spec.provenance.get("effects", ())
    return {effect_name(str(name)) for name in found} if isinstance(found, Sequence) else set()


def _with_parameters_released(
    problem: Problem, earlier: Posterior, names: Collection[Parameter]
) -> Problem:
    """Return the problem with wide priors of some parameters and the earlier ones of all others.

    A pattern that changed is an unknown beside its legs: the change of the pattern.
    """
    patterns = [name for name in names if name not in problem.names]
    extended = with_free(problem, patterns, release=False) if patterns else problem
    unknowns = (
        replace(u, prior_width=max(SLAB_SCALES)) if u.name.plain in names else u
        for u in extended.unknowns
    )
    remaining = earlier.without(names)
    return replace(extended, unknowns=tuple(unknowns), earlier_posterior=remaining)


def _with_both_values(
    change: Change, earlier: Posterior, changed: Collection[Parameter], fit: Estimate
) -> Change:
    """Return a change with its values at the earlier calibration and by the fit, in which all
    ``changed`` parameters are released.
    """
    problem, parameter, catalogue = fit.problem, change.parameter, change.catalogue
    spec, last = problem.machine.spec, problem.factors[problem.last_factor_index]
    vague = bool(_ambiguity_clause(spec)) and catalogue.effect_of(parameter).controller != "zero"
    unseen = 0.0
    if parameter in earlier.names:
        summed = change.summed_members
        after, sigma_after = combination(fit, [fit.names.index(name) for name in summed])
        unchanged = [n for n in fit.names if n in earlier.names and n not in (*changed, *summed)]
        before, sigma = _value_before(earlier, fit, summed, unchanged)
        variances = earlier.conditional_variance  # each parameter alone off by its tolerance
        if variances is not None:
            unseen = float(np.sqrt(max(variances[earlier.names.index(n)] for n in summed)))
        sigma = math.hypot(sigma, unseen, change.sigma_between_sets)
        if vague:  # the search estimates the change without the earlier average
            before, sigma = after - change.sizes[parameter], change.sigma
    else:
        before = 0.0  # a plate was assumed flat; a pattern is the projection of its legs
        if not catalogue.effect_of(parameter).of_body:
            weights = catalogue.elementary_weights(parameter)
            shares = (w * earlier.mean[earlier.names.index(n)] for n, w in weights.items())
            before = float(sum(shares) / sum(w * w for w in weights.values()))
        place = [n.plain for n in problem.names].index(parameter)
        size, sigma_after = combination(fit, [place])
        after, sigma = before + size, math.hypot(sigma_after, change.sigma_between_sets)
    files = Path(spec.file).name or "earlier calibration", last.name
    return replace(
        change, files=files, before=before, after=after, sigma=sigma, sigma_after=sigma_after,
        unseen_before=unseen, vague=vague,
    )  # fmt: skip


def _value_before(
    earlier: Posterior, fit: Estimate, members: Sequence[str], unchanged: Sequence[str]
) -> tuple[float, float]:
    """Return the sum of some parameters at the earlier calibration, and the sigma of its change.

    The pose of the whole machine, which both visits leave undetermined, cancels in the difference
    of ``s - w^T x``: s is the sum now, x the unchanged parameters, and w the regression of the sum
    on x. The variance of two independent sums is used if it is smaller.
    """
    at, others_at = ([earlier.names.index(n) for n in part] for part in (members, unchanged))
    places, others = ([fit.names.index(n) for n in part] for part in (members, unchanged))
    slopes, left = earlier.regression(members, unchanged)
    slope, sum_weights = slopes.sum(axis=0), np.ones(len(members))
    _, sigma = combination(fit, [*places, *others], [*sum_weights, *-slope])
    regressed = math.hypot(sigma, math.sqrt(max(left.sum(), 0.0)))
    _, sigma = combination(fit, places)
    independent = math.hypot(sigma, math.sqrt(earlier.covariance[np.ix_(at, at)].sum()))
    before = float(earlier.mean[at].sum())
    if regressed < independent:  # unchanged parameters tell more of the sum
        before += float(slope @ (fit.x[others] - earlier.mean[others_at]))
    return before, min(regressed, independent)
