"""Readings of dials that separate rival explanations, or determine a weak direction better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from orthoglide.accuracy import workspace_grid
from orthoglide.effects.wording import cause_short, parameter_words
from orthoglide.errors import InputError
from orthoglide.explanation import FullPosterior, Located
from orthoglide.explanation.class_members import ClassMembers
from orthoglide.fit import Estimate, linearise, normal_equations
from orthoglide.fit.factors import Factor
from orthoglide.geometry import Array
from orthoglide.instruments.leg_dial import PLACEMENT_INDEX
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, ranked
from orthoglide.planning.choosing import CombinationPrecision, RivalSeparation, choose
from orthoglide.planning.instrument_choice import suggest_instruments_for_places
from orthoglide.planning.linear import LinearReadings
from orthoglide.planning.pool import reading_pool
from orthoglide.planning.suggestions import DECISIVE_SIGMAS, Suggestion
from orthoglide.prediction import Conditions
from orthoglide.result.fits import WeakDirection
from orthoglide.text import listed

Values = Mapping[str, float]
Pair = tuple[int, int]
"""Two rivals, the smaller number first."""

ENOUGH_SIGMAS = 6.0
"""Sigmas of separation beyond which no further reading is proposed."""

_INSEPARABLE_SIGMAS = (
    2.0  # sigmas by the whole pool: rivals that no reading within reach tells apart
)
_MIN_SIGMAS = 1.0  # sigmas: less is not worth taking readings for
_MAX_SIGMA_RATIO = 0.9  # of a sigma before: readings that leave more are not worth taking
_MOST_DIRECTIONS = 2  # weak directions of a fit: further ones are known well enough
_MOUNTING_COST = 4.0  # readings that mounting a dial, with its first two, is worth
_MAX_NAMED_PAIRS = 3  # pairs of rivals in a sentence: the least separated ones
_MIN_SHAPE_RATIO = 0.02  # of the shift between two machines: less is no difference in shape
_COMMANDS_PER_AXIS = 3  # commands along each axis: enough to compare two machines
_MOST_PLACES, _PLACE_READINGS = 6, 12  # places that are parted, the likeliest; readings for them


@dataclass(frozen=True)
class Rival:
    """One way to explain the readings at hand."""

    words: str  # as it is quoted
    values: Values  # parameters of the machine, SI
    parts: tuple[str, ...]  # elementary parameters of the machine that its unknowns set
    weights: Array  # of these for each unknown (E, P)
    covariance: Array  # of the unknowns (P, P), SI, tolerances as priors

    @classmethod
    def of(cls, name: str, found: Estimate | Values, like: Estimate, scale: float) -> Rival:
        """Return an explanation by its own fit, or by its values and the unknowns of another fit.

        Args:
            name: of the cause: a parameter, a structured member, or any other name.
            found: an estimate of the machine as it is now, or all its parameters, SI.
            like: the fit whose readings, unknowns and nuisances count where there are values only.
            scale: of the noise, where lack of fit remains.
        """
        fit = found if isinstance(found, Estimate) else like
        problem, at = fit.problem, fit.at
        if not isinstance(found, Estimate):
            parts = [dict(u.weights[problem.last_factor]) for u in problem.unknowns]
            at = linearise(problem, np.array([_fitted_unknown(p, found) for p in parts]))
        here = normal_equations(replace(problem, priors=True), at, fit.nuisance)
        unit = problem.tolerance
        scaled = here.information * unit * unit[:, None] / scale**2
        covariance = np.linalg.inv(scaled) * unit * unit[:, None]
        catalogue = problem.machine.catalogue
        values = catalogue.machine_values(problem.values(problem.last_factor, at.x))
        with suppress(InputError):  # else it is a name for people
            name = f'"{cause_short(catalogue, name)}"'
        return cls(name, values, *problem.machine_parameters(problem.last_factor), covariance)

    def weights_by_parameter(self, names: Sequence[str]) -> Array:
        """Return the weights of elementary parameters for each unknown ``(n, P)``; 0 where none
        sets one.
        """
        matrix = np.zeros((len(names), self.weights.shape[1]))
        matrix[[names.index(part) for part in self.parts]] = self.weights
        return matrix

    def parameter_covariance(self, names: Sequence[str]) -> Array:
        """Return the covariance of elementary parameters ``(n, n)``, SI."""
        matrix = self.weights_by_parameter(names)
        return np.asarray(matrix @ self.covariance @ matrix.T)


def _fitted_unknown(parts: Values, values: Values) -> float:
    """Return the unknown that sets its parts to these values, in the least squares."""
    weight = np.array(list(parts.values()))
    given = np.array([values.get(p, 0.0) for p in parts])
    return float(weight @ given / (weight @ weight)) if len(weight) else 0.0


def next_measurements(
    fit: Estimate,
    rivals: Sequence[tuple[str, Values | Estimate]] = (),
    *,
    pairs: Sequence[Pair] | None = None,
    count: int = 12,
    directions: Sequence[WeakDirection] | None = None,
) -> tuple[Suggestion, ...]:
    """Return the few readings that would tell most, out of those that the machine can reach.

    Everything is linear around the fits, but for the readings that the rivals predict. Base
    parameters, the rivals' own and the new datums and places are fitted again on old and new
    readings together: what is counted is what no fit could explain away.

    Args:
        fit: of the readings at hand.
        rivals: explanations between which these cannot decide: names with their fits, or with all
            parameters of the machine as it is now, SI, in the unknowns of ``fit``.
        pairs: of rivals that are to be told apart, by place; all where absent.
        count: readings to propose, at most, for each purpose.
        directions: to pin down; the fit's weakest two where absent, none where empty.

    Raises:
        InputError: for fewer than two readings.
    """
    machine = fit.problem.machine
    weak = fit.weak[:_MOST_DIRECTIONS] if directions is None else directions
    scale = max(fit.sigma_scale, 1.0)
    several = [Rival.of(name, found, fit, scale) for name, found in rivals]
    own = Rival.of("", fit, fit, scale)
    names = tuple(dict.fromkeys(p for e in (own, *several) for p in e.parts))
    choice = reading_pool(machine.geometry, load=_median_load(fit))
    at = machine.model.linearised(own.values, choice, names)
    total = fit.problem.noise.typical * scale
    readings = LinearReadings.from_columns(
        machine, choice, at.jacobian, at.reading_poses.nuisance_jacobian[:, PLACEMENT_INDEX], total
    )
    found: list[Suggestion] = []
    every = [*combinations(range(len(several)), 2)] if pairs is None else pairs
    if every:
        predicted = [machine.model.readings(e.values, choice) for e in several]
        both = replace(readings, columns=np.column_stack([at.jacobian, *predicted]))
        found += _suggest_separating(machine, both, names, several, every, count)
    for direction in weak:
        found.append(_suggest_narrowing(readings, names, own, fit, direction, count))
    return tuple(found)


def _median_load(estimate: Estimate) -> float:
    """Return the load at the TCP over the last campaign, newtons; 0 where none is known."""
    if not estimate.problem.campaigns:
        return 0.0
    load = estimate.problem.campaigns[-1].load
    known = load[np.isfinite(load)]
    return float(np.median(known)) if len(known) else 0.0


# -- rivals ----------------------------------------------------------------------------------------


def _suggest_separating(
    machine: Machine,
    readings: LinearReadings,
    names: tuple[str, ...],
    rivals: Sequence[Rival],
    pairs: Sequence[Pair],
    count: int,
) -> list[Suggestion]:
    """Return readings between pairs of rivals, and the groups of rivals that none tells apart; the
    readings are by elementary parameters of these names, then as each rival predicts them.
    """
    spread = np.stack([e.parameter_covariance(names) for e in rivals])
    every = RivalSeparation.between(spread, np.array(pairs))
    apart = replace(every, information=readings.information()).sigmas
    weak = {pair: sigmas for pair, sigmas in apart.items() if sigmas < _INSEPARABLE_SIGMAS}
    rows, end = tuple[int, ...](), None
    while left := [pair for pair in apart if pair not in weak]:
        start = RivalSeparation.between(spread, np.array(left), ENOUGH_SIGMAS**2)
        rows, end = choose(readings, start, count, mounting_cost=_MOUNTING_COST)
        if not (low := {pair: s for pair, s in end.sigmas.items() if s < _MIN_SIGMAS}):
            break
        weak, rows, end = weak | low, (), None
    found = []
    if end is not None:
        # Every station is visited again where there is room: a single visit may be misread.
        again = tuple(k for k in rows if rows.count(k) == 1)
        if again and len(rows) + len(again) <= count:
            rows = (*rows, *again)
            end = start.with_rows(readings, rows)
        found.append(_separating_suggestion(readings.campaign, rows, rivals, end.sigmas))
    for group, sigmas in _inseparable_groups(weak):
        text = _inseparable_reason(machine, [rivals[k] for k in group], sigmas, readings)
        found.append(Suggestion(text, "none", sigmas, readings.campaign))
    return found


def _separating_suggestion(
    pool: Readings, rows: tuple[int, ...], rivals: Sequence[Rival], apart: Mapping[Pair, float]
) -> Suggestion:
    """Return the suggestion of readings by the sigmas that they set pairs of rivals apart."""
    least = ranked(apart.items(), lambda item: -float(np.log(item[1])), LOG_ODDS_MARGIN)
    text = "; ".join(
        f"{rivals[a].words} from {rivals[b].words} by {s:.1f} sigma"
        for (a, b), s in least[:_MAX_NAMED_PAIRS]
    )
    more = len(least) - _MAX_NAMED_PAIRS
    text += f" (and {more} further pairs by more)" if more > 0 else ""
    gain = least[0][1]
    if gain < DECISIVE_SIGMAS:
        text += ": too little to decide, but the most that so few readings can do"
    reason = f"{_readings_and_setups(pool, rows)} expected to separate {text}"
    return Suggestion(reason, "separate", gain, pool, rows)


def _inseparable_groups(apart: Mapping[Pair, float]) -> list[tuple[list[int], float]]:
    """Return rivals of which no two can be told apart, and the most sigmas between any two; given
    are those of the pairs that cannot be.
    """
    groups: list[set[int]] = []
    for pair in sorted(apart):
        joined = (g | set(pair) for g in groups)
        whole = next((j for j in joined if all(p in apart for p in _pairs(j))), set(pair))
        groups = [g for g in groups if not g <= whole] + [whole]
    return [(sorted(g), max(apart[p] for p in _pairs(g))) for g in groups]


def _pairs(group: set[int]) -> list[Pair]:
    return [*combinations(sorted(group), 2)]


def _inseparable_reason(
    machine: Machine, rivals: Sequence[Rival], sigmas: float, readings: LinearReadings
) -> str:
    """Return why no reading is proposed for rivals, and what it means for the TCP.

    Args:
        machine: of the workspace.
        rivals: that are inseparable.
        sigmas: the most that was found between two of them.
        readings: that they were judged by.
    """
    conditions = Conditions.from_commands(
        workspace_grid(machine.geometry, _COMMANDS_PER_AXIS, machine.spec.screw_pitch)
    )
    points = [machine.model.outputs(e.values, conditions).p for e in rivals]
    apart = [p - q for p in points for q in points]
    shift = max(float(np.linalg.norm(d.mean(axis=0))) for d in apart)
    rest = max(float(np.linalg.norm(d - d.mean(axis=0), axis=1).max()) for d in apart)
    level = float(readings.sigma.max())  # a smaller difference of the TCPs does not count
    if max(shift, rest) < level:
        tail = "their TCPs are the same, too"
    elif rest < max(_MIN_SHAPE_RATIO * shift, level):
        tail = f"their TCPs are the same but for a shift of {shift * 1e3:.2g} mm"
    else:
        tail = (
            f"their TCPs differ by up to {rest * 1e3:.2g} mm after the best shift: measure the "
            "TCP, or look at the parts themselves"
        )
    return (
        f"no few readings of a dial on a leg tell {listed(e.words for e in rivals)} apart (out of "
        f"{len(readings.campaign)} within reach; {sigmas:.1f} sigma at most); {tail}"
    )


def suggest_separating_places(posterior: FullPosterior, located: Located) -> tuple[Suggestion, ...]:
    """Return readings, a dozen at most, that would part the likeliest places of a class, and which
    of them none parts.

    Each is a rival with its own free function, which new readings narrow as they do all else.
    """
    members = ClassMembers.from_posterior(posterior, located, _MOST_PLACES)
    machine, fit = posterior.machine, posterior.after
    if len(members.members) < 2:
        return ()
    if not machine.geometry.dialled:
        return suggest_instruments_for_places(members)
    pool = reading_pool(machine.geometry, load=_median_load(fit))
    rows, seen = members.rows(Factor.from_planned(pool.with_moves(), machine))
    expected = rows @ np.stack([one.mean for one in members.members], axis=1)
    total = fit.problem.noise.typical * max(fit.sigma_scale, 1.0)
    columns = np.hstack([rows, expected])
    readings = LinearReadings.from_columns(
        machine, pool, columns, seen.nuisance_jacobian[:, PLACEMENT_INDEX], total
    )
    names = tuple(str(k) for k in members.coefficients)
    rivals = [
        Rival(f'"{one.words}"', one.machine, names, np.eye(len(names)), one.covariance)
        for one in members.members
    ]
    pairs = [*combinations(range(len(rivals)), 2)]
    apart = [p for p in pairs if any(members.members[k].permanent for k in p)]
    found = (
        _suggest_separating(machine, readings, names, rivals, apart, _PLACE_READINGS)
        if apart
        else []
    )
    gone = [
        rival.words for rival, one in zip(rivals, members.members, strict=True) if not one.permanent
    ]
    if len(gone) > 1:
        reason = (
            f"no new readings tell {listed(gone)} apart: these belong to the session and to the "
            f"dials that were read; look at the parts themselves"
        )
        found.append(Suggestion(reason, "none", 0.0, pool))
    if any(place.of_dial for place in members.free_form_errors):
        other = "; take another dial for them than before"
        found = [replace(s, reason=s.reason + other) if s.chosen else s for s in found]
    return tuple(found)


# -- weak directions -------------------------------------------------------------------------------


def _suggest_narrowing(
    readings: LinearReadings,
    names: tuple[str, ...],
    own: Rival,
    estimate: Estimate,
    direction: WeakDirection,
    count: int,
) -> Suggestion:
    """Return readings for one weak direction of the fit, in its own unknowns, each in its
    tolerance.
    """
    shares, catalogue = direction.parameters, estimate.problem.machine.catalogue
    d = np.array([shares.get(n, 0.0) for n in estimate.problem.names])
    tolerance = estimate.problem.tolerance
    here = replace(
        readings, columns=readings.columns @ (own.weights_by_parameter(names) * tolerance)
    )
    information = np.linalg.inv(own.covariance / tolerance / tolerance[:, None])
    start = CombinationPrecision(np.asarray(information), (d * tolerance)[:, None])
    rows, end = choose(here, start, count, mounting_cost=_MOUNTING_COST)
    before, after = (float(np.sqrt(o.combination_covariance[0, 0])) for o in (start, end))
    words = listed(f"the {parameter_words(catalogue.parameter(n), catalogue.legs)}" for n in shares)
    together = "their weakest combination" if len(shares) > 1 else "it"
    if not rows or after > _MAX_SIGMA_RATIO * before:
        reason = (
            f"no {count} readings of a dial on a leg determine {words} noticeably better: of "
            f"{together} they add hardly anything to what the tolerances say"
        )
        return Suggestion(reason, "none", before / after, here.campaign)
    reason = (
        f"{_readings_and_setups(here.campaign, rows)} expected to determine {words} better: the standard "
        f"deviation of {together} falls to {100 * after / before:.0f} % of what it is"
    )
    return Suggestion(reason, "narrow", before / after, here.campaign, rows)


def _readings_and_setups(pool: Readings, rows: Sequence[int]) -> str:
    setups = len(np.unique(pool.setup[list(rows)]))
    return f"{len(rows)} readings in {setups} {'setup' if setups == 1 else 'setups'} are"
