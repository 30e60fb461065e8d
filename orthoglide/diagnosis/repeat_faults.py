"""Faults that repeats betray: outliers and knocked stands against visits to the same station."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Kind, campaign_of, message, untouched
from orthoglide.diagnosis.scatter import Scatter, median_scatter
from orthoglide.errors import InputError
from orthoglide.fit import Problem
from orthoglide.fit.noise import PUBLISHED_REPEATABILITY
from orthoglide.geometry import Array
from orthoglide.ordering import EQUAL_ODDS, best_of, largest

_BEYOND = 3.0  # times what a dial scatters, that nothing of it explains
_FEWEST_REPEATS = 4  # degrees of freedom from which a setup may be said to scatter
_STEPS: dict[Kind, float] = {"outlier": 3.0, "knocked_stand": 2.0}  # of the instrument: least size
_MOST = 6
_NOISY = 4.0  # times the noise of all setups, that one may scatter about what was found in it
_NO_DRIFT = 8e-5  # metres from one repeat to the next: more than warmth or a creeping stand does
_EACH, _ONCE = 2.0, 3.5
"""Log of odds against each power of a drift and each new datum of a dial that is set to zero at
every repeat; and against one that was so once: more likely than that twice, of three repeats."""

_TREND_MARGIN = 12.0  # fall of chi2, over the noise, by which a step must beat a smooth drift


def noise_scale(problem: Problem, setups: Sequence[Scatter]) -> float:
    """Squared scatter of all readings of dials about their stations, whitened, within a repeat or
    over all, whichever is less.
    """
    least = 1.0
    if problem.noise.source == "repeats":
        least = (problem.noise.resolution / problem.noise.typical) ** 2 / 12
    # Where dials were set to zero anew, only the visits of one repeat show what they scatter by.
    each = [square / dof for square, dof in (s.within for s in setups) if dof >= 2]
    inside = float(np.median(each)) if each else np.inf
    return min(median_scatter(setups, least), max(inside, least))


def searches(problem: Problem, setups: Sequence[Scatter]) -> list[Slips]:
    """A search for slips in every setup, whose dial has a step of its own."""
    scale, count = noise_scale(problem, setups), len(problem.measured)
    steps = [float(problem.step[s.rows].max(initial=0.0)) for s in setups]
    each = [Slips(s, scale, step, count) for s, step in zip(setups, steps, strict=True)]
    home = [campaign_of(problem, s.rows) for s in setups]
    for part in set(home):
        own = [k for k, campaign in enumerate(home) if campaign == part]
        # Who sets most dials to zero anew between repeats does so with all, at each.
        if 2 * sum(each[k].between for k in own) <= len(own) or len(own) == 1:
            continue
        for k in own:
            if len(setups[k].starts) and not each[k].zeroed:
                each[k] = replace(each[k], habit=True)
    return each


def repeat_faults(problem: Problem, setups: Sequence[Slips], known: Sequence[Fault]) -> list[Fault]:
    """Outliers and knocked stands that repeats show; setups of known faults are left alone."""
    free = untouched(problem, known)
    able = [s for s in setups if s.scatter.dof >= 2 and s.scatter.setup in free]
    found = [fault for slips in able for fault in slips.confirmed()]
    return [*_zeroed(problem, found), *(f for f in found if f.kind != "zeroed")]


def _zeroed(problem: Problem, faults: Sequence[Fault]) -> Iterator[Fault]:
    """Dials of a campaign that were set to zero anew, as one fault, in the order of setups."""
    by_home: dict[int, list[Fault]] = {}
    for fault in faults:
        if fault.kind == "zeroed":
            by_home.setdefault(campaign_of(problem, fault.rows), []).append(fault)
    for each in by_home.values():
        yield Fault(
            "zeroed",
            np.concatenate([f.rows for f in each]),
            tuple(f.setups[0] for f in each),
            evidence=sum(f.evidence for f in each),
            sizes=tuple(size for f in each for size in f.sizes),
        )


def scatter_faults(
    problem: Problem, setups: Sequence[Slips], known: Sequence[Fault]
) -> list[Fault]:
    """Setups whose repeats do not repeat: by more than any dial scatters, slips set aside; those of
    known faults are left alone.

    Noise that is taken from the repeats believes anything of them: here it is held against what
    the machine file says of the dial, or what dials are like.

    Raises:
        InputError: where most setups are like that: then none of their rows can be believed.
    """
    if problem.noise.source == "declared":
        return []
    dial = max(PUBLISHED_REPEATABILITY, problem.machine.spec.dial.repeatability or 0.0)
    found = []
    for slips in setups:
        size, own = slips.spread(), slips.scatter
        if size > _BEYOND * max(dial, slips.step):
            found.append(Fault("scatter", own.rows, (own.setup,), size))
    if 2 * len(found) > len(setups):
        raise InputError(message(problem, found[0]) + "; most other setups are no better")
    free = untouched(problem, known)
    return [fault for fault in found if fault.setups[0] in free]


_Place = tuple[Kind | Literal["trend", "anew"], int]
"""A fault at a reading, a trend of some powers of time, or a datum anew at each repeat."""


@dataclass(frozen=True)
class Slips:
    """A search for slips in one setup."""

    scatter: Scatter  # of the setup
    scale: float  # squared scatter of all readings, whitened
    step: float  # of the instrument, metres or radians
    count: int  # of readings, any of which may have slipped
    habit: bool = False  # whether most dials of the campaign were set to zero anew at each repeat

    def columns(self, item: _Place) -> Array:
        """What it would show of the setup's readings ``(k, c)``."""
        kind, place = item
        if kind == "trend":
            return self.scatter.past(self.scatter.trend[:, :place])
        if kind == "anew":
            return self.scatter.anew
        return self.scatter.column(kind, place)

    @cached_property
    def found(self) -> list[_Place]:
        """What is likeliest: slips and trends, or a datum anew at each repeat and these beside."""
        return self._anew if self.zeroed else self._slips

    @cached_property
    def zeroed(self) -> bool:
        """Whether the dial was set to zero anew at each repeat."""
        largest = np.abs(self.scatter.datums).max(initial=0.0)
        if self.habit or largest <= (_STEPS["knocked_stand"] - 0.5) * self.step:
            return self.habit
        # Warmth comes and goes in steps and trends besides.
        if not all(kind in ("anew", "outlier") for kind, _ in self._anew):
            return False
        # Of two repeats a drift shows what a step does; one as large as this is none.
        margin = EVIDENCE if largest > _NO_DRIFT and len(self.scatter.starts) == 1 else 0.0
        likelier = self._score(self._anew) + margin > self._score(self._slips)
        return likelier and self._anew_evidence >= EVIDENCE

    @property
    def between(self) -> bool:
        """Whether it was so at some repeats at least, and was not knocked elsewhere."""
        steps = {place for kind, place in self._slips if kind == "knocked_stand"}
        return self.zeroed or (bool(steps) and steps <= set(self.scatter.starts.tolist()))

    @cached_property
    def _anew_evidence(self) -> float:
        """Log evidence for a datum anew at each repeat, beside what was found with it."""
        return self._score(self._anew) - self._score(self._anew[1:])

    @cached_property
    def _slips(self) -> list[_Place]:
        return self._pruned(self._search(self.scatter))

    @cached_property
    def _anew(self) -> list[_Place]:
        scatter = self.scatter
        anew: _Place = ("anew", len(scatter.starts))
        return self._pruned([anew, *self._search(scatter.without(scatter.anew))], keep=1)

    def _pruned(self, found: list[_Place], keep: int = 0) -> list[_Place]:
        """Without what later finds explain as well: two steps look like a trend at first."""
        fewer = [found[:k] + found[k + 1 :] for k in range(keep, len(found))]
        best = best_of((found, *fewer), self._score, EQUAL_ODDS)
        return found if best is found else self._pruned(best, keep)

    def _score(self, found: list[_Place]) -> float:
        """Log evidence for all of some faults and trends together."""
        past = self._past(found)
        gain, size = self.scatter.chi2 - past.chi2, self.scatter.dof - past.dof
        evidence = float(self.scatter.evidence(gain, size, self.scale))
        return evidence - sum(self._unlikely(*item) for item in found)

    def _unlikely(self, kind: Kind | Literal["trend", "anew"], place: int) -> float:
        """Log of how many alike there are, or of how long a drift's powers are."""
        if kind not in _STEPS:
            return _EACH * place
        if kind == "knocked_stand" and place in self.scatter.starts:
            return _ONCE
        return float(np.log(self.count))

    def _search(self, now: Scatter) -> list[_Place]:
        """The best of outliers, steps and trends, one after the other, until none is left."""
        found: list[_Place] = []
        for _ in range(_MOST):
            evidence, item = self._best(now)
            past = now.without(self.columns(item))
            if evidence < EVIDENCE:
                # Two of a size are noise to each other.
                second, other = self._best(past)
                if "trend" in (item[0], other[0]) or evidence + second < 2 * EVIDENCE:
                    break
                found.append(item)
                item, past = other, past.without(self.columns(other))
            found.append(item)
            now = past
        return found

    def _best(self, now: Scatter) -> tuple[float, _Place]:
        return best_of(self._choices(now), lambda choice: choice[0], EQUAL_ODDS)

    def _choices(self, now: Scatter) -> Iterator[tuple[float, _Place]]:
        """The best of each kind, its evidence less the logarithm of the number of its like."""
        for kind, least in _STEPS.items():
            gain, size = now.gains(kind)
            evidence = self._evidence(now, gain)
            too_small = (least - 0.5) * self.step
            evidence[np.abs(size) < too_small] = -np.inf
            # Of two visits that contradict each other the one that fits worse.
            even = np.flatnonzero(evidence >= evidence.max() - EQUAL_ODDS)
            place = int(even[largest(np.abs(now.fitted[even]))])
            yield float(evidence[place]), (kind, place)
        for power in (1, 3):
            fall = now.gain(now.past(now.trend[:, :power]))
            yield float(now.evidence(fall, power, self.scale)) - _EACH * power, ("trend", power)

    def _evidence(self, now: Scatter, gain: ArrayLike) -> Array:
        return now.evidence(gain, 1, self.scale) - np.log(self.count)

    def _past(self, found: list[_Place]) -> Scatter:
        """The scatter with all that was found set free."""
        columns = [self.columns(item) for item in found]
        return self.scatter.without(np.hstack(columns)) if found else self.scatter

    def spread(self) -> float:
        """Standard deviation of the readings about what slips leave of them, metres or radians; 0
        where there are too few repeats.
        """
        if self.scatter.dof < _FEWEST_REPEATS:
            return 0.0
        last = self._past(self.found)
        if 2 * last.dof < self.scatter.dof:
            last = self.scatter  # as many slips as readings are none
        return float(np.sqrt(last.chi2 / last.dof) / np.sqrt(np.mean(last.weight**2)))

    def confirmed(self) -> list[Fault]:
        """Faults that stand beside all others found, and no smooth trend in their place."""
        scatter, found = self.scatter, self.found
        last = self._past(found)
        noisy = last.chi2 > _NOISY * self.scale * max(last.dof, 1) or 2 * last.dof < scatter.dof
        outliers = sum(kind == "outlier" for kind, _ in found)
        if noisy or outliers > max(2, len(scatter.rows) // 6):
            return []  # a setup that scatters as a whole is no handful of slips
        faults = []
        if self.zeroed:
            sizes = tuple(np.cumsum(self._past(found[1:]).datums).tolist())
            rows, evidence = scatter.rows[scatter.starts[0] :], self._anew_evidence
            faults.append(Fault("zeroed", rows, (scatter.setup,), evidence=evidence, sizes=sizes))
        for k, (kind, place) in enumerate(found):
            if kind == "trend" or kind == "anew":
                continue
            rest = self._past(found[:k] + found[k + 1 :])
            gain, size = (values[place] for values in rest.gains(kind))
            step = kind == "knocked_stand"
            smooth = step and self._smooth(rest, float(gain))
            evidence = float(self._evidence(rest, gain))
            if evidence >= EVIDENCE and not smooth:
                rows = scatter.rows[place:] if step else scatter.rows[[place]]
                faults.append(Fault(kind, rows, (scatter.setup,), float(size), evidence))
        return faults

    def _smooth(self, rest: Scatter, gain: float) -> bool:
        """Whether a drift over time explains a step of some gain nearly as well."""
        noise = max(self.scale, max(rest.chi2 - gain, 0.0) / max(rest.dof - 1, 1))
        return gain - rest.gain(rest.past(rest.trend[:, :2])) <= _TREND_MARGIN * noise
