"""The likelihood of readings, and of alternative readings, under the full model.

Every parameter may deviate by a multiple of its tolerance, which gives whitened readings the
covariance ``S = 1 + A D A^T``. Alternative readings r' have the log likelihood
``-r'^T S^-1 r' / 2`` up to a constant, so one factorisation serves all of them.
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
"""Largest standard deviation of a nuisance of an instrument, such as a datum, metres or radians."""

# Added to the diagonal of 1 + A^T A, relative to its largest entry, so that rounding of the largest
# sums keeps it positive definite.
_SUM_ROUNDING = 1e-15
_ROUNDING = 1e-12  # added to A A^T, relative to its largest entry: far below the noise


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
        projected = solve_triangular(self.cholesky, self.columns.T @ rows, lower=True)
        square = np.sum(rows**2, axis=0) - np.sum(projected**2, axis=0)
        return np.asarray(-(square + _log_determinant(self.cholesky)) / 2)


def _log_determinant(cholesky: Array) -> float:
    """Log determinant of the matrix whose Cholesky factor is ``cholesky``."""
    return 2 * float(np.log(np.diag(cholesky)).sum())


@dataclass(frozen=True, eq=False, repr=False)
class DeletionResidual:
    """Difference of some readings from their prediction by all others."""

    difference: Array  # (k,), metres
    mahalanobis_square: float  # of the difference, by its covariance
    log_det: float  # log determinant of the inverse covariance, in units of the noise


@dataclass(frozen=True, eq=False, repr=False)
class FullLikelihood:
    """Likelihood of readings under the full model, in units of their noise."""

    weighing: Weighing
    columns: Array  # of the machine, in standard deviations (n, C)
    instruments: Array  # of the instruments' nuisances, in standard deviations (n, k)
    residual: Array  # (n,)

    @classmethod
    def from_linear_model(
        cls, model: LinearisedModel, parameter_scale: float, free_form_scale: float
    ) -> FullLikelihood:
        """Linearise the readings about the posterior.

        Args:
            model: the full linear model.
            parameter_scale: background scale of the parameters, in tolerances.
            free_form_scale: background scale of the free-form errors.
        """
        nuisance = model.nuisance
        precision = np.maximum(nuisance.precision, WIDEST_DATUM**-2.0)
        scales = parameter_scale, free_form_scale
        columns, expected = in_standard_deviations(model, model.rows, *scales)
        whiten = nuisance.weighing.whiten
        return cls(
            nuisance.weighing, whiten(columns), whiten(nuisance.columns / np.sqrt(precision)),
            whiten(model.problem.measured - model.value_at_zero - expected),
        )  # fmt: skip

    @cached_property
    def _inverse_covariance(self) -> InverseCovariance:
        return InverseCovariance.from_columns(np.hstack([self.columns, self.instruments]))

    def _block_cholesky(self, rows: Rows) -> Array:
        """Return the Cholesky factor of a diagonal block of ``S^-1`` ``(k, k)``."""
        block = self._inverse_covariance.downdate[rows]
        inverse_block = (1 + _ROUNDING) * np.eye(len(rows)) - block @ block.T
        return np.asarray(np.linalg.cholesky(inverse_block), dtype=np.float64)

    def log_likelihood(self, change: Array) -> Array:
        """Return the log likelihood ``(h,)`` of readings with changes ``(n, h)``, metres."""
        return self._inverse_covariance.log_likelihood(
            self.residual[:, None] + self.weighing.whiten(change)
        )

    @cached_property
    def _weighted_residual(self) -> Array:
        """``S^-1`` times the residual of the readings as they stand ``(n,)``."""
        return self._inverse_covariance.apply(self.residual)

    @cached_property
    def _deletion_residuals(self) -> dict[bytes, DeletionResidual]:
        return {}

    def deletion_residual(self, rows: Rows) -> DeletionResidual:
        """Return the difference of some readings from their prediction by all others."""
        key = rows.tobytes()
        if key not in self._deletion_residuals:
            cholesky = self._block_cholesky(rows)
            whitened = solve_triangular(cholesky, self._weighted_residual[rows], lower=True)
            scaled = solve_triangular(cholesky, whitened, lower=True, trans="T")
            difference, square = scaled * self.weighing.sigma[rows], float(whitened @ whitened)
            log_det = _log_determinant(cholesky)
            self._deletion_residuals[key] = DeletionResidual(difference, square, log_det)
        return self._deletion_residuals[key]

    def deletion_gain(self, rows: Rows, change: Array | None = None) -> float:
        """Return the gain of log likelihood by zero weight of some rows.

        Args:
            rows: rows of zero weight.
            change: change of the readings ``(n,)``, metres.
        """
        if change is None:
            deleted = self.deletion_residual(rows)
            return (deleted.mahalanobis_square - deleted.log_det) / 2
        cholesky = self._block_cholesky(rows)
        whitened_change = self._inverse_covariance.apply(self.weighing.whiten(change))
        weighted = self._weighted_residual + whitened_change
        whitened = solve_triangular(cholesky, weighted[rows], lower=True)
        return (float(whitened @ whitened) - _log_determinant(cholesky)) / 2

    def relabelling_bound(self, rows: Rows) -> float:
        """Return an upper bound of the gain of log likelihood by other labels of some rows: by how
        much less likely the rows are, given all others, than on average.
        """
        return (self.deletion_residual(rows).mahalanobis_square - len(rows)) / 2

    def relabelled_log_likelihood(
        self, rows: Rows, columns: Array, instruments: Array, residual: Array
    ) -> float:
        """Return the log likelihood with other columns ``(k, C)``, nuisances and residual ``(k,)``
        of whole setups.
        """
        machine, others = self.columns.copy(), self.instruments.copy()
        machine[rows], others[rows] = columns, 0.0
        nuisances = np.zeros((len(machine), instruments.shape[1]))
        nuisances[rows] = instruments
        relabelled = self.residual.copy()
        relabelled[rows] = residual
        inverse = InverseCovariance.from_columns(np.hstack([machine, others, nuisances]))
        return float(inverse.log_likelihood(relabelled[:, None])[0])

    def expected_noise(self, change: Array) -> Array:
        """Return the expected noise of changed readings ``(n,)``, metres."""
        return self.weighing.metres(
            self._inverse_covariance.apply(self.residual + self.weighing.whiten(change))
        )


def in_standard_deviations(
    model: LinearisedModel, rows: Array, parameter_scale: float, free_form_scale: float
) -> tuple[Array, Array]:
    """Return rows ``(n, C)`` scaled to a standard deviation of each coefficient, and their prior
    mean ``(n,)``. Parameters of an earlier calibration have its mean and covariance.
    """
    sd = np.sqrt(model.linear.spike(parameter_scale, free_form_scale))
    columns = rows * sd
    matrix, target = model.prior_rows
    if not len(target):
        return columns, np.zeros(len(rows))
    calibrated = np.flatnonzero(matrix.any(axis=0))
    root = np.linalg.inv(matrix[:, calibrated] * model.units[calibrated])
    columns[:, calibrated] = rows[:, calibrated] @ root
    return columns, np.asarray(columns[:, calibrated] @ target)
