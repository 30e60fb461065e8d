"""Which instrument at the tool would separate rivals, where no dial can be set against the legs.

New readings are linear in the parameters, as those at hand. How far they set two rivals apart is in
sigmas, the instruments' own nuisances and everything else that may be wrong fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from orthoglide.effects.wording import cause_short
from orthoglide.explanation import Cause, Explanation, FullPosterior
from orthoglide.explanation.class_members import ClassMembers
from orthoglide.fit import Problem
from orthoglide.fit.factors import Factor, NuisanceBlock
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.geometry import Array
from orthoglide.instruments import TOOL_OBSERVATIONS
from orthoglide.numerals import compact
from orthoglide.ordering import RELATIVE_MARGIN, ranked
from orthoglide.parameters import split_campaign
from orthoglide.planning.choosing import RivalSeparation
from orthoglide.planning.sheets import tool_sheet
from orthoglide.planning.suggestions import Suggestion
from orthoglide.text import MACHINE_OPTION, listed

_SEPARATED_SIGMAS = 3.0
"""Sigmas: the wrong one of two becomes less likely by a factor of 90, more than the odds between
members of a credible set."""

_MAX_NAMED = 2  # explanations in a sentence; of others their number
_PROBABILITY_TOLERANCE = 0.1  # to which probabilities that decide are known
_PLATE_TURN = (
    60.0  # degrees, of a plate on its seat: the lobes of a shape of three come to its hollows
)
_EXTRA_LENGTH = 0.04  # metres: as much again as a nozzle hangs below the joints of a platform
_SHEET_HINT = "; a sheet for it: orthoglide design --owns {0}{1} --out {0}.csv"


@dataclass(frozen=True, eq=False)
class QuotedExplanation:
    """One of the explanations of a credible set, or of the places of a class."""

    words: str  # as it is quoted
    probability: float
    cause: Explanation | None = None  # that it is, where it is no place


Pair = tuple[QuotedExplanation, QuotedExplanation]


@dataclass(frozen=True)
class ReadingProposal:
    """Readings that could be taken."""

    brief: str  # what they are
    how: str  # they are taken
    sheet: str  # where there is one
    problem: Problem  # of them alone, in the unknowns of the readings at hand
    common_equipment: bool = True  # whether a workshop has what they take


@dataclass(frozen=True)
class Decision:
    """What an instrument's readings would decide."""

    proposal: ReadingProposal  # whose readings
    # sigmas between each two rivals of one set, the likelier one first
    separations: dict[Pair, float]

    def pairs_of_set(self, rivals: Sequence[QuotedExplanation], *, separated: bool) -> list[Pair]:
        """Return the pairs of a set that are separated, or those that are not, likeliest first."""
        found = (
            p
            for p, sigmas in self.separations.items()
            if (sigmas >= _SEPARATED_SIGMAS) == separated
        )
        return ranked((pair for pair in found if pair[0] in rivals), _pair_probability)

    @property
    def probability(self) -> float:
        """Probability that it separates two explanations, each drawn by its probability."""
        return sum(
            _pair_probability(pair)
            for pair, sigmas in self.separations.items()
            if sigmas >= _SEPARATED_SIGMAS
        )


def _pair_probability(pair: Pair) -> float:
    return pair[0].probability * pair[1].probability


def suggest_instruments_for_causes(
    known: FullPosterior, causes: Sequence[Cause]
) -> tuple[Suggestion, ...]:
    """Return the instruments at the tool that would decide between rivals of the causes found,
    where no dial is set on the legs.
    """
    sets = [
        [
            QuotedExplanation(f'"{cause_short(one.catalogue, one.name)}"', one.probability, one)
            for one in ranked(cause.explanations, lambda one: one.probability)
        ]
        for cause in causes
    ]
    proposals = _proposals(known.after.problem)
    return _suggest_instruments(
        "causes", sets, proposals, lambda new, pairs: _cause_separations(known, new, pairs)
    )


def suggest_instruments_for_places(members: ClassMembers) -> tuple[Suggestion, ...]:
    """Return the instruments at the tool that would part the places of a class. A plate may have
    any shape, which a free function of any part draws as well, so that a probe does not count.
    """
    rivals = [QuotedExplanation(f'"{one.words}"', one.probability) for one in members.members]
    proposals = (
        one for one in _proposals(members.posterior.after.problem)
        if not one.problem.factors[0].readings.touching.any()
    )  # fmt: skip
    return _suggest_instruments(
        "places", [rivals], proposals, lambda new, pairs: _place_separations(members, new)
    )


def _suggest_instruments(
    rivals: str,
    sets: Sequence[Sequence[QuotedExplanation]],
    proposals: Iterator[ReadingProposal],
    separation: Callable[[Problem, Sequence[Pair]], Sequence[float]],
) -> tuple[Suggestion, ...]:
    """Return a suggestion for each instrument that separates any two rivals of one set.

    First stands what decides between the likeliest: the sum of the products of the probabilities
    of any two that it separates is the largest. They are known to a tenth or so: of those equal
    by that first stands what needs least.
    """
    pairs = [pair for one in sets for pair in combinations(one, 2)]
    if not pairs:
        return ()
    several = [
        Decision(p, dict(zip(pairs, separation(p.problem, pairs), strict=True))) for p in proposals
    ]
    several = _ordered_by_need(several)
    for usual in (True, False):  # a tracker or a ball bar only where nothing else decides
        own = [one for one in several if one.proposal.common_equipment is usual]
        if found := [
            _instrument_suggestion(rivals, one, sets, own) for one in own if one.probability > 0
        ]:
            return tuple(found)
    one, other = pairs[0]
    reason = f"no instrument at the tool separates {one.words} from {other.words}"
    return (Suggestion(reason, "none", 0.0, None),)


def _ordered_by_need(several: Sequence[Decision]) -> list[Decision]:
    """Return decisions, given that of least need first, so that none stands behind one that is no
    better by more than what probabilities are known to.
    """
    left, order = [*several], list[Decision]()
    while left:
        most = max(one.probability for one in left)
        order.append(
            next(
                one
                for one in left
                if one.probability > most - _PROBABILITY_TOLERANCE - RELATIVE_MARGIN
            )
        )
        left.remove(order[-1])
    return order


# -- what could be read ----------------------------------------------------------------------------


def _proposals(problem: Problem) -> Iterator[ReadingProposal]:
    """Yield the readings that could be taken, those that need least first."""
    plates = [
        (int(np.sum(f.setup == s)), k, s, f)
        for k, f, s, setup in problem.tool_setups
        if setup.observation.touches
    ]
    if plates:
        yield ReadingProposal(
            f"a mesh with the plate turned by {_PLATE_TURN:.0f} degrees",
            f" on its seat, as a setup of its own with {_PLATE_TURN:.0f} under turned_deg (of a "
            f"printer: a profile of its own, imported with --turned NAME={_PLATE_TURN:.0f})",
            "",
            _turned_plate_problem(problem, *max(plates)[1:]),
        )
    long = f"{_EXTRA_LENGTH * 1e3:.0f}"
    several = [(i, 0.0, i.instrument_phrase, i.suggestion_suffix, _SHEET_HINT.format(i.kind, MACHINE_OPTION)) for i in TOOL_OBSERVATIONS.values()
               if not i.touches]  # fmt: skip
    several += [
        (i, _EXTRA_LENGTH, f"{i.quantity_phrase} by a tool {long} mm longer", f", a pen or a rod, around the rim "
         f"and across it, commanded {long} mm higher, as a setup of their own with -{long} under "
         f"beside_z_mm", "")
        for i in TOOL_OBSERVATIONS.values() if i.suggestion_suffix and i.paired
    ]  # fmt: skip
    for instrument, longer, brief, how, told in several:
        sheet = tool_sheet(problem.machine, instrument, longer)
        factor = Factor.from_planned(sheet, problem.machine)
        known = f"{how}, to {compact(float(factor.sigma[0]) * 1e3, 2)} {instrument.unit} each"
        alone = _one_factor_problem(problem, problem.last_factor, factor)
        yield ReadingProposal(
            brief, known, told, alone, common_equipment=bool(instrument.suggestion_suffix)
        )


def _turned_plate_problem(problem: Problem, k: int, setup: int, factor: Factor) -> Problem:
    """Return one setup's touches of a plate again, with the plate turned on its seat."""
    rows, own = factor.setup == setup, factor.readings.setups[setup]
    lies = replace(own, turned=own.turned + _PLATE_TURN)
    points = replace(factor.readings.subset(rows), setups=(lies,), setup=np.zeros(rows.sum(), int))
    again = Factor.from_readings(points, problem.machine, factor.noise.subset(rows))
    # Shapes without a name, of one degree as likely along all directions, are so when turned, too.
    curves, at = problem.free_form_errors, problem.factor_rows[k]
    if curves is not None:
        curves = NuisanceBlock(curves.columns[at][rows], curves.sd)
    return _one_factor_problem(problem, k, again, curves)


def _one_factor_problem(
    problem: Problem, k: int, factor: Factor, curves: NuisanceBlock | None = None
) -> Problem:
    """Return a problem of other readings alone, of the machine as factor ``k`` was read on."""
    return replace(
        problem,
        factors=(factor,),
        unknowns=tuple(replace(u, weights=(u.weights[k],)) for u in problem.unknowns),
        held=(problem.held[k],),
        free_form_errors=curves,
    )


# -- what it would tell ----------------------------------------------------------------------------


def _place_separations(members: ClassMembers, new: Problem) -> list[float]:
    """Return the sigmas that new readings separate each two places by, each narrowed by them."""
    rows, seen = members.rows(new.factors[0])
    means = np.stack([one.mean for one in members.members], axis=1)
    shown = nuisances(new, (seen,)).project(np.hstack([rows, rows @ means]))
    spread = np.stack([one.covariance for one in members.members])
    pairs = np.array([*combinations(range(len(members.members)), 2)])
    apart = replace(RivalSeparation.between(spread, pairs), information=shown.T @ shown)
    return list(apart.sigmas.values())


def _cause_separations(known: FullPosterior, new: Problem, pairs: Sequence[Pair]) -> list[float]:
    """Return the sigmas that new readings separate pairs of causes by: what one of its size would
    show is fitted by its rival of any size, the base and the background, beyond what that leaves of
    the readings at hand.
    """
    problem, fixed = (
        known.after.problem,
        known.mixture.linear.fixed_sd[: known.linearised.parameter_count],
    )
    # About the base: what causes do together is of the second order, and differs by what is there.
    x = problem.zero_padded(known.before.x)
    at, then = linearise(problem, x), linearise(new, x)
    old = np.vstack([known.after.nuisance.project(at.jacobian), known.linearised.prior_rows[0]])
    more = nuisances(new, then.reading_poses).project(then.jacobian)
    base = np.diag(np.where(np.isnan(fixed), known.background_scale, fixed) * problem.tolerance)
    several = list(dict.fromkeys(one for pair in pairs for one in pair))
    sizes = [_cause_vector(one.cause, problem) for one in several if one.cause is not None]
    columns = np.hstack([base, np.stack(sizes, axis=1)])
    i, j = np.array([[several.index(one) for one in pair] for pair in pairs]).T

    def squares(rows: Array) -> Array:
        """Return chi2 of one cause of its size where the other is fitted, the smaller of both."""
        shown = rows @ columns
        b, information = len(base), shown.T @ shown
        past = np.linalg.solve(np.eye(b) + information[:b, :b], information[:b, b:])
        G = information[b:, b:] - information[b:, :b] @ past
        large = np.maximum(G[i, i], G[j, j])
        left = np.minimum(G[i, i], G[j, j]) - G[i, j] ** 2 / np.where(large > 0, large, 1.0)
        return np.maximum(left, 0.0)

    gained = squares(np.vstack([old, more])) - squares(old)
    found: list[float] = np.sqrt(np.maximum(gained, 0.0)).tolist()
    return found


def _cause_vector(one: Explanation, problem: Problem) -> Array:
    """Return a cause of its size in the unknowns ``(P,)``, SI."""
    setups = [s for f in problem.factors for s in f.setup_names]
    found = np.zeros(len(problem.names))
    for name, value in one.values.items():
        weights = one.catalogue.elementary_weights(name, setups).items()
        of = {split_campaign(parameter)[0]: w for parameter, w in weights}
        campaign = one.catalogue.parameter(name, setups).campaign
        mine = [not campaign or n.campaign in ("", campaign) for n in problem.names]
        found += value * np.array([of.get(n.plain, 0.0) for n in problem.names]) * mine
    return found


def _instrument_suggestion(
    rivals: str,
    one: Decision,
    sets: Sequence[Sequence[QuotedExplanation]],
    several: Sequence[Decision],
) -> Suggestion:
    told = [text for own in sets for text in _separation_sentences(one, own, several)]
    i, most = one.proposal, max(one.separations.values())
    what = f"to tell the {rivals} apart measure {'' if i.common_equipment else 'with '}{i.brief}{i.how}"
    reason = f"{what}: {'; '.join(told)}{i.sheet}"
    return Suggestion(reason, "none", most, None, what=f"{what}{i.sheet}")


def _separation_sentences(
    one: Decision, own: Sequence[QuotedExplanation], several: Sequence[Decision]
) -> Iterator[str]:
    """Yield the pairs of a set that it separates, and the likeliest that it does not."""
    separated, left = one.pairs_of_set(own, separated=True), one.pairs_of_set(own, separated=False)
    if separated:
        first = separated[0][0]
        rivals = {b: one.separations[a, b] for a, b in separated if a is first}
        named = [other.words for other in rivals]
        if len(named) > _MAX_NAMED:
            named[_MAX_NAMED:] = [f"{len(named) - _MAX_NAMED} more"]
        least = f"{min(rivals.values()):.0f} sigma or more"
        yield f"it tells {first.words} from {listed(named)}, by {least}"
    if left:
        a, b = left[0]
        others = [d.proposal.brief for d in several if d.separations[a, b] >= _SEPARATED_SIGMAS]
        yield (
            f"it does not tell {a.words} from {b.words}, "
            f"{f'for that take {others[0]}' if others else 'as none of these does'}"
        )
