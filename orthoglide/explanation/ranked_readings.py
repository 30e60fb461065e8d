"""The likeliest alternative readings, each compared by one factorisation of the full model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from orthoglide.errors import InputError, NumericsError
from orthoglide.explanation.alternative_readings import (
    NOISE_RATIOS,
    RowsBySetup,
    alternative_readings,
    level_readings,
    setups_to_reinterpret,
    turn_alternatives,
)
from orthoglide.explanation.base_fit import fit_nested
from orthoglide.explanation.columns import LinearisedModel
from orthoglide.explanation.compression import MOST_RANKED_READINGS
from orthoglide.explanation.corrections import corrected_readings, with_faults_corrected
from orthoglide.explanation.credible_faults import EVEN_PROBABILITY
from orthoglide.explanation.faults import Fault, Rows, factors_and_rows, setups_of, weighted_rows
from orthoglide.explanation.full_likelihood import (
    WIDEST_DATUM,
    Deletion,
    FullLikelihood,
    Prediction,
    Scales,
    WhitenedRows,
    in_standard_deviations,
)
from orthoglide.explanation.full_posterior import FullPosterior, posterior_at_base_fit
from orthoglide.explanation.linear_model import TWENTY_TO_ONE
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.least_squares import linearise
from orthoglide.fit.plausible import exchanged_drives, sigma_scale_within
from orthoglide.geometry import Array
from orthoglide.observations import source
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of, descending, largest

_PER_SELECTION = 3
"""Alternatives of each selection of backgrounds that are searched in full: 6 changed no result."""

RANKING_BACKGROUNDS: Sequence[Scales] = ((0.1, 0.1), (0.01, 0.003), (1.0, 0.1), (1.0, 3.0))
"""Backgrounds under which misreadings of dials are ranked: a usual machine, a sound one, one off by
all its tolerances, and one with free-form errors everywhere."""


class Misreading(NamedTuple):
    """The likeliest misreading, if there is one."""

    # log evidence of the readings with the misreading, its prior odds included; without a fault,
    # the log evidence that a misreading had to exceed
    evidence: float
    fault: Fault | None = None
    posterior: FullPosterior | None = None  # of the readings with the misreading corrected


def likeliest_misreading(
    base: Estimate,
    posterior: FullPosterior,
    alternatives: Iterable[Fault],
    rows_by_setup: RowsBySetup,
    other_evidence: float = -np.inf,
    background_scales: Sequence[Scales] = RANKING_BACKGROUNDS,
) -> Misreading:
    """Return the misreading, or the noisy setup, whose evidence exceeds that of the readings as
    they stand by `TWENTY_TO_ONE`.

    Args:
        base: fit to the readings as they stand.
        posterior: its posterior, which may take for wrong commands what is a misreading.
        alternatives: to be compared.
        rows_by_setup: rows of their setups, in the order they were taken.
        other_evidence: log evidence of another explanation of the readings.
        background_scales: under which alternatives are ranked; the first also beside the groups
            that are active in the readings as they stand.
    """
    # By a clear margin, as the prior probability of a misreading is a guess.
    best = Misreading(max(posterior.evidence, other_evidence) + TWENTY_TO_ONE)
    least = max(other_evidence - posterior.evidence, 0.0)
    for log_odds, alternative in _rank(
        posterior, alternatives, rows_by_setup, background_scales, least
    ):
        # A search of the corrected readings seldom raises the odds: it finds more to explain in the
        # readings as they stand. So alternatives that are far behind are not searched, nor those
        # that would not win even if the corrected readings fitted as well as noise allows.
        likely = posterior.evidence + log_odds + TWENTY_TO_ONE
        limit = _evidence_limit(posterior, alternative) + alternative.log_odds
        if min(likely, limit) < best.evidence:
            continue
        try:
            corrected = with_faults_corrected(base.problem, [alternative])
            other = posterior_at_base_fit(fit_nested(corrected))
        except NumericsError:
            continue
        # Larger noise, or a background beyond all tolerances, explains any readings.
        if other.mixture.probability_rare < EVEN_PROBABILITY:
            found = Misreading(other.evidence + alternative.log_odds, alternative, other)
            best = best_of((best, found), lambda one: one.evidence, LOG_ODDS_MARGIN)
    return best


def _evidence_limit(posterior: FullPosterior, alternative: Fault) -> float:
    """Return a log evidence that corrected readings seldom exceed: that of a model without causes
    and background.

    Its chi2 is the smaller of two: the expected one less three standard deviations, as the noise is
    an estimate too, and that of the best explanation of the readings as they stand.
    """
    mixture, model = posterior.mixture, posterior.linearised
    remaining = mixture.chi2_with_remainder + model.unexplainable_chi2
    _, lost = corrected_readings(model.problem, alternative)
    count = np.sum(model.problem.weighted) - len(lost)
    dof = max(float(count - model.nuisance.unconstrained_count), 0.0)
    chi2 = min(max(dof - 3 * np.sqrt(2 * dof), 0.0), remaining) - model.unexplainable_chi2
    log_weight = max(scale.basis.largest_log_z for scale in mixture.scales) - chi2 / 2
    return float(posterior.evidence + log_weight - mixture.log_weight(mixture.best))


def check_drive_order(estimate: Estimate) -> None:
    """Refuse campaigns if the full model, too, prefers exchanged commands of two drives: both to
    the readings as they stand and to exchanged labels of two dials, which are a fault of the data.

    Raises:
        InputError: naming the files, and the drives.
    """
    suspected = exchanged_drives(estimate)
    if suspected is None:
        return
    problem, tied = estimate.problem, suspected.tied
    alternatives = alternative_readings(problem, setups_to_reinterpret(problem, []))
    exchanges = [fault for fault in alternatives if fault.kind == "exchanged_labels"]
    corrected = (with_faults_corrected(problem, [fault]) for fault in exchanges)
    others = [_evidence(p) for p in corrected if sigma_scale_within(p, tied) < tied]
    threshold = posterior_at_base_fit(estimate).evidence + TWENTY_TO_ONE
    if _evidence(suspected.exchanged) > max([threshold, *others]):
        raise InputError(suspected.message)


def _evidence(problem: Problem) -> float:
    """Return the log evidence of readings at their base fit; minus infinity if they have none."""
    try:
        return posterior_at_base_fit(fit_nested(problem)).evidence
    except NumericsError:
        return -np.inf


_LEVEL_SCALES: Sequence[Scales] = ((5.0, 0.003),)
"""Background of levels: what turns the platform is often off by many tolerances, and must not count
against an interpretation."""


def check_levels(estimate: Estimate) -> None:
    """Refuse readings of levels that are far likelier with another interpretation than as they
    stand, both at their base fits.

    Zeros and leg lengths do not turn the platform, so the base model fits such readings equally
    well, and causes that turn it are found for them. Only the evidence of the full model prefers
    the correct interpretation.

    Raises:
        InputError: names file and setups, the interpretation, and what to do.
    """
    problem = estimate.problem
    setups = np.unique(problem.setup_of_row[problem.angular]).tolist()
    if not setups:
        return
    readings, posterior = level_readings(problem), posterior_at_base_fit(estimate)
    rows_by_setup = {s: weighted_rows(problem, s) for s in setups}
    found = likeliest_misreading(
        estimate, posterior, [*readings.values()], rows_by_setup, background_scales=_LEVEL_SCALES
    ).fault
    if found is not None:
        files = [source(f.readings) for f in problem.factors for _ in f.readings.setups]
        names = "; ".join(f"{files[s]}, setup {problem.setups[s].name!r}" for s in setups)
        clause = next(clause for clause, fault in readings.items() if fault is found)
        raise InputError(f"{names}: the readings of the level are far likelier {clause}")


def _rank(
    posterior: FullPosterior,
    alternatives: Iterable[Fault],
    rows_by_setup: RowsBySetup,
    background_scales: Sequence[Scales],
    least: float,
) -> list[tuple[float, Fault]]:
    """Return pairs of log odds over the readings as they stand and the alternative reading: the
    three likeliest over all backgrounds, and the three likeliest over those without active groups.

    Only log odds above ``least`` are returned, and none with over `MOST_RANKED_READINGS` readings.
    """
    model, problem = posterior.linearised, posterior.linearised.problem
    if len(problem.measured) > MOST_RANKED_READINGS or not (alternatives := [*alternatives]):
        return []
    likelihoods, costs = _backgrounds(posterior, background_scales, best_last=least > 0)
    deletions = [{s: w.deletion(rows) for s, rows in rows_by_setup.items()} for w in likelihoods]
    dials = {s: rows for s, rows in rows_by_setup.items() if s in problem.leg_setups}
    alternatives = [*alternatives, *turn_alternatives(problem, likelihoods, deletions, dials)]
    as_read, logs, changes, lost = _log_likelihoods(problem, likelihoods, alternatives)
    as_read, logs = as_read - costs, logs - costs[:, None]
    relabelled = list[int]()
    for k, fault in enumerate(alternatives):
        if fault.kind == "noisy":
            gains = np.array([w.noise_gains(fault.rows, NOISE_RATIOS) for w in likelihoods])
            size = largest(np.logaddexp.reduce(as_read[:, None] + gains, axis=0))
            alternatives[k] = replace(fault, size=NOISE_RATIOS[size])
            logs[:, k] += gains[:, size]
        elif fault.relabels:
            relabelled.append(k)
            logs[:, k] = -np.inf
        elif len(lost[k]):
            logs[:, k] += [w.deletion(lost[k], changes[k]).gain for w in likelihoods]
    priors = np.array([fault.log_odds for fault in alternatives])
    selections = slice(None), slice(len(background_scales))
    totals = [np.logaddexp.reduce(as_read[part]) for part in selections]

    def all_log_odds() -> list[Array]:
        """Return the log odds of all alternatives ``(K,)`` by each selection."""
        pairs = zip(selections, totals, strict=True)
        return [priors + np.logaddexp.reduce(logs[part], axis=0) - total for part, total in pairs]

    # Other labels take most time, and are left out where three others exceed their usual gain.
    enough = min(odds[descending(odds)[:_PER_SELECTION]][-1] for odds in all_log_odds())
    predictions = dict[bytes, list[Prediction]]()  # of the machine, by the rows it is without
    for k in relabelled:
        fault = alternatives[k]
        gain, over_best = _relabelling_limits(problem, as_read, deletions, selections, fault)
        if gain > max(least, enough) and not (least > 0 and over_best < least):
            logs[:, k] = _relabelled(model, likelihoods, predictions, fault) - costs
    ranked_odds = dict[int, float]()
    for odds in all_log_odds():
        for k in descending(odds, LOG_ODDS_MARGIN)[:_PER_SELECTION]:
            ranked_odds[k] = max(float(odds[k]), ranked_odds.get(k, -np.inf))
    return [(odds, alternatives[k]) for k, odds in ranked_odds.items() if odds > least]


def _relabelling_limits(
    problem: Problem,
    as_read: Array,
    deletions: Sequence[Mapping[int, Deletion]],
    selections: Sequence[slice],
    fault: Fault,
) -> tuple[float, float]:
    """Return the log odds that other labels of setups seldom exceed, by the better selection of
    backgrounds; and against the best explanation, which comes last.

    The chi2 of that explanation is a sample, so three of its standard deviations, halved as in a
    log likelihood, are added to the odds against it.
    """
    by_selection = fault.log_odds
    over_best = fault.log_odds + 1.5 * float(np.sqrt(2 * np.sum(problem.weighted)))
    for setup in setups_of(problem, fault):
        limits = as_read + [d[setup].relabelling_limit for d in deletions]
        gains = [limits[part].max() - np.logaddexp.reduce(as_read[part]) for part in selections]
        by_selection += float(max(gains))
        over_best += float(limits.max() - as_read[-1])
    return by_selection, over_best


def _log_likelihoods(
    problem: Problem, likelihoods: Sequence[FullLikelihood], alternatives: Sequence[Fault]
) -> tuple[Array, Array, list[Array], list[Rows]]:
    """Return the log likelihoods of the readings as they stand ``(b,)`` and of alternatives
    ``(b, K)``, the changes of the readings ``(n,)`` by each, and the rows that are lost by it.
    """
    corrected = [corrected_readings(problem, fault) for fault in alternatives]
    changes = [readings - problem.measured for readings, _ in corrected]
    other = np.flatnonzero([bool(change.any()) for change in changes])
    columns = np.column_stack([np.zeros(len(problem.measured)), *(changes[k] for k in other)])
    found = np.stack([w.log_likelihood(columns) for w in likelihoods])
    logs = np.repeat(found[:, :1], len(changes), axis=1)
    logs[:, other] = found[:, 1:]
    return found[:, 0], logs, changes, [rows for _, rows in corrected]


def _backgrounds(
    posterior: FullPosterior, background_scales: Sequence[Scales], best_last: bool
) -> tuple[list[FullLikelihood], Array]:
    """Return likelihoods under several backgrounds, and the log odds against each ``(b,)``.

    A misreading may come beside groups that are active in the readings as they stand, or in place
    of them: beside none, one, all but one, or all. The best explanation, at its scales, comes last
    if that is asked.
    """
    readings, mixture = WhitenedRows.of(posterior.linearised), posterior.mixture
    likelihoods, costs = list[FullLikelihood](), list[float]()
    count = len(mixture.best)
    for size in sorted({0, min(1, count), max(count - 1, 0), count}):
        for state in combinations(mixture.best, size):
            root, cost = mixture.slab_root(state), sum(mixture.cost[group] for group, _ in state)
            for scales in background_scales[: 1 if state else None]:
                likelihoods.append(readings.likelihood(scales, root))
                costs.append(float(cost))
    for state, scale in mixture.likely_explanations[: int(best_last)]:
        scales = scale.background_scale, scale.free_form_scale
        likelihoods.append(readings.likelihood(scales, mixture.slab_root(state)))
        costs.append(float(sum(mixture.cost[group] for group, _ in state)))
    return likelihoods, np.array(costs)


def _relabelled(
    model: LinearisedModel,
    likelihoods: Sequence[FullLikelihood],
    predictions: dict[bytes, list[Prediction]],
    fault: Fault,
) -> Array:
    """Return the log likelihoods ``(b,)`` of readings under other labels, with free datums and
    placements of their setups; add the predictions without these readings, if they are new.
    """
    count, first = model.parameter_count, len(model.units)
    # Readings under other labels have columns of parameters, and of active groups.
    kept = [np.r_[:count, first : w.columns.shape[1] - model.nuisance.count] for w in likelihoods]
    if (key := fault.rows.tobytes()) not in predictions:
        pairs = zip(likelihoods, kept, strict=True)
        predictions[key] = [w.prediction_without(fault.rows, columns) for w, columns in pairs]
    corrected, changed = with_faults_corrected(model.problem, [fault]), np.sort(fault.rows)
    places = np.array(factors_and_rows(corrected, changed))
    parts = {  # all other readings stay as they are
        k: corrected.factors[k].subset(places[places[:, 0] == k, 1])
        for k in np.unique(places[:, 0]).tolist()
    }
    linearised = linearise(corrected, model.point, parts)
    jacobian = linearised.jacobian
    rows = np.zeros((len(changed), len(model.units)))
    in_model = model.rows.blocks[0][0].any(axis=0)  # all but parameters that a twin represents
    rows[:, :count] = jacobian * model.units[:count] * in_model
    residual = corrected.measured[changed] - linearised.value + jacobian @ model.point
    poses = zip(parts.values(), linearised.reading_poses, strict=True)
    blocks = [factor.nuisances(of_factor) for factor, of_factor in poses]
    placed = block_diag(*(b.columns * np.minimum(b.sd, WIDEST_DATUM) for b in blocks))
    whiten, logs = model.nuisance.weighing.subset(changed).whiten, []
    for w, prediction, which in zip(likelihoods, predictions[key], kept, strict=True):
        columns, expected = in_standard_deviations(model, rows, w.scales, w.slab_root)
        whitened = map(whiten, (columns[:, which], placed, residual - expected))
        logs.append(prediction.relabelled(*whitened))
    return np.array(logs)
