"""A setup's readings about the means of their stations.

Whatever a machine does that depends on its posture and approach, it does again at every repeat.
Within a setup the readings less their station's mean therefore hold noise, slow drifts and faults,
and nothing of the causes in the catalogue or outside it that do not change with time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.diagnosis.faults import Kind, Rows, clock, in_order
from orthoglide.diagnosis.station_means import orthonormal
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.least_squares import past
from orthoglide.geometry import Array
from orthoglide.observations.arrays import numbered

_REPEATS = 8.0  # times the variance of visits, that stations have where these repeat anything
_FEWEST = 2  # readings on either side of a knock: fewer are outliers
_FEWEST_STATIONS = 8  # with repeats, of which a median says something
_PRIOR_DOF = 10.0  # weight of the noise of all setups against the scatter within one


@dataclass(frozen=True)
class Scatter:
    """A setup's readings about their stations' means, whitened, in the order they were taken."""

    setup: int  # numbered over all campaigns
    rows: Rows  # stacked (k,)
    weight: Array  # 1 / sigma (k,)
    station: Rows  # of each (k,), numbered within the setup
    repeat: Rows  # of each (k,), as the campaign numbers them
    read: Array  # whitened readings less the fit (k,)
    trend: Array  # whitened powers of time 1 to 3 (k, 3)
    fitted: Array  # whitened residuals of the fit to all readings (k,)
    found: Array  # orthonormal columns of what was found already, past the means (k, q)

    @classmethod
    def of(cls, estimate: Estimate, setup: int) -> Scatter:
        """Of a setup, numbered over all campaigns."""
        problem = estimate.problem
        rows = in_order(problem, setup)
        weight = 1 / np.hypot(problem.sigma, problem.common)[rows]
        station = numbered(problem.station[rows])
        rest = (problem.measured - estimate.at.value)[rows] * weight
        along = clock(problem.of_dials("time")[rows], np.arange(len(rows)))
        powers = along[:, None] ** [1, 2, 3] * weight[:, None]
        repeat = problem.of_dials("repeat")[rows]
        fitted, none = estimate.residuals[rows] * weight, np.zeros((len(rows), 0))
        return cls(setup, rows, weight, station, repeat, rest, powers, fitted, none)

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
        names = ("rows", "weight", "repeat", "read", "trend", "fitted")
        parts = {name: getattr(self, name)[kept] for name in names}
        station = numbered(self.station[kept])
        return replace(self, **parts, station=station, found=np.zeros((int(kept.sum()), 0)))

    @cached_property
    def starts(self) -> Rows:
        """Places ``(r - 1,)`` at which a repeat begins; none where repeats do not follow each
        other, or are too short to have a datum of their own.
        """
        places = np.flatnonzero(np.diff(self.repeat)) + 1
        follow = len(places) == len(np.unique(self.repeat)) - 1
        return places if follow and 2 * len(places) <= self.dof else places[:0]

    def column(self, kind: Kind, place: int) -> Array:
        """What a fault at a reading would show: that one off, or all from there on ``(k, 1)``."""
        k = np.arange(len(self.rows))
        shown = k == place if kind == "outlier" else k >= place
        return self.past((shown * self.weight)[:, None])

    @cached_property
    def anew(self) -> Array:
        """What a dial would show that was set to zero anew at each repeat ``(k, r - 1)``."""
        steps = [self.column("knocked_stand", int(place)) for place in self.starts]
        return np.hstack([np.zeros((len(self.rows), 0)), *steps])

    @cached_property
    def datums(self) -> Array:
        """By how much the datum of each repeat would be off that before ``(r - 1,)``, metres."""
        square = self.anew.T @ self.anew  # of few columns, however many readings there are
        return np.asarray(np.linalg.lstsq(square, self.anew.T @ self.rest, rcond=1e-9)[0])

    @property
    def within(self) -> tuple[float, int]:
        """Square of ``rest`` past a datum for each repeat, and its degrees of freedom."""
        fall = float(self.datums @ (self.anew.T @ self.rest))
        return self.chi2 - fall, self.dof - len(self.datums)

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

    def evidence(
        self, gain: ArrayLike, size: int, scale: float, known: float = _PRIOR_DOF
    ) -> Array:
        """Log Bayes factor of a fall of chi2, the noise known no better than it is.

        Student's form: ``(dof + d) / 2 log(1 + gain / (rest + d scale))`` with d degrees of
        freedom's worth of what all setups say of the noise.
        """
        fall = np.asarray(gain, dtype=float)
        left = np.maximum(self.chi2 - fall, 0) + known * scale
        return np.asarray((max(self.dof - size, 0) + known) / 2 * np.log1p(fall / left))


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


def median_scatter(setups: Sequence[Scatter], least: float) -> float:
    """Squared scatter of all readings about their stations, whitened, whatever some of them do; no
    less than ``least``, which stands where nothing repeats.

    The median of the setups, or of the stations where that is less: a slip in most setups is none
    in most stations.
    """
    able = [scatter for scatter in setups if scatter.dof >= 2]
    if not able:
        return least
    by_setup = float(np.median([scatter.chi2 / scatter.dof for scatter in able]))
    each = np.concatenate([scatter.by_station() for scatter in able])
    by_station = float(np.median(each)) if len(each) >= _FEWEST_STATIONS else by_setup
    return max(least, min(by_setup, by_station))
