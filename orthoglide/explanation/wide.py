"""The likelihood of readings, and of other data in their place, under the full model.

Every parameter may deviate by a multiple of its tolerance, which gives whitened readings the
covariance ``S = 1 + A D A^T``. Other data r' have the log likelihood ``-r'^T S^-1 r' / 2`` up to a
constant: one factorisation serves all of them.
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
"""Widest standard deviation of a nuisance of an instrument, metres or radians: where a dial's zero
may be."""

# Added to the diagonal of 1 + A^T A, relative to its largest entry, so that rounding of the largest
# sums keeps it positive definite.
_OF_SUMS = 1e-15
_ROUNDING = 1e-12  # the same of A A^T, relative to the largest variance: far below the noise


@dataclass(frozen=True, eq=False, repr=False)
class Root:
    """The inverse of a covariance ``S = 1 + A A^T`` by the Cholesky factor of ``1 + A^T A``, whose
    size is the number of columns and not that of the readings.
    """

    columns: Array  # A (n, q), no more columns than rows
    inner: Array  # (q, q)

    @classmethod
    def of(cls, columns: Array) -> Root:
        """Return it for columns ``A`` ``(n, k)``; more than ``n`` are replaced by a factor of
        ``A A^T`` with ``n`` columns.
        """
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
    """The readings under the full model, in units of their noise."""

    weighing: Weighing
    columns: Array  # of the machine, in standard deviations (n, C)
    instruments: Array  # of the instruments' nuisances, in standard deviations (n, k)
    residual: Array  # (n,)

    @classmethod
    def of(cls, about: Everything, share: float, free: float) -> Wide:
        """Linearise the readings about the posterior.

        Args:
            about: the full linear model.
            share: background scale of the parameters, in tolerances.
            free: background scale of the free-form errors.
        """
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
        white = self._root.white[rows]
        part = (1 + _ROUNDING) * np.eye(len(rows)) - white @ white.T
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
        """Return the gain of log likelihood once some rows have no weight.

        Args:
            rows: without weight.
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
        """Return the log likelihood that other labels of some rows could gain at most: by how much
        the rows are less likely, given all others, than in the mean.
        """
        return (self.foretold(rows).square - len(rows)) / 2

    def relabelled(self, rows: Rows, columns: Array, instruments: Array, residual: Array) -> float:
        """Return the log likelihood if whole setups have other columns ``(k, C)``, nuisances and
        residuals ``(k,)``.
        """
        count = self.columns.shape[1]
        both = np.zeros((len(self.residual), count + self.instruments.shape[1]))
        both[:, :count], both[:, count:] = self.columns, self.instruments
        both[rows, :count], both[rows, count:] = columns, 0.0
        nuisances = np.zeros((len(both), instruments.shape[1]))
        nuisances[rows] = instruments
        left = self.residual.copy()
        left[rows] = residual
        return float(Root.of(np.hstack([both, nuisances])).log_likelihood(left[:, None])[0])

    def noise(self, change: Array) -> Array:
        """Return the expected noise of changed readings ``(n,)``, metres: what the model leaves."""
        return self.weighing.metres(self._root.past(self.residual + self.weighing.whiten(change)))


def in_deviations(about: Everything, rows: Array, share: float, free: float) -> tuple[Array, Array]:
    """Return rows ``(n, C)`` by a standard deviation of each coefficient, and their expected value
    ``(n,)``. Parameters of an earlier calibration have its mean and covariance.
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
