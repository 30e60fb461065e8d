"""The closed loop: test the residual, find its causes, identify again, and judge."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from orthoglide.accuracy import tcp_map
from orthoglide.closing.judging import held_out_rms, points_contradiction, tcp_errors
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
from orthoglide.fit.plausible import check_plausible
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.observations import Readings
from orthoglide.observations.tables import shared_fraction
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import HoldOut, LackOfFit, Request, Word
from orthoglide.threads import on_one_thread

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
    notes = (*change_notes, *findings.notes, *_ambiguous_calibration_note(base_fit))
    progress(Step("verifying"))
    after = replace(outcome.after, verification=verify(outcome.after))
    outcome = _with_warnings(replace(outcome, changed=changed, after=after), *notes)
    progress(Step("judging"))
    return judge(outcome)


def _ambiguous_calibration_note(base_fit: Estimate) -> Iterator[Note]:
    """Yield a note if an earlier calibration left open which parameter was wrong."""
    clause = ambiguity_clause(base_fit.problem.machine.spec)
    if clause and base_fit.problem.has_earlier_calibration:
        yield Note(
            f"the earlier calibration {clause}, so changes since then are uncertain; run "
            f"orthoglide check on the readings of both visits, with the machine file of the first",
            "earlier",
        )


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
    # If an explanation is missing, the true error is not in the model, and located errors may only
    # imitate it.
    is_missing = _lacks_explanation(fit_test) and not _explains_most(posterior)
    sets = replace(sets, effects=effects, located=() if is_missing else sets.located)
    word = _verdict(sets, fit_test)
    # An unexplained residual needs further causes than one on a machine that is sound otherwise.
    alone = sets.alone if word in ("adequate", "diffuse") else ()
    least = 0.0 if word == "unexplained" else EVEN_PROBABILITY
    possible = tuple(one for one in sets.possible if one.probability > least)
    return replace(sets, alone=alone, possible=possible), word


def _explains_most(posterior: FullPosterior) -> bool:
    """Return whether the calibrated machine explains most of the base model's lack of fit."""
    before, after = posterior.before.scores, posterior.after.scores
    return after.chi2 - after.dof < _MAX_RESIDUAL_SHARE * (before.chi2 - before.dof)


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
    before, after = outcome.values_before, outcome.values
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
