"""The likeliest alternative readings, each compared by one factorisation of the full model.

Whole turns of a dial's hand are among them: the small hand, which counts them, was not read or was
misread. If only the large hand was read, all readings of a setup lie within one turn. The missing
turns of a setup are rounded from its deletion residual; those of all setups at once from the
residual of the readings, and then from what the readings with these turns corrected leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from orthoglide.explanation.alternative_readings import (
    EXPECTED_COUNT,
    AlternativeReadings,
    list_alternative_readings,
    with_misreading_corrected,
)
from orthoglide.explanation.columns import LinearisedModel
from orthoglide.explanation.faults import Fault, Rows, campaign_index
from orthoglide.explanation.full_likelihood import (
    WIDEST_DATUM,
    FullLikelihood,
    in_standard_deviations,
)
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_MOST_READINGS = 10_000  # readings: for more, four matrices by unknowns take over 0.4 GB
_MOST_RANKED = 5  # alternatives that are searched in full

_BACKGROUND_SCALES = ((0.01, 0.003), (0.1, 0.1), (1.0, 0.1), (1.0, 3.0))
"""Background scales of the parameters, in tolerances, and of the free-form errors."""


def rank_alternative_readings(
    posterior: FullPosterior, rows_by_setup: Mapping[int, Rows]
) -> list[tuple[float, AlternativeReadings]]:
    """Return the alternative readings that fit better than the readings as they stand, the
    likeliest first, each with its gain of log evidence.

    Args:
        posterior: of the readings as they stand.
        rows_by_setup: rows of each setup without a misreading, in the order they were taken.
    """
    model = posterior.linearised
    if len(model.value_at_zero) > _MOST_READINGS:
        return []
    alternatives = list_alternative_readings(model.problem, rows_by_setup)
    if not alternatives:
        return []
    likelihoods = _likelihoods(model)
    alternatives = [*alternatives, *turn_alternatives(model.problem, likelihoods, rows_by_setup)]
    no_change = np.zeros((len(model.value_at_zero), 1))
    by_background = np.array([w.log_likelihood(no_change)[0] for w in likelihoods])
    as_read = np.logaddexp.reduce(by_background)
    pairs = list(zip(by_background, likelihoods, strict=True))
    bounds = {s: max(p + w.relabelling_bound(rows) for p, w in pairs) - as_read
              for s, rows in rows_by_setup.items()}  # fmt: skip
    changes = np.stack([alternative.change for alternative in alternatives], axis=1)
    by_scale = np.stack([w.log_likelihood(changes) for w in likelihoods])
    scores = np.logaddexp.reduce(by_scale, axis=0)
    # A misreading may come beside the data faults that are active, or in place of them.
    model_with_faults, cost = _with_active_faults_fixed(posterior)
    if cost:
        both = np.hstack([no_change, changes])
        each = [w.log_likelihood(both) for w in _likelihoods(model_with_faults)]
        with_faults = np.logaddexp.reduce(each) - cost
        as_read = max(as_read, with_faults[0])
        scores = np.maximum(scores, with_faults[1:])
    # The background that the readings of all other setups favour, by relabelled setups.
    backgrounds: dict[tuple[int, ...], int] = {}
    for k, alternative in enumerate(alternatives):
        fault, labels = alternative.fault, alternative.labels
        if labels and alternative.log_odds + sum(bounds[s] for s in labels) < 0:
            scores[k] = -np.inf
        elif labels:
            if fault.setups not in backgrounds:
                others = [p + w.deletion_gain(fault.rows) for p, w in pairs]
                backgrounds[fault.setups] = int(np.argmax(others))
            best = backgrounds[fault.setups]
            scores[k] = _relabelled_log_likelihood(
                model, likelihoods[best], _BACKGROUND_SCALES[best], alternative
            )
        elif len(alternative.zero_weight):
            change = alternative.change if alternative.change.any() else None
            deleted = [p + w.deletion_gain(alternative.zero_weight, change)
                       for p, w in zip(by_scale[:, k], likelihoods, strict=True)]  # fmt: skip
            scores[k] = np.logaddexp.reduce(deleted)
    gains = scores + np.array([alternative.log_odds for alternative in alternatives]) - as_read
    order = descending(gains, LOG_ODDS_MARGIN)[:_MOST_RANKED]
    return [(float(gains[k]), alternatives[k]) for k in order if gains[k] > 0]


def _likelihoods(model: LinearisedModel) -> list[FullLikelihood]:
    return [FullLikelihood.from_linear_model(model, *scales) for scales in _BACKGROUND_SCALES]


def _with_active_faults_fixed(posterior: FullPosterior) -> tuple[LinearisedModel, float]:
    """Return the full model with a fixed prior scale of active data faults, and the log odds
    against these faults.
    """
    model, linear, cost = posterior.linearised, posterior.linearised.linear, 0.0
    fixed = linear.fixed_sd.copy()
    for k, tau in posterior.mixture.best:
        if linear.groups[k].of_data:
            fixed[linear.groups[k].coefficients] = tau
            cost += float(posterior.mixture.cost[k])
    return replace(model, linear=replace(linear, fixed_sd=fixed)), cost


def _relabelled_log_likelihood(
    model: LinearisedModel,
    likelihood: FullLikelihood,
    scales: tuple[float, float],
    alternative: AlternativeReadings,
) -> float:
    """Return the log likelihood of readings under other labels, with setups at unknown places."""
    problem, changed = model.problem, np.sort(alternative.fault.rows)
    k = campaign_index(problem, changed)
    relabelled = with_misreading_corrected(problem, alternative.fault).factors[k]
    factor = relabelled.subset(changed - problem.leg_rows[k].start)
    names, matrix = problem.elementary_parameters(k)
    linearised = factor.linearise(problem.machine.model, problem.values(k, model.point), names)
    jacobian = linearised.jacobian @ matrix
    count = jacobian.shape[1]
    rows = np.zeros((len(changed), model.rows.shape[1]))
    rows[:, :count] = jacobian * model.units[:count]
    rows[:, ~model.rows.any(axis=0)] = 0.0
    weighing = likelihood.weighing.subset(changed)
    columns, expected = in_standard_deviations(model, rows, *scales)
    residual = problem.measured[changed] - linearised.value + jacobian @ model.point - expected
    nuisances = factor.nuisances(linearised.reading_poses)
    instrument = weighing.whiten(nuisances.columns * np.minimum(nuisances.sd, WIDEST_DATUM))
    return likelihood.relabelled_log_likelihood(
        changed, weighing.whiten(columns), instrument, weighing.whiten(residual)
    )


HAND_TURNS = (1e-3, 5e-4, 2e-4, 2.54e-3, 2.54e-4)
"""Travel by one turn of the large hand of a dial, metres; the most usual first."""

_DIVISION_RANGE = (40, 300)  # fewest and most divisions of a turn
_USUAL_DIVISIONS = (100, 200)  # divisions of most dials
_UNUSUAL_PENALTY = 3.0  # log odds against other divisions
_ROUNDS = 4  # corrections of the turns
_EQUAL_DECIMALS = 9  # decimals of a metre: five turns of 0.2 mm are one of 1 mm


def turn_alternatives(
    problem: Problem, likelihoods: Sequence[FullLikelihood], rows_by_setup: Mapping[int, Rows]
) -> list[AlternativeReadings]:
    """Return the likeliest whole turns by which readings of each setup, or of all, are off.

    Args:
        problem: the readings.
        likelihoods: their likelihood under several backgrounds.
        rows_by_setup: rows of each setup without a misreading.
    """
    found: dict[bytes, AlternativeReadings] = {}
    least, most = _DIVISION_RANGE
    steps = {s: float(problem.resolution[rows].max()) for s, rows in rows_by_setup.items()}
    for likelihood in likelihoods:
        deviations = {
            s: likelihood.deletion_residual(rows).difference for s, rows in rows_by_setup.items()
        }
        for turn in HAND_TURNS:
            # Dials whose step, 0 if unknown, allows such a hand.
            able = [s for s, step in steps.items() if not step or least <= turn / step <= most]
            dials = {s: rows_by_setup[s] for s in able}
            per_setup = np.zeros((len(dials), len(problem.measured)))
            for off, (s, rows) in zip(per_setup, dials.items(), strict=True):
                off[rows] = turn * _whole_turns(deviations[s], turn)
            for off in (*per_setup, _joint_turns(likelihood, dials, turn)):
                if any(_are_turns(off[rows], problem.station[rows]) for rows in dials.values()):
                    alternative = _turn_alternative(problem, dials, off, turn)
                    found.setdefault((np.round(off, _EQUAL_DECIMALS) + 0.0).tobytes(), alternative)
    return list(found.values())


def _are_turns(off: Array, station: Rows) -> bool:
    """Return whether readings in time order ``(k,)`` may be off by turns.

    A single one is a slip, and a single step is a knocked stand. Most stations must be off by the
    same turns at each visit, because the hand is read at the same place.
    """
    affected = np.unique(station[off != 0])
    constant = sum(np.ptp(off[station == s]) == 0 for s in affected)
    steps = np.count_nonzero(np.diff(off))
    return bool(np.count_nonzero(off) > 1 and steps > 1 and 2 * constant >= len(affected))


def _turn_alternative(
    problem: Problem, rows: Mapping[int, Rows], off: Array, turn: float
) -> AlternativeReadings:
    setups = tuple(s for s, setup_rows in rows.items() if off[setup_rows].any())
    log_count = sum(_log_count_of_turns(problem, rows[s], off[rows[s]], turn) for s in setups)
    affected = np.flatnonzero(off)
    fault = Fault("turns", affected, setups, turn, sizes=tuple(off[affected].tolist()))
    return AlternativeReadings(fault, -off, float(np.log(EXPECTED_COUNT)) - log_count)


def _whole_turns(residual: Array, turn: float) -> Array:
    """Return the whole turns in the residual of a setup ``(k,)`` with any datum, less their most
    frequent number.
    """
    turns = residual / turn
    datum = np.angle(np.exp(2j * np.pi * turns).sum()) / (2 * np.pi)
    whole = np.rint(turns - datum)
    values, count = np.unique(whole, return_counts=True)
    return np.asarray(whole - values[count.argmax()])


def _joint_turns(likelihood: FullLikelihood, rows: Mapping[int, Rows], turn: float) -> Array:
    """Return the whole turns of all setups at once ``(n,)``, metres; zeros if not converged."""
    residual = likelihood.weighing.metres(likelihood.residual)
    last = np.zeros(len(residual))
    for _ in range(_ROUNDS):
        off = np.zeros(len(residual))
        for setup_rows in rows.values():
            off[setup_rows] = turn * _whole_turns(residual[setup_rows], turn)
        if np.array_equal(off, last):
            return off
        residual, last = off + likelihood.expected_noise(-off), off
    return np.zeros(len(residual))


def _log_count_of_turns(problem: Problem, rows: Rows, off: Array, turn: float) -> float:
    """Return the log number of equally plausible ways in which a setup is off by turns: all
    readings within one turn, or each station by its own number of turns.
    """
    divisions = turn / max(float(problem.resolution[rows].max()), 1e-300)
    unusual = 0.0 if np.isclose(divisions, _USUAL_DIVISIONS, rtol=0.01).any() else _UNUSUAL_PENALTY
    stations, first = np.unique(problem.station[rows], return_index=True)
    whole = np.abs(off[first]) / turn
    by_station = np.log(2 * len(stations) * whole[whole > 0]).sum()
    one_turn = float(np.ptp(problem.measured[rows])) < turn
    return unusual + float(min(by_station, np.log(2 * len(stations)) if one_turn else np.inf))
