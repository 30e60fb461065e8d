"""The search for data faults, and the readings without them.

Data faults and causes of the machine compete in one search (`fault_columns`). Faults that are found
are corrected and the search is repeated, at most six times.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError, NumericsError
from orthoglide.explanation.alternative_readings import (
    MISREADING_KINDS,
    setups_to_reinterpret,
    with_misreading_corrected,
    with_noise_reestimated,
    without_weight,
)
from orthoglide.explanation.change import Change
from orthoglide.explanation.change_search import likeliest_changes, with_changes_separate
from orthoglide.explanation.credible_faults import (
    EVEN_PROBABILITY,
    ambiguous_faults,
    certain_data_faults,
    probable_faults,
)
from orthoglide.explanation.fault_columns import FaultKey, with_command_corrected
from orthoglide.explanation.faults import (
    DATUM_KINDS,
    Fault,
    Kind,
    Rows,
    datum_columns,
    factors_and_rows,
    fault_message,
    rows_in_order,
    split_by_datum,
)
from orthoglide.explanation.full_posterior import (
    FullPosterior,
    full_posterior,
    posterior_at_base_fit,
    posterior_with_corrected_commands,
)
from orthoglide.explanation.ranked_readings import rank_alternative_readings
from orthoglide.explanation.repeats import (
    check_scatter,
    find_scattered_setups,
    outlying_repeats,
    with_smaller_noise,
)
from orthoglide.fit import Estimate, Factor, Problem, solve
from orthoglide.fit.least_squares import joint_prior_rows
from orthoglide.fit.noise_notes import noise_scales
from orthoglide.fit.scores import rms_by_unit
from orthoglide.geometry import Array
from orthoglide.notes import Note
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of

_ROUNDS = 6
"""Largest number of rounds of search and correction."""

_MISREADING_MARGIN = 3.0
"""Log odds by which a misreading must be likelier: its prior probability is a guess."""

_OVERSTATED_NOISE = 0.25
"""Chi2 per degree of freedom below which the declared noise is at least twice too large."""


@dataclass(frozen=True)
class ReportedFault:
    """A data fault with its message and its influence on the fit."""

    kind: Kind
    # factor and row within it; for a knocked stand the rows after the knock, for dials set to zero
    # anew at each repeat those after the first
    rows: tuple[tuple[int, int], ...]
    setups: tuple[str, ...]  # names of the setups concerned
    message: str  # which file, which lines, what it looks like, what to do
    # decrease of the least cost (chi2 and priors) by its correction, earlier faults being corrected
    improvement: float
    rms_with: float  # of the residuals with it, metres
    rms_without: float  # of the residuals without it, metres
    commands: tuple[tuple[int, float], ...] = ()  # as in `Fault`

    @property
    def excluded(self) -> bool:
        """True if the rows are not fitted; otherwise they are fitted with a separate datum."""
        return self.kind not in DATUM_KINDS

    def lines(self, tables: Sequence[Readings]) -> dict[str, tuple[int, ...]]:
        """Return the lines of the rows by file, or by campaign if it was not read from a file."""
        lines: dict[str, dict[int, None]] = {}
        for k, row in self.rows:
            name = tables[k].file or tables[k].name
            lines.setdefault(name, {})[int(tables[k].line[row])] = None
        return {name: tuple(numbers) for name, numbers in lines.items()}


@dataclass(frozen=True)
class DataFindings:
    """Data faults, and changes of the machine between visits."""

    data_faults: tuple[ReportedFault, ...]  # in the order they were found
    changes: tuple[Change, ...]  # changed parameters with their values
    # posterior of the readings as they stand; absent if faults are possible or anything was changed
    posterior: FullPosterior | None
    # faults that a cause of the machine may explain equally well
    ambiguous: frozenset[FaultKey] = frozenset()
    # on faults that are more probable than not, but not certain enough to be corrected
    notes: tuple[Note, ...] = ()


def find_data_faults(estimate: Estimate) -> DataFindings:
    """Find data faults and changes between visits, from the fit of the base model to all readings.

    Raises:
        InputError: if repeats scatter more than those of any such instrument.
        NumericsError: if the machine that is found cannot be closed.
    """
    problem = estimate.problem
    faults_found = find_scattered_setups(problem)
    if faults_found:
        fit = _fit_nested(_correct_faults(problem, faults_found))
    else:
        fit = _fit_with_narrow_priors(estimate)
    for _ in range(_ROUNDS):
        # Changes are searched again: a fault that is corrected now may have caused earlier ones.
        changes, cost = likeliest_changes(fit)
        base, misreading = fit, None
        posterior = posterior_with_corrected_commands(fit)
        if changes:
            posterior_without_changes = posterior
            base = _fit_nested(with_changes_separate(fit.problem, changes))
            posterior = posterior_with_corrected_commands(base)
            evidence = posterior.evidence - cost
            misreading = _find_misreading(fit, posterior_without_changes, faults_found, evidence)
        if misreading is None:
            if posterior.chi2_per_dof < _OVERSTATED_NOISE:  # a wrong unit could pass for the noise
                ratios = _noise_square_ratios(posterior)
                base = _fit_nested(with_smaller_noise(base.problem, ratios))
                posterior = posterior_with_corrected_commands(base)
            misreading = _find_misreading(base, posterior, faults_found)
        faults = _certain_faults(base, posterior) if misreading is None else [misreading]
        if not faults:
            break
        faults_found = _merge_faults(faults_found, [_with_all_rows(problem, f) for f in faults])
        fit = _fit_nested(_correct_faults(problem, faults_found))
    check_scatter(posterior.before.problem)
    ambiguous = ambiguous_faults(posterior)
    noise_unchanged = np.array_equal(posterior.before.problem.sigma, problem.sigma)
    altered = faults_found or changes or ambiguous or posterior.linearised.suspects
    return DataFindings(
        _report_faults(estimate, faults_found),
        tuple(change.with_separate_fit(posterior.before) for change in changes),
        posterior if noise_unchanged and not altered else None,
        ambiguous,
        tuple(_probable_fault_notes(posterior)),
    )


def _certain_faults(base: Estimate, posterior: FullPosterior) -> list[Fault]:
    """Return the data faults that are certain, from a base fit and its first posterior.

    An alternative in the machine may fit only in the linearisation at the base fit. If it is gone
    where the posterior has converged, data faults alone explain the readings.
    """
    faults = certain_data_faults(posterior)
    if not faults and (rivals := ambiguous_faults(posterior)):
        faults = certain_data_faults(full_posterior(base, fault_keys=rivals))
    return faults


def _probable_fault_notes(posterior: FullPosterior) -> Iterator[Note]:
    """Yield a note on each fault that is probable, but not certain enough to be corrected."""
    for fault, probability in probable_faults(posterior):
        certainty = f"probability {100 * probability:.0f} %, too low for a correction"
        text = fault_message(posterior.before.problem, fault)
        yield Note(
            f"possible data fault ({certainty}, so the rows stay in the fit): {text}", "slip"
        )


def _noise_square_ratios(posterior: FullPosterior) -> dict[str, float]:
    """Return the ratio of the squared noise of the best explanation to that assumed, by kind of
    reading, because the noise of one instrument alone may be overstated.
    """
    kinds = {kind for factor in posterior.before.problem.factors for kind in factor.readings.kind}
    chi2, dof = dict.fromkeys(kinds, 0.0), dict.fromkeys(kinds, 0.0)
    for one in noise_scales(posterior.after):
        chi2[one.setup.kind] += one.chi2
        dof[one.setup.kind] += one.dof
    return {kind: min(chi2[kind] / dof[kind], 1.0) if dof[kind] > 0 else 1.0 for kind in kinds}


def _fit_with_narrow_priors(estimate: Estimate) -> Estimate:
    """Return the fit with narrow priors, so that faulty readings cannot pull parameters far off,
    and with the noise estimated without the repeats that differ most.
    """
    problem = _with_tolerance_priors(estimate.problem)
    if (outlying := outlying_repeats(problem)).any():
        problem = with_noise_reestimated(problem, outlying)
    return estimate if problem is estimate.problem else _fit_nested(problem)


def _with_tolerance_priors(problem: Problem) -> Problem:
    """Return the problem with the tolerance as each prior's standard deviation.

    After an earlier calibration the priors stay as they are, because parameters that changed since
    then have wide ones.
    """
    return problem if problem.has_earlier_calibration else problem.with_prior_widths_reset()


def _fit_nested(problem: Problem) -> Estimate:
    return solve(problem, method="nested", widen=False)


def _find_misreading(
    base: Estimate,
    posterior: FullPosterior,
    faults: Sequence[Fault],
    other_evidence: float = -np.inf,
) -> Fault | None:
    """Return the misreading that explains the readings clearly better; ``None`` if there is none.

    Args:
        base: fit to the readings as they stand.
        posterior: its posterior, which may have corrected commands that a misreading explains.
        faults: data faults found so far.
        other_evidence: log evidence of another explanation of the readings.
    """
    problem, candidates = base.problem, list[tuple[float, Fault]]()
    rows_by_setup = setups_to_reinterpret(problem, faults)
    for _, alternative in rank_alternative_readings(posterior, rows_by_setup):
        try:
            corrected = with_misreading_corrected(problem, alternative.fault)
            other = posterior_at_base_fit(_fit_nested(corrected))
        except NumericsError:
            continue
        if other.mixture.probability_rare < EVEN_PROBABILITY:  # more noise explains anything
            candidates.append((other.evidence + alternative.log_odds, alternative.fault))
    if not candidates:
        return None
    evidence, fault = best_of(candidates, lambda one: one[0], LOG_ODDS_MARGIN)
    threshold = max(posterior.evidence, other_evidence) + _MISREADING_MARGIN
    return fault if evidence > threshold else None


def _with_all_rows(problem: Problem, fault: Fault) -> Fault:
    """Return the fault with its setups numbered as in the original problem. A wrong sign or label
    is extended to all rows of its setups.
    """
    setups = tuple(np.unique(problem.setup_of_row[fault.rows]).tolist())
    rows = fault.rows
    if fault.kind in ("sign", "label", "exchanged_labels"):
        rows = np.concatenate([rows_in_order(problem, s) for s in setups])
    return replace(fault, setups=setups, rows=rows)


def _merge_faults(faults: Sequence[Fault], new: Sequence[Fault]) -> list[Fault]:
    """Return all faults but those in setups that a new misreading covers, to search them again."""
    misread_setups = [set(f.setups) for f in new if f.kind in MISREADING_KINDS]
    kept = [f for f in faults if f.commands or not any(set(f.setups) <= s for s in misread_setups)]
    return [*kept, *new]


def _correct_faults(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """Return the problem with misreadings and wrong commands corrected, shifted datums split.

    Rows of other faults get zero weight. So do those of wrong commands, which are corrected
    nevertheless, because the approach of the next rows depends on them. Prior widths are reset to
    the tolerances unless there is an earlier calibration.
    """
    for fault in faults:
        if fault.kind in MISREADING_KINDS:
            problem = with_misreading_corrected(problem, fault)
    factors = list(problem.factors)
    zero_weight = np.zeros(len(problem.measured), dtype=bool)
    for fault in (f for f in faults if f.kind not in MISREADING_KINDS):
        k, _ = factors_and_rows(problem, fault.rows[:1])[0]
        rows = fault.rows - problem.factor_rows[k].start
        factors[k] = factors[k].with_table(_corrected_table(factors[k].readings, fault, rows))
        zero_weight[fault.rows] |= fault.excluded
    problem = replace(_with_tolerance_priors(problem), factors=tuple(factors))
    problem = without_weight(problem, zero_weight)
    return with_noise_reestimated(problem, outlying_repeats(problem))


def _report_faults(estimate: Estimate, faults: Sequence[Fault]) -> tuple[ReportedFault, ...]:
    """Return the faults with the decrease of the cost as each is corrected in turn."""
    problem, n = estimate.problem, len(estimate.problem.measured)
    kept, columns = np.ones(n, dtype=bool), np.zeros((n, 0))
    cost, rms = _least_cost(estimate, kept, columns)
    reported = []
    for fault in faults:
        cost_with, rms_with = cost, rms
        rows = np.isin(np.arange(n), fault.rows)
        datums = datum_columns(problem, fault)
        if fault.kind == "moved":
            datums = estimate.nuisance.columns * rows[:, None]
            datums = datums[:, datums.any(axis=0)]
        columns = np.hstack([columns, datums])
        kept = kept & ~(rows & fault.excluded)
        cost, rms = _least_cost(estimate, kept, columns)
        reported.append(
            ReportedFault(
                fault.kind, factors_and_rows(problem, fault.rows),
                tuple(problem.setups[s].name for s in fault.setups), fault_message(problem, fault),
                cost_with - cost, rms_with, rms, fault.commands,
            )
        )  # fmt: skip
    return tuple(reported)


def _least_cost(estimate: Estimate, kept: NDArray[np.bool_], datums: Array) -> tuple[float, float]:
    """Return the least cost of a linearised fit, and the rms of its residuals of lengths, metres.

    Args:
        estimate: point of linearisation.
        kept: readings to fit ``(n,)``.
        datums: columns of further free datums ``(n, k)``.
    """
    if not kept.any():
        return 0.0, 0.0
    problem, nuisance, linearised = estimate.problem, estimate.nuisance, estimate.at
    weighing = problem.weighing.subset(kept)
    columns = np.hstack([linearised.jacobian, nuisance.columns, datums])
    prior = np.pad(joint_prior_rows(problem, nuisance), ((0, 0), (0, datums.shape[1])))
    rows = np.vstack([weighing.whiten(columns[kept]), prior])
    residual = (problem.measured - linearised.value + linearised.jacobian @ linearised.x)[kept]
    _, prior_target = problem.prior_rows
    target = np.concatenate([weighing.whiten(residual), prior_target])
    target = np.pad(target, (0, len(rows) - len(target)))
    scale = np.linalg.norm(rows, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    solution = np.linalg.lstsq(rows / scale, target, rcond=1e-10)[0] / scale
    whitened = target - rows @ solution
    residual = residual - columns[kept] @ solution
    return float(whitened @ whitened), rms_by_unit(residual, problem.angular[kept]).length


def without_faults(problem: Problem, faults: Sequence[ReportedFault]) -> Problem:
    """Return the problem with faulty rows removed, wrong commands corrected, and knocked, re-zeroed
    or moved setups split by datum.

    Prior widths are reset to the tolerances unless there is an earlier calibration. Noise that came
    from repeats is estimated again from the remaining ones.

    Raises:
        InputError: if no row of a campaign remains.
    """
    factors = list[Factor]()
    for k, factor in enumerate(problem.factors):
        table, kept = factor.readings, np.ones(len(factor.readings), dtype=bool)
        for fault in faults:
            rows = np.array([row for c, row in fault.rows if c == k], dtype=np.int64)
            if len(rows):
                table = _corrected_table(table, fault, rows)
                kept[rows] &= not fault.excluded
        if not kept.any():
            fault = next(f for f in faults if any(c == k for c, _ in f.rows))
            raise InputError(
                f"all {len(kept)} rows of {table.name} are faulty, so it cannot be used; measure "
                f"it again ({fault.message})"
            )
        factors.append(factor.with_table(table).subset(kept))
    problem = replace(_with_tolerance_priors(problem), factors=tuple(factors))
    return with_noise_reestimated(problem)


def _corrected_table(table: Readings, fault: Fault | ReportedFault, rows: Rows) -> Readings:
    """Return a table with the command, or the datums, of some rows corrected."""
    if fault.commands:  # the approach of the next rows depends on it
        return with_command_corrected(table, rows, *fault.commands[0])
    if not fault.excluded:
        for part in split_by_datum(fault.kind, rows, table.setup, table.repeat):
            table = _split_setup(table, part)
    return table


def _split_setup(campaign: Readings, rows: Rows) -> Readings:
    """Return the table with rows of a setup as a separate one, unless they are all its rows."""
    number = campaign.setup[rows[0]]
    if len(rows) == np.sum(campaign.setup == number):
        return campaign
    old = campaign.setups[number]
    names = {s.name for s in campaign.setups}
    name = f"{old.name}-from-line-{int(campaign.line[rows].min())}"
    while name in names:
        name += "-again"
    setup = campaign.setup.copy()
    # A later knock may have split off some of the rows before.
    setup[rows[setup[rows] == number]] = len(campaign.setups)
    return replace(campaign, setups=(*campaign.setups, replace(old, name=name)), setup=setup)
