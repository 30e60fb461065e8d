"""What to measure next: the few readings that separate rivals or pin down a weak direction."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np

from orthoglide.fit import Estimate, WeakDirection
from orthoglide.frames import Framed
from orthoglide.geometry import Array
from orthoglide.instruments.leg_dial import PLACE
from orthoglide.machine import Machine
from orthoglide.observations import Readings, campaign_rows
from orthoglide.ordering import EQUAL_ODDS, best_of, ranked
from orthoglide.planning.choosing import choose
from orthoglide.planning.criteria import LeastVariance, RivalSeparation
from orthoglide.planning.linear import LinearReadings
from orthoglide.planning.pool import reading_pool, sheet
from orthoglide.planning.rivals import (
    Rival,
    Values,
    inseparable_groups,
    inseparable_words,
    rival_of,
)

Rivals = Sequence[tuple[str, "Values | Estimate"]]
Aim = Literal["separate", "narrow", "trace", "none"]
Pairs = dict[tuple[int, int], float]
"""Sigmas between two rivals, the smaller number first."""

ENOUGH = 6.0
"""Sigmas of separation beyond which no further reading is proposed."""

_NEVER = 2.0  # sigmas by the whole pool: rivals that no reading within reach tells apart
_HINTS = 1.0  # sigmas: less is not worth taking readings for
DECIDES = 2.0  # sigmas: less leaves both in one class, which is a chi2 of 4 wide
_WORTH = 0.9  # of a sigma before: readings that leave more are not worth taking
_MOST_DIRECTIONS = 2
_MOUNTING = 4.0  # readings that mounting a dial, with its first two, is worth


@dataclass(frozen=True)
class Suggestion(Framed):
    """A few readings to take, and why.

    Attributes:
        reason: what they are for and what is to be expected of them, in words.
        aim: ``separate`` rivals, ``narrow`` a weak direction, ``trace`` what nothing explains, or
            ``none`` where nothing helps.
        gain: for rivals the sigmas between the two least separated, by another instrument between
            the two most; for a direction how many times narrower it gets; nan of what nothing
            explains.
        pool: the readings to choose from; ``None`` where another instrument is what helps.
        chosen: those chosen, with repetitions; none where nothing helps.
        what: what to measure, without what is to be expected of it; empty where that is all of
            the reason.
    """

    reason: str
    aim: Aim
    gain: float
    pool: Readings | None
    chosen: tuple[int, ...] = ()
    what: str = ""

    @property
    def campaign(self) -> Readings | None:
        """The readings without their values; ``None`` where nothing helps."""
        return sheet(self.pool, self.chosen) if self.chosen and self.pool is not None else None

    @property
    def hopeless(self) -> bool:
        """Whether it says that nothing helps."""
        return self.aim == "none" and self.gain < DECIDES

    def __repr__(self) -> str:
        return f"<Suggestion, {len(self.chosen)} readings: {self.reason}>"

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The rows as campaign files have them, by column; empty where nothing helps."""
        rows = self.rows
        return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}

    @property
    def rows(self) -> tuple[dict[str, str], ...]:
        """The rows as campaign files have them, moves included, the reading left out."""
        if self.campaign is None:
            return ()
        table = campaign_rows(self.campaign)
        return tuple({k: v for k, v in row.items() if k != "reading_mm"} for row in table)


def next_sheet(suggestions: Sequence[Suggestion]) -> Readings | None:
    """One measuring sheet for all suggestions of a run; ``None`` where nothing helps.

    A visit that serves two purposes stands once.
    """
    pools: dict[tuple[Any, ...], Readings] = {}
    visits: dict[tuple[Any, ...], Counter[int]] = {}
    for suggestion in suggestions:
        pool = suggestion.pool
        if pool is not None and suggestion.chosen:
            key = (*pool.setups, len(pool))
            pools.setdefault(key, pool)
            visits[key] = visits.get(key, Counter()) | Counter(suggestion.chosen)
    sheets = [sheet(pools[key], tuple(wanted.elements())) for key, wanted in visits.items()]
    return Readings.concatenated(sheets) if sheets else None


def next_measurements(
    fit: Estimate,
    rivals: Rivals = (),
    machine: Machine | None = None,
    *,
    pairs: Sequence[tuple[int, int]] | None = None,
    count: int = 12,
    directions: Sequence[WeakDirection] | None = None,
    pool: Readings | None = None,
) -> tuple[Suggestion, ...]:
    """The few readings that would tell most, out of those that the machine can reach.

    Everything is linear around the fits, but for the readings that the rivals predict. Base
    parameters, the rivals' own and the new datums and places are fitted again on old and new
    readings together: what is counted is what no fit could explain away.

    Args:
        fit: of the readings at hand.
        rivals: explanations between which these cannot decide: names with all parameters of the
            machine as it is now, SI, or with their fits.
        machine: where the readings will be taken; the fit's where absent.
        pairs: of rivals that are to be told apart, by place; all where absent.
        count: readings to propose, at most, for each purpose.
        directions: to pin down; the fit's weakest two where absent, none where empty.
        pool: readings to choose from; all within reach where absent.

    Raises:
        InputError: for fewer than two readings.
    """
    machine = machine or fit.problem.machine
    weak = fit.weak[:_MOST_DIRECTIONS] if directions is None else directions
    scale = max(fit.sigma_scale, 1.0)
    several = [rival_of(name, found, fit, scale) for name, found in rivals]
    own = rival_of("", fit, fit, scale)
    names = tuple(dict.fromkeys(p for e in (own, *several) for p in e.parts))
    choice = pool or reading_pool(machine.geometry, load=usual_load(fit))
    at = machine.model.linearised(own.values, choice, names)
    total = fit.problem.noise.typical * scale
    readings = LinearReadings.around(
        machine, choice, at.jacobian, at.seen.by_nuisance[:, PLACE], total
    )
    found: list[Suggestion] = []
    every = [*combinations(range(len(several)), 2)] if pairs is None else pairs
    if every:
        predicted = [machine.model.readings(e.values, choice) for e in several]
        both = replace(readings, columns=np.column_stack([at.jacobian, *predicted]))
        found += to_separate(machine, both, names, several, every, count)
    for direction in weak:
        found.append(_to_narrow(readings, names, own, fit, direction, count))
    return tuple(found)


def usual_load(estimate: Estimate) -> float:
    """At the TCP over the last campaign, newtons; 0 where none is known."""
    if not estimate.problem.campaigns:
        return 0.0
    load = estimate.problem.campaigns[-1].load
    known = load[np.isfinite(load)]
    return float(np.median(known)) if len(known) else 0.0


def to_separate(
    machine: Machine,
    readings: LinearReadings,
    names: tuple[str, ...],
    several: Sequence[Rival],
    pairs: Sequence[tuple[int, int]],
    count: int,
) -> list[Suggestion]:
    """Readings between pairs of rivals, and the groups of rivals that none tells apart; the
    readings are by elementary parameters of these names, then as each rival predicts them.
    """
    spread = np.stack([e.spread(names) for e in several])
    every = RivalSeparation.between(spread, np.array(pairs))
    most = replace(every, information=readings.information()).sigmas
    never = {pair: sigmas for pair, sigmas in most.items() if sigmas < _NEVER}
    rows, end, weak = _for_pairs(readings, spread, [p for p in most if p not in never], count)
    pool, level = readings.campaign, float(readings.sigma.max())
    found = []
    for group, sigmas in inseparable_groups({**never, **weak}):
        rivals = [several[k] for k in group]
        text = inseparable_words(machine, rivals, sigmas, len(pool), level)
        found.append(Suggestion(text, "none", sigmas, pool))
    if end is None:
        return found
    least = ranked(end.sigmas.items(), lambda item: -float(np.log(item[1])), EQUAL_ODDS)
    text = "; ".join(
        f"{several[a].name} from {several[b].name} by {s:.1f} sigma" for (a, b), s in least[:3]
    )
    more = f" (and {len(least) - 3} further pairs by more)" if len(least) > 3 else ""
    reason = f"{_size(pool, rows)} expected to separate {text}{more}"
    gain = least[0][1]
    if gain < DECIDES:
        reason += ": too little to decide, but the most that so few readings can do"
    return [Suggestion(reason, "separate", gain, pool, rows), *found]


def _for_pairs(
    readings: LinearReadings, spread: Array, pairs: Sequence[tuple[int, int]], count: int
) -> tuple[tuple[int, ...], RivalSeparation | None, Pairs]:
    """Readings for the pairs that so few of them can separate; the others with what they reach."""
    weak: Pairs = {}
    pairs = list(pairs)
    while pairs:
        start = RivalSeparation.between(spread, np.array(pairs), ENOUGH**2)
        rows, end = choose(readings, start, count, mounting=_MOUNTING)
        low = [pair for pair, sigmas in end.sigmas.items() if sigmas < _HINTS]
        # A pair may have come off badly for the sake of others: it counts alone.
        alone = {pair: _alone(readings, spread, pair, count) for pair in low}
        out = {pair: sigmas for pair, sigmas in alone.items() if sigmas < _HINTS}
        if not out:
            # Every station is visited again where there is room: a single visit may be misread.
            again = [k for k in rows if rows.count(k) == 1]
            if again and len(rows) + len(again) <= count:
                rows = (*rows, *again)
                end = start.with_rows(readings, [*rows])
            return rows, end, weak
        weak |= out
        pairs = [pair for pair in pairs if pair not in out]
    return (), None, weak


def _alone(readings: LinearReadings, spread: Array, pair: tuple[int, int], count: int) -> float:
    """Sigmas between two rivals by the best readings for them alone."""
    size = spread.shape[1]
    here = replace(readings, columns=readings.columns[:, [*range(size), *(size + k for k in pair)]])
    start = RivalSeparation.between(spread[list(pair)], np.array([(0, 1)]), ENOUGH**2)
    return choose(here, start, count, mounting=_MOUNTING)[1].sigmas[0, 1]


def _to_narrow(
    readings: LinearReadings,
    names: tuple[str, ...],
    own: Rival,
    estimate: Estimate,
    direction: WeakDirection,
    count: int,
) -> Suggestion:
    """Readings for one weak direction of the fit, in its own unknowns, each in its tolerance."""
    shares = direction.parameters
    d = np.array([shares.get(n, 0.0) for n in estimate.problem.names])
    unit = estimate.unit(best_of(shares, lambda n: abs(shares[n])))
    tolerance = estimate.problem.tolerance
    here = replace(readings, columns=readings.columns @ (own.weights_of(names) * tolerance))
    information = np.linalg.inv(own.covariance / tolerance / tolerance[:, None])
    start = LeastVariance(np.asarray(information), d * tolerance)
    rows, end = choose(here, start, count, mounting=_MOUNTING)
    before, after = (np.sqrt(o.variance) / unit.si for o in (start, end))
    along = " ".join(f"{share:+.2f} {name}" for name, share in shares.items())
    gain = float(before / after)
    if not rows or after > _WORTH * before:
        reason = (
            f"no {count} readings of a dial on a leg narrow {' and '.join(shares)} noticeably: "
            f"sigma along {along} stays at {before:.2g}{unit.behind}, as the tolerances have it"
        )
        return Suggestion(reason, "none", gain, here.campaign)
    reason = (
        f"{_size(here.campaign, rows)} expected to narrow {' and '.join(shares)}: sigma along "
        f"{along} from {before:.2g} to {after:.2g}{unit.behind}"
    )
    return Suggestion(reason, "narrow", gain, here.campaign, rows)


def _size(pool: Readings, rows: Sequence[int]) -> str:
    setups = len(np.unique(pool.setup[list(rows)]))
    return f"{len(rows)} readings in {setups} {'setup' if setups == 1 else 'setups'} are"
