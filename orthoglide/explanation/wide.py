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
from scipy.linalg import cho_solve, solve_triangular

from orthoglide.explanation.columns import Everything
from orthoglide.explanation.faults import Rows
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array

DATUM = 1e-2
"""Metres: where a dial's zero may be."""

_ROUNDING = 1e-12  # of the largest variance: far below the noise, far above what sums leave of it


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
    def _factor(self) -> Array:
        """``F`` of the covariance ``1 + F F^T`` of the readings, no wider than they are many."""
        every = np.hstack([self.columns, self.instruments])
        if every.shape[1] <= len(every):
            return every
        square = every @ every.T
        square[np.diag_indices_from(square)] += _ROUNDING * square.diagonal().max()
        return np.asarray(np.linalg.cholesky(square), dtype=np.float64)

    @cached_property
    def _inner(self) -> Array:
        """Cholesky factor of ``1 + F^T F``, whose determinant is that of the covariance, and
        ``S^-1 = 1 - F (1 + F^T F)^-1 F^T``: as large as what is unknown, however much was read.
        """
        square = self._factor.T @ self._factor
        return np.asarray(np.linalg.cholesky(square + np.eye(len(square))), dtype=np.float64)

    @cached_property
    def _log_det(self) -> float:
        return 2 * float(np.log(np.diag(self._inner)).sum())

    def _past(self, rows: Array) -> Array:
        """``S^-1`` times whitened rows ``(n, ...)``."""
        found = cho_solve((self._inner, True), self._factor.T @ rows)
        return np.asarray(rows - self._factor @ found)

    def _block(self, rows: Rows) -> Array:
        """Cholesky factor of the part of ``S^-1`` of some rows ``(k, k)``."""
        half = solve_triangular(self._inner, self._factor[rows].T, lower=True)
        part = (1 + _ROUNDING) * np.eye(len(rows)) - half.T @ half
        return np.asarray(np.linalg.cholesky(part), dtype=np.float64)

    def score(self, change: Array) -> Array:
        """Log likelihood of changed readings ``(h,)``, changes ``(n, h)`` in metres."""
        changed = self.residual[:, None] + self.weighing.whiten(change)
        square = np.sum(changed * self._past(changed), axis=0)
        return np.asarray(-(square + self._log_det) / 2)

    @cached_property
    def _as_read(self) -> Array:
        """``S^-1`` times the residuals of the readings as they stand ``(n,)``."""
        return self._past(self.residual)

    def without(self, rows: Rows, change: Array | None = None) -> float:
        """What the likelihood grows by once some rows say nothing, in units of their noise.

        Args:
            rows: that say nothing.
            change: of the readings ``(n,)``, metres; none where absent.
        """
        root = self._block(rows)
        past = self._as_read
        if change is not None:
            past = past + self._past(self.weighing.whiten(change))
        white = solve_triangular(root, past[rows], lower=True)
        return float(white @ white) / 2 - float(np.log(np.diag(root)).sum())

    def odd(self, rows: Rows) -> float:
        """By how much less likely some readings are than in the mean, all others given: what other
        labels of theirs could gain at most.
        """
        white = solve_triangular(self._block(rows), self._as_read[rows], lower=True)
        return (float(white @ white) - len(rows)) / 2

    def relabelled(self, rows: Rows, columns: Array, instruments: Array, residual: Array) -> float:
        """Log likelihood where whole setups have other columns ``(k, C)``, nuisances of their own,
        and residuals ``(k,)``.
        """
        root = self._block(rows)
        rest = np.delete(np.arange(len(self.residual)), rows)
        across = columns @ self.columns[rest].T
        both = np.zeros((len(self.residual), len(rows) + 1))
        both[rest] = np.column_stack([across.T, self.residual[rest]])
        # By the inverse of the others' covariance: what is in the rows is chosen so that S^-1 has
        # nothing there.
        both[rows] = -cho_solve((root, True), self._past(both)[rows])
        found = self._past(both)[rest]
        own = columns @ columns.T + instruments @ instruments.T + np.eye(len(rows))
        # Rounding is of the size of what is subtracted from, not of what is left.
        rounding = _ROUNDING * own.diagonal().max()
        own -= across @ found[:, :-1]
        own[np.diag_indices_from(own)] += rounding
        new = np.linalg.cholesky(own)
        white = solve_triangular(new, residual - across @ found[:, -1], lower=True)
        log_det = self._log_det + 2 * float(
            np.log(np.diag(new)).sum() + np.log(np.diag(root)).sum()
        )
        return -float(white @ white + self.residual[rest] @ found[:, -1] + log_det) / 2

    def missed(self, rows: Rows) -> Array:
        """By how much some readings are off what all others foretell ``(k,)``, metres."""
        off = cho_solve((self._block(rows), True), self._as_read[rows])
        return np.asarray(off * self.weighing.sigma[rows])

    def noise(self, change: Array) -> Array:
        """What the machine does not explain of changed readings ``(n,)``, metres."""
        return self.weighing.metres(self._past(self.residual + self.weighing.whiten(change)))


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
