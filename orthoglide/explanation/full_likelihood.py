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

from orthoglide.explanation.columns import LinearisedModel
from orthoglide.explanation.faults import Rows
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array

WIDEST_DATUM = 1e-2
"""Widest standard deviation of a nuisance of an instrument, metres or radians: where a dial's zero
may be."""

# Added to the diagonal of 1 + A^T A, relative to its largest entry, so that rounding of the largest
# sums keeps it positive definite.
_SUM_ROUNDING = 1e-15
_ROUNDING = 1e-12  # the same of A A^T, relative to the largest variance: far below the noise


@dataclass(frozen=True, eq=False, repr=False)
class InverseCovariance:
    """The inverse of a covariance ``S = 1 + A A^T`` by the Cholesky factor of ``1 + A^T A``, whose
    size is the number of columns and not that of the readings.
    """

    columns: Array  # A (n, q), no more columns than rows
    cholesky: Array  # (q, q)

    @classmethod
    def from_columns(cls, columns: Array) -> InverseCovariance:
        """Return it for columns ``A`` ``(n, k)``; more than ``n`` are replaced by a factor of
        ``A A^T`` with ``n`` columns.
        """
        if columns.shape[1] > len(columns):
            square = columns @ columns.T
            square[np.diag_indices_from(square)] += _ROUNDING * square.diagonal().max()
            columns = np.asarray(np.linalg.cholesky(square), dtype=np.float64)
        inner = columns.T @ columns
        inner[np.diag_indices_from(inner)] += 1 + _SUM_ROUNDING * inner.diagonal().max(initial=0.0)
        return cls(columns, np.asarray(np.linalg.cholesky(inner), dtype=np.float64))

    @cached_property
    def downdate(self) -> Array:
        """``V`` of ``S^-1 = 1 - V V^T`` ``(n, q)``."""
        return np.asarray(solve_triangular(self.cholesky, self.columns.T, lower=True).T)

    def apply(self, rows: Array) -> Array:
        """Return ``S^-1`` times rows ``(n, ...)``."""
        return np.asarray(rows - self.downdate @ (self.downdate.T @ rows))

    def log_likelihood(self, rows: Array) -> Array:
        """Return the log likelihood ``(h,)`` of rows ``(n, h)``."""
        shown = solve_triangular(self.cholesky, self.columns.T @ rows, lower=True)
        square = np.sum(rows**2, axis=0) - np.sum(shown**2, axis=0)
        return np.asarray(-(square + _log_determinant(self.cholesky)) / 2)


def _log_determinant(root: Array) -> float:
    """Log determinant of the matrix whose Cholesky factor is ``root``."""
    return 2 * float(np.log(np.diag(root)).sum())


@dataclass(frozen=True, eq=False, repr=False)
class DeletionResidual:
    """Some readings compared with what all others foretell of them."""

    difference: Array  # difference of each (k,), metres
    mahalanobis_square: float  # of all together, in units of their covariance
    log_det: float  # of the inverse of that, in units of their noise


@dataclass(frozen=True, eq=False, repr=False)
class FullLikelihood:
    """The readings under the full model, in units of their noise."""

    weighing: Weighing
    columns: Array  # of the machine, in standard deviations (n, C)
    instruments: Array  # of the instruments' nuisances, in standard deviations (n, k)
    residual: Array  # (n,)

    @classmethod
    def from_linear_model(cls, about: LinearisedModel, share: float, free: float) -> FullLikelihood:
        """Linearise the readings about the posterior.

        Args:
            about: the full linear model.
            share: background scale of the parameters, in tolerances.
            free: background scale of the free-form errors.
        """
        nuisance = about.nuisance
        known = np.maximum(nuisance.precision, WIDEST_DATUM**-2.0)
        columns, expected = in_standard_deviations(about, about.rows, share, free)
        weigh = nuisance.weighing.whiten
        return cls(
            nuisance.weighing, weigh(columns), weigh(nuisance.columns / np.sqrt(known)),
            weigh(about.problem.measured - about.value_at_zero - expected),
        )  # fmt: skip

    @cached_property
    def _inverse_covariance(self) -> InverseCovariance:
        return InverseCovariance.from_columns(np.hstack([self.columns, self.instruments]))

    def _block_cholesky(self, rows: Rows) -> Array:
        """Cholesky factor of the part of ``S^-1`` of some rows ``(k, k)``."""
        white = self._inverse_covariance.downdate[rows]
        part = (1 + _ROUNDING) * np.eye(len(rows)) - white @ white.T
        return np.asarray(np.linalg.cholesky(part), dtype=np.float64)

    def log_likelihood(self, change: Array) -> Array:
        """Log likelihood of changed readings ``(h,)``, changes ``(n, h)`` in metres."""
        return self._inverse_covariance.log_likelihood(
            self.residual[:, None] + self.weighing.whiten(change)
        )

    @cached_property
    def _weighted_residual(self) -> Array:
        """``S^-1`` times the residuals of the readings as they stand ``(n,)``."""
        return self._inverse_covariance.apply(self.residual)

    @cached_property
    def _deletion_residuals(self) -> dict[bytes, DeletionResidual]:
        return {}

    def deletion_residual(self, rows: Rows) -> DeletionResidual:
        """Compare some readings with what all others foretell of them."""
        key = rows.tobytes()
        if key not in self._deletion_residuals:
            root = self._block_cholesky(rows)
            white = solve_triangular(root, self._weighted_residual[rows], lower=True)
            off = solve_triangular(root, white, lower=True, trans="T") * self.weighing.sigma[rows]
            self._deletion_residuals[key] = DeletionResidual(
                off, float(white @ white), _log_determinant(root)
            )
        return self._deletion_residuals[key]

    def deletion_gain(self, rows: Rows, change: Array | None = None) -> float:
        """Return the gain of log likelihood once some rows have no weight.

        Args:
            rows: without weight.
            change: of the readings ``(n,)``, metres; none where absent.
        """
        if change is None:
            found = self.deletion_residual(rows)
            return (found.mahalanobis_square - found.log_det) / 2
        root = self._block_cholesky(rows)
        past = self._weighted_residual + self._inverse_covariance.apply(
            self.weighing.whiten(change)
        )
        white = solve_triangular(root, past[rows], lower=True)
        return (float(white @ white) - _log_determinant(root)) / 2

    def relabelling_bound(self, rows: Rows) -> float:
        """Return the log likelihood that other labels of some rows could gain at most: by how much
        the rows are less likely, given all others, than in the mean.
        """
        return (self.deletion_residual(rows).mahalanobis_square - len(rows)) / 2

    def relabelled_log_likelihood(
        self, rows: Rows, columns: Array, instruments: Array, residual: Array
    ) -> float:
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
        return float(
            InverseCovariance.from_columns(np.hstack([both, nuisances])).log_likelihood(
                left[:, None]
            )[0]
        )

    def expected_noise(self, change: Array) -> Array:
        """Return the expected noise of changed readings ``(n,)``, metres: what the model leaves."""
        return self.weighing.metres(
            self._inverse_covariance.apply(self.residual + self.weighing.whiten(change))
        )


def in_standard_deviations(
    about: LinearisedModel, rows: Array, share: float, free: float
) -> tuple[Array, Array]:
    """Return rows ``(n, C)`` by a standard deviation of each coefficient, and their expected value
    ``(n,)``. Parameters of an earlier calibration have its mean and covariance.
    """
    sd = np.sqrt(about.linear.spike(share, free))
    columns = rows * sd
    matrix, target = about.prior_rows
    if not len(target):
        return columns, np.zeros(len(rows))
    spoken = np.flatnonzero(matrix.any(axis=0))
    root = np.linalg.inv(matrix[:, spoken] * about.units[spoken])
    columns[:, spoken] = rows[:, spoken] @ root
    return columns, np.asarray(columns[:, spoken] @ target)
