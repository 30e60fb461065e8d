"""The closed loop: identify, find causes, test the residual, and give a verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orthoglide.closing.outcome import RunOutcome
from orthoglide.closing.validation import validate, validation_readings
from orthoglide.explanation import (
    CredibleSets,
    FullPosterior,
    check_levels,
    credible_sets,
    full_posterior,
    posterior_lack_of_fit,
)
from orthoglide.explanation.assumed_noise import with_refuted_noise_enlarged
from orthoglide.explanation.causes import fitted_beyond_tolerance, probable_places, smallest_count
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
from orthoglide.explanation.recalibration import account_for_changes, doubt_of_earlier
from orthoglide.fit import Estimate, assemble, refit_with_residual_noise, solve
from orthoglide.fit.crosscheck import verify
from orthoglide.fit.plausible import check_plausible
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.ordering import ranked
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import LackOfFit, Request, Word
from orthoglide.threads import on_one_thread

_MAX_RESIDUAL_SHARE = 0.1  # share of the base model's lack of fit that located errors may leave

# Verdicts after which the search is not repeated without changes. `located` is not in this list,
# because a located error may be the residual of a spurious change.
_FULLY_EXPLAINED = ("adequate", "diffuse", "explained", "ambiguous")


@on_one_thread
def compute_outcome(request: Request, progress: Progress = no_progress) -> RunOutcome:
    """Run a request: identify, search for causes, test the residual, and score the result on
    readings and points held out.

    Raises:
        InputError: if the campaigns cannot be used.
        NumericsError: if the base model cannot be identified.
    """
    if not request.searches:
        return _identify_only(request, progress)
    progress(Step("identifying", "joint offsets and leg lengths"))
    machine = request.machine
    check_plausible(request.given, machine, request.frame)
    check_plausible(validation_readings(request), machine)
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
    if doubt := doubt_of_earlier(base_fit.problem):
        notes.append(Note(
            f"the earlier calibration {doubt}; run orthoglide check on the readings of both "
            f"visits, with the machine file of the first",
            "earlier",
        ))  # fmt: skip
    progress(Step("verifying"))
    after = replace(outcome.after, verification=verify(outcome.after))
    outcome = replace(outcome, changed=changed, after=after).with_warnings(*notes)
    progress(Step("judging"))
    return validate(outcome)


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
    # A single cause on an otherwise sound machine (`alone`) cannot explain a residual that the
    # verdict calls unexplained, so it is reported only after the verdicts adequate and diffuse.
    alone = sets.alone if word in ("adequate", "diffuse") else ()
    places = [] if sets.effects or sets.located else probable_places(posterior, EVEN_PROBABILITY)
    possible = tuple(ranked((*places, *sets.possible), lambda one: one.probability))
    if word != "unexplained":  # the fewest that are together more probable than not
        odds = np.array([one.probability for one in possible])
        possible = possible[: smallest_count(odds, EVEN_PROBABILITY)]
        possible = possible if odds.sum() > EVEN_PROBABILITY else ()
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
    fit_test, sets = estimate_lack_of_fit(estimate), CredibleSets()
    if (word := _verdict(sets, fit_test)) == "adequate":  # parts beyond tolerance are not adequate
        sets = CredibleSets(effects=fitted_beyond_tolerance(estimate))
        word = _verdict(sets, fit_test)
    return RunOutcome(
        **vars(sets), request=request, word=word, before=estimate, after=estimate,
        residual_test=fit_test, changed=estimate.changes,
    )  # fmt: skip


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
