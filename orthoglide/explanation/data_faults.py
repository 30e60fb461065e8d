"""The search for data faults, and the readings without them.

Data faults and causes of the machine compete in one search (`fault_columns`). Faults that are found
are corrected and the search is repeated, for at most six rounds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from orthoglide.errors import InputError, NumericsError
from orthoglide.explanation.alternative_readings import (
    alternative_readings,
    noisy_setups,
    setups_to_reinterpret,
)
from orthoglide.explanation.assumed_noise import (
    FittedState,
    check_scatter,
    find_scattered_setups,
    outlying_repeats,
    states_by_noise,
    with_noise_reestimated,
)
from orthoglide.explanation.base_fit import fit_nested
from orthoglide.explanation.change import Change
from orthoglide.explanation.change_search import likeliest_changes, with_changes_separate
from orthoglide.explanation.columns import ENOUGH_REPEATS
from orthoglide.explanation.compression import MOST_RANKED_READINGS
from orthoglide.explanation.corrections import with_faults_accounted_for
from orthoglide.explanation.credible_faults import CredibleFaults, credible_faults
from orthoglide.explanation.fault_columns import FaultKey
from orthoglide.explanation.faults import (
    MISREADING_KINDS,
    Fault,
    factors_and_rows,
    fault_message,
    lines_of,
    setups_of,
)
from orthoglide.explanation.full_posterior import (
    FullPosterior,
    full_posterior,
    posterior_at_base_fit,
    posterior_with_corrected_commands,
)
from orthoglide.explanation.ranked_readings import Misreading, likeliest_misreading
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.estimate import row_indices
from orthoglide.fit.noise import rms_by_unit
from orthoglide.notes import Note
from orthoglide.observations import Readings, source
from orthoglide.observations.touched_plates import disagreements
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.result import DataFault

_ROUNDS = 6
"""Largest number of rounds of search and correction: 12 changed no result."""

_MOST_SLIPS = 0.25
"""Share of the readings of one kind that may be slips. People misread one reading in fifty: if more
than a quarter disagrees with the others, the model is wrong or the commands are."""


@dataclass(frozen=True)
class DataFindings:
    """Data faults, and changes of the machine between visits."""

    faults: tuple[Fault, ...]  # data faults, in the order they were found
    changes: tuple[Change, ...]  # changed parameters with their values
    # converged posterior of the readings as given; absent if a fault was found, or is possible but
    # not ambiguous, if the machine changed, or if the noise was estimated again
    posterior: FullPosterior | None
    # faults that a cause of the machine may explain equally well
    ambiguous: frozenset[FaultKey] = frozenset()
    # on too many slips, on a search that did not settle, on readings too many to be ranked, and on
    # faults that are more probable than not, but not certain enough to be corrected
    notes: tuple[Note, ...] = ()


def find_data_faults(estimate: Estimate, progress: Progress = no_progress) -> DataFindings:
    """Find data faults and changes between visits, from the fit of the base model to all readings.

    Args:
        estimate: the fit.
        progress: called at each round of the search.

    Raises:
        InputError: if repeats scatter more than those of a working instrument can.
        NumericsError: if the loops do not close with the estimated parameters.
    """
    problem = estimate.problem
    faults_found = find_scattered_setups(problem)
    contradictions, unsettled = list[Note](), tuple[Note, ...]()
    misreading = Misreading(-np.inf)
    for _ in range(_ROUNDS):
        progress(Step("faults", f"beside {len(faults_found)} found" if faults_found else ""))
        corrected = _correct_faults(problem, faults_found)
        fit = estimate if corrected is problem else fit_nested(corrected)
        # Changes are searched again: a fault that is corrected now may have caused earlier ones.
        changes, base, first, unchanged = _beside_changes(fit, misreading.posterior)
        states = states_by_noise(base, first)
        base, posterior = states[0]
        misreading = _find_misreading(states, faults_found)
        # A misreading may explain the readings without changes.
        if changes and misreading.fault is None:
            evidence = first.evidence - _prior_log_odds_against(changes)
            unchanged = unchanged or posterior_at_base_fit(fit)
            misreading = _find_misreading([(fit, unchanged)], faults_found, evidence)
        found = _without_contradictory_lists(problem, credible_faults(posterior))
        converged = None
        if misreading.fault is None and found.ambiguous and not found.certain:
            # An alternative in the machine may fit only in the linearisation at the base fit. If it
            # is gone where the posterior has converged, data faults alone explain the readings.
            converged = full_posterior(base, fault_keys=found.ambiguous)
            found = found._replace(certain=credible_faults(converged).certain)
        faults = found.certain if misreading.fault is None else [misreading.fault]
        if contradictions:
            faults = _without_slips(faults)
        if not faults:
            break
        faults_found = _merge_faults(problem, faults_found, faults)
        if contradictions := contradictions or [*_contradictions(problem, faults_found)]:
            faults_found = _without_slips(faults_found)
    else:
        unsettled = (_unsettled_note(),)
    check_scatter(posterior.before.problem)
    if found.ambiguous:
        as_given = converged if base is estimate else None
    else:
        as_given = None if faults_found or changes else _converged_as_given(estimate, first)
    return DataFindings(
        tuple(faults_found),
        tuple(change.with_separate_fit(posterior.before) for change in changes),
        as_given,
        found.ambiguous,
        (*contradictions, *unsettled, *_fault_notes(posterior.before.problem, found)),
    )


def _beside_changes(
    fit: Estimate, earlier: FullPosterior | None
) -> tuple[list[Change], Estimate, FullPosterior, FullPosterior | None]:
    """Return the changes between visits, the fit with these parameters separate and its posterior;
    and the posterior of the fit without changes, if it was needed.

    The search of changes may take for a change what is noise larger than declared. Where no repeats
    show the noise, the evidence of the full model must be larger with the changes too.

    Args:
        fit: of all readings, with one value of each parameter.
        earlier: posterior that is used again if it is of the same fit.
    """
    if changes := likeliest_changes(fit):
        base = fit_nested(with_changes_separate(fit.problem, changes))
        posterior = posterior_with_corrected_commands(base, earlier)
        evidence = posterior.evidence - _prior_log_odds_against(changes)
        if fit.problem.repeat_count >= ENOUGH_REPEATS:
            return changes, base, posterior, None
        earlier = (earlier and earlier.of_equal_fit(fit)) or posterior_at_base_fit(fit)
        if evidence > earlier.evidence:
            return changes, base, posterior, earlier
    return [], fit, posterior_with_corrected_commands(fit, earlier), None


def _prior_log_odds_against(changes: Sequence[Change]) -> float:
    return sum(change.log_odds_against for change in changes)


def _without_contradictory_lists(problem: Problem, found: CredibleFaults) -> CredibleFaults:
    """Return the data faults without those in lists of touches that differ at common places.

    The difference of two lists is no fault of single touches. Faults of kind ``moved`` remain.
    """
    tables, spec = [factor.readings for factor in problem.factors], problem.machine.spec
    pairs = disagreements(spec.kinematics, tables, relative=spec.meshes_relative)
    names = {name for *pair, _ in pairs for name in pair}
    if not names:
        return found
    contradictory = np.concatenate([table.touching & (table.name in names) for table in tables])
    certain = [f for f in found.certain if f.kind == "moved" or not contradictory[f.rows].any()]
    probable = [pair for pair in found.probable if not contradictory[pair[0].rows].any()]
    return found._replace(certain=certain, probable=probable)


def _converged_as_given(estimate: Estimate, first: FullPosterior) -> FullPosterior | None:
    """Return the converged posterior of a fit from its first one; ``None`` if that has data faults
    to consider or other noise.
    """
    suspected = any(group.of_data for group in first.mixture.linear.groups)
    if suspected or not np.array_equal(first.before.problem.sigma, estimate.problem.sigma):
        return None
    return full_posterior(estimate, first_posterior=first)


def _without_slips(faults: Sequence[Fault]) -> list[Fault]:
    return [fault for fault in faults if fault.kind != "outlier"]


def _contradictions(problem: Problem, faults: Sequence[Fault]) -> Iterator[Note]:
    """Yield a note on each kind of reading of which too many would have to be slips."""
    slip = np.zeros(len(problem.measured), dtype=bool)
    for fault in faults:
        # A pillar that leans is one fault of several distances.
        slip[fault.rows[:1]] |= fault.kind == "outlier"
    for factor, rows in zip(problem.factors, problem.factor_rows, strict=True):
        for kind in dict.fromkeys(factor.readings.kind):
            of_kind = slip[rows][factor.readings.of_kind(kind) & factor.noise.weighted]
            if of_kind.sum() > _MOST_SLIPS * len(of_kind):
                yield Note(
                    f"{source(factor.readings)}: {of_kind.sum()} of {len(of_kind)} readings would "
                    f"have to be wrong, too many for slips, so none is discarded: compare the "
                    f"dimensions in the machine file, and the commands, with those that the "
                    f"readings were taken with",
                    "slip",
                )


def _unsettled_note() -> Note:
    """Return a note that the last round still found data faults."""
    return Note(
        f"the search for data faults stopped after round {_ROUNDS} before it had settled, so "
        f"faults and causes named here may be wrong; check the rows named, correct the file, then "
        f"close the loop again",
        "slip",
    )


def _fault_notes(problem: Problem, found: CredibleFaults) -> Iterator[Note]:
    """Yield a note on each fault that is probable, but not certain enough to be corrected, and one
    if the readings are too many to be compared with misreadings of them.
    """
    if problem.campaigns and len(problem.measured) > MOST_RANKED_READINGS:
        yield Note(
            f"wrong signs, units and labels, exchanged dials and shifted rows are searched for in "
            f"up to {MOST_RANKED_READINGS} readings, so not in these: to search for them, give a "
            f"part of the readings first",
            "slip",
        )
    for fault, probability in found.probable:
        certainty = f"probability {100 * probability:.0f} %, too low for a correction"
        text = fault_message(problem, fault)
        yield Note(
            f"possible data fault ({certainty}, so the rows stay in the fit): {text}", "slip"
        )


def _with_tolerance_priors(problem: Problem) -> Problem:
    """Return the problem with the tolerance as each prior's standard deviation.

    After an earlier calibration the priors stay as they are, because parameters that changed since
    then have wide ones.
    """
    return problem if problem.has_earlier_calibration else problem.with_prior_widths_reset()


def _find_misreading(
    states: Sequence[FittedState], faults: Sequence[Fault], other_evidence: float = -np.inf
) -> Misreading:
    """Return the misreading whose evidence clearly exceeds that of the readings as they stand, in
    setups in which no misreading was found before. Its fault is ``None`` if there is none.

    Args:
        states: fit and posterior for each assumed noise. Readings in a wrong unit may have the
            smaller noise, and the corrected readings the noise assumed first, so both are tried.
        faults: found so far.
        other_evidence: log evidence of another explanation of the readings.
    """
    other_evidence = max([other_evidence, *(posterior.evidence for _, posterior in states)])
    found = list[Misreading]()
    for base, posterior in states:
        rows = setups_to_reinterpret(base.problem, faults)
        # A generator: it does no work if the readings are too many to be ranked.
        alternatives: Iterator[Fault] = alternative_readings(base.problem, rows)
        # Noisy setups are tried only where there are dials: among a few distances or touches,
        # larger noise would hide faults of single readings.
        if rows:
            every = range(len(base.problem.setups))
            rows = setups_to_reinterpret(base.problem, faults, every)
            alternatives = chain(alternatives, noisy_setups(rows))
        found.append(likeliest_misreading(base, posterior, alternatives, rows, other_evidence))
    return best_of(found, lambda one: one.evidence, LOG_ODDS_MARGIN)


def _merge_faults(problem: Problem, faults: Sequence[Fault], new: Sequence[Fault]) -> list[Fault]:
    """Return the earlier and the new faults, without earlier ones that a new one may explain.

    These are faults in setups that a new misreading covers, except wrong commands; and drifts of an
    instrument that was moved, new ones too. They are searched for again. A wrong sign or label is
    extended to all rows of its setups in the original problem.
    """
    setup, merged = problem.setup_of_row, list[Fault]()
    misread_setups = [set(setups_of(problem, f)) for f in new if f.kind in MISREADING_KINDS]
    for fault in faults:
        setups = set(setups_of(problem, fault))
        if fault.kind == "command" or not any(setups <= misread for misread in misread_setups):
            merged.append(fault)
    for fault in new:
        rows = fault.rows
        if fault.kind == "sign" or fault.relabels:
            rows = np.flatnonzero(np.isin(setup, setup[rows]))
        merged.append(replace(fault, rows=rows))
    # Until its noise is known, a drift fits an instrument that was moved.
    moved_setups = [setups_of(problem, f) for f in new if f.kind == "moved"]
    return [f for f in merged if f.kind != "drifted" or setups_of(problem, f) not in moved_setups]


def _correct_faults(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """Return the problem with data faults corrected; the same object if no fault, outlying repeat
    or prior width is to be changed, on which the caller relies.

    Prior widths are reset to the tolerances unless there is an earlier calibration, so that faulty
    readings cannot pull parameters far off. Repeats that differ most do not count for the noise.
    """
    problem = with_faults_accounted_for(_with_tolerance_priors(problem), faults)
    outlying = outlying_repeats(problem)
    return with_noise_reestimated(problem, outlying) if faults or outlying.any() else problem


def report_faults(
    estimate: Estimate, faults: Sequence[Fault], given: Sequence[Readings]
) -> Iterator[DataFault]:
    """Yield the data faults as a result reports them, each corrected beside those before it.

    Args:
        estimate: the fit of the base model to all readings.
        faults: found in them.
        given: the readings of the request, of which the fit uses a part.
    """
    problem, fit, rms = estimate.problem, estimate, estimate.scores.rms
    tables = [factor.readings for factor in problem.factors]
    places = [row_indices(*pair) for pair in zip(tables, given, strict=True)]
    for k, fault in enumerate(faults, 1):
        cost_with, rms_with = fit.scores.cost, rms
        corrected = with_faults_accounted_for(problem, faults[:k])
        with suppress(NumericsError):  # it may not close until the other faults are corrected
            fit = fit_nested(corrected)
        kept = corrected.weighted | ~problem.weighted
        residual = np.where(kept, fit.residuals, np.nan)
        rms = rms_by_unit(residual, problem.angular).length if kept.any() else 0.0
        lines = dict.fromkeys(lines_of(problem, fault))  # each once
        files: dict[str, tuple[int, ...]] = {}
        for table, line in lines:
            name = source(tables[table])
            files[name] = (*files.get(name, ()), line)
        yield DataFault(
            kind=fault.kind,
            rows=tuple(line for _, line in lines),
            files=files,
            setups=tuple(problem.setups[s].name for s in setups_of(problem, fault)),
            message=fault_message(problem, fault),
            improvement=cost_with - fit.scores.cost,
            rms_with=rms_with,
            rms_without=rms,
            rows_in_request=tuple(
                (table, int(places[table][row]))
                for table, row in factors_and_rows(problem, fault.rows)
            ),
            excluded=fault.excluded,
        )


def without_faults(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """Return the problem with data faults corrected, and without the rows that no correction
    restores.

    Prior widths are reset to the tolerances unless there is an earlier calibration. Noise that came
    from repeats is estimated again from the remaining ones.

    Raises:
        InputError: if no row of a campaign remains.
    """
    corrected = with_faults_accounted_for(_with_tolerance_priors(problem), faults)
    kept, factors = corrected.weighted | ~problem.weighted, []
    for factor, part in zip(corrected.factors, problem.factor_rows, strict=True):
        if not kept[part].any():
            rows = np.arange(part.start, part.stop)
            fault = next(f for f in faults if np.isin(f.rows, rows).any())
            raise InputError(
                f"all {len(factor.readings)} rows of {factor.name} are faulty, so it cannot be "
                f"used; measure it again ({fault_message(problem, fault)})"
            )
        factors.append(factor.subset(kept[part]))
    return with_noise_reestimated(replace(corrected, factors=tuple(factors)))
