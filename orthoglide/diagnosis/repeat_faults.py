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
from numpy.typing import ArrayLike

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Kind, Rows, in_order, untouched
from orthoglide.diagnosis.station_means import orthonormal, past
from orthoglide.fit import Estimate, Problem
from orthoglide.geometry import Array

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
        free: orthonormal columns of station means and what was found already ``(k, q)``.
        rest: whitened and projected ``(k,)``.
        trend: whitened, projected powers of time 1 to 3 ``(k, 3)``.
        fitted: whitened residuals of the fit to all readings ``(k,)``.
    """

    setup: int
    rows: Rows
    weight: Array
    free: Array
    rest: Array
    trend: Array
    fitted: Array

    @classmethod
    def of(cls, estimate: Estimate, setup: int) -> Scatter:
        """Of a setup, numbered over all campaigns."""
        problem = estimate.problem
        rows = in_order(problem, setup)
        weight = 1 / np.hypot(problem.sigma, problem.noise.common)[rows]
        stations = np.unique(problem.station[rows], return_inverse=True)[1].reshape(-1)
        free = orthonormal(np.eye(int(stations.max()) + 1)[stations] * weight[:, None])
        rest = (problem.measured - estimate.at.value)[rows] * weight
        powers = _clock(problem, rows)[:, None] ** [1, 2, 3] * weight[:, None]
        fitted = estimate.residuals[rows] * weight
        return cls(setup, rows, weight, free, past(free, rest), past(free, powers), fitted)

    @property
    def dof(self) -> int:
        """Degrees of freedom of the scatter."""
        return len(self.rows) - self.free.shape[1]

    @property
    def chi2(self) -> float:
        """Square of ``rest``."""
        return float(self.rest @ self.rest)

    @cached_property
    def outliers(self) -> Array:
        """One reading off, each in turn ``(k, k)``."""
        return past(self.free, np.diag(self.weight))

    @cached_property
    def steps(self) -> Array:
        """A step before each reading in turn ``(k, k)``; zero near the ends."""
        k = len(self.rows)
        after = np.tri(k)
        after[:, : min(_FEWEST, k)] = 0.0
        after[:, max(k - _FEWEST + 1, 0) :] = 0.0
        return past(self.free, after * self.weight[:, None])

    def columns(self, kind: Kind) -> Array:
        """What a fault at each reading in turn would show ``(k, k)``."""
        return self.outliers if kind == "outlier" else self.steps

    def without(self, columns: Array) -> Scatter:
        """With whitened columns ``(k, c)`` set free besides."""
        free = orthonormal(np.hstack([self.free, columns]))
        return replace(self, free=free, rest=past(free, self.rest), trend=past(free, self.trend))

    def gain(self, columns: Array) -> float:
        """Fall of chi2 by several columns together."""
        return float(np.sum((orthonormal(columns).T @ self.rest) ** 2))

    def gains(self, columns: Array) -> tuple[Array, Array]:
        """Fall of chi2 by each column alone, its coefficient in metres; 0 if it is not seen."""
        square = np.sum(columns**2, axis=0)
        visible = square > 1e-3 * float(np.min(self.weight)) ** 2
        size = np.where(visible, columns.T @ self.rest / np.where(visible, square, 1.0), 0.0)
        return size**2 * square, size

    def evidence(self, gain: ArrayLike, size: int, scale: float) -> Array:
        """Log Bayes factor of a fall of chi2, the noise known no better than it is.

        Student's form: ``(dof + d) / 2 log(1 + gain / (rest + d scale))`` with d degrees of
        freedom's worth of what all setups say of the noise.
        """
        fall = np.asarray(gain, dtype=float)
        left = np.maximum(self.chi2 - fall, 0) + _PRIOR_DOF * scale
        return np.asarray((max(self.dof - size, 0) + _PRIOR_DOF) / 2 * np.log1p(fall / left))


def _clock(problem: Problem, rows: Rows) -> Array:
    """Time of readings over -1 to 1, or their sequence where none was recorded."""
    time = np.concatenate([c.time for c in problem.campaigns])[rows]
    if not np.isfinite(time).all() or np.ptp(time) <= 0:
        time = np.arange(len(rows), dtype=float)
    return np.asarray(2 * (time - time.min()) / max(np.ptp(time), 1e-300) - 1)


def noise_scale(problem: Problem, setups: Sequence[Scatter]) -> float:
    """Squared scatter of all readings about their stations, whitened, whatever one setup does."""
    least = 1.0
    if problem.noise.source == "repeats":
        least = (problem.machine.spec.dial.resolution / problem.noise.typical) ** 2 / 12
    spread = [scatter.chi2 / scatter.dof for scatter in setups if scatter.dof >= 2]
    return max(least, float(np.median(spread)) if spread else 0.0)


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
            return self.scatter.trend[:, :place]
        return self.scatter.columns(kind)[:, [place]]

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
            gain, size = now.gains(now.columns(kind))
            evidence = self._evidence(now, gain)
            too_small = (least - 0.5) * self.problem.machine.spec.dial.resolution
            evidence[np.abs(size) < too_small] = -np.inf
            # Of two visits that contradict each other the one that fits worse.
            even = np.flatnonzero(evidence >= evidence.max() - 1e-6)
            place = int(even[np.argmax(np.abs(now.fitted[even]))])
            yield float(evidence[place]), (kind, place)
        for power in (1, 3):
            fall = now.gain(now.trend[:, :power])
            yield float(now.evidence(fall, power, self.scale)) - 2 * power, ("trend", power)

    def _evidence(self, now: Scatter, gain: ArrayLike) -> Array:
        return now.evidence(gain, 1, self.scale) - np.log(len(self.problem.measured))

    def confirmed(self, found: list[_Place]) -> list[Fault]:
        """Faults that stand beside all others found, and no smooth trend in their place."""
        scatter, columns = self.scatter, [self.columns(item) for item in found]
        last = scatter.without(np.hstack(columns)) if found else scatter
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
            (gain,), (size,) = rest.gains(rest.columns(kind)[:, [place]])
            evidence = float(self._evidence(rest, gain))
            step = kind == "knocked_stand"
            if evidence >= EVIDENCE and not (step and self._smooth(rest, float(gain))):
                rows = scatter.rows[place:] if step else scatter.rows[[place]]
                faults.append(Fault(kind, rows, (scatter.setup,), float(size), evidence))
        return faults

    def _smooth(self, rest: Scatter, gain: float) -> bool:
        """Whether a drift over time explains a step of some gain nearly as well."""
        noise = max(self.scale, max(rest.chi2 - gain, 0.0) / max(rest.dof - 1, 1))
        return gain - rest.gain(rest.trend[:, :2]) <= _TREND_MARGIN * noise
