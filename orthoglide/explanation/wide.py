"""Readings on a machine that may be off by anything: how likely they are, with others in their
place too.

With ``S = 1 + A D A^T`` the covariance of whitened readings on a machine that is off by so many of
its tolerances everywhere, other data r' have ``-r'^T S^-1 r' / 2``: one factorisation for all of
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from orthoglide.explanation.columns import Everything
from orthoglide.explanation.faults import Rows
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array

DATUM = 1e-2
"""Metres: where a dial's zero may be."""

_OF_SUMS = 1e-15  # of the largest square: what sums of that size leave of the ones beside them
_ROUNDING = 1e-12  # of the largest variance: far below the noise, far above what sums leave of it


@dataclass(frozen=True, eq=False, repr=False)
class Root:
    """The inverse of a covariance ``S = 1 + A A^T``, by the Cholesky factor of ``1 + A^T A``: as
    large as what is unknown, however much was read.
    """

    columns: Array  # A (n, q), no more columns than rows
    inner: Array  # (q, q)

    @classmethod
    def of(cls, columns: Array) -> Root:
        """Return it for columns ``A`` ``(n, k)``; as many as there are rows show all of more."""
        if columns.shape[1] > len(columns):
            square = columns @ columns.T
            square[np.diag_indices_from(square)] += _ROUNDING * square.diagonal().max()
            columns = np.asarray(np.linalg.cholesky(square), dtype=np.float64)
        inner = columns.T @ columns
        inner[np.diag_indices_from(inner)] += 1 + _OF_SUMS * inner.diagonal().max(initial=0.0)
        return cls(columns, np.asarray(np.linalg.cholesky(inner), dtype=np.float64))

    @cached_property
    def white(self) -> Array:
        """``V`` of ``S^-1 = 1 - V V^T`` ``(n, q)``."""
        return np.asarray(solve_triangular(self.inner, self.columns.T, lower=True).T)

    def past(self, rows: Array) -> Array:
        """Return ``S^-1`` times rows ``(n, ...)``."""
        return np.asarray(rows - self.white @ (self.white.T @ rows))

    def log_likelihood(self, rows: Array) -> Array:
        """Return the log likelihood ``(h,)`` of rows ``(n, h)``."""
        shown = solve_triangular(self.inner, self.columns.T @ rows, lower=True)
        square = np.sum(rows**2, axis=0) - np.sum(shown**2, axis=0)
        return np.asarray(-(square + _log_det(self.inner)) / 2)


def _log_det(root: Array) -> float:
    """Log determinant of the matrix whose Cholesky factor is ``root``."""
    return 2 * float(np.log(np.diag(root)).sum())


@dataclass(frozen=True, eq=False, repr=False)
class Foretold:
    """Some readings compared with what all others foretell of them."""

    off: Array  # difference of each (k,), metres
    square: float  # of all together, in units of their covariance
    log_det: float  # of the inverse of that, in units of their noise


@dataclass(frozen=True, eq=False, repr=False)
class Wide:
    """The readings on a machine that may be off by anything, in units of their noise."""

    weighing: Weighing
    columns: Array  # of the machine, in standard deviations (n, C)
    instruments: Array  # of the instruments' nuisances, in standard deviations (n, k)
    residual: Array  # (n,)

    @classmethod
    def of(cls, about: Everything, share: float, free: float) -> Wide:
        """Of everything, with a background of some scales."""
        nuisance = about.nuisance
        known = np.maximum(nuisance.precision, DATUM**-2.0)
        columns, expected = in_deviations(about, about.rows, share, free)
        weigh = nuisance.weighing.whiten
        return cls(
            nuisance.weighing, weigh(columns), weigh(nuisance.columns / np.sqrt(known)),
            weigh(about.problem.measured - about.value - expected),
        )  # fmt: skip

    @cached_property
    def _root(self) -> Root:
        return Root.of(np.hstack([self.columns, self.instruments]))

    def _block(self, rows: Rows) -> Array:
        """Cholesky factor of the part of ``S^-1`` of some rows ``(k, k)``."""
        own = self._root.white[rows]
        part = (1 + _ROUNDING) * np.eye(len(rows)) - own @ own.T
        return np.asarray(np.linalg.cholesky(part), dtype=np.float64)

    def score(self, change: Array) -> Array:
        """Log likelihood of changed readings ``(h,)``, changes ``(n, h)`` in metres."""
        return self._root.log_likelihood(self.residual[:, None] + self.weighing.whiten(change))

    @cached_property
    def _as_read(self) -> Array:
        """``S^-1`` times the residuals of the readings as they stand ``(n,)``."""
        return self._root.past(self.residual)

    @cached_property
    def _by_rows(self) -> dict[bytes, Foretold]:
        return {}

    def foretold(self, rows: Rows) -> Foretold:
        """Compare some readings with what all others foretell of them."""
        key = rows.tobytes()
        if key not in self._by_rows:
            root = self._block(rows)
            white = solve_triangular(root, self._as_read[rows], lower=True)
            off = solve_triangular(root, white, lower=True, trans="T") * self.weighing.sigma[rows]
            self._by_rows[key] = Foretold(off, float(white @ white), _log_det(root))
        return self._by_rows[key]

    def without(self, rows: Rows, change: Array | None = None) -> float:
        """What the likelihood grows by once some rows say nothing, in units of their noise.

        Args:
            rows: that say nothing.
            change: of the readings ``(n,)``, metres; none where absent.
        """
        if change is None:
            found = self.foretold(rows)
            return (found.square - found.log_det) / 2
        root = self._block(rows)
        past = self._as_read + self._root.past(self.weighing.whiten(change))
        white = solve_triangular(root, past[rows], lower=True)
        return (float(white @ white) - _log_det(root)) / 2

    def odd(self, rows: Rows) -> float:
        """By how much less likely some readings are than in the mean, all others given: what other
        labels of theirs could gain at most.
        """
        return (self.foretold(rows).square - len(rows)) / 2

    def relabelled(self, rows: Rows, columns: Array, instruments: Array, residual: Array) -> float:
        """Log likelihood where whole setups have other columns ``(k, C)``, nuisances of their own,
        and residuals ``(k,)``.
        """
        count = self.columns.shape[1]
        both = np.zeros((len(self.residual), count + self.instruments.shape[1]))
        both[:, :count], both[:, count:] = self.columns, self.instruments
        both[rows, :count], both[rows, count:] = columns, 0.0
        own = np.zeros((len(both), instruments.shape[1]))
        own[rows] = instruments
        left = self.residual.copy()
        left[rows] = residual
        return float(Root.of(np.hstack([both, own])).log_likelihood(left[:, None])[0])

    def noise(self, change: Array) -> Array:
        """What the machine does not explain of changed readings ``(n,)``, metres."""
        return self.weighing.metres(self._root.past(self.residual + self.weighing.whiten(change)))


def in_deviations(about: Everything, rows: Array, share: float, free: float) -> tuple[Array, Array]:
    """Rows ``(n, C)`` by a standard deviation of each coefficient, and what is expected of them
    ``(n,)``: of what an earlier calibration speaks, as it says.
    """
    sd = np.sqrt(about.linear.spike(share, free))
    columns = rows * sd
    matrix, target = about.known_rows
    if not len(target):
        return columns, np.zeros(len(rows))
    spoken = np.flatnonzero(matrix.any(axis=0))
    root = np.linalg.inv(matrix[:, spoken] * about.scale[spoken])
    columns[:, spoken] = rows[:, spoken] @ root
    return columns, np.asarray(columns[:, spoken] @ target)
