"""Data faults that were found, each with its rows, and the readings without them.

Data faults and causes of the machine compete in one search (`suspects`). Faults that are found are
corrected and the search is repeated, at most six times.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

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
from orthoglide.explanation.changes import likeliest_changes, with_changes_separate
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
"""Log odds by which another meaning must be likelier: what is expected of each kind is a guess."""


_OVERSTATED_NOISE = 0.25
"""Chi2 a degree of freedom from which noise was declared twice too large, or more."""


@dataclass(frozen=True)
class ReportedFault:
    """A fault of the data."""

    # outlier, knocked_stand, zeroed, moved, command, sign, label, exchanged_labels, shifted, unit,
    # turns, stuck or scatter
    kind: Kind
    # factor and row within it; of a knocked stand the rows after the knock, of dials set to zero
    # anew at each repeat those after the first
    rows: tuple[tuple[int, int], ...]
    setups: tuple[str, ...]  # names of the setups concerned
    message: str  # which file, which lines, what it looks like, what to do
    # decrease of the least cost (chi2 and priors) once it is corrected, earlier faults corrected
    improvement: float
    rms_with: float  # of the residuals with it, metres
    rms_without: float  # of the residuals without it, metres
    # of a wrong command the drives that it may be of, the likeliest first, and how much more each
    # was told than is written, metres
    commands: tuple[tuple[int, float], ...] = ()
    # the hypothesis, rows stacked over all campaigns
    fault: Fault | None = field(default=None, compare=False, repr=False)

    @property
    def excluded(self) -> bool:
        """Whether the result is fitted without its rows; else they have a datum of their own."""
        return self.kind not in DATUM_KINDS

    def lines(self, given: Sequence[Readings]) -> dict[str, tuple[int, ...]]:
        """Lines of the rows by file, or by campaign where there is none."""
        found: dict[str, tuple[int, ...]] = {}
        for k, row in self.rows:
            name = given[k].file or given[k].name
            found[name] = (*found.get(name, ()), int(given[k].line[row]))
        return {name: tuple(dict.fromkeys(lines)) for name, lines in found.items()}


@dataclass(frozen=True)
class Findings:
    """What is wrong with readings, and what changed between them."""

    data_faults: tuple[ReportedFault, ...]  # faults of the data, in the order they were found
    changes: tuple[Change, ...]  # parameters of the machine, values included
    # a first look at the readings; absent where a fault came near, or they were not looked at as
    # they stand
    posterior: FullPosterior | None
    # faults that the data may have, where a cause of the machine would explain the readings as well
    ambiguous: frozenset[FaultKey] = frozenset()
    # on faults that are more probable than not, but not certain enough to be corrected
    notes: tuple[Note, ...] = ()


def find_data_faults(read: Estimate) -> Findings:
    """Find faults of the data and changes between visits, from the fit of the base model to all
    readings.

    Raises:
        InputError: where repeats scatter as those of no such instrument do.
        NumericsError: where the machine that is found cannot be closed.
    """
    found = find_scattered_setups(read.problem)
    fit = (
        _fit_nested(_correct_faults(read.problem, found))
        if found
        else _fit_with_narrow_priors(read)
    )
    for _ in range(_ROUNDS):
        # Changes are searched anew: a fault that is corrected now may have caused the earlier ones.
        changed, cost = likeliest_changes(fit)
        base = _fit_nested(with_changes_separate(fit.problem, changed)) if changed else fit
        look = posterior_with_corrected_commands(base)
        misread = (
            _find_misreading(
                fit, posterior_with_corrected_commands(fit), found, look.evidence - cost
            )
            if changed
            else None
        )
        if misread is not None:
            found = _merge_faults(found, [_with_all_rows(read.problem, misread)])
            fit = _fit_nested(_correct_faults(read.problem, found))
            continue
        if look.chi2_per_dof < _OVERSTATED_NOISE:  # else a wrong unit could pass for the noise
            base = _fit_nested(with_smaller_noise(base.problem, _noise_square_ratios(look)))
            look = posterior_with_corrected_commands(base)
        misread = _find_misreading(base, look, found)
        faults = _certain_faults(base, look) if misread is None else [misread]
        if not faults:
            break
        found = _merge_faults(found, [_with_all_rows(read.problem, f) for f in faults])
        fit = _fit_nested(_correct_faults(read.problem, found))
    check_scatter(look.before.problem)
    measured = tuple(c.with_separate_fit(look.before) for c in changed)
    as_read = np.array_equal(look.before.problem.sigma, read.problem.sigma)
    whole = as_read and not (found or changed or look.linearised.suspects)
    maybe = ambiguous_faults(look)
    reusable = look if whole and not maybe else None
    notes = tuple(_probable_fault_notes(look))
    return Findings(_report_faults(read, found), measured, reusable, maybe, notes)


def _certain_faults(base: Estimate, look: FullPosterior) -> list[Fault]:
    """Return the data faults that are certain, from a base fit and its first posterior.

    An alternative in the machine may fit only as far as the readings are linear at the base fit. If
    it does not stand where the posterior has converged, the faults alone are left.
    """
    faults = certain_data_faults(look)
    if not faults and (rivals := ambiguous_faults(look)):
        faults = certain_data_faults(full_posterior(base, unsure=rivals))
    return faults


def _probable_fault_notes(look: FullPosterior) -> Iterator[Note]:
    """Yield a note on each fault that is probable, but not certain enough to be corrected."""
    for fault, probability in probable_faults(look):
        text = fault_message(look.before.problem, fault)
        yield Note(f"perhaps ({100 * probability:.0f} % likely; it is kept): {text}", "slip")


def _noise_square_ratios(look: FullPosterior) -> dict[str, float]:
    """Return the square of the noise that the best explanation leaves, over that assumed, by kind
    of reading: one instrument may be quiet beside another.
    """
    kinds = {kind for factor in look.before.problem.factors for kind in factor.readings.kind}
    chi2, dof = dict.fromkeys(kinds, 0.0), dict.fromkeys(kinds, 0.0)
    for one in noise_scales(look.after):
        chi2[one.setup.kind] += one.chi2
        dof[one.setup.kind] += one.dof
    return {kind: min(chi2[kind] / dof[kind], 1.0) if dof[kind] > 0 else 1.0 for kind in kinds}


def _fit_with_narrow_priors(read: Estimate) -> Estimate:
    """Return the fit with narrow priors, so that faulty readings cannot pull parameters far off.

    The noise is estimated without the repeats that differ most.
    """
    problem = _with_tolerance_priors(read.problem)
    if (far := outlying_repeats(problem)).any():
        problem = with_noise_reestimated(problem, far)
    return read if problem is read.problem else _fit_nested(problem)


def _with_tolerance_priors(problem: Problem) -> Problem:
    """Return the problem with the tolerance as each prior's standard deviation.

    With an earlier calibration the priors stay as wide as they are: what changed since may be
    anything.
    """
    return problem if problem.has_earlier_calibration else problem.with_prior_widths_reset()


def _fit_nested(problem: Problem) -> Estimate:
    return solve(problem, method="nested", widen=False)


def _find_misreading(
    base: Estimate, look: FullPosterior, found: Sequence[Fault], otherwise: float = -np.inf
) -> Fault | None:
    """Return the wrong sign, unit, label, shift or turn that explains readings clearly better;
    ``None`` if there is none.

    Args:
        base: fit to the readings as they stand.
        look: its posterior, which may have corrected commands that a misreading explains.
        found: faults that are known.
        otherwise: evidence for what explains the readings otherwise.
    """
    problem, tried = base.problem, list[tuple[float, Fault]]()
    for _, one in rank_alternative_readings(look, setups_to_reinterpret(problem, found)):
        try:
            other = posterior_at_base_fit(
                _fit_nested(with_misreading_corrected(problem, one.fault))
            )
        except NumericsError:
            continue
        if other.mixture.probability_rare < EVEN_PROBABILITY:  # more noise explains anything
            tried.append((other.evidence + one.log_odds, one.fault))
    if not tried:
        return None
    evidence, fault = best_of(tried, lambda one: one[0], LOG_ODDS_MARGIN)
    return fault if evidence > max(look.evidence, otherwise) + _MISREADING_MARGIN else None


def _with_all_rows(problem: Problem, fault: Fault) -> Fault:
    """The fault with its setups as the readings had them first."""
    setups = tuple(np.unique(problem.setup_of_row[fault.rows]).tolist())
    rows = fault.rows
    if fault.kind in ("sign", "label", "exchanged_labels"):
        rows = np.concatenate([rows_in_order(problem, s) for s in setups])
    return replace(fault, setups=setups, rows=rows)


def tool_fault_notes(estimate: Estimate) -> Iterator[Note]:
    """Yield a sentence for each reading of the tool that slipped and each instrument that was
    moved, in a fit that sets nothing aside.

    Raises:
        InputError: where repeats scatter as those of no such instrument do.
    """
    problem = estimate.problem
    if not problem.tool_factors:
        return
    check_scatter(problem)
    for fault in certain_data_faults(posterior_with_corrected_commands(estimate)):
        if fault.setups[0] not in problem.leg_setups:
            text = f"{fault_message(problem, fault)}; close-loop sets it aside"
            yield Note(text, "slip")


def _merge_faults(found: Sequence[Fault], new: Sequence[Fault]) -> list[Fault]:
    """Return all faults. One found on rows that a new misreading covers is dropped, to be searched
    again.
    """
    misread = [set(f.setups) for f in new if f.kind in MISREADING_KINDS]
    kept = [f for f in found if f.commands or not any(set(f.setups) <= s for s in misread)]
    return [*kept, *new]


def _correct_faults(problem: Problem, faults: Sequence[Fault]) -> Problem:
    """Return the problem with misread readings restored, shifted datums split and wrong commands
    corrected.

    Rows of other faults have no weight. Nor have those of wrong commands, which are corrected all
    the same: the side from which the next rows were reached depends on them.
    """
    for fault in faults:
        if fault.kind in MISREADING_KINDS:
            problem = with_misreading_corrected(problem, fault)
    faults = [f for f in faults if f.kind not in MISREADING_KINDS]
    factors = list(problem.factors)
    silent = np.zeros(len(problem.measured), dtype=bool)
    for fault in faults:
        k, _ = factors_and_rows(problem, fault.rows[:1])[0]
        part = problem.factor_rows[k]
        table = _corrected_table(factors[k].readings, fault, fault.rows - part.start)
        factors[k] = factors[k].with_table(table)
        silent[fault.rows] |= fault.excluded
    problem = without_weight(
        replace(_with_tolerance_priors(problem), factors=tuple(factors)), silent
    )
    return with_noise_reestimated(problem, outlying_repeats(problem))


def _report_faults(read: Estimate, faults: Sequence[Fault]) -> tuple[ReportedFault, ...]:
    """The faults with what each explains once those before it are set aside."""
    problem, n = read.problem, len(read.problem.measured)
    kept, shown = np.ones(n, dtype=bool), np.zeros((n, 0))
    cost, rms = _least_cost(read, kept, shown)
    blunders = []
    for fault in faults:
        before, with_it = cost, rms
        rows = np.isin(np.arange(n), fault.rows)
        free = datum_columns(problem, fault)
        if fault.kind == "moved":
            free = read.nuisance.columns * rows[:, None]
            free = free[:, free.any(axis=0)]
        shown = np.hstack([shown, free])
        if fault.excluded:
            kept = kept & ~rows
        cost, rms = _least_cost(read, kept, shown)
        blunders.append(
            ReportedFault(
                fault.kind,
                factors_and_rows(problem, fault.rows),
                tuple(problem.setups[s].name for s in fault.setups),
                fault_message(problem, fault),
                before - cost,
                with_it,
                rms,
                fault.commands,
                fault,
            )
        )
    return tuple(blunders)


def _least_cost(estimate: Estimate, kept: NDArray[np.bool_], steps: Array) -> tuple[float, float]:
    """Least cost of a linearised fit to some readings ``(n,)``, with steps free, and the root mean
    square that it leaves of lengths.
    """
    problem, nuisance, at = estimate.problem, estimate.nuisance, estimate.at
    if not kept.any():
        return 0.0, 0.0
    weighing = problem.weighing.subset(kept)
    columns = np.hstack([at.jacobian, nuisance.columns, steps])
    known = joint_prior_rows(problem, nuisance)
    known = np.hstack([known, np.zeros((len(known), steps.shape[1]))])
    rows = np.vstack([weighing.whiten(columns[kept]), known])
    rest = (problem.measured - at.value + at.jacobian @ at.x)[kept]
    aim = np.zeros(len(rows))
    aim[: len(rest)] = weighing.whiten(rest)
    _, target = problem.prior_rows
    aim[len(rest) :][: len(target)] = target
    scale = np.linalg.norm(rows, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    found = np.linalg.lstsq(rows / scale, aim, rcond=1e-10)[0] / scale
    left = aim - rows @ found
    rest = rest - columns[kept] @ found
    return float(left @ left), rms_by_unit(rest, problem.angular[kept]).length


def without_faults(problem: Problem, blunders: Sequence[ReportedFault]) -> Problem:
    """The problem without the faulty rows; a knocked setup becomes two, with a datum each.

    Noise that was taken from the repeats is taken from those that are left.

    Raises:
        InputError: where nothing is left of a campaign.
    """
    factors = list[Factor]()
    for k, factor in enumerate(problem.factors):
        campaign, kept = factor.readings, np.ones(len(factor.readings), dtype=bool)
        table = campaign
        for blunder in blunders:
            rows = np.array([row for c, row in blunder.rows if c == k], dtype=np.int64)
            if len(rows):
                table = _corrected_table(table, blunder, rows)
                kept[rows] &= not blunder.excluded
        if not kept.any():
            fault = next(b for b in blunders if any(c == k for c, _ in b.rows))
            raise InputError(
                f"nothing is left of {campaign.name} once its faulty rows are set aside: measure "
                f"it again ({fault.message})"
            )
        factors.append(factor.with_table(table).subset(kept))
    problem = replace(problem.with_prior_widths_reset(), factors=tuple(factors))
    return with_noise_reestimated(problem)


def _corrected_table(table: Readings, fault: Fault | ReportedFault, rows: Rows) -> Readings:
    """A table with the command, or the datums, of some of its rows put right."""
    if fault.commands:  # the side that the neighbours of these rows were reached from depends on it
        return with_command_corrected(table, rows, *fault.commands[0])
    if not fault.excluded:
        for part in split_by_datum(fault.kind, rows, table.setup, table.repeat):
            table = _split_setup(table, part)
    return table


def _split_setup(campaign: Readings, rows: Rows) -> Readings:
    """Rows of one setup as a setup of their own; all that it has are one already."""
    number = int(campaign.setup[rows[0]])
    if len(rows) == np.sum(campaign.setup == number):
        return campaign
    old = campaign.setups[number]
    taken = {s.name for s in campaign.setups}
    name = f"{old.name}-from-line-{int(campaign.line[rows].min())}"
    while name in taken:
        name += "-again"
    setup = campaign.setup.copy()
    # The rest was split off by a later knock.
    setup[rows[setup[rows] == setup[rows[0]]]] = len(campaign.setups)
    return replace(campaign, setups=(*campaign.setups, replace(old, name=name)), setup=setup)
