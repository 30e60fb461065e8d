"""The closed loop: test the residual, find its causes, identify again, and judge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from orthoglide.accuracy import tcp_map
from orthoglide.closing.outcome import RunOutcome
from orthoglide.explanation import (
    CredibleSets,
    FullPosterior,
    check_levels,
    credible_sets,
    full_posterior,
    posterior_lack_of_fit,
)
from orthoglide.explanation.assumed_noise import with_refuted_noise_enlarged
from orthoglide.explanation.change import Change
from orthoglide.explanation.change_search import with_changes_separate
from orthoglide.explanation.credible_faults import EVEN_PROBABILITY
from orthoglide.explanation.data_faults import (
    DataFindings,
    find_data_faults,
    report_faults,
    without_faults,
)
from orthoglide.explanation.identifying import identify
from orthoglide.explanation.lack_of_fit import SIGNIFICANT, estimate_lack_of_fit
from orthoglide.explanation.linear_model import SLAB_SCALES
from orthoglide.explanation.ranked_readings import check_drive_order
from orthoglide.explanation.recalibration import account_for_changes, ambiguity_clause
from orthoglide.fit import Estimate, assemble, refit_with_residual_noise, solve
from orthoglide.fit.crosscheck import verify
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.fit.noise import rms_by_unit
from orthoglide.fit.plausible import check_plausible
from orthoglide.fit.scores import FittedRows
from orthoglide.geometry import Array, align_points
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.numerals import SIGMAS_95, ByUnit, compact, distinct_figures
from orthoglide.observations import Readings
from orthoglide.observations.readings import Points
from orthoglide.observations.tables import shared_fraction
from orthoglide.prediction import Conditions
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import HoldOut, LackOfFit, Request, TcpErrors, Word
from orthoglide.threads import on_one_thread

_MAX_ERROR_RATIO = 3.0  # ratio of errors to expected errors from which points fit no machine


def held_out_rms(
    values: Mapping[str, float],
    machine: Machine,
    held: Sequence[Readings],
    per_campaign: Sequence[str] = (),
) -> ByUnit:
    """Return the root mean square residual of readings that a machine was not fitted to; ``values``
    are its parameters, SI.

    Parameters specific to a campaign, its datums and its placements (of the tool's instruments all
    parameters of a setup) are fitted to the campaign itself, each time without the reading scored.
    """
    machine_values = machine.catalogue.machine_values(values)
    free = per_campaign or machine.catalogue.base
    problem = assemble(held, machine.with_only(machine_values), free)
    if per_campaign:
        rows = solve(problem, method="nested").rows
    else:
        problem = replace(problem, unknowns=(), held=(machine_values,) * len(problem.factors))
        linearised = linearise(problem, np.zeros(0))
        nuisance = nuisances(problem, linearised.reading_poses)
        rows = FittedRows.from_fit(problem, nuisance, linearised)
    share = 1 - rows.leverage  # of the residual of a reading that its own fit leaves
    return rms_by_unit(rows.residual / np.where(share > 1e-6, share, np.nan), problem.angular)


def points_contradiction(errors: TcpErrors, stated_sigma: Array, points: Points) -> str:
    """Return how measured points contradict the machine both with and without the finding, a
    clause; empty if they do not, or if their accuracy is unknown. The errors are after the best
    translation; ``stated_sigma`` is that of the calibrated machine ``(n, 3)``, metres.
    """
    declared_sigma = _declared_sigma(points)
    if not declared_sigma.any():
        return ""
    expected = float(np.sqrt(np.mean(np.sum(stated_sigma**2 + declared_sigma**2, axis=1))))
    if min(errors.before_mean, errors.after_mean) < _MAX_ERROR_RATIO * expected:
        return ""
    before, after = distinct_figures(errors.before_mean * 1e3, errors.after_mean * 1e3)
    return (
        f"the measured points fit this result neither with nor without what was found: the tool is "
        f"{after} and {before} mm off, where {compact(expected * 1e3, 2)} mm are to be expected; "
        f"look for what moved, or check the frame and the sigma of the points"
    )


def _declared_sigma(points: Points) -> Array:
    """Return the declared standard deviation of a coordinate ``(m, 1)``, metres; 0 without one."""
    return np.nan_to_num(points.sigma)[:, None]


def tcp_errors(
    machine: Machine,
    given: Readings,
    before: Mapping[str, float],
    after: Mapping[str, float],
    sigma: Array | None = None,
) -> dict[str, TcpErrors]:
    """Return errors at TCP points by alignment: none, the best translation, a rigid motion.

    ``before`` and ``after`` are parameters, SI; ``sigma`` is the standard deviation for ``after``,
    best translation removed ``(n, 3)``, metres, to which that of the points is added.
    """
    points = given.points()
    conditions = Conditions.from_commands(points.command, approach=points.approach)
    errors, declared_sigma = {}, _declared_sigma(points)
    predicted = {
        name: machine.model.outputs(values, conditions).p
        for name, values in (("nominal", {}), ("before", before), ("after", after))
    }
    for fit in ("none", "translation", "rigid"):
        figures, inside = {}, float("nan")
        for name, p in predicted.items():
            difference = _aligned(p, points.p, fit) - points.p
            distance = np.sqrt(np.nansum(difference**2, axis=1))
            figures[f"{name}_mean"] = float(distance.mean())
            figures[f"{name}_max"] = float(distance.max())
        if sigma is not None and fit == "translation":  # of `after`, the last
            within = np.abs(difference) <= SIGMAS_95 * np.hypot(sigma, declared_sigma)
            inside = float(np.mean(within[np.isfinite(difference)]))
        errors[fit] = TcpErrors(**figures, inside=inside)
    return errors


def _aligned(p: Array, measured: Array, fit: str) -> Array:
    """Return predicted points aligned with the measured ones, as ``fit`` says."""
    if fit == "none":
        return p
    complete = np.isfinite(measured).all(axis=1)
    if fit == "translation" or complete.sum() < 3:
        return p + np.nanmean(measured - p, axis=0)
    return align_points(p, p[complete], measured[complete])


_MAX_RESIDUAL_SHARE = 0.1  # share of the base model's lack of fit that located errors may leave

# Verdicts after which the search is not repeated without changes. A located error is absent: it may
# be what a spurious change left over.
_FULLY_EXPLAINED = ("adequate", "diffuse", "explained", "ambiguous")


@on_one_thread
def compute_outcome(request: Request, progress: Progress = no_progress) -> RunOutcome:
    """Run a request: identify, search for causes, test the residual, and judge.

    Raises:
        InputError: if the campaigns cannot be used.
        NumericsError: if the base model cannot be identified.
    """
    if not request.searches:
        return _identify_only(request, progress)
    progress(Step("identifying", "joint offsets and leg lengths"))
    machine = request.machine
    check_plausible(request.given, machine, request.frame)
    check_plausible(_validation_readings(request), machine)
    calibrated_names = [name for name, entry in machine.spec.parameters.items() if entry.sigma > 0]
    problem = assemble(
        request.given, machine, (*machine.catalogue.base, *calibrated_names),
        per_campaign=request.own, noise=request.noise, frame=request.frame,
    )  # fmt: skip
    base_fit = account_for_changes(solve(with_refuted_noise_enlarged(problem), method="nested"))
    check_drive_order(base_fit)
    findings = find_data_faults(base_fit, progress)
    changes = findings.changes
    outcome = _search(request, base_fit, findings, progress)
    if outcome.word not in _FULLY_EXPLAINED and any(
        _exceeds_readjustment(change, machine) for change in changes
    ):
        # The change may be spurious: a free-form error of similar effect may explain the readings,
        # so the search is repeated without changes.
        changes = ()
        findings = replace(findings, changes=(), posterior=None, ambiguous=frozenset())
        outcome = _search(request, base_fit, findings, progress)
    if outcome.word not in ("adequate", "diffuse"):
        check_levels(outcome.before)
    if outcome.word == "unexplained":
        refit = refit_with_residual_noise(outcome.before)
        outcome = replace(outcome, before=refit, after=refit)
    earlier_changes = [c.with_later_fit(outcome.after) for c in base_fit.changes]
    changed = (
        *(c for c in earlier_changes if c.is_reported),
        *(c.with_separate_fit(outcome.after) for c in changes),
    )
    change_notes = (Note(text, "earlier") for c in earlier_changes if (text := c.found_only_now))
    notes = [*change_notes, *findings.notes]
    clause = ambiguity_clause(machine.spec)
    if clause and base_fit.problem.has_earlier_calibration:
        notes.append(Note(
            f"the earlier calibration {clause}, so changes since then are uncertain; run "
            f"orthoglide check on the readings of both visits, with the machine file of the first",
            "earlier",
        ))  # fmt: skip
    progress(Step("verifying"))
    after = replace(outcome.after, verification=verify(outcome.after))
    outcome = _with_warnings(replace(outcome, changed=changed, after=after), *notes)
    progress(Step("judging"))
    return judge(outcome)


def _search(
    request: Request, base_fit: Estimate, findings: DataFindings, progress: Progress
) -> RunOutcome:
    """Search with faulty rows excluded and changed parameters free; return the active causes with
    the test for lack of fit and the verdict.
    """
    progress(Step("searching"))
    problem, faults, changes = base_fit.problem, findings.faults, findings.changes
    if faults:
        problem = without_faults(problem, faults)
    # A changed parameter is a cause only if its value after the change is still significant.
    # Without readings on legs, a change with several members cannot be assigned to one parameter,
    # so it is no cause.
    causes = [c for c in changes if c.is_cause and c.parameter not in base_fit.names]
    causes = [c for c in causes if problem.campaigns or not c.members[1:]]
    if changes:
        problem = with_changes_separate(problem, [c for c in changes if c not in causes])
        separate = (n for c in causes for n in c.campaign_parameters)
        problem = replace(problem, per_campaign=(*problem.per_campaign, *separate))
    changed_names = [c.parameter for c in causes]
    before = solve(problem, method="nested") if faults or changes else base_fit
    posterior = findings.posterior
    if posterior is None:
        posterior = full_posterior(before, changed_names, fault_keys=findings.ambiguous)
    progress(Step("testing"))
    sets = credible_sets(posterior, changed_names)
    fit_test = posterior_lack_of_fit(posterior, sets)
    sets, word = _reported_sets(posterior, sets, fit_test)
    return RunOutcome(
        **vars(sets), request=request, word=word, before=posterior.before,
        after=posterior.after, residual_test=fit_test, posterior=posterior,
        blunders=tuple(report_faults(base_fit, faults, request.given)),
        fit_with_faults=base_fit if faults else None,
    )  # fmt: skip


def _reported_sets(
    posterior: FullPosterior, sets: CredibleSets, fit_test: LackOfFit
) -> tuple[CredibleSets, Word]:
    """Return the verdict, and the credible sets without those that it does not support."""
    effects = sets.effects if posterior.converged else ()
    before, after = posterior.before.scores, posterior.after.scores
    explains_most = after.chi2 - after.dof < _MAX_RESIDUAL_SHARE * (before.chi2 - before.dof)
    # If an explanation is missing, the true error is not in the model, and located errors may only
    # imitate it.
    is_missing = _lacks_explanation(fit_test) and not explains_most
    sets = replace(sets, effects=effects, located=() if is_missing else sets.located)
    word = _verdict(sets, fit_test)
    # An unexplained residual needs further causes than one on a machine that is sound otherwise.
    alone = sets.alone if word in ("adequate", "diffuse") else ()
    least = 0.0 if word == "unexplained" else EVEN_PROBABILITY
    possible = tuple(one for one in sets.possible if one.probability > least)
    return replace(sets, alone=alone, possible=possible), word


def _exceeds_readjustment(change: Change, machine: Machine) -> bool:
    """Return whether a structural parameter changed by more than the widest prior of a change, ten
    tolerances, which no readjustment explains.
    """
    widest = SLAB_SCALES[-1] * machine.tolerance(change.parameter)
    structural = change.parameter.effect not in machine.catalogue.base
    return structural and abs(change.after - change.before) > widest


def _identify_only(request: Request, progress: Progress) -> RunOutcome:
    """Return the outcome of ``identify``, which searches for no causes."""
    progress(Step("identifying", f"from {sum(map(len, request.given))} readings"))
    estimate = identify(
        request.given, request.machine, request.free, own=request.own, priors=request.priors,
        noise=request.noise, method="reduction" if request.reduced else "auto", frame=request.frame,
    )  # fmt: skip
    fit_test = estimate_lack_of_fit(estimate)
    return RunOutcome(
        request=request, word=_verdict(CredibleSets(), fit_test), before=estimate, after=estimate,
        residual_test=fit_test, changed=estimate.changes,
    )  # fmt: skip


def _validation_readings(request: Request) -> tuple[Readings, ...]:
    """Return the readings and points held out, which are not fitted."""
    return (*request.holdout, *([] if request.tcp is None else [request.tcp]))


def judge(outcome: RunOutcome) -> RunOutcome:
    """Return an outcome with the scores of the readings and points held out, and with warnings if
    they contradict the stated errors or were fitted too.
    """
    request, machine = outcome.request, outcome.machine
    problem, after = outcome.before.problem, outcome.values
    before = problem.values(problem.last_factor_index, outcome.before.x)
    scores, errors, notes = None, None, list[str]()
    if held := request.holdout:
        scores = HoldOut(*(held_out_rms(v, machine, held, request.own) for v in (before, after)))
    if request.tcp is not None:
        stated_sigma = tcp_map(outcome.machine, request.tcp.points().command).sigma
        errors = tcp_errors(machine, request.tcp, before, after, stated_sigma)
        points = request.tcp.points()
        notes.append(points_contradiction(errors["translation"], stated_sigma, points))
    pairs = product(_validation_readings(request), request.given)
    share = max((shared_fraction(*pair) for pair in pairs), default=0.0)
    if share > 0.5:
        notes.append(
            f"{100 * share:.0f} % of the readings held out were also fitted, so they do not test "
            f"the result; hold out other readings"
        )
    judged = replace(outcome, hold_out=scores, tcp=errors)
    return _with_warnings(judged, *(Note(text, "holdout") for text in notes if text))


def _with_warnings(outcome: RunOutcome, *notes: Note) -> RunOutcome:
    warnings = (*outcome.after.warnings, *notes)
    return replace(outcome, after=replace(outcome.after, warnings=warnings))


def _lacks_explanation(fit_test: LackOfFit) -> bool:
    """Return whether an explanation is missing.

    One is missing if the residual is significant or was not tested. One is also missing if more
    probably than not the residual is explained only by a machine beyond all tolerances, or by more
    noise than the repeats show: both explain any residual.
    """
    return not fit_test.p_value >= SIGNIFICANT or fit_test.rare > EVEN_PROBABILITY


def _verdict(sets: CredibleSets, fit_test: LackOfFit) -> Word:
    """Return the verdict from the credible sets and from the test of the residual."""
    if not sets.effects and not sets.located:
        if fit_test.base_p_value >= SIGNIFICANT:
            return "adequate"
        return "diffuse" if fit_test.explained_within_tolerances else "unexplained"
    if _lacks_explanation(fit_test):
        return "partial"
    if any(c.others or c.data for c in sets.effects) or any(f.data for f in sets.located):
        return "ambiguous"
    return "located" if sets.located else "explained"
