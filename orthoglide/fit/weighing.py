"""Readings in units of their noise, which includes the rounding error that visits share.

The covariance of a station's readings is ``diag(sigma^2) + common^2``: independent scatter, and a
rounding error that they share. Its inverse root is a diagonal and one direction a station, which
needs no matrix of rows times stations:

    W = (1 - a u u^T) diag(1 / sigma),   u ~ 1 / sigma
    a = 1 - 1 / sqrt(1 + common^2 sum(1 / sigma^2))
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.observations.arrays import group_ids


@dataclass(frozen=True, eq=False, repr=False)
class Weighing:
    """The inverse root of the covariance of rows."""

    sigma: Array  # of each row, reduced by averaging (n,), metres
    common: Array  # of each row, shared by its station (n,), metres; one figure a station
    station: NDArray[np.int64]  # of each row (n,)

    def subset(self, rows: NDArray[Any]) -> Weighing:
        """Return the weighing of some rows, given as indices or booleans ``(n,)``."""
        return Weighing(self.sigma[rows], self.common[rows], group_ids(self.station[rows]))

    @cached_property
    def weight(self) -> Array:
        """1 / sigma of each row ``(n,)``."""
        return 1 / self.sigma

    @cached_property
    def _sorted(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows sorted by station, and the index of each station's first one among them."""
        order = np.argsort(self.station, kind="stable")
        return order, np.flatnonzero(np.diff(self.station[order], prepend=-1))

    @cached_property
    def direction(self) -> Array:
        """Direction of the common error of each station, whitened, of unit length ``(n,)``."""
        return self.weight / np.sqrt(np.bincount(self.station, self.weight**2))[self.station]

    @cached_property
    def _stretch(self) -> Array:
        """Standard deviation along ``direction`` over that without common error ``(n,)``."""
        square = np.bincount(self.station, self.weight**2)[self.station]
        return np.sqrt(1 + self.common**2 * square)

    @property
    def log_determinant(self) -> float:
        """Log determinant of the covariance, metres squared."""
        return 2 * float(np.log(self.sigma).sum() + np.log(self._stretch[self.first_rows]).sum())

    def station_components(self, rows: Array) -> Array:
        """Part of whitened rows ``(n, ...)`` along each station's direction ``(stations, ...)``."""
        order, starts = self._sorted
        return np.add.reduceat((rows.T * self.direction).T[order], starts, axis=0)

    @cached_property
    def first_rows(self) -> NDArray[np.int64]:
        """The first row of each station ``(stations,)``."""
        order, starts = self._sorted
        return order[starts]

    def _scaled(self, rows: Array, factor: Array) -> Array:
        """Rows with their part along each station's direction multiplied by ``factor (n,)``."""
        if not self.common.any():
            return rows
        part = self.station_components(rows)[self.station]
        return np.asarray(rows + (part.T * (self.direction * (factor - 1))).T)

    def whiten(self, rows: Array) -> Array:
        """Return whitened rows ``(n, ...)``, dimensionless, from rows in metres."""
        return self._scaled((rows.T * self.weight).T, 1 / self._stretch)

    def metres(self, rows: Array) -> Array:
        """Return whitened rows ``(n, ...)`` in metres; the inverse of :meth:`whiten`."""
        return np.asarray((self._scaled(rows, self._stretch).T * self.sigma).T)
