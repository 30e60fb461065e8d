"""The likelihood of readings, and of alternative readings, under the full model.

Every parameter may deviate by a multiple of its tolerance, which gives whitened readings the
covariance ``S = 1 + A D A^T``. Alternative readings r' have the log likelihood
``-r'^T S^-1 r' / 2`` up to a constant, so one factorisation serves all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from orthoglide.explanation.columns import LinearisedModel
from orthoglide.explanation.faults import Rows
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array

Scales = tuple[float, float]
"""Background scales of the parameters, in tolerances, and of the free-form errors."""

WIDEST_DATUM = 1e-2
"""Largest standard deviation of a nuisance of an instrument, such as a datum, metres or radians."""

# Added to the diagonal of 1 + A^T A, relative to its largest entry, so that rounding of the largest
# sums keeps it positive definite. S, by far less regular, gets the bound of that rounding.
_SUM_ROUNDING = 1e-15
_ROUNDING = 1e-12  # added to the diagonal of blocks of S^-1, which is 1 or less


class Deletion(NamedTuple):
    """Some readings against their prediction by all others."""

    difference: Array  # from that prediction (k,), metres
    mahalanobis_square: float  # of the difference, by its covariance
    log_det: float  # log determinant of the inverse covariance, in units of the noise

    @property
    def gain(self) -> float:
        """Gain of log likelihood by zero weight of these readings."""
        return (self.mahalanobis_square - self.log_det) / 2

    @property
    def relabelling_bound(self) -> float:
        """Upper bound of the gain of log likelihood by other labels of these readings: by how much
        less likely they are, given all others, than on average.
        """
        return (self.mahalanobis_square - len(self.difference)) / 2


@dataclass(frozen=True, eq=False, repr=False)
class FullLikelihood:
    """Likelihood of readings under the full model, in units of their noise."""

    weighing: Weighing
    columns: Array  # of the machine and then of its instruments, in standard deviations (n, q)
    residual: Array  # (n,)
    scales: Scales
    covariance: Array | None = None  # S, if it is known and has fewer rows than A columns

    @classmethod
    def from_linear_model(cls, model: LinearisedModel, scales: Scales) -> FullLikelihood:
        """Linearise the readings about the posterior."""
        nuisance = model.nuisance
        precision = np.maximum(nuisance.precision, WIDEST_DATUM**-2.0)
        columns, expected = in_standard_deviations(model, model.rows.columns(), scales)
        whiten = nuisance.weighing.whiten
        return cls(
            nuisance.weighing,
            whiten(np.hstack([columns, nuisance.columns / np.sqrt(precision)])),
            whiten(model.problem.measured - model.value_at_zero - expected),
            scales,
        )

    @cached_property
    def _is_wide(self) -> bool:
        """True if columns outnumber readings. Then ``S`` is factorised, and else ``1 + A^T A``, the
        smaller of the two, with ``S^-1 = 1 - A (1 + A^T A)^-1 A^T``.
        """
        return self.columns.shape[1] > len(self.columns)

    @cached_property
    def _square(self) -> Array:
        """``S`` ``(n, n)`` or ``1 + A^T A`` ``(q, q)``."""
        columns = self.columns if self._is_wide else self.columns.T
        square = columns @ columns.T if self.covariance is None else self.covariance
        if self.covariance is None:
            square[np.diag_indices_from(square)] += 1.0
        return np.asarray(square)

    @cached_property
    def _cholesky(self) -> Array:
        """Cholesky factor of ``_square``."""
        square = self._square.copy()
        rounding = len(square) * np.finfo(float).eps if self._is_wide else _SUM_ROUNDING
        square[np.diag_indices_from(square)] += rounding * square.diagonal().max(initial=0.0)
        return np.asarray(np.linalg.cholesky(square), dtype=np.float64)

    @cached_property
    def _root(self) -> Array:
        """``V`` of ``S^-1 = V V^T`` ``(n, n)``, or of ``S^-1 = 1 - V V^T`` ``(n, q)``."""
        right = np.eye(len(self.columns)) if self._is_wide else self.columns.T
        return np.asarray(solve_triangular(self._cholesky, right, lower=True).T)

    def _weighted_residual(self, change: Array) -> Array:
        """Return ``S^-1`` times the residual of changed readings ``(n,)``."""
        residual = self.residual + self.weighing.whiten(change)
        product = self._root @ (self._root.T @ residual)
        return np.asarray(product if self._is_wide else residual - product)

    def log_likelihood(self, change: Array) -> Array:
        """Return the log likelihood ``(h,)`` of readings with changes ``(n, h)``, metres."""
        residuals = self.residual[:, None] + self.weighing.whiten(change)
        right = residuals if self._is_wide else self.columns.T @ residuals
        projected = solve_triangular(self._cholesky, right, lower=True)
        square = np.sum(projected**2, axis=0)
        if not self._is_wide:
            square = np.sum(residuals**2, axis=0) - square
        return np.asarray(-(square + _log_determinant(self._cholesky)) / 2)

    def deletion(self, rows: Rows, change: Array) -> Deletion:
        """Return some readings, with a change of all readings ``(n,)``, metres, against their
        prediction by all others.
        """
        block = self._root[rows] @ self._root[rows].T
        inverse_block = block if self._is_wide else np.eye(len(rows)) - block
        inverse_block[np.diag_indices_from(block)] += _ROUNDING
        cholesky = np.asarray(np.linalg.cholesky(inverse_block), dtype=np.float64)
        whitened = solve_triangular(cholesky, self._weighted_residual(change)[rows], lower=True)
        scaled = solve_triangular(cholesky, whitened, lower=True, trans="T")
        square = float(whitened @ whitened)
        return Deletion(scaled * self.weighing.sigma[rows], square, _log_determinant(cholesky))

    def relabelled(
        self, rows: Rows, columns: Array, instruments: Array, residual: Array
    ) -> FullLikelihood:
        """Return the likelihood with other columns of the machine ``(k, C)``, nuisances and
        residual ``(k,)`` of whole setups, all in metres.
        """
        whiten = self.weighing.subset(rows).whiten
        changed = np.pad(self.columns, [(0, 0), (0, instruments.shape[1])])
        changed[rows] = 0.0
        changed[rows, : columns.shape[1]] = whiten(columns)
        changed[rows, self.columns.shape[1] :] = whiten(instruments)
        residuals = self.residual.copy()
        residuals[rows] = whiten(residual)
        covariance = None
        if self._is_wide:  # the other readings have the covariance that they had
            covariance = self._square.copy()
            covariance[rows] = changed[rows] @ changed.T
            covariance[:, rows] = covariance[rows].T
            covariance[rows, rows] += 1.0
        return replace(self, columns=changed, residual=residuals, covariance=covariance)

    def expected_noise(self, change: Array) -> Array:
        """Return the expected noise of changed readings ``(n,)``, metres."""
        return self.weighing.metres(self._weighted_residual(change))


def _log_determinant(cholesky: Array) -> float:
    """Log determinant of the matrix whose Cholesky factor is ``cholesky``."""
    return 2 * float(np.log(np.diag(cholesky)).sum())


def in_standard_deviations(
    model: LinearisedModel, rows: Array, scales: Scales
) -> tuple[Array, Array]:
    """Return rows ``(n, C)`` scaled to a standard deviation of each coefficient, and their prior
    mean ``(n,)``. Parameters of an earlier calibration have its mean and covariance.
    """
    sd = np.sqrt(model.linear.spike(*scales))
    columns = rows * sd
    matrix, target = model.prior_rows
    if not len(target):
        return columns, np.zeros(len(rows))
    calibrated = np.flatnonzero(matrix.any(axis=0))
    root = np.linalg.inv(matrix[:, calibrated] * model.units[calibrated])
    columns[:, calibrated] = rows[:, calibrated] @ root
    return columns, np.asarray(columns[:, calibrated] @ target)
