"""The likelihood of readings, and of alternative readings, under the full model.

Every parameter and every nuisance of an instrument may deviate by its prior standard deviation,
which gives whitened readings the covariance ``S = 1 + A A^T``, with the columns A in these standard
deviations. Alternative readings r' have the log likelihood
``-r'^T S^-1 r' / 2`` up to a constant, so one factorisation serves all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from orthoglide.explanation.columns import LinearisedModel
from orthoglide.explanation.faults import Rows
from orthoglide.fit.least_squares import rounding
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array

Scales = tuple[float, float]
"""Background scales of the parameters, in tolerances, and of the free-form errors."""

WIDEST_DATUM = 1e-2
"""Largest standard deviation of a nuisance of an instrument, such as a datum, metres or radians:
half the range of a dial."""

_LEAST_EXCESS = 2.0
"""Standard deviations by which the squares of a setup must exceed their mean before larger noise is
considered: an excess of z gains ``z^2 / 2`` at most, 2 at two, against log odds of 3 at least."""

_ROUNDING = 1e-12  # of entries of S^-1, which are 1 or less: sums of some thousand products


class Deletion(NamedTuple):
    """Some readings against their prediction by all others."""

    difference: Array  # from that prediction (k,), metres
    mahalanobis_square: float  # of the difference, by its covariance
    log_det: float  # log determinant of the inverse covariance, in units of the noise
    scatter_square: float  # part of the square that is scatter of readings with equal rows
    row_count: int  # number of different rows

    @property
    def gain(self) -> float:
        """Gain of log likelihood by zero weight of these readings."""
        return (self.mahalanobis_square - self.log_det) / 2

    @property
    def relabelling_limit(self) -> float:
        """Gain of log likelihood that the right labels of these readings seldom exceed: with them
        the square is its mean, less a standard deviation. Labels leave the scatter unchanged; the
        determinants are taken as equal.
        """
        expected = self.row_count - np.sqrt(2 * self.row_count)
        return float(self.mahalanobis_square - self.scatter_square - expected) / 2


@dataclass(frozen=True, eq=False, repr=False)
class FullLikelihood:
    """Likelihood of readings under the full model, in units of their noise."""

    weighing: Weighing
    # one row for each group of readings with equal rows, which stands for their sum over the root
    # of their number: their differences are noise. First the columns of the machine, then those of
    # its instruments, in prior standard deviations (m, q)
    columns: Array
    residual: Array  # (n,)
    group: NDArray[np.int64]  # row of each reading (n,)
    scales: Scales
    square: Array | None = None  # ``S`` or ``1 + A^T A``, see ``_square``, if it is known
    # root of the covariance that active groups add to the coefficients (C, k)
    slab_root: Array | None = None

    @classmethod
    def from_linear_model(
        cls, model: LinearisedModel, scales: Scales, slab_root: Array
    ) -> FullLikelihood:
        """Linearise the readings about the posterior, with the slab of some active groups."""
        nuisance = model.nuisance
        precision = np.maximum(nuisance.precision, WIDEST_DATUM**-2.0)
        rows = model.rows.rows(model.rows.first)
        columns, expected = in_standard_deviations(model, rows, scales, slab_root)
        group, means = model.rows.index, nuisance.of_means(model.rows.index)
        return cls(
            nuisance.weighing,
            means.weighing.whiten(np.hstack([columns, means.columns / np.sqrt(precision)])),
            nuisance.weighing.whiten(
                model.problem.measured - model.value_at_zero - expected[group]
            ),
            group,
            scales,
            slab_root=slab_root,
        )

    @cached_property
    def _counts(self) -> NDArray[np.int64]:
        """Number of readings of each row ``(m,)``."""
        return np.bincount(self.group)

    def _normalised_sums(self, readings: Array) -> Array:
        """Return the normalised sums ``(m, ...)`` of whitened readings ``(n, ...)`` of one row."""
        order, count = np.argsort(self.group, kind="stable"), self._counts
        sums = np.add.reduceat(readings[order], np.cumsum(count) - count, axis=0)
        return np.asarray((sums.T / np.sqrt(count)).T)

    @cached_property
    def _is_wide(self) -> bool:
        """True if columns outnumber rows. Then ``S`` is factorised, and else ``1 + A^T A``, the
        smaller of the two, with ``S^-1 = 1 - A (1 + A^T A)^-1 A^T``.
        """
        return self.columns.shape[1] > len(self.columns)

    @cached_property
    def _square(self) -> Array:
        """``S`` ``(m, m)`` or ``1 + A^T A`` ``(q, q)``."""
        if self.square is not None:
            return self.square
        columns = self.columns if self._is_wide else self.columns.T
        square = columns @ columns.T
        square[np.diag_indices_from(square)] += 1.0
        return np.asarray(square)

    @cached_property
    def _cholesky(self) -> Array:
        """Cholesky factor of ``_square``."""
        square = self._square + rounding(self._square)
        return np.asarray(np.linalg.cholesky(square), dtype=np.float64)

    @cached_property
    def _root(self) -> Array:
        """``V`` of ``S^-1 = V V^T`` ``(m, m)``, or of ``S^-1 = 1 - V V^T`` ``(m, q)``."""
        right = np.eye(len(self.columns)) if self._is_wide else self.columns.T
        return np.asarray(solve_triangular(self._cholesky, right, lower=True).T)

    @cached_property
    def _weighted_as_read(self) -> Array:
        """``S^-1`` times the residual of the readings as they stand ``(n,)``."""
        return self._weighted(self.residual)

    def _weighted(self, residual: Array) -> Array:
        """Return ``S^-1`` times a residual ``(n,)``."""
        sums = self._normalised_sums(residual)
        product = self._root @ (self._root.T @ sums)
        explained = sums - product if self._is_wide else product
        return np.asarray(residual - (explained / np.sqrt(self._counts))[self.group])

    def log_likelihood(self, change: Array) -> Array:
        """Return the log likelihood ``(h,)`` of readings with changes ``(n, h)``, metres."""
        residuals = self.residual[:, None] + self.weighing.whiten(change)
        sums = self._normalised_sums(residuals)
        right = sums if self._is_wide else self.columns.T @ sums
        projected = solve_triangular(self._cholesky, right, lower=True)
        explained = np.sum(projected**2, axis=0)
        if self._is_wide:
            explained = np.sum(sums**2, axis=0) - explained
        square = np.sum(residuals**2, axis=0) - explained
        return np.asarray(-(square + _log_determinant(self._cholesky)) / 2)

    def deletion(self, rows: Rows, change: Array | None = None) -> Deletion:
        """Return some readings, with a change of all readings ``(n,)``, metres, against their
        prediction by all others. The difference is exact for whole stations.
        """
        weighted = self._weighted_as_read
        if change is not None and change.any():
            weighted = self._weighted(self.residual + self.weighing.whiten(change))
        present, of_row, count = self._rows_of(rows)
        cholesky = np.asarray(np.linalg.cholesky(self._inverse_block(present, count)))
        sums = np.bincount(of_row, weighted[rows]) / np.sqrt(count)
        differences = weighted[rows] - (sums / np.sqrt(count))[of_row]
        whitened = solve_triangular(cholesky, sums, lower=True)
        scaled = solve_triangular(cholesky, whitened, lower=True, trans="T")
        difference = differences + (scaled / np.sqrt(count))[of_row]
        scatter = float(differences @ differences)
        return Deletion(
            self.weighing.subset(rows).metres(difference), float(whitened @ whitened) + scatter,
            _log_determinant(cholesky), scatter, len(present),
        )  # fmt: skip

    def _rows_of(self, readings: Rows) -> tuple[Rows, Rows, Rows]:
        """Return the different rows ``(k,)`` of some readings, the index of each reading's row
        among them, and how many of the readings have each.
        """
        return np.unique(self.group[readings], return_inverse=True, return_counts=True)

    def _inverse_block(self, present: Rows, count: Rows) -> Array:
        """Return the block of ``S^-1`` ``(k, k)`` of ``count`` readings of each of some rows."""
        share, no_noise = np.sqrt(count / self._counts[present]), np.eye(len(present))
        block = self._root[present] @ self._root[present].T
        hat = no_noise - block if self._is_wide else block
        return np.asarray((1 + _ROUNDING) * no_noise - share[:, None] * hat * share)

    def noise_gains(self, rows: Rows, ratios: Sequence[float]) -> Array:
        """Return the gain of log likelihood if the noise of some readings is so many times larger
        ``(r,)``; zeros where their squares are no larger than expected.

        With the block B of ``S^-1`` and w of ``S^-1 r``, noise of a variance larger by v changes
        the log likelihood by ``v w^T (1 + v B)^-1 w / 2 - ln|1 + v B| / 2``.
        """
        present, of_row, count = self._rows_of(rows)
        inverse, weighted = self._inverse_block(present, count), self._weighted_as_read[rows]
        sums, scatter_dof = np.bincount(of_row, weighted) / np.sqrt(count), len(rows) - len(count)
        expected = np.trace(inverse) + scatter_dof
        spread = np.sqrt(2 * (np.sum(inverse**2) + scatter_dof))
        if weighted @ weighted < expected + _LEAST_EXCESS * spread:
            return np.zeros(len(ratios))
        values, vectors = np.linalg.eigh(inverse)
        squares, added = (vectors.T @ sums) ** 2, np.array(ratios)[:, None] ** 2 - 1
        scatter = max(float(weighted @ weighted - sums @ sums), 0.0)
        values, squares = np.append(values, 1.0), np.append(squares, scatter)
        dof = np.append(np.ones(len(sums)), scatter_dof)
        gains = added * squares / (1 + added * values) - dof * np.log1p(added * values)
        return np.asarray(gains.sum(axis=1) / 2)

    def relabelled(
        self, rows: Rows, columns: Array, instruments: Array, residual: Array
    ) -> FullLikelihood:
        """Return the likelihood with other columns of the machine ``(k, C)``, nuisances and
        residual ``(k,)`` of whole setups, all in metres.
        """
        whiten = self.weighing.subset(rows).whiten
        present, first = np.unique(self.group[rows], return_index=True)
        changed = np.pad(self.columns, [(0, 0), (0, instruments.shape[1])])
        changed[present] = 0.0
        changed[present, : columns.shape[1]] = whiten(columns)[first]
        changed[present, self.columns.shape[1] :] = whiten(instruments)[first]
        changed[present] *= np.sqrt(self._counts[present])[:, None]
        residuals = self.residual.copy()
        residuals[rows] = whiten(residual)
        square = None
        if self._is_wide:  # only these rows and columns of S change
            square = self._square.copy()
            square[present] = changed[present] @ changed.T
            square[:, present] = square[present].T
            square[present, present] += 1.0
        elif changed.shape[1] <= len(changed):  # only their part of A^T A changes
            before, after = self.columns[present], changed[present]
            square, count = after.T @ after, len(self._square)
            square[:count, :count] += self._square - before.T @ before
            square[range(count, len(square)), range(count, len(square))] += 1.0
        return replace(self, columns=changed, residual=residuals, square=square)

    def expected_noise(self, change: Array) -> Array:
        """Return the expected noise of changed readings ``(n,)``, metres."""
        return self.weighing.metres(self._weighted(self.residual + self.weighing.whiten(change)))


def _log_determinant(cholesky: Array) -> float:
    """Log determinant of the matrix whose Cholesky factor is ``cholesky``."""
    return 2 * float(np.log(np.diag(cholesky)).sum())


def in_standard_deviations(
    model: LinearisedModel, rows: Array, scales: Scales, slab_root: Array | None
) -> tuple[Array, Array]:
    """Return rows ``(n, C)`` scaled to a standard deviation of each coefficient and of each
    direction of the slab ``(C, k)``, and their prior mean ``(n,)``. Parameters of an earlier
    calibration have its mean and covariance.
    """
    sd = np.sqrt(model.linear.spike(*scales))
    columns = rows * sd if slab_root is None else np.hstack([rows * sd, rows @ slab_root])
    matrix, target = model.prior_rows
    if not len(target):
        return columns, np.zeros(len(rows))
    calibrated = np.flatnonzero(matrix.any(axis=0))
    root = np.linalg.inv(matrix[:, calibrated] * model.units[calibrated])
    columns[:, calibrated] = rows[:, calibrated] @ root
    return columns, np.asarray(columns[:, calibrated] @ target)
