"""Faults that repeats betray: outliers and knocked stands against visits to the same station.

Whatever a machine does that depends on its posture and approach, it does again at every repeat.
Within a setup the readings less their station's mean therefore hold noise, slow drifts and faults,
and nothing of the causes in the catalogue or outside it that do not change with time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.diagnosis.faults import EVIDENCE, Fault, Kind, Rows, in_order
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


@dataclass(frozen=True)
class _Found:
    """What was found in a setup: a fault at a place, or a trend of some powers of time."""

    kind: Kind | Literal["trend"]
    place: int
    evidence: float

    def columns(self, scatter: Scatter) -> Array:
        if self.kind == "trend":
            return scatter.trend[:, : self.place]
        return scatter.columns(self.kind)[:, [self.place]]


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
    touched = {s for fault in known for s in fault.setups}
    found: list[Fault] = []
    for scatter in setups:
        if scatter.dof >= 2 and scatter.setup not in touched:
            found += _confirmed(problem, scatter, _greedy(problem, scatter, scale), scale)
    return found


def _greedy(problem: Problem, scatter: Scatter, scale: float) -> list[_Found]:
    """The best of outliers, steps and trends, one after the other, until none is left."""
    found: list[_Found] = []
    now = scatter
    for _ in range(_MOST):
        best = max(_choices(problem, now, scale), key=lambda choice: choice.evidence)
        if best.evidence < EVIDENCE:
            break
        found.append(best)
        now = now.without(best.columns(scatter))
    return found


def _choices(problem: Problem, scatter: Scatter, scale: float) -> list[_Found]:
    """The best of each kind, its evidence less the logarithm of the number of its like."""
    resolution = problem.machine.spec.dial.resolution
    choices = []
    for kind, least in _STEPS.items():
        gain, size = scatter.gains(scatter.columns(kind))
        evidence = scatter.evidence(gain, 1, scale) - np.log(len(problem.measured))
        evidence[np.abs(size) < (least - 0.5) * resolution] = -np.inf
        # Of two visits that contradict each other the one that fits worse.
        even = np.flatnonzero(evidence >= evidence.max() - 1e-6)
        place = int(even[np.argmax(np.abs(scatter.fitted[even]))])
        choices.append(_Found(kind, place, float(evidence[place])))
    for power in (1, 3):
        fall = scatter.gain(scatter.trend[:, :power])
        evidence = float(scatter.evidence(fall, power, scale)) - 2 * power
        choices.append(_Found("trend", power, evidence))
    return choices


def _confirmed(
    problem: Problem, scatter: Scatter, found: list[_Found], scale: float
) -> list[Fault]:
    """Faults that stand beside all others found, and no smooth trend in their place."""
    columns = [f.columns(scatter) for f in found]
    last = scatter.without(np.hstack(columns)) if found else scatter
    noisy = last.chi2 > _NOISY * scale * max(last.dof, 1) or 2 * last.dof < scatter.dof
    if noisy or sum(f.kind == "outlier" for f in found) > max(2, len(scatter.rows) // 6):
        return []  # a setup that scatters as a whole is no handful of slips
    faults = []
    for k, item in enumerate(found):
        if item.kind == "trend":
            continue
        others = [c for i, c in enumerate(columns) if i != k]
        rest = scatter.without(np.hstack(others)) if others else scatter
        (gain,), (size,) = rest.gains(item.columns(rest))
        evidence = float(rest.evidence(gain, 1, scale)) - float(np.log(len(problem.measured)))
        rows = scatter.rows[[item.place]]
        if item.kind == "knocked_stand":
            rows = scatter.rows[item.place :]
            if not _beats_trend(rest, float(gain), scale):
                continue
        if evidence >= EVIDENCE:
            faults.append(Fault(item.kind, rows, (scatter.setup,), float(size), evidence))
    return faults


def _beats_trend(scatter: Scatter, gain: float, scale: float) -> bool:
    left = max(scatter.chi2 - gain, 0.0)
    noise = max(scale, left / max(scatter.dof - 1, 1))
    return gain - scatter.gain(scatter.trend[:, :2]) > _TREND_MARGIN * noise
