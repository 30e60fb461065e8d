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
    def _root(self) -> Array:
        cov = self.columns @ self.columns.T + self.instruments @ self.instruments.T
        return np.asarray(np.linalg.cholesky(cov + np.eye(len(cov))), dtype=np.float64)

    @cached_property
    def inverse(self) -> Array:
        """Of the covariance of the readings ``(n, n)``."""
        half = np.linalg.inv(self._root)
        return np.asarray(half.T @ half)

    @cached_property
    def log_det(self) -> float:
        """Of the covariance."""
        return 2 * float(np.log(np.diag(self._root)).sum())

    def score(self, change: Array) -> Array:
        """Log likelihood of changed readings ``(h,)``, changes ``(n, h)`` in metres."""
        changed = self.residual[:, None] + self.weighing.whiten(change)
        white = solve_triangular(self._root, changed, lower=True)
        return np.asarray(-(np.sum(white**2, axis=0) + self.log_det) / 2)

    def without(self, rows: Rows, change: Array) -> float:
        """What the likelihood grows by once some rows say nothing, in units of their noise."""
        along = self.inverse[rows] @ (self.residual + self.weighing.whiten(change))
        inner = self.inverse[np.ix_(rows, rows)]
        square = along @ np.linalg.solve(inner, along)
        return float(square - np.linalg.slogdet(inner)[1]) / 2

    def odd(self, rows: Rows) -> float:
        """By how much less likely some readings are than in the mean, all others given: what other
        labels of theirs could gain at most.
        """
        along = self.inverse[rows] @ self.residual
        square = along @ np.linalg.solve(self.inverse[np.ix_(rows, rows)], along)
        return float(square - len(rows)) / 2

    def relabelled(self, rows: Rows, columns: Array, instruments: Array, residual: Array) -> float:
        """Log likelihood where whole setups have other columns ``(k, C)``, nuisances of their own,
        and residuals ``(k,)``.
        """
        rest = np.setdiff1d(np.arange(len(self.residual)), rows)
        q = self.inverse
        across = columns @ self.columns[rest].T
        # S_oo^-1 = Q_oo - Q_os Q_ss^-1 Q_so, of the others.
        inner = q[np.ix_(rows, rows)]
        beside = q[np.ix_(rest, rows)]
        both = np.column_stack([across.T, self.residual[rest]])
        found = q[np.ix_(rest, rest)] @ both - beside @ np.linalg.solve(inner, beside.T @ both)
        own = columns @ columns.T + instruments @ instruments.T + np.eye(len(rows))
        own -= across @ found[:, :-1]
        root = np.linalg.cholesky(own)
        white = solve_triangular(root, residual - across @ found[:, -1], lower=True)
        plain = self.residual[rest] @ found[:, -1]
        log_det = 2 * float(np.log(np.diag(root)).sum())
        log_det += self.log_det + np.linalg.slogdet(inner)[1]
        return -float(white @ white + plain + log_det) / 2

    def missed(self, rows: Rows) -> Array:
        """By how much some readings are off what all others foretell ``(k,)``, metres."""
        own = np.linalg.solve(self.inverse[np.ix_(rows, rows)], self.inverse[rows] @ self.residual)
        return np.asarray(own * self.weighing.sigma[rows])

    def noise(self, change: Array) -> Array:
        """What the machine does not explain of changed readings ``(n,)``, metres."""
        return self.weighing.metres(self.inverse @ (self.residual + self.weighing.whiten(change)))


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
