"""The pool as numbers: what one more reading would add, given those already chosen.

A reading is ``j x + datum + slope * place + rounding + noise``. Within a mounting the last four
make readings correlated; a further reading, less what the chosen ones of its mounting predict of
it, is ``d x + e`` with ``e`` independent of all else and of variance ``s2``. So every step is one
scalar observation, and its gain by any criterion is a formula. A mounting begins with two readings:
with a free datum, one says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.geometry import Array
from orthoglide.observations import Campaign

_DATUM = 1e-2  # metres: a dial's zero lies within its travel, which is as good as anywhere


class Scatter(NamedTuple):
    """What one reading of a pool scatters by; standard deviations, metres.

    Attributes:
        reading: of one visit.
        common: of the rounding that all visits to a station share.
        placement: of the dial's place along the leg.
    """

    reading: float
    common: float
    placement: float


@dataclass(frozen=True)
class Steps:
    """Things that can be done next.

    Attributes:
        rows: of the pool ``(k, 2)``; the first is -1 where the mounting stands already.
        columns: ``d`` ``(k, P)``.
        variance: ``s2`` ``(k,)``, square metres.
        opening: whether a dial has to be mounted first ``(k,)``.
    """

    rows: NDArray[np.int64]
    columns: Array
    variance: Array
    opening: NDArray[np.bool_]

    def taken(self, k: int) -> list[int]:
        """Rows of the pool that step ``k`` reads."""
        return [int(r) for r in self.rows[k] if r >= 0]


@dataclass(frozen=True, eq=False)
class Bench:
    """A pool with its derivatives.

    Attributes:
        pool: without readings.
        columns: derivative of each reading ``(n, P)`` by whatever is asked for.
        slope: by the dial's place ``(n,)``.
        scatter: of the readings.
    """

    pool: Campaign
    columns: Array
    slope: Array
    scatter: Scatter

    def covariance(self, one: ArrayLike, other: ArrayLike) -> Array:
        """Covariance ``(a, b)`` of rows of one mounting, other visits, parameters given."""
        i, j = np.asarray(one, dtype=np.int64), np.asarray(other, dtype=np.int64)
        slopes = np.multiply.outer(self.slope[i], self.slope[j])
        shared = np.equal.outer(i, j) * self.scatter.common**2
        return np.asarray(_DATUM**2 + self.scatter.placement**2 * slopes + shared)

    @cached_property
    def of_setup(self) -> tuple[NDArray[np.intp], ...]:
        """Rows of each setup."""
        return tuple(np.flatnonzero(self.pool.setup == k) for k in range(len(self.pool.setups)))

    @cached_property
    def openings(self) -> Steps:
        """Pairs of readings to begin a mounting with: one at zero or an end, one anywhere else."""
        pairs = []
        for rows in self.of_setup:
            if len(rows) < 2:
                continue
            leg = self.pool.setups[self.pool.setup[rows[0]]].leg
            own = self.pool.command[rows, leg]
            middle = int(np.argmin(np.abs(own - np.median(own))))
            anchors = dict.fromkeys([int(np.argmin(own)), middle, int(np.argmax(own))])
            pairs += [(rows[a], r) for a in anchors for r in rows if r != rows[a]]
        table = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        first, second = table.T
        single = self.scatter.reading**2 + self.scatter.common**2
        apart = self.slope[second] - self.slope[first]
        return Steps(
            table,
            self.columns[second] - self.columns[first],
            2 * single + (self.scatter.placement * apart) ** 2,
            np.ones(len(table), dtype=bool),
        )

    def continued(self, setup: int, chosen: Sequence[int]) -> Steps:
        """One more reading, of any station, in a mounting that stands."""
        rows = self.of_setup[setup]
        among = self.covariance(chosen, chosen) + self.scatter.reading**2 * np.eye(len(chosen))
        across = self.covariance(rows, chosen)
        weights = np.linalg.solve(among, across.T).T
        single = self.covariance(rows, rows).diagonal() + self.scatter.reading**2
        return Steps(
            np.column_stack([np.full(len(rows), -1), rows]).astype(np.int64),
            self.columns[rows] - weights @ self.columns[list(chosen)],
            single - np.sum(weights * across, axis=1),
            np.zeros(len(rows), dtype=bool),
        )

    def steps(self, chosen: Sequence[int], room: int) -> Steps:
        """All steps that ``room`` readings allow.

        Args:
            chosen: rows taken so far.
            room: readings left to choose.
        """
        standing = dict.fromkeys(int(self.pool.setup[k]) for k in chosen)
        parts = []
        if room >= 2:
            free = ~np.isin(self.pool.setup[self.openings.rows[:, 0]], list(standing))
            o = self.openings
            parts.append(Steps(o.rows[free], o.columns[free], o.variance[free], o.opening[free]))
        for setup in standing:
            own = [k for k in chosen if self.pool.setup[k] == setup]
            parts.append(self.continued(setup, own))
        return Steps(
            np.concatenate([p.rows for p in parts]),
            np.concatenate([p.columns for p in parts]),
            np.concatenate([p.variance for p in parts]),
            np.concatenate([p.opening for p in parts]),
        )

    def information(self, chosen: Sequence[int]) -> Array:
        """What chosen rows say of the columns ``(P, P)``, datums and places taken out."""
        total = np.zeros((self.columns.shape[1],) * 2)
        rows = np.asarray(chosen, dtype=np.int64)
        for setup in np.unique(self.pool.setup[rows]):
            own = rows[self.pool.setup[rows] == setup]
            among = self.covariance(own, own) + self.scatter.reading**2 * np.eye(len(own))
            total += self.columns[own].T @ np.linalg.solve(among, self.columns[own])
        return total

    @cached_property
    def everything(self) -> Array:
        """Information of the whole pool, every reading once ``(P, P)``."""
        return self.information(range(len(self.pool)))
