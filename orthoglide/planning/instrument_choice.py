"""Which instrument at the tool would separate rivals, where no dial can be set against the legs.

New readings are linear in the parameters, as those at hand. The separation of two rivals is in
sigmas, after the nuisances of the instruments and all other parameters are fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from orthoglide.effects.wording import cause_short
from orthoglide.explanation import FullPosterior
from orthoglide.fit import Problem
from orthoglide.fit.factors import Factor, NuisanceBlock
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.geometry import Array
from orthoglide.instruments import TOOL_OBSERVATIONS
from orthoglide.numerals import compact
from orthoglide.ordering import RELATIVE_MARGIN, ranked
from orthoglide.parameters import split_campaign
from orthoglide.planning.linear import RivalSeparation
from orthoglide.planning.located_alternatives import LocatedAlternatives
from orthoglide.planning.sheets import instrument_sheet
from orthoglide.planning.suggestions import Suggestion
from orthoglide.result import Cause, Explanation
from orthoglide.text import MACHINE_OPTION, listed

_SEPARATED_SIGMAS = 3.0  # sigmas: odds of 90, more than between members of a credible set
_MAX_NAMED = 2  # explanations in a sentence; of others their number
_PROBABILITY_TOLERANCE = 0.1  # to which probabilities that decide are known
_PLATE_TURN = 60.0  # degrees on its seat: a shape of three lobes then has hollows in their place
_EXTRA_LENGTH = 0.04  # metres: as much again as a nozzle hangs below the joints of a platform
_SHEET_HINT = "; a sheet for it: orthoglide design --owns {0}{1} --out {0}.csv"


@dataclass(frozen=True, eq=False)
class QuotedExplanation:
    """One cause or free-form error of a credible set."""

    words: str  # as it is quoted
    probability: float
    cause: Explanation | None = None  # that it is; `None` of a free-form error


Pair = tuple[QuotedExplanation, QuotedExplanation]


@dataclass(frozen=True)
class ReadingProposal:
    """Readings that could be taken, and what they would decide."""

    brief: str  # what they are
    how: str  # they are taken
    sheet: str  # where there is one
    problem: Problem  # of them alone, in the unknowns of the readings at hand
    common_equipment: bool = True  # whether a workshop has what they take
    separations: Mapping[Pair, float] = field(default_factory=dict)  # sigmas, likelier rival first

    def separates(self, pair: Pair) -> bool:
        """Return whether the readings decide between two rivals."""
        return self.separations[pair] >= _SEPARATED_SIGMAS

    @property
    def probability(self) -> float:
        """Probability that it separates two explanations, each drawn by its probability."""
        return sum(map(_pair_probability, filter(self.separates, self.separations)))


def _pair_probability(pair: Pair) -> float:
    return pair[0].probability * pair[1].probability


def suggest_instruments_for_causes(
    posterior: FullPosterior, causes: Sequence[Cause]
) -> tuple[Suggestion, ...]:
    """Return the instruments at the tool that would separate the rival explanations of causes."""
    credible_sets = [
        [
            QuotedExplanation(f'"{cause_short(e.catalogue, e.name)}"', e.probability, e)
            for e in ranked(cause.explanations, lambda e: e.probability)
        ]
        for cause in causes
    ]
    return _suggest_instruments(
        "causes",
        credible_sets,
        _proposals(posterior.after.problem),
        lambda new, pairs: _cause_separations(posterior, new, pairs),
    )


def suggest_instruments_for_located_errors(
    alternatives: LocatedAlternatives,
) -> tuple[Suggestion, ...]:
    """Return the instruments at the tool that would separate the alternatives of a located error.

    A probe does not count: a plate may have any shape, which a free-form error can imitate.
    """
    rivals = [QuotedExplanation(f'"{m.words}"', m.probability) for m in alternatives.members]
    proposals = (
        p for p in _proposals(alternatives.posterior.after.problem)
        if not p.problem.factors[0].readings.touching.any()
    )  # fmt: skip
    return _suggest_instruments(
        "free-form errors",
        [rivals],
        proposals,
        lambda new, pairs: _located_separations(alternatives, new),
    )


def _suggest_instruments(
    rivals: str,
    sets: Sequence[Sequence[QuotedExplanation]],
    proposals: Iterator[ReadingProposal],
    separation: Callable[[Problem, Sequence[Pair]], Sequence[float]],
) -> tuple[Suggestion, ...]:
    """Return a suggestion for each instrument that separates any two rivals of one set.

    The first one most probably separates two explanations that are drawn by their probabilities.
    Probabilities are known to a tenth or so: among equal ones the least equipment comes first.
    """
    pairs = [pair for members in sets for pair in combinations(members, 2)]
    if not pairs:
        return ()
    remaining, ordered = list[ReadingProposal](), list[ReadingProposal]()
    for proposal in proposals:
        sigmas = dict(zip(pairs, separation(proposal.problem, pairs), strict=True))
        remaining.append(replace(proposal, separations=sigmas))
    while remaining:
        limit = max(p.probability for p in remaining) - _PROBABILITY_TOLERANCE - RELATIVE_MARGIN
        ordered.append(next(p for p in remaining if p.probability > limit))
        remaining.remove(ordered[-1])
    for common in (True, False):  # a tracker or a ball bar only where nothing else decides
        candidates = [p for p in ordered if p.common_equipment is common]
        if deciding := [p for p in candidates if p.probability > 0]:
            suggestions = []
            for p in deciding:
                text = "; ".join(s for members in sets for s in _sentences(p, members, candidates))
                verb = "measure" if common else "measure with"
                what = f"to tell the {rivals} apart {verb} {p.brief}{p.how}"
                reason, most = f"{what}: {text}{p.sheet}", max(p.separations.values())
                suggestion = Suggestion(reason, "none", most, None, what=f"{what}{p.sheet}")
                suggestions.append(suggestion)
            return tuple(suggestions)
    a, b = pairs[0]
    reason = f"no instrument at the tool separates {a.words} from {b.words}"
    return (Suggestion(reason, "none", 0.0, None),)


# -- what could be read ----------------------------------------------------------------------------


def _proposals(problem: Problem) -> Iterator[ReadingProposal]:
    """Yield the readings that could be taken, those that need least first."""
    plates = [
        (int(np.sum(f.setup == s)), k, s, f)
        for k, f, s, setup in problem.iter_tool_setups()
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

    instruments = [i for i in TOOL_OBSERVATIONS.values() if not i.touches]
    longer = [i for i in instruments if i.suggestion_suffix and i.paired]
    for i, length in (*((i, 0.0) for i in instruments), *((i, _EXTRA_LENGTH) for i in longer)):
        factor = Factor.from_planned(
            instrument_sheet(problem.machine, i.kind, length), problem.machine
        )
        brief, how = i.instrument_phrase, i.suggestion_suffix
        if i.paired and any(f.readings.paired.any() for f in problem.tool_factors):
            brief = f"more {brief}"
        hint = _SHEET_HINT.format(i.kind, MACHINE_OPTION)
        if length:
            mm = f"{length * 1e3:.0f}"
            brief, hint = f"{i.quantity_phrase} by a tool {mm} mm longer", ""
            how = (
                f", a pen or a rod, around the rim and across it, commanded {mm} mm higher, as a "
                f"setup of their own with -{mm} under beside_z_mm"
            )
        how += f", to {compact(float(factor.sigma[0]) * 1e3, 2)} {i.unit} each"
        new_problem = _one_factor_problem(problem, problem.last_factor_index, factor)
        yield ReadingProposal(brief, how, hint, new_problem, bool(i.suggestion_suffix))


def _turned_plate_problem(problem: Problem, k: int, setup: int, factor: Factor) -> Problem:
    """Return one setup's touches of a plate again, with the plate turned on its seat."""
    rows, plate = factor.setup == setup, factor.readings.setups[setup]
    plates = (replace(plate, turned=plate.turned + _PLATE_TURN),)
    points = replace(factor.readings.subset(rows), setups=plates, setup=np.zeros(rows.sum(), int))
    turned = Factor.from_readings(points, problem.machine, factor.noise.subset(rows))
    # Unnamed shapes of one degree are equally likely along all directions, turned or not.
    curves = problem.free_form_nuisances
    if curves is not None:
        curves = NuisanceBlock(curves.columns[problem.factor_rows[k]][rows], curves.sd)
    return _one_factor_problem(problem, k, turned, curves)


def _one_factor_problem(
    problem: Problem, k: int, factor: Factor, curves: NuisanceBlock | None = None
) -> Problem:
    """Return a problem of other readings alone, of the machine as factor ``k`` was read on."""
    return replace(
        problem,
        factors=(factor,),
        unknowns=tuple(replace(u, weights=(u.weights[k],)) for u in problem.unknowns),
        held=(problem.held[k],),
        free_form_nuisances=curves,
    )


# -- what it would decide --------------------------------------------------------------------------


def _located_separations(alternatives: LocatedAlternatives, new: Problem) -> list[float]:
    """Return the separations of every two alternatives, sigmas; new readings narrow each."""
    members = alternatives.members
    rows, reading_poses = alternatives.linearise(new.factors[0])
    means = np.stack([member.mean for member in members], axis=1)
    whitened = nuisances(new, (reading_poses,)).project(np.hstack([rows, rows @ means]))
    pairs = [*combinations(range(len(members)), 2)]
    before = RivalSeparation.before([member.covariance for member in members], pairs)
    return list(replace(before, information=whitened.T @ whitened).sigmas.values())


def _cause_separations(
    posterior: FullPosterior, new: Problem, pairs: Sequence[Pair]
) -> list[float]:
    """Return the separations of pairs of causes by new readings, sigmas, beyond those at hand.

    One cause of its size is true; its rival of any size is fitted with the base model and the
    background.
    """
    problem, linear = posterior.after.problem, posterior.linearised
    fixed = posterior.mixture.linear.fixed_sd[: linear.parameter_count]
    # About the base model: joint effects of causes are of second order and differ between machines.
    x = problem.zero_padded(posterior.before.x)
    old_model, new_model = linearise(problem, x), linearise(new, x)
    old_rows = np.vstack(
        [posterior.after.nuisance.project(old_model.jacobian), linear.prior_rows[0]]
    )
    new_rows = nuisances(new, new_model.reading_poses).project(new_model.jacobian)
    prior_sd = np.where(np.isnan(fixed), posterior.background_scale, fixed) * problem.tolerance
    rivals = list(dict.fromkeys(rival for pair in pairs for rival in pair))
    sizes = [_cause_vector(rival.cause, problem) for rival in rivals if rival.cause is not None]
    columns = np.hstack([np.diag(prior_sd), np.stack(sizes, axis=1)])
    i, j = np.array([[rivals.index(rival) for rival in pair] for pair in pairs]).T

    def chi2(rows: Array) -> Array:
        """Return chi2 of one cause of its size where the other is fitted, the smaller of both."""
        whitened = rows @ columns
        b, W = len(prior_sd), whitened.T @ whitened
        G = W[b:, b:] - W[b:, :b] @ np.linalg.solve(np.eye(b) + W[:b, :b], W[:b, b:])
        larger = np.maximum(G[i, i], G[j, j])
        residual = np.minimum(G[i, i], G[j, j]) - G[i, j] ** 2 / np.where(larger > 0, larger, 1.0)
        return np.maximum(residual, 0.0)

    gained = chi2(np.vstack([old_rows, new_rows])) - chi2(old_rows)
    return list(np.sqrt(np.maximum(gained, 0.0)).tolist())


def _cause_vector(explanation: Explanation, problem: Problem) -> Array:
    """Return a cause of its size in the unknowns ``(P,)``, SI."""
    setups = [s for f in problem.factors for s in f.setup_names]
    vector = np.zeros(len(problem.names))
    for name, value in explanation.values.items():
        parts = explanation.catalogue.elementary_weights(name, setups).items()
        weights = {split_campaign(part)[0]: weight for part, weight in parts}
        campaign = explanation.catalogue.parameter(name, setups).campaign
        applies = [not campaign or n.campaign in ("", campaign) for n in problem.names]
        vector += value * np.array([weights.get(n.plain, 0.0) for n in problem.names]) * applies
    return vector


def _sentences(
    proposal: ReadingProposal,
    members: Sequence[QuotedExplanation],
    proposals: Sequence[ReadingProposal],
) -> Iterator[str]:
    """Yield sentences on the separated pairs of a set and on the likeliest unseparated pair."""
    pairs = ranked(combinations(members, 2), _pair_probability)
    if separated := [pair for pair in pairs if proposal.separates(pair)]:
        first = separated[0][0]
        sigmas = {b: proposal.separations[a, b] for a, b in separated if a is first}
        names = [rival.words for rival in sigmas]
        if len(names) > _MAX_NAMED:
            names[_MAX_NAMED:] = [f"{len(names) - _MAX_NAMED} more"]
        least = f"{min(sigmas.values()):.0f} sigma or more"
        yield f"it separates {first.words} from {listed(names)}, by {least}"
    if unseparated := [pair for pair in pairs if not proposal.separates(pair)]:
        a, b = unseparated[0]
        others = [p.brief for p in proposals if p.separates((a, b))]
        other = f"for that take {others[0]}" if others else "as none of these does"
        yield f"it does not separate {a.words} from {b.words}, {other}"
