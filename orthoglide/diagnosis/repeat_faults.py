"""Faults that repeats betray: outliers and knocked stands against visits to the same station.

Whatever a machine does that depends on its posture and approach, it does again at every repeat.
Within a setup the readings less their station's mean therefore hold noise, slow drifts and faults,
and nothing of the causes in the catalogue or outside it that do not change with time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.diagnosis.faults import (
    EVIDENCE,
    Fault,
    Kind,
    Rows,
    clock,
    in_order,
    message,
    untouched,
)
from orthoglide.diagnosis.station_means import orthonormal
from orthoglide.errors import InputError
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.least_squares import past
from orthoglide.fit.noise import PUBLISHED_REPEATABILITY
from orthoglide.geometry import Array
from orthoglide.observations.arrays import numbered

_REPEATS = 8.0  # times the variance of visits, that stations have where these repeat anything
_BEYOND = 3.0  # times what a dial scatters, that nothing of it explains
_FEWEST_REPEATS = 4  # degrees of freedom from which a setup may be said to scatter
_FEWEST_STATIONS = 8  # with repeats, of which a median says something
_FEWEST = 2  # readings on either side of a knock: fewer are outliers
_PRIOR_DOF = 10.0  # weight of the noise of all setups against the scatter within one
_STEPS: dict[Kind, float] = {"outlier": 3.0, "knocked_stand": 2.0}  # of the dial: least size
_MOST = 6
_NOISY = 4.0  # times the noise of all setups, that one may scatter about what was found in it
_TREND_MARGIN = 12.0  # fall of chi2, over the noise, by which a step must beat a smooth drift


@dataclass(frozen=True)
class Scatter:
    """A setup's readings about their stations' means, whitened, in the order they were taken.

    Attributes:
        setup: numbered over all campaigns.
        rows: stacked ``(k,)``.
        weight: 1 / sigma ``(k,)``.
        station: of each ``(k,)``, numbered within the setup.
        read: whitened readings less the fit ``(k,)``.
        trend: whitened powers of time 1 to 3 ``(k, 3)``.
        fitted: whitened residuals of the fit to all readings ``(k,)``.
        found: orthonormal columns of what was found already, past the means ``(k, q)``.
    """

    setup: int
    rows: Rows
    weight: Array
    station: Rows
    read: Array
    trend: Array
    fitted: Array
    found: Array

    @classmethod
    def of(cls, estimate: Estimate, setup: int) -> Scatter:
        """Of a setup, numbered over all campaigns."""
        problem = estimate.problem
        rows = in_order(problem, setup)
        weight = 1 / np.hypot(problem.sigma, problem.noise.common)[rows]
        station = numbered(problem.station[rows])
        rest = (problem.measured - estimate.at.value)[rows] * weight
        time = np.concatenate([c.time for c in problem.campaigns])[rows]
        along = clock(time, np.arange(len(rows)))
        powers = along[:, None] ** [1, 2, 3] * weight[:, None]
        fitted = estimate.residuals[rows] * weight
        return cls(setup, rows, weight, station, rest, powers, fitted, np.zeros((len(rows), 0)))

    @property
    def dof(self) -> int:
        """Degrees of freedom of the scatter."""
        return len(self.rows) - len(np.unique(self.station)) - self.found.shape[1]

    def repeats(self, problem: Problem) -> bool:
        """Whether stations differ by more than the visits to one: else rows are mixed up."""
        shown = problem.measured[self.rows] * self.weight
        about = float(np.sum((shown - np.mean(problem.measured[self.rows]) * self.weight) ** 2))
        inside = float(np.sum(self.past(shown) ** 2))
        stations = len(np.unique(self.station))
        between = (about - inside) / max(stations - 1, 1)
        return between > _REPEATS * inside / max(self.dof, 1)

    @cached_property
    def share(self) -> Array:
        """Of each reading in its station's mean ``(k,)``."""
        square = self.weight**2
        return np.asarray(square / np.bincount(self.station, square)[self.station])

    def past(self, columns: Array) -> Array:
        """Whitened columns ``(k, ...)`` about their stations' means, past what was found."""
        metres = (columns.T / self.weight * self.share).T
        total = np.zeros((int(self.station.max(initial=-1)) + 1, *columns.shape[1:]))
        np.add.at(total, self.station, metres)
        return past(self.found, columns - (total[self.station].T * self.weight).T)

    @cached_property
    def rest(self) -> Array:
        """Whitened readings about their stations' means, past what was found ``(k,)``."""
        return self.past(self.read)

    @property
    def chi2(self) -> float:
        """Square of ``rest``."""
        return float(self.rest @ self.rest)

    def by_station(self) -> Array:
        """Squared scatter of each station with repeats, over what half of all are below."""
        from scipy.special import chdtri

        dof = np.bincount(self.station) - 1.0
        square = np.bincount(self.station, self.rest**2)
        return np.asarray(square[dof > 0] / chdtri(dof[dof > 0], 0.5))

    def only(self, kept: NDArray[np.bool_]) -> Scatter:
        """Of some of the readings ``(k,)``, nothing found yet."""
        names = ("rows", "weight", "read", "trend", "fitted")
        parts = {name: getattr(self, name)[kept] for name in names}
        station = numbered(self.station[kept])
        return replace(self, **parts, station=station, found=np.zeros((int(kept.sum()), 0)))

    def column(self, kind: Kind, place: int) -> Array:
        """What a fault at a reading would show: that one off, or all from there on ``(k, 1)``."""
        k = np.arange(len(self.rows))
        shown = k == place if kind == "outlier" else k >= place
        return self.past((shown * self.weight)[:, None])

    def without(self, columns: Array) -> Scatter:
        """With whitened columns ``(k, c)`` set free besides."""
        free = orthonormal(np.hstack([self.found, self.past(columns)]))
        return replace(self, found=free)

    def gain(self, columns: Array) -> float:
        """Fall of chi2 by several columns together."""
        return float(np.sum((orthonormal(columns).T @ self.rest) ** 2))

    def gains(self, kind: Kind) -> tuple[Array, Array]:
        """Fall of chi2 by a fault at each reading, its size in metres; 0 if it is not seen.

        The squares of all columns at once: of a step, from sums over the readings behind it.
        """
        w, found = self.weight, self.found * self.weight[:, None]
        if kind == "outlier":
            square = w**2 * (1 - self.share) - np.sum(found**2, axis=1)
            along = w * self.rest
        else:
            own = _behind(w**2, self.station)
            total = np.bincount(self.station, w**2)[self.station]
            # A reading adds to its station's part of the step: (s + w^2)^2 - s^2 over the total.
            taken = (2 * own * w**2 + w**4) / total
            square = _after(w**2 - taken) - np.sum(_after(found) ** 2, axis=1)
            along = _after(w * self.rest)
            near = np.arange(len(w))
            square[(near < _FEWEST) | (near > len(w) - _FEWEST)] = 0.0
        visible = square > 1e-3 * float(np.min(w)) ** 2
        size = np.where(visible, along / np.where(visible, square, 1.0), 0.0)
        return size**2 * square, size

    def evidence(self, gain: ArrayLike, size: int, scale: float) -> Array:
        """Log Bayes factor of a fall of chi2, the noise known no better than it is.

        Student's form: ``(dof + d) / 2 log(1 + gain / (rest + d scale))`` with d degrees of
        freedom's worth of what all setups say of the noise.
        """
        fall = np.asarray(gain, dtype=float)
        left = np.maximum(self.chi2 - fall, 0) + _PRIOR_DOF * scale
        return np.asarray((max(self.dof - size, 0) + _PRIOR_DOF) / 2 * np.log1p(fall / left))


def _after(values: Array) -> Array:
    """Sums of a reading's value and of all behind it ``(k, ...)``."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


def _behind(values: Array, station: Rows) -> Array:
    """Sums over the later readings of each reading's station ``(k,)``."""
    order = np.argsort(station, kind="stable")
    sums = _after(values[order]) - values[order]
    last = np.flatnonzero(np.diff(station[order], append=-1))
    ends = np.repeat(sums[last], np.diff(last, prepend=-1))
    found = np.empty(len(values))
    found[order] = sums - ends
    return found


def noise_scale(problem: Problem, setups: Sequence[Scatter]) -> float:
    """Squared scatter of all readings about their stations, whitened, whatever some of them do.

    The median of the setups, or of the stations where that is less: a slip in most setups is none
    in most stations.
    """
    least = 1.0
    if problem.noise.source == "repeats":
        least = (problem.machine.spec.dial.resolution / problem.noise.typical) ** 2 / 12
    able = [scatter for scatter in setups if scatter.dof >= 2]
    if not able:
        return least
    by_setup = float(np.median([scatter.chi2 / scatter.dof for scatter in able]))
    each = np.concatenate([scatter.by_station() for scatter in able])
    by_station = float(np.median(each)) if len(each) >= _FEWEST_STATIONS else by_setup
    return max(least, min(by_setup, by_station))


def repeat_faults(
    problem: Problem, setups: Sequence[Scatter], known: Sequence[Fault]
) -> list[Fault]:
    """Outliers and knocked stands that repeats show.

    Args:
        problem: of the readings.
        setups: scatter of all of them.
        known: faults found before; their setups are left alone.
    """
    scale = noise_scale(problem, setups)
    free = untouched(problem, known)
    tests = [_Test(problem, s, scale) for s in setups if s.dof >= 2 and s.setup in free]
    return [fault for test in tests for fault in test.confirmed(test.found())]


def scatter_faults(
    problem: Problem, setups: Sequence[Scatter], known: Sequence[Fault]
) -> list[Fault]:
    """Setups whose repeats do not repeat: by more than any dial scatters, slips set aside.

    Noise that is taken from the repeats believes anything of them: here it is held against what
    the machine file says of the dial, or what dials are like.

    Args:
        problem: of the readings.
        setups: scatter of all of them.
        known: faults found before; their setups are left alone.

    Raises:
        InputError: where most setups are like that: then none of their rows can be believed.
    """
    if problem.noise.source == "declared":
        return []
    dial = max(PUBLISHED_REPEATABILITY, problem.machine.spec.dial.resolution)
    limit = _BEYOND * max(dial, problem.machine.spec.dial.repeatability or 0.0)
    scale, found = noise_scale(problem, setups), []
    for scatter in setups:
        size = _Test(problem, scatter, scale).spread() if scatter.dof >= _FEWEST_REPEATS else 0.0
        if size > limit:
            found.append(Fault("scatter", scatter.rows, (scatter.setup,), size))
    if 2 * len(found) > len(setups):
        raise InputError(message(problem, found[0]) + "; most other setups are no better")
    free = untouched(problem, known)
    return [fault for fault in found if fault.setups[0] in free]


_Place = tuple[Kind | Literal["trend"], int]
"""A fault at a reading, or a trend of some powers of time."""


@dataclass(frozen=True)
class _Test:
    """A search for slips in one setup.

    Attributes:
        problem: of the readings.
        scatter: of the setup.
        scale: squared scatter of all readings, whitened.
    """

    problem: Problem
    scatter: Scatter
    scale: float

    def columns(self, item: _Place) -> Array:
        """What it would show of the setup's readings ``(k, c)``."""
        kind, place = item
        if kind == "trend":
            return self.scatter.past(self.scatter.trend[:, :place])
        return self.scatter.column(kind, place)

    def found(self) -> list[_Place]:
        """The best of outliers, steps and trends, one after the other, until none is left."""
        found: list[_Place] = []
        now = self.scatter
        for _ in range(_MOST):
            evidence, item = max(self._choices(now), key=lambda choice: choice[0])
            if evidence < EVIDENCE:
                break
            found.append(item)
            now = now.without(self.columns(item))
        return found

    def _choices(self, now: Scatter) -> Iterator[tuple[float, _Place]]:
        """The best of each kind, its evidence less the logarithm of the number of its like."""
        for kind, least in _STEPS.items():
            gain, size = now.gains(kind)
            evidence = self._evidence(now, gain)
            too_small = (least - 0.5) * self.problem.machine.spec.dial.resolution
            evidence[np.abs(size) < too_small] = -np.inf
            # Of two visits that contradict each other the one that fits worse.
            even = np.flatnonzero(evidence >= evidence.max() - 1e-6)
            place = int(even[np.argmax(np.abs(now.fitted[even]))])
            yield float(evidence[place]), (kind, place)
        for power in (1, 3):
            fall = now.gain(now.past(now.trend[:, :power]))
            yield float(now.evidence(fall, power, self.scale)) - 2 * power, ("trend", power)

    def _evidence(self, now: Scatter, gain: ArrayLike) -> Array:
        return now.evidence(gain, 1, self.scale) - np.log(len(self.problem.measured))

    def _past(self, found: list[_Place]) -> Scatter:
        """The scatter with all that was found set free."""
        columns = [self.columns(item) for item in found]
        return self.scatter.without(np.hstack(columns)) if found else self.scatter

    def spread(self) -> float:
        """Standard deviation of the readings about what slips leave of them, metres."""
        found = self.found()
        last = self._past(found)
        if 2 * last.dof < self.scatter.dof:
            last = self.scatter  # as many slips as readings are none
        return float(np.sqrt(last.chi2 / last.dof) / np.sqrt(np.mean(last.weight**2)))

    def confirmed(self, found: list[_Place]) -> list[Fault]:
        """Faults that stand beside all others found, and no smooth trend in their place."""
        scatter, columns = self.scatter, [self.columns(item) for item in found]
        last = self._past(found)
        noisy = last.chi2 > _NOISY * self.scale * max(last.dof, 1) or 2 * last.dof < scatter.dof
        outliers = sum(kind == "outlier" for kind, _ in found)
        if noisy or outliers > max(2, len(scatter.rows) // 6):
            return []  # a setup that scatters as a whole is no handful of slips
        faults = []
        for k, (kind, place) in enumerate(found):
            if kind == "trend":
                continue
            others = columns[:k] + columns[k + 1 :]
            rest = scatter.without(np.hstack(others)) if others else scatter
            gain, size = (values[place] for values in rest.gains(kind))
            evidence = float(self._evidence(rest, gain))
            step = kind == "knocked_stand"
            if evidence >= EVIDENCE and not (step and self._smooth(rest, float(gain))):
                rows = scatter.rows[place:] if step else scatter.rows[[place]]
                faults.append(Fault(kind, rows, (scatter.setup,), float(size), evidence))
        return faults

    def _smooth(self, rest: Scatter, gain: float) -> bool:
        """Whether a drift over time explains a step of some gain nearly as well."""
        noise = max(self.scale, max(rest.chi2 - gain, 0.0) / max(rest.dof - 1, 1))
        return gain - rest.gain(rest.past(rest.trend[:, :2])) <= _TREND_MARGIN * noise
