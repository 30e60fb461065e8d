"""Readings of dials that separate rival explanations, or determine a weak direction better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from orthoglide.accuracy import without_translation, workspace_grid
from orthoglide.arguments import public
from orthoglide.effects.wording import cause_short, parameter_words
from orthoglide.errors import InputError, check_type
from orthoglide.explanation import FullPosterior
from orthoglide.fit import Estimate, normal_equations
from orthoglide.fit.factors import Factor
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, ranked
from orthoglide.planning.instrument_choice import suggest_instruments_for_located_errors
from orthoglide.planning.linear import (
    CombinationPrecision,
    LinearReadings,
    Pair,
    RivalSeparation,
    choose,
)
from orthoglide.planning.located_alternatives import LocatedAlternatives
from orthoglide.planning.sheets import reading_pool
from orthoglide.planning.suggestions import DECISIVE_SIGMAS, Suggestion
from orthoglide.prediction import Conditions, MeasurementModel, ReadingPoses
from orthoglide.result import Located, WeakDirection
from orthoglide.text import listed

Values = Mapping[str, float]
ENOUGH_SIGMAS = 6.0
"""Sigmas of separation beyond which no further reading is proposed."""

_INSEPARABLE_SIGMAS = 2.0  # a pair that the whole pool separates by less counts as inseparable
_MIN_SIGMAS = 1.0  # least separation of a pair for which readings are proposed
_MAX_SIGMA_RATIO = 0.9  # largest sd after / before for which readings are proposed
_MOST_DIRECTIONS = 2  # weak directions of a fit: further ones are determined well enough
_MOUNTING_COST = 4.0  # cost of mounting a dial and taking its first two readings, in readings
_MIN_SHAPE_RATIO = 0.02  # relative to the translation: a smaller difference in shape is ignored
_COMMANDS_PER_AXIS = 3  # commands along each axis: enough to compare two machines
_MAX_LOCATED_ERRORS = 6  # alternatives of a located error to separate: the likeliest
_READINGS_PER_SET = 12  # most readings proposed for the alternatives of one located error


@dataclass(frozen=True)
class Rival:
    """One way to explain the readings at hand."""

    words: str  # name in messages
    values: Values  # parameters of the machine, SI
    covariance: Array  # of the unknowns of new readings (P, P), SI, tolerances as priors


def _parameter_map_and_covariance(
    fit: Estimate, names: Sequence[str], lack_of_fit: float
) -> tuple[Array, Array]:
    """Return the matrix ``(P, U)`` from a fit's unknowns to parameters, and the covariance of the
    unknowns ``(U, U)``, SI, with tolerances as priors and widened by the lack of fit.
    """
    problem = replace(fit.problem, use_tolerance_priors=True)
    parts, part_weights = problem.machine_parameters(problem.last_factor_index)
    weights = np.zeros((len(names), len(problem.unknowns)))
    weights[[names.index(part) for part in parts]] = part_weights
    unit = problem.tolerance * problem.tolerance[:, None]
    information = normal_equations(problem, fit.at, fit.nuisance).information
    return weights, np.linalg.inv(information * unit / lack_of_fit**2) * unit


@public
def next_measurements(
    fit: Estimate,
    rivals: Sequence[tuple[str, Values | Estimate]] = (),
    *,
    pairs: Sequence[Pair] | None = None,
    count: int = 12,
    directions: Sequence[WeakDirection] | None = None,
) -> tuple[Suggestion, ...]:
    """Return the few readings of the largest gain among all readings within reach.

    The computation is linear around the fits, except for the readings that the rivals predict. Base
    parameters, the parameters of the rivals and new nuisances are fitted again on old and new
    readings together, so that only separations count that no fit can remove.

    Args:
        fit: of the readings at hand.
        rivals: pairs of a name and either a fit or the machine's current parameters (SI), whose
            uncertainty is then that of ``fit``.
        pairs: of rivals to separate, by their indices; by default all.
        count: largest number of readings proposed for each purpose.
        directions: weak directions to determine better; by default the fit's weakest two. An empty
            sequence stands for none.

    Raises:
        InputError: if ``fit`` is no estimate, or if readings are to be chosen and ``count`` is
            not a whole number from 2 to 500.
    """
    check_type("the fit", fit, Estimate, "an Estimate, as og.identify returns it")
    machine, lack_of_fit = fit.problem.machine, max(fit.sigma_scale, 1.0)
    fits = (fit, *(source for _, source in rivals if isinstance(source, Estimate)))
    parts = (one.problem.machine_parameters(one.problem.last_factor_index)[0] for one in fits)
    names = tuple(dict.fromkeys(name for each in parts for name in each))
    weights, covariance = _parameter_map_and_covariance(fit, names, lack_of_fit)
    pool = _loaded_pool(fit)
    of_pool = MeasurementModel(pool)
    linearised = of_pool.linearise(machine.model, fit.machine.values, names)
    readings = _linear_readings(fit, pool, linearised.jacobian, linearised.reading_poses)
    suggestions = list[Suggestion]()
    pairs = [*combinations(range(len(rivals)), 2)] if pairs is None else pairs
    if pairs:
        candidates = []
        for name, source in rivals:
            to_names, unknown_covariance = weights, covariance
            if isinstance(source, Estimate):
                to_names, unknown_covariance = _parameter_map_and_covariance(
                    source, names, lack_of_fit
                )
            values = source.machine.values if isinstance(source, Estimate) else source
            with suppress(InputError):  # else it is a name for people
                name = f'"{cause_short(machine.catalogue, name)}"'
            name_covariance = to_names @ unknown_covariance @ to_names.T
            candidates.append(Rival(name, values, name_covariance))
        predicted = [of_pool.predict(machine.model, rival.values) for rival in candidates]
        extended = replace(readings, columns=np.column_stack([linearised.jacobian, *predicted]))
        suggestions = _suggest_separating(machine, extended, candidates, pairs, count)
    by_unknowns = replace(readings, columns=readings.columns @ weights)
    weak = fit.weak[:_MOST_DIRECTIONS] if directions is None else directions
    narrowing = (_suggest_narrowing(by_unknowns, covariance, fit, one, count) for one in weak)
    return (*suggestions, *narrowing)


def _loaded_pool(fit: Estimate) -> Readings:
    """Return the readings that can be chosen, under the median load of the last campaign."""
    load = fit.problem.campaigns[-1].load if fit.problem.campaigns else np.zeros(1)
    finite = load[np.isfinite(load)]
    median = float(np.median(finite)) if len(finite) else 0.0
    return reading_pool(fit.problem.machine.geometry, load=median)


def _linear_readings(
    fit: Estimate, pool: Readings, columns: Array, poses: ReadingPoses
) -> LinearReadings:
    """Return the readings of a pool by their derivatives, with the noise of a fit."""
    sigma = fit.problem.noise.typical * max(fit.sigma_scale, 1.0)
    return LinearReadings.from_columns(fit.problem.machine, pool, columns, poses, sigma)


# -- rivals ----------------------------------------------------------------------------------------


def _suggest_separating(
    machine: Machine,
    readings: LinearReadings,
    rivals: Sequence[Rival],
    pairs: Sequence[Pair],
    count: int,
) -> list[Suggestion]:
    """Return suggestions of readings that separate pairs of rivals, and of the groups of rivals
    that no reading separates.

    The columns of the readings belong to the unknowns, then to the predictions of each rival.
    """
    covariances = [rival.covariance for rival in rivals]
    before = RivalSeparation.before(covariances, pairs)
    by_pool = replace(before, information=readings.information()).sigmas
    remaining = [pair for pair, s in by_pool.items() if s >= _INSEPARABLE_SIGMAS]
    by_pool = {pair: s for pair, s in by_pool.items() if pair not in remaining}
    by_choice: dict[Pair, float] = {}
    suggestions, pool = list[Suggestion](), readings.campaign
    while remaining:
        start = RivalSeparation.before(covariances, remaining, ENOUGH_SIGMAS**2)
        rows, criterion = choose(readings, start, count, mounting_cost=_MOUNTING_COST)
        if close := {pair: s for pair, s in criterion.sigmas.items() if s < _MIN_SIGMAS}:
            by_choice |= close
            remaining = [pair for pair in remaining if pair not in close]
            continue
        # Every station is visited again where there is room: a single visit may be misread.
        repeated = tuple(k for k in rows if rows.count(k) == 1)
        if repeated and len(rows) + len(repeated) <= count:
            rows = (*rows, *repeated)
            criterion = start.with_rows(readings, rows)
        suggestions.append(_separating_suggestion(pool, rows, rivals, criterion.sigmas))
        break
    size = len(pool)
    for text, close in (
        (
            f"are not separated by {count} readings of dials on the legs: these separate them by "
            f"{{:.1f}} sigma, so take more of the {size} possible ones",
            by_choice,
        ),
        (
            f"cannot be separated by dials on the legs: all {size} possible readings together "
            f"separate them by at most {{:.1f}} sigma",
            by_pool,
        ),
    ):
        for group, sigmas in _inseparable_groups(close):
            members = [rivals[k] for k in group]
            reason = (
                f"{listed(r.words for r in members)} {text.format(sigmas)}. "
                f"{_tcp_consequence(machine, members, float(readings.sigma.max()))}"
            )
            suggestions.append(Suggestion(reason, "none", sigmas, pool))
    return suggestions


def _separating_suggestion(
    pool: Readings, rows: tuple[int, ...], rivals: Sequence[Rival], sigmas: Mapping[Pair, float]
) -> Suggestion:
    """Return the suggestion of readings that separate pairs of rivals by so many sigmas."""
    closest = ranked(sigmas.items(), lambda item: -float(np.log(item[1])), LOG_ODDS_MARGIN)
    named: dict[Pair, float] = {}
    for pair, separation in closest:  # each rival with the one that is closest to it
        if not {*pair} <= {rival for other in named for rival in other}:
            named[pair] = separation
    text = "; ".join(
        f"{rivals[a].words} from {rivals[b].words} by {s:.1f} sigma" for (a, b), s in named.items()
    )
    further = len(closest) - len(named)
    text += f" (and {further} further pairs)" if further else ""
    gain = closest[0][1]
    if gain < DECISIVE_SIGMAS:
        text += ": too little to decide, but the most that so few readings can do"
    reason = f"{_readings_and_setups(pool, rows)} expected to separate {text}"
    return Suggestion(reason, "separate", gain, pool, rows)


def _inseparable_groups(separations: Mapping[Pair, float]) -> list[tuple[list[int], float]]:
    """Return groups of rivals that no reading separates, and the most sigmas between any two."""

    def pairs(group: set[int]) -> list[Pair]:
        return [*combinations(sorted(group), 2)]

    groups: list[set[int]] = []
    for pair in sorted(separations):
        unions = (g | set(pair) for g in groups)
        merged = next((j for j in unions if all(p in separations for p in pairs(j))), set(pair))
        groups = [g for g in groups if not g <= merged] + [merged]
    return [(sorted(g), max(separations[p] for p in pairs(g))) for g in groups]


def _tcp_consequence(machine: Machine, rivals: Sequence[Rival], noise: float) -> str:
    """Return what inseparable rivals mean for the TCP over the workspace, a sentence; differences
    below the noise of a reading, metres, do not count.
    """
    conditions = Conditions.from_commands(
        workspace_grid(machine.geometry, _COMMANDS_PER_AXIS, machine.spec.screw_pitch)
    )
    points = [machine.model.outputs(rival.values, conditions).p for rival in rivals]
    differences = [p - q for p, q in combinations(points, 2)]
    shift = max(float(np.linalg.norm(d.mean(axis=0))) for d in differences)
    shape = max(float(np.linalg.norm(without_translation(d), axis=1).max()) for d in differences)
    if max(shift, shape) < noise:
        return "Their TCPs are the same, too"
    if shape < max(_MIN_SHAPE_RATIO * shift, noise):
        return f"Their TCPs are the same but for a translation of {shift * 1e3:.2g} mm"
    return (
        f"Their TCPs differ by up to {shape * 1e3:.2g} mm after the best translation: measure the "
        "TCP, or look at the parts themselves"
    )


def suggest_separating_located_errors(
    posterior: FullPosterior, located: Located
) -> tuple[Suggestion, ...]:
    """Return readings that would separate the likeliest alternatives of a located error, and a
    statement on those that no reading separates.

    Each error is a rival with a free-form curve, which is fitted again on old and new readings.
    """
    alternatives = LocatedAlternatives.from_posterior(posterior, located, _MAX_LOCATED_ERRORS)
    machine, members = posterior.machine, alternatives.members
    if len(members) < 2:
        return ()
    if not machine.geometry.dialled:
        return suggest_instruments_for_located_errors(alternatives)
    pool = _loaded_pool(posterior.after)
    planned = Factor.from_planned(pool.with_moves(), machine)
    rows, reading_poses = alternatives.linearise(planned)
    predicted = rows @ np.stack([member.mean for member in members], axis=1)
    columns = np.hstack([rows, predicted])
    readings = _linear_readings(posterior.after, pool, columns, reading_poses)
    rivals = [Rival(f'"{m.words}"', m.machine, m.covariance) for m in members]
    pairs = [*combinations(range(len(rivals)), 2)]
    pairs = [(a, b) for a, b in pairs if members[a].permanent or members[b].permanent]
    suggestions = list[Suggestion]()
    if pairs:
        suggestions = _suggest_separating(machine, readings, rivals, pairs, _READINGS_PER_SET)
    temporary = [f'"{member.words}"' for member in members if not member.permanent]
    if len(temporary) > 1:
        reason = (
            f"{listed(temporary)} cannot be separated by new readings: they belong to this session "
            f"or to the dials that were used. Look at the parts themselves"
        )
        suggestions.append(Suggestion(reason, "none", 0.0, pool))
    if any(group.source.of_dial for group in alternatives.free_form_groups):
        advice = "; take another dial for them than before"
        suggestions = [replace(s, reason=s.reason + advice) if s.chosen else s for s in suggestions]
    return tuple(suggestions)


# -- weak directions -------------------------------------------------------------------------------


def _suggest_narrowing(
    readings: LinearReadings,
    covariance: Array,
    estimate: Estimate,
    direction: WeakDirection,
    count: int,
) -> Suggestion:
    """Return the readings that reduce the standard deviation of one weak direction of the fit.

    The columns of the readings and the covariance belong to the unknowns of the fit.
    """
    shares, catalogue = direction.parameters, estimate.problem.machine.catalogue
    tolerance = estimate.problem.tolerance
    combination = np.array([shares.get(n, 0.0) for n in estimate.problem.names]) * tolerance
    information = np.linalg.inv(covariance / tolerance / tolerance[:, None])
    start = CombinationPrecision(np.asarray(information), combination[:, None])
    scaled, pool = replace(readings, columns=readings.columns * tolerance), readings.campaign
    rows, end = choose(scaled, start, count, mounting_cost=_MOUNTING_COST)
    before, after = (float(np.sqrt(c.combination_covariance[0, 0])) for c in (start, end))
    words = listed(f"the {parameter_words(catalogue.parameter(n), catalogue.legs)}" for n in shares)
    if not rows or after > _MAX_SIGMA_RATIO * before:
        reason = (
            f"{count} further dial readings on the legs would reduce the standard deviation of "
            f"{'the weakest combination of ' * (len(shares) > 1)}{words} by less than "
            f"{100 * (1 - _MAX_SIGMA_RATIO):.0f} %, so none is proposed"
        )
        return Suggestion(reason, "none", before / after, pool)
    subject = "their weakest combination" if len(shares) > 1 else "it"
    reason = (
        f"{_readings_and_setups(pool, rows)} expected to determine {words} better: the standard "
        f"deviation of {subject} falls to {100 * after / before:.0f} % of what it is"
    )
    return Suggestion(reason, "narrow", before / after, pool, rows)


def _readings_and_setups(pool: Readings, rows: Sequence[int]) -> str:
    setups = len(np.unique(pool.setup[list(rows)]))
    return f"{len(rows)} readings in {setups} {'setup' if setups == 1 else 'setups'} are"
