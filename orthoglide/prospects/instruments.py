"""Which other instrument would tell rivals apart, where no dial can be set against the legs.

New readings are taken together with those at hand, all linear in the parameters. What one cause of
its size would show is fitted by its rival of any size, the base, the background and the
instruments' own nuisances; what is left, in sigmas, beyond what is left of the readings at hand, is
how far the new ones set the two apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from orthoglide.effects.wording import cause_short
from orthoglide.explanation import Cause, Explanation, FullPosterior
from orthoglide.fit import Problem
from orthoglide.fit.factors import Block, Factor
from orthoglide.fit.least_squares import linearise, nuisances
from orthoglide.geometry import Array
from orthoglide.instruments import AT_TOOL, OBSERVATIONS
from orthoglide.numerals import compact
from orthoglide.ordering import EQUAL, ranked
from orthoglide.parameters import plain_and_campaign
from orthoglide.planning.criteria import EffectSeparation
from orthoglide.planning.sheets import KINDS, tool_sheet
from orthoglide.planning.suggestions import Suggestion

TAKEN_BY = {kind: OBSERVATIONS[kind].words for kind in KINDS}
"""Kinds of readings, and what takes them."""

_TELLS = 3.0
"""Sigmas: the wrong one of two becomes less likely by a factor of 90, more than the odds between
members of a credible set."""

_NAMED = 2  # explanations in a sentence; of others their number
_KNOWN_TO = 0.1  # to which probabilities that decide are known
_TURNED = 60.0  # degrees, of a plate on its seat: the lobes of a shape of three come to its hollows
_LONGER = 0.04  # metres: as much again as a nozzle hangs below the joints of a platform
_SHEET = "; a sheet for it: orthoglide design --owns {0} --machine machine.toml --out {0}.csv"

Pair = tuple[Explanation, Explanation]


@dataclass(frozen=True)
class Proposal:
    """Readings that could be taken."""

    brief: str  # what they are
    how: str  # they are taken
    sheet: str  # where there is one
    problem: Problem  # of them alone, in the unknowns of the readings at hand


@dataclass(frozen=True)
class Decision:
    """What an instrument's readings would decide."""

    proposal: Proposal  # whose readings
    # sigmas between each two explanations of one cause, the likelier one first
    apart: dict[Pair, float]

    def of(self, cause: Cause, *, told: bool) -> list[Pair]:
        """Pairs of a cause that are told apart, or those that are not, likeliest first."""
        found = (p for p, sigmas in self.apart.items() if (sigmas >= _TELLS) == told)
        return ranked((p for p in found if p[0] in cause.explanations), _weight)

    @property
    def probability(self) -> float:
        """That of two machines, each with a cause as probable as it is, it tells which is which."""
        return sum(_weight(pair) for pair, sigmas in self.apart.items() if sigmas >= _TELLS)


def _weight(pair: Pair) -> float:
    return pair[0].probability * pair[1].probability


def deciding_instruments(known: FullPosterior, causes: Sequence[Cause]) -> tuple[Suggestion, ...]:
    """Instruments at the tool that would decide between rivals of the causes found, where no dial
    is set on the legs, with the most sigmas between two of them.

    First stands what decides between the likeliest: the sum of the products of the probabilities
    of any two that it tells apart is the largest. They are known to a tenth or so: of those alike
    by that first stands what needs least.
    """
    each = (ranked(cause.explanations, lambda one: one.probability) for cause in causes)
    pairs = [pair for likeliest_first in each for pair in combinations(likeliest_first, 2)]
    if not pairs:
        return ()
    several = [
        Decision(i, _apart(known, i.problem, pairs)) for i in _instruments(known.after.problem)
    ]
    order = _by_need(several)
    return tuple(_suggested(one, causes, several) for one in order if one.probability > 0)


def _by_need(several: Sequence[Decision]) -> list[Decision]:
    """Return decisions, given that of least need first, so that none stands behind one that is no
    better by more than what probabilities are known to.
    """
    left, order = [*several], list[Decision]()
    while left:
        most = max(one.probability for one in left)
        order.append(next(one for one in left if one.probability > most - _KNOWN_TO - EQUAL))
        left.remove(order[-1])
    return order


# -- what could be read ----------------------------------------------------------------------------


def _instruments(problem: Problem) -> Iterator[Proposal]:
    """Those that need least first."""
    plates = [
        (int(np.sum(f.setup == s)), k, s, f)
        for k, f, s, setup in problem.mounted
        if setup.observation.touches
    ]
    if plates:
        yield Proposal(
            f"a mesh with the plate turned by {_TURNED:.0f} degrees",
            f" on its seat, as a setup of its own with {_TURNED:.0f} under turned_deg (of a "
            f"printer: a profile of its own, imported with --turned NAME={_TURNED:.0f})",
            "",
            _turned(problem, *max(plates)[1:]),
        )
    long = f"{_LONGER * 1e3:.0f}"
    several = [(i, 0.0, i.words, i.how, _SHEET.format(i.kind)) for i in AT_TOOL.values() if i.how]
    several += [
        (i, _LONGER, f"{i.reads} by a tool {long} mm longer", f", a pen or a rod, around the rim "
         f"and across it, commanded {long} mm higher, as a setup of their own with -{long} under "
         f"beside_z_mm", "")
        for i in AT_TOOL.values() if i.how and i.paired
    ]  # fmt: skip
    for instrument, longer, brief, how, told in several:
        sheet = tool_sheet(problem.machine, instrument, longer)
        factor = Factor.unread(sheet, problem.machine)
        known = f"{how}, to {compact(float(factor.sigma[0]) * 1e3, 2)} {instrument.unit} each"
        yield Proposal(brief, known, told, _alone(problem, problem.last, factor))


def _turned(problem: Problem, k: int, setup: int, factor: Factor) -> Problem:
    """One setup's touches of a plate again, with the plate turned on its seat."""
    rows, own = factor.setup == setup, factor.readings.setups[setup]
    lies = replace(own, turned=own.turned + _TURNED)
    points = replace(factor.readings.subset(rows), setups=(lies,), setup=np.zeros(rows.sum(), int))
    again = Factor.of(points, problem.machine, factor.noise.of(rows))
    # Shapes without a name, of one degree as likely along all directions, are so when turned, too.
    curves, at = problem.curves, problem.factor_rows[k]
    if curves is not None:
        curves = Block(curves.columns[at][rows], curves.sd)
    return _alone(problem, k, again, curves)


def _alone(problem: Problem, k: int, factor: Factor, curves: Block | None = None) -> Problem:
    """Other readings alone, of the machine as it is to a factor of the problem."""
    return replace(
        problem,
        factors=(factor,),
        unknowns=tuple(replace(u, parts=(u.parts[k],)) for u in problem.unknowns),
        held=(problem.held[k],),
        curves=curves,
    )


# -- what it would tell ----------------------------------------------------------------------------


def _apart(known: FullPosterior, new: Problem, pairs: Sequence[Pair]) -> dict[Pair, float]:
    """Sigmas that new readings set pairs apart by."""
    problem, fixed = known.after.problem, known.mixture.linear.fixed[: known.about.known]
    # About the base: what causes do together is of the second order, and differs by what is there.
    x = problem.padded(known.before.x)
    at, then = linearise(problem, x), linearise(new, x)
    old = np.vstack([known.after.nuisance.project(at.jacobian), known.about.known_rows[0]])
    more = nuisances(new, then.seen).project(then.jacobian)
    base = np.diag(np.where(np.isnan(fixed), known.share, fixed) * problem.tolerance)
    several = list(dict.fromkeys(one for pair in pairs for one in pair))
    columns = np.hstack([base, np.stack([_of(one, problem) for one in several], axis=1)])
    index = np.array([[several.index(one) for one in pair] for pair in pairs])

    def squares(rows: Array) -> Array:
        shown = rows @ columns
        information = shown.T @ shown
        information[: len(base), : len(base)] += np.eye(len(base))
        return EffectSeparation(information, len(base), index).squares

    gained = squares(np.vstack([old, more])) - squares(old)
    return dict(zip(pairs, np.sqrt(np.maximum(gained, 0.0)).tolist(), strict=True))


def _of(one: Explanation, problem: Problem) -> Array:
    """A cause of its size in the unknowns ``(P,)``, SI."""
    setups = [s for f in problem.factors for s in f.setup_names]
    found = np.zeros(len(problem.names))
    for name, value in one.values.items():
        weights = one.catalogue.elementary(name, setups).items()
        of = {plain_and_campaign(parameter)[0]: w for parameter, w in weights}
        campaign = one.catalogue.parameter(name, setups).campaign
        mine = [not campaign or n.campaign in ("", campaign) for n in problem.names]
        found += value * np.array([of.get(n.plain, 0.0) for n in problem.names]) * mine
    return found


def _suggested(one: Decision, causes: Sequence[Cause], several: Sequence[Decision]) -> Suggestion:
    said = [text for cause in causes for text in _of_cause(one, cause, several)]
    i, most = one.proposal, max(one.apart.values())
    what = f"to tell the causes apart measure {i.brief}{i.how}"
    reason = f"{what}: {'; '.join(said)}{i.sheet}"
    return Suggestion(reason, "none", most, None, what=f"{what}{i.sheet}")


def _of_cause(one: Decision, cause: Cause, several: Sequence[Decision]) -> Iterator[str]:
    """What of a cause it tells, and the likeliest that it does not, with what would."""
    told, left = one.of(cause, told=True), one.of(cause, told=False)
    if told:
        first = told[0][0]
        rivals = {b: one.apart[a, b] for a, b in told if a is first}
        named = [_quoted(other) for other in rivals]
        if len(named) > _NAMED:
            named[_NAMED:] = [f"{len(named) - _NAMED} more"]
        listed = " and ".join([", ".join(named[:-1]), named[-1]] if named[1:] else named)
        least = f"{min(rivals.values()):.0f} sigma or more"
        yield f"it tells {_quoted(first)} from {listed}, by {least}"
    if left:
        a, b = left[0]
        others = [d.proposal.brief for d in several if d.apart[a, b] >= _TELLS]
        yield (
            f"it does not tell {_quoted(a)} from {_quoted(b)}, "
            f"{f'for that take {others[0]}' if others else 'as none of these does'}"
        )


def _quoted(one: Explanation) -> str:
    return f'"{cause_short(one.catalogue, one.name)}"'
