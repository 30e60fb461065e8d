"""Closing the loop: find what is left, trace it to a cause, add it, identify again, judge."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from orthoglide.accuracy import tcp_map
from orthoglide.closing.judging import hold_out, points_contradiction, tcp_errors
from orthoglide.closing.outcome import RunOutcome
from orthoglide.explanation import (
    CredibleSets,
    FullPosterior,
    check_levels,
    credible_sets,
    full_posterior,
    posterior_lack_of_fit,
)
from orthoglide.explanation.change import Change
from orthoglide.explanation.change_model import SLAB_WIDTHS
from orthoglide.explanation.changes import with_changes_separate
from orthoglide.explanation.credible_faults import EVEN_PROBABILITY
from orthoglide.explanation.data_faults import ReportedFault, find_data_faults, without_faults
from orthoglide.explanation.fault_columns import FaultKey
from orthoglide.explanation.identifying import identify
from orthoglide.explanation.recalibration import account_for_changes, ambiguity_clause
from orthoglide.explanation.repeats import with_refuted_noise_enlarged
from orthoglide.explanation.significance import SIGNIFICANT, LackOfFitTest, estimate_lack_of_fit
from orthoglide.fit import Estimate, assemble, refit_with_residual_noise, solve
from orthoglide.fit.crosscheck import verify
from orthoglide.fit.plausible import check_drive_order, check_plausible
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.observations.repetition import shared_fraction
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import Request, Word
from orthoglide.threads import on_one_thread

_MAX_RESIDUAL_SHARE = 0.1  # share of the lack of fit that a place which was found may leave

_FULLY_EXPLAINED = (
    "adequate",
    "diffuse",
    "explained",
    "ambiguous",
)  # nothing is left but what has a name


@on_one_thread
def compute_outcome(request: Request, progress: Progress = no_progress) -> RunOutcome:
    """Run a request: identify, search for causes, test the residual, and judge.

    Raises:
        InputError: where the campaigns cannot be used.
        NumericsError: where the base model cannot be identified.
    """
    if not request.searches:
        return _identify_only(request, progress)
    progress(Step("identifying", "joint offsets and leg lengths"))
    machine = request.machine
    judges = () if request.tcp is None else (request.tcp,)
    given = (*request.campaigns, *request.points)
    check_plausible(given, machine, request.frame)
    check_plausible((*request.holdout, *judges), machine)
    carried = [name for name, entry in machine.spec.parameters.items() if entry.sigma > 0]
    problem = assemble(
        given, machine, (*machine.catalogue.base, *carried),
        per_campaign=request.own, noise=request.noise, frame=request.frame,
    )  # fmt: skip
    problem = with_refuted_noise_enlarged(problem)
    read = account_for_changes(solve(problem, method="nested"))
    check_drive_order(read)
    progress(Step("faults"))
    faults = find_data_faults(read)
    blunders, changes = faults.data_faults, faults.changes
    known, found, left, word = _search(
        read, blunders, changes, progress, faults.posterior, faults.ambiguous
    )
    if word not in _FULLY_EXPLAINED and any(_exceeds_readjustment(c, machine) for c in changes):
        # What has no name takes any change that comes near.
        changes = ()
        known, found, left, word = _search(read, blunders, changes, progress)
    before = known.before
    if word not in ("adequate", "diffuse"):
        check_levels(known)
    if word == "unexplained":
        before = refit_with_residual_noise(before)
    closed = RunOutcome(
        request, word, before, before if word == "unexplained" else known.after,
        found.causes, found.located,
        found.candidate_scores, left, known, blunders,
        fit_with_faults=read if blunders else None,
        alone=found.single_causes if word in ("adequate", "diffuse") else (),
        possible=found.possible_causes if word == "unexplained" else (),
    )  # fmt: skip
    since = [c.now(closed.after) for c in read.changes]
    changed = (
        *(c for c in since if c.is_reported),
        *(c.with_separate_fit(closed.after) for c in changes),
    )
    notes = (Note(found_now, "earlier") for c in since if (found_now := c.found_only_now))
    told = (*closed.after.warnings, *notes, *faults.notes, *_ambiguous_calibration_note(read))
    progress(Step("verifying"))
    after = replace(closed.after, warnings=told, verification=verify(closed.after))
    progress(Step("judging"))
    return judge(replace(closed, changed=changed, after=after))


def _ambiguous_calibration_note(read: Estimate) -> Iterator[Note]:
    """Yield a note if an earlier calibration left open which parameter was wrong."""
    held = ambiguity_clause(read.problem.machine.spec)
    if held and read.problem.has_earlier_calibration:
        yield Note(
            f"the calibration before {held}: what changed since is told best by orthoglide check, "
            f"from the readings of both visits",
            "earlier",
        )


def _search(
    read: Estimate,
    blunders: Sequence[ReportedFault],
    changes: Sequence[Change],
    progress: Progress,
    look: FullPosterior | None = None,
    unsure: Collection[FaultKey] = (),
) -> tuple[FullPosterior, CredibleSets, LackOfFitTest, Word]:
    """Search with faulty rows excluded and changed parameters free; return the posterior, what is
    active, the lack of fit, and the verdict.
    """
    progress(Step("testing"))
    problem = without_faults(read.problem, blunders) if blunders else read.problem
    # What a change put right is no cause now; what is still wrong is named as one. Without dials it
    # is not known which one of several it was.
    causes = [
        c
        for c in changes
        if c.is_cause and c.parameter not in read.names and (problem.campaigns or not c.members[1:])
    ]
    if changes:
        problem = with_changes_separate(problem, [c for c in changes if c not in causes])
        problem = replace(
            problem,
            per_campaign=(
                *problem.per_campaign,
                *(n for c in causes for n in c.campaign_parameters),
            ),
        )
    named = [c.parameter for c in causes]
    before = solve(problem, method="nested") if blunders or changes else read
    known = full_posterior(before, named, look, unsure)
    progress(Step("allowing"))
    found = credible_sets(known, named)
    left = posterior_lack_of_fit(known, found)
    if not known.converged:
        found = replace(found, causes=())
    if _lacks_explanation(left) and not _explains_most(known):
        # A place is missing, and others may stand in for it.
        found = replace(found, located=())
    return known, found, left, _verdict(found, left)


def _explains_most(known: FullPosterior) -> bool:
    """Return whether the finding leaves little of the lack of fit of the base model."""
    before, after = known.before.scores, known.after.scores
    return after.chi2 - after.dof < _MAX_RESIDUAL_SHARE * (before.chi2 - before.dof)


def _exceeds_readjustment(change: Change, machine: Machine) -> bool:
    """Return whether a structural parameter changed by more than the widest change expected, which
    no readjustment explains.
    """
    by, most = (
        abs(change.after - change.before),
        SLAB_WIDTHS[-1] * machine.tolerance(change.parameter),
    )
    return change.parameter.effect not in machine.catalogue.base and by > most


def _identify_only(request: Request, progress: Progress) -> RunOutcome:
    """Return a closed loop to which no effect may be added."""
    count = sum(map(len, request.campaigns)) + sum(map(len, request.points))
    progress(Step("identifying", f"from {count} readings"))
    estimate = identify(
        [*request.campaigns, *request.points],
        request.machine,
        request.free,
        own=request.own,
        priors=request.priors,
        noise=request.noise,
        method="reduction" if request.reduced else "auto",
        frame=request.frame,
    )
    left = estimate_lack_of_fit(estimate)
    return RunOutcome(
        request, _verdict(CredibleSets((), (), ()), left), estimate, estimate, (), (), (), left,
        changed=estimate.changes,
    )  # fmt: skip


def judge(closed: RunOutcome) -> RunOutcome:
    """Judge a closed loop by what its request holds back; only the scores change."""
    request, machine = closed.request, closed.machine
    before, after = closed.values_before, closed.values
    scored = errors = None
    if request.holdout:
        scored = hold_out(before, after, machine, request.holdout, request.own)
    if request.tcp is not None:
        stated = tcp_map(closed.machine, request.tcp.points().command).sigma
        errors = tcp_errors(machine, request.tcp, before, after, stated)
        if text := points_contradiction(errors["translation"], stated, request.tcp.points()):
            closed = _with_warning(closed, Note(text, "holdout"))
    held = (*request.holdout, *([] if request.tcp is None else [request.tcp]))
    fitted = (*request.campaigns, *request.points)
    if any(shared_fraction(one, other) > 0.5 for one in held for other in fitted):
        text = "the readings held out are readings that were fitted: they judge nothing"
        closed = _with_warning(closed, Note(text, "holdout"))
    return replace(closed, hold_out=scored, tcp=errors)


def _with_warning(closed: RunOutcome, note: Note) -> RunOutcome:
    warnings = (*closed.after.warnings, note)
    return replace(closed, after=replace(closed.after, warnings=warnings))


def _lacks_explanation(left: LackOfFitTest) -> bool:
    """Return whether the list of explanations lacks one.

    The residual is significant, or was not tested; or it is likelier than not that only a machine
    beyond all its tolerances, or more noise than the repeats show, explains it, which would explain
    anything.
    """
    return not left.p_value >= SIGNIFICANT or left.rare > EVEN_PROBABILITY


def _verdict(found: CredibleSets, left: LackOfFitTest) -> Word:
    """Return the verdict from what was found and whether the residual is significant."""
    significant = _lacks_explanation(left)
    if not found.causes and not found.located:
        if left.base_p_value >= SIGNIFICANT:
            return "adequate"
        return "diffuse" if left.explained_within_tolerances else "unexplained"
    if significant:
        return "partial"
    several = any(c.others or c.data for c in found.causes)
    if several or any(one.data for one in found.located):
        return "ambiguous"
    return "located" if found.located else "explained"
