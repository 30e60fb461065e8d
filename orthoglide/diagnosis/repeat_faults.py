"""Faults that repeats betray: outliers and knocked stands against visits to the same station.

Whatever a machine does that depends on its posture and approach, it does again at every repeat.
Within a setup the readings less their station's mean therefore hold noise, slow drifts and faults,
and nothing of the causes in the catalogue or outside it that do not change with time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.diagnosis.faults import Fault, Rows, in_order
from orthoglide.fit import Estimate, Problem
from orthoglide.geometry import Array

EVIDENCE = 7.0
"""Log Bayes factor that a fault must reach, the number of its like discounted: about 1 in 1000."""

FEWEST = 2
"""Readings on either side of a knock: fewer are outliers."""

_PRIOR_DOF = 10.0  # weight of the noise of all setups against the scatter within one
_OUTLIER_STEPS, _KNOCK_STEPS = 3.0, 2.0  # of the dial, that a fault must at least reach
_MOST = 6
_NOISY = 4.0  # times the noise of all setups, that one may scatter about what was found in it
_TREND_MARGIN = 12.0  # fall of chi2, over the noise, by which a step must beat a smooth drift


@dataclass(frozen=True)
class Within:
    """A setup's readings about their stations' means, whitened, in the order they were taken.

    Attributes:
        setup: numbered over all campaigns.
        rows: stacked ``(k,)``.
        weight: 1 / sigma ``(k,)``.
        free: orthonormal columns of station means and what is known already ``(k, q)``.
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
    def of(cls, estimate: Estimate, setup: int, known: Sequence[Fault]) -> Within:
        """Prepare a setup, rows of known faults set free.

        Args:
            estimate: the fit.
            setup: numbered over all campaigns.
            known: faults found before.
        """
        problem = estimate.problem
        rows = in_order(problem, setup)
        weight = 1 / np.hypot(problem.sigma, problem.noise.common)[rows]
        stations = np.unique(problem.station[rows], return_inverse=True)[1].reshape(-1)
        parts = [np.eye(int(stations.max()) + 1)[stations]]
        parts += [f.columns(problem)[rows] for f in known if setup in f.setups]
        free = span(np.hstack(parts) * weight[:, None])
        rest = (problem.measured - estimate.at.value)[rows] * weight
        powers = _clock(problem, rows)[:, None] ** [1, 2, 3] * weight[:, None]
        fitted = estimate.residuals[rows] * weight
        return cls(setup, rows, weight, free, _past(free, rest), _past(free, powers), fitted)

    @property
    def dof(self) -> int:
        """Degrees of freedom of the scatter."""
        return len(self.rows) - self.free.shape[1]

    @cached_property
    def outliers(self) -> Array:
        """One reading off, each in turn ``(k, k)``."""
        return _past(self.free, np.diag(self.weight))

    @cached_property
    def steps(self) -> Array:
        """A step before each reading in turn ``(k, k)``; zero near the ends."""
        k = len(self.rows)
        after = (np.arange(k)[:, None] >= np.arange(k)).astype(float)
        after[:, : min(FEWEST, k)] = 0.0
        after[:, max(k - FEWEST + 1, 0) :] = 0.0
        return _past(self.free, after * self.weight[:, None])

    def without(self, columns: Array) -> Within:
        """With whitened columns set free besides."""
        free = span(np.hstack([self.free, columns]))
        rest, trend = _past(free, self.rest), _past(free, self.trend)
        return replace(self, free=free, rest=rest, trend=trend)

    def evidence(self, gain: ArrayLike, size: int, scale: float) -> Array:
        """Log Bayes factor of a fall of chi2, the noise known no better than it is.

        Student's form: ``(dof + d) / 2 log(1 + gain / (rest + d scale))`` with d degrees of
        freedom's worth of what all setups say of the noise.
        """
        fall = np.asarray(gain, dtype=float)
        left = self.rest @ self.rest - fall
        dof = max(self.dof - size, 0) + _PRIOR_DOF
        return np.asarray(dof / 2 * np.log1p(fall / (np.maximum(left, 0) + _PRIOR_DOF * scale)))


def span(columns: Array) -> Array:
    """Orthonormal basis of columns."""
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, singular > 1e-9 * max(float(singular.max(initial=0.0)), 1e-300)])


def _past(free: Array, columns: Array) -> Array:
    return np.asarray(columns - free @ (free.T @ columns))


def _clock(problem: Problem, rows: Rows) -> Array:
    """Time of readings over -1 to 1, or their sequence where none was recorded."""
    time = np.concatenate([c.time for c in problem.campaigns])[rows]
    if not np.isfinite(time).all() or np.ptp(time) <= 0:
        time = np.arange(len(rows), dtype=float)
    return np.asarray(2 * (time - time.min()) / max(np.ptp(time), 1e-300) - 1)


def gains(columns: Array, rest: Array, weight: Array) -> tuple[Array, Array]:
    """Fall of chi2 by each column alone, and its coefficient in metres; 0 where nothing is seen."""
    square = np.sum(columns**2, axis=0)
    seen = square > 1e-3 * float(np.min(weight)) ** 2
    along = columns.T @ rest
    safe = np.where(seen, square, 1.0)
    return np.where(seen, along**2 / safe, 0.0), np.where(seen, along / safe, 0.0)


def scatter(problem: Problem, setups: list[Within]) -> float:
    """Squared scatter of all readings about their stations, whitened, whatever one setup does."""
    floor = 1.0
    if problem.noise.source == "repeats":
        floor = (problem.machine.spec.dial.resolution / problem.noise.typical) ** 2 / 12
    spread = [own.rest @ own.rest / own.dof for own in setups if own.dof >= 2]
    return max(floor, float(np.median(spread)) if spread else 0.0)


def repeat_faults(estimate: Estimate, known: Sequence[Fault]) -> list[Fault]:
    """Outliers and knocked stands that repeats show.

    Args:
        estimate: the fit.
        known: faults found before; their setups are left alone.
    """
    problem = estimate.problem
    setups = [Within.of(estimate, s, known) for s in range(problem.setup_count)]
    scale = scatter(problem, setups)
    touched = {s for f in known for s in f.setups}
    found = []
    for own in setups:
        if own.dof >= 2 and own.setup not in touched:
            found += _of_setup(problem, own, scale, len(problem.measured))
    return found


def _of_setup(problem: Problem, own: Within, scale: float, count: int) -> list[Fault]:
    """Greedy: the best of outliers, steps and trends, until none is left."""
    found: list[tuple[str, int]] = []
    now = own
    for _ in range(_MOST):
        choices = _choices(problem, now, scale, count)
        kind, place, evidence = max(choices, key=lambda c: c[2])
        if evidence < EVIDENCE:
            break
        found.append((kind, place))
        now = now.without(_columns(own, kind, place))
    return _confirmed(problem, own, found, scale, count)


def _choices(
    problem: Problem, own: Within, scale: float, count: int
) -> list[tuple[str, int, float]]:
    """Kind, place, and evidence less the logarithm of the number of its like."""
    resolution = problem.machine.spec.dial.resolution
    choices = []
    for kind, columns, least in (
        ("outlier", own.outliers, _OUTLIER_STEPS),
        ("knocked_stand", own.steps, _KNOCK_STEPS),
    ):
        gain, size = gains(columns, own.rest, own.weight)
        evidence = own.evidence(gain, 1, scale) - np.log(count)
        evidence[np.abs(size) < (least - 0.5) * resolution] = -np.inf
        place = _likeliest(evidence, own.fitted)
        choices.append((kind, place, float(evidence[place])))
    for power in (1, 3):
        basis = span(own.trend[:, :power])
        fall = np.sum((basis.T @ own.rest) ** 2)
        choices.append(("trend", power, float(own.evidence(fall, power, scale)) - 2 * power))
    return choices


def _likeliest(evidence: Array, fitted: Array) -> int:
    """The best place; of two visits that contradict each other the one that fits worse."""
    even = np.flatnonzero(evidence >= evidence.max() - 1e-6)
    return int(even[np.argmax(np.abs(fitted[even]))])


def _columns(own: Within, kind: str, place: int) -> Array:
    if kind == "trend":
        return own.trend[:, :place]
    return (own.outliers if kind == "outlier" else own.steps)[:, [place]]


def _confirmed(
    problem: Problem, own: Within, found: list[tuple[str, int]], scale: float, count: int
) -> list[Fault]:
    """Faults that stand beside all others found, and no smooth trend in their place."""
    last = own.without(np.hstack([_columns(own, *f) for f in found])) if found else own
    noisy = last.rest @ last.rest > _NOISY * scale * max(last.dof, 1) or 2 * last.dof < own.dof
    if noisy or sum(f[0] == "outlier" for f in found) > max(2, len(own.rows) // 6):
        return []  # a setup that scatters as a whole is no handful of slips
    faults = []
    for kind, place in found:
        if kind == "trend":
            continue
        others = [_columns(own, k, p) for k, p in found if (k, p) != (kind, place)]
        rest = own.without(np.hstack(others)) if others else own
        column = _columns(rest, kind, place)
        gain, size = gains(column, rest.rest, rest.weight)
        evidence = float(rest.evidence(gain, 1, scale)[0]) - float(np.log(count))
        if evidence < EVIDENCE:
            continue
        if kind == "knocked_stand" and not _beats_trend(rest, float(gain[0]), scale):
            continue
        rows = own.rows[[place]] if kind == "outlier" else own.rows[place:]
        faults.append(Fault(kind, rows, (own.setup,), float(size[0]), evidence))  # type: ignore[arg-type]
    return faults


def _beats_trend(own: Within, gain: float, scale: float) -> bool:
    basis = span(own.trend[:, :2])
    smooth = float(np.sum((basis.T @ own.rest) ** 2))
    left = max(float(own.rest @ own.rest) - gain, 0.0)
    noise = max(scale, left / max(own.dof - 1, 1))
    return gain - smooth > _TREND_MARGIN * noise
