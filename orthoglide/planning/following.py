"""What to measure next: the few readings that separate rivals or pin down a weak direction."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from orthoglide.diagnosis.signatures import Signatures
from orthoglide.effects import is_dial
from orthoglide.fit import Estimate, WeakDirection
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, campaign_rows
from orthoglide.planning.alike import groups, in_words
from orthoglide.planning.bench import Bench
from orthoglide.planning.choosing import choose, replayed
from orthoglide.planning.expected import scatter_of
from orthoglide.planning.explanations import Explanation, Values, explanation
from orthoglide.planning.objectives import Narrow, Separate
from orthoglide.planning.pool import reading_pool, sheet

Rivals = Sequence[tuple[str, "Values | Estimate"]]
Aim = Literal["separate", "narrow", "none"]

ENOUGH = 6.0
"""Sigmas of separation beyond which no further reading is proposed."""

_NEVER = 2.0  # sigmas by the whole pool: rivals that no reading within reach tells apart
_HINTS = 1.0  # sigmas: less is not worth taking readings for
_DECIDES = 2.0  # sigmas: less leaves both in one class, which is a chi2 of 4 wide
_WORTH = 0.9  # of a sigma before: readings that leave more are not worth taking
_MOST_DIRECTIONS = 2
_MOUNTING = 4.0  # readings that mounting a dial, with its first two, is worth


@dataclass(frozen=True)
class Suggestion:
    """A few readings to take, and why.

    Attributes:
        reason: what they are for and what is to be expected of them, in words.
        aim: ``separate`` rivals, ``narrow`` a weak direction, or ``none`` where nothing helps.
        gain: for rivals the sigmas between the two least separated; for a direction how many times
            narrower it gets.
        pool: the readings to choose from.
        chosen: those chosen, with repetitions; none where nothing helps.
    """

    reason: str
    aim: Aim
    gain: float
    pool: Campaign
    chosen: tuple[int, ...] = ()

    @property
    def campaign(self) -> Campaign | None:
        """The readings without their values; ``None`` where nothing helps."""
        return sheet(self.pool, self.chosen) if self.chosen else None

    @property
    def rows(self) -> tuple[dict[str, str], ...]:
        """The rows as campaign files have them, moves included, the reading left out."""
        if self.campaign is None:
            return ()
        table = campaign_rows(self.campaign)
        return tuple({k: v for k, v in row.items() if k != "reading_mm"} for row in table)


def next_sheet(suggestions: Sequence[Suggestion]) -> Campaign | None:
    """One measuring sheet for all suggestions of a run; ``None`` where nothing helps.

    A visit that serves two purposes stands once.
    """
    visits: Counter[int] = Counter()
    for suggestion in suggestions:
        visits |= Counter(suggestion.chosen)
    return sheet(suggestions[0].pool, tuple(visits.elements())) if visits else None


def next_measurements(
    fit: Estimate | Signatures,
    rivals: Rivals = (),
    machine: Machine | None = None,
    *,
    count: int = 12,
    directions: Sequence[WeakDirection] | None = None,
    pool: Campaign | None = None,
) -> tuple[Suggestion, ...]:
    """The few readings that would tell most, out of those that the machine can reach.

    Everything is linear around the fits, but for the readings that the rivals predict. Base
    parameters, the rivals' own and the new datums and places are fitted again on old and new
    readings together: what is counted is what no fit could explain away.

    Args:
        fit: of the readings at hand.
        rivals: explanations between which these cannot decide: names with all parameters of the
            last campaign's machine, SI, or with their fits.
        machine: where the readings will be taken; the fit's where absent.
        count: readings to propose, at most, for each purpose.
        directions: to pin down; the fit's weakest two where absent, none where empty.
        pool: readings to choose from; all of :func:`reading_pool` where absent.

    Raises:
        InputError: for fewer than two readings.
    """
    estimate = fit.estimate if isinstance(fit, Signatures) else fit
    machine = machine or estimate.problem.machine
    last = estimate.problem.campaigns[-1]
    known = last.load[np.isfinite(last.load)]
    load = float(np.median(known)) if len(known) else 0.0
    choice = pool or reading_pool(machine.geometry, load=load)
    weak = estimate.weak[:_MOST_DIRECTIONS] if directions is None else directions
    scale = max(estimate.sigma_scale, 1.0)
    several = [explanation(name, found, estimate, scale) for name, found in rivals]
    own = explanation("", estimate, estimate, scale)
    bench, names = _bench(machine, choice, estimate, [own, *several], scale)
    found: list[Suggestion] = []
    if len(several) > 1:
        found += _to_separate(bench, names, several, count, machine)
    for direction in weak:
        found.append(_to_narrow(bench, names, own, estimate, direction, count))
    return tuple(found)


def _bench(
    machine: Machine,
    pool: Campaign,
    estimate: Estimate,
    explanations: Sequence[Explanation],
    scale: float,
) -> tuple[Bench, tuple[str, ...]]:
    """The pool by all parameters in question, then what each explanation predicts of it."""
    names = tuple(dict.fromkeys(p for e in explanations for p in e.parts))
    here = {n: v for n, v in explanations[0].values.items() if not is_dial(n)}
    model = machine.model
    readings = model.linearised(here, pool, names)
    predicted = [
        model.readings({n: v for n, v in e.values.items() if not is_dial(n)}, pool)
        for e in explanations[1:]
    ]
    columns = np.column_stack([readings.jacobian, *predicted])
    scatter = scatter_of(machine, estimate.problem.noise.typical * scale)
    return Bench(pool, columns, readings.by_gauge, scatter), names


def _to_separate(
    bench: Bench,
    names: tuple[str, ...],
    several: Sequence[Explanation],
    count: int,
    machine: Machine,
) -> list[Suggestion]:
    spread = np.stack([e.spread(names) for e in several])
    pairs = np.array([(a, b) for a in range(len(several)) for b in range(len(several)) if a != b])
    most = np.sqrt([_by_everything(bench, spread, len(names), a, b) for a, b in pairs])
    most = np.minimum(most, most[[_place(pairs, b, a) for a, b in pairs]])
    together = {(int(a), int(b)): float(m) for (a, b), m in zip(pairs, most, strict=True)}
    rows, end, weak = _for_pairs(bench, spread, pairs[most >= _NEVER], count)
    never = {pair: sigmas for pair, sigmas in together.items() if sigmas < _NEVER}
    found = [
        Suggestion(
            in_words(machine, bench, [several[k] for k in group], sigmas),
            "none",
            sigmas,
            bench.pool,
        )
        for group, sigmas in groups({**never, **weak})
    ]
    if end is None:
        return found
    least = {(a, b): s for (a, b), s in _least(end).items() if a < b}
    gain = min(least.values())
    text = "; ".join(
        f"{several[a].name} from {several[b].name} by {s:.1f} sigma"
        for (a, b), s in sorted(least.items(), key=lambda item: item[1])[:3]
    )
    more = f" (and {len(least) - 3} further pairs by more)" if len(least) > 3 else ""
    chosen = sheet(bench.pool, rows)
    reason = f"{_size(chosen)} expected to separate {text}{more}"
    if gain < _DECIDES:
        reason += ": too little to decide, but the most that so few readings can do"
    return [Suggestion(reason, "separate", gain, bench.pool, rows), *found]


def _for_pairs(
    bench: Bench, spread: Array, pairs: Array, count: int
) -> tuple[tuple[int, ...], Separate | None, dict[tuple[int, int], float]]:
    """Readings for the pairs that so few of them can separate; the others with what they reach."""
    weak: dict[tuple[int, int], float] = {}
    while len(pairs):
        start, rows, end, least = _chosen(bench, spread, pairs, count)
        low = [pair for pair, s in least.items() if s < _HINTS and pair[0] < pair[1]]
        # A pair may have come off badly for the sake of others: it counts alone.
        alone = {pair: _alone(bench, spread, pair, count) for pair in low}
        out = {pair: sigmas for pair, sigmas in alone.items() if sigmas < _HINTS}
        if not out:
            return (*_twice(bench, start, rows, end, count), weak)
        weak |= out
        pairs = pairs[[(min(p), max(p)) not in out for p in pairs.tolist()]]
    return (), None, weak


def _chosen(
    bench: Bench, spread: Array, pairs: Array, count: int
) -> tuple[Separate, tuple[int, ...], Separate, dict[tuple[int, int], float]]:
    """Start, rows and end of a choice for ordered pairs; sigmas by pair, the lesser way round."""
    nothing = np.zeros((len(pairs), spread.shape[1]))
    start = Separate(spread, pairs, nothing, np.zeros(len(pairs)), ENOUGH**2)
    rows, end = choose(bench, start, count, mounting=_MOUNTING)
    return start, rows, end, _least(end)


def _alone(bench: Bench, spread: Array, pair: tuple[int, int], count: int) -> float:
    """Sigmas between two rivals by the best readings for them alone."""
    size = spread.shape[1]
    columns = bench.columns[:, [*range(size), *(size + k for k in pair)]]
    here = Bench(bench.pool, columns, bench.slope, bench.scatter)
    return _chosen(here, spread[list(pair)], np.array([(0, 1), (1, 0)]), count)[3][0, 1]


def _least(end: Separate) -> dict[tuple[int, int], float]:
    sigmas = dict(zip(map(tuple, end.pairs.tolist()), np.sqrt(end.chi2).tolist(), strict=True))
    return {(a, b): min(s, sigmas[b, a]) for (a, b), s in sigmas.items()}


def _twice(
    bench: Bench, start: Separate, rows: tuple[int, ...], end: Separate, count: int
) -> tuple[tuple[int, ...], Separate]:
    """Every station visited again where there is room: a single visit may be misread."""
    alone = [k for k in rows if rows.count(k) == 1]
    if len(rows) + len(alone) > count or not alone:
        return rows, end
    more = (*rows, *alone)
    return more, replayed(bench, start, more)


def _place(pairs: Array, a: int, b: int) -> int:
    return int(np.flatnonzero((pairs == (a, b)).all(axis=1))[0])


def _by_everything(bench: Bench, spread: Array, size: int, a: int, b: int) -> float:
    """Expected chi2 of rival b were a true, after every reading of the pool."""
    W = bench.everything
    e = np.zeros(len(W) - size)
    e[a], e[b] = 1.0, -1.0
    toward = W[:size, size:] @ e
    # (C^-1 + W)^-1 = C (1 + W C)^-1, whatever C's rank.
    absorbed = spread[b] @ np.linalg.solve(np.eye(size) + W[:size, :size] @ spread[b], toward)
    return float(max(e @ W[size:, size:] @ e - toward @ absorbed, 0.0))


def _to_narrow(
    bench: Bench,
    names: tuple[str, ...],
    own: Explanation,
    estimate: Estimate,
    direction: WeakDirection,
    count: int,
) -> Suggestion:
    """Readings for one weak direction of the fit."""
    from orthoglide.effects import family_of

    unknowns = estimate.problem.names
    d = np.array([direction.parameters.get(n, 0.0) for n in unknowns])
    unit = family_of(max(direction.parameters, key=lambda n: abs(direction.parameters[n]))).unit
    # The bench in the fit's own unknowns, each in its tolerance.
    size = estimate.problem.tolerance
    weights = np.zeros((len(names), len(unknowns)))
    for part, row in zip(own.parts, own.weights, strict=True):
        weights[names.index(part)] = row
    columns = bench.columns[:, : len(names)] @ (weights * size)
    here = Bench(bench.pool, columns, bench.slope, bench.scatter)
    start = Narrow(own.covariance / size / size[:, None], d * size)
    rows, end = choose(here, start, count, mounting=_MOUNTING)
    before, after = (np.sqrt(o.variance) / unit.si for o in (start, end))
    what = " and ".join(direction.parameters)
    along = " ".join(f"{share:+.2f} {name}" for name, share in direction.parameters.items())
    if not rows or after > _WORTH * before:
        reason = (
            f"no {count} readings of a dial on a leg narrow {along} noticeably: sigma stays at "
            f"{before:.2g} {unit.name}, which is knowledge of the tolerances"
        )
        return Suggestion(reason, "none", float(before / after), here.pool)
    chosen = sheet(here.pool, rows)
    reason = (
        f"{_size(chosen)} expected to narrow {what}: sigma along {along} from {before:.2g} to "
        f"{after:.2g} {unit.name}"
    )
    return Suggestion(reason, "narrow", float(before / after), here.pool, rows)


def _size(campaign: Campaign) -> str:
    n, m = len(campaign), len(campaign.setups)
    return f"{n} readings in {m} {'setup' if m == 1 else 'setups'} are"


def as_result(suggestions: Sequence[Suggestion]) -> list[Mapping[str, Any]]:
    """As ``next_measurements`` stands in ``result.json``."""
    return [{"reason": s.reason, "readings": list(s.rows)} for s in suggestions]
