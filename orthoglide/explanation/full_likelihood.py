"""The likelihood of readings, and of alternative readings, under the full model.

Every parameter and every nuisance of an instrument may deviate by its prior standard deviation,
which gives whitened readings the covariance ``S = 1 + A A^T``, with the columns A in these standard
deviations. Alternative readings r' have the log likelihood
``-r'^T S^-1 r' / 2`` up to a constant, so one factorisation serves all of them. Another leg or
direction changes the columns of one setup or two only: the other readings are factorised once, and
each label costs a factorisation in the machine's parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import qr, solve_triangular

from orthoglide.explanation.columns import LinearisedModel
from orthoglide.explanation.faults import Rows
from orthoglide.fit.noise import Weighing
from orthoglide.geometry import Array
from orthoglide.observations.arrays import group_ids

Scales = tuple[float, float]
"""Background scales of the parameters, in tolerances, and of the free-form errors."""

WIDEST_DATUM = 1e-2
"""Largest standard deviation of a nuisance of an instrument, such as a datum, metres or radians:
half the range of a dial."""

_LEAST_EXCESS = 2.0
"""Standard deviations by which the squares of a setup must exceed their mean before larger noise is
considered: an excess of z gains ``z^2 / 2`` at most, 2 at two, against log odds of 3 at least."""

_SUM_ROUNDING = 1e-15  # of a sum of squares, relative to it: some machine epsilons
_LEAST_LENGTH = 1e-9
"""Smallest pivot of a direction that is kept in a basis, in standard deviations of a reading by one
unit of a coefficient: with 30 units, and readings off by 10 000 standard deviations, the others
change a log likelihood by less than 1e-6."""

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
class WhitenedRows:
    """Readings and their columns in units of the noise, which all backgrounds share.

    The columns of each setup are expressed in an orthonormal basis of their span, so that many
    readings cost no more than their rank. What is orthogonal to it is noise.
    """

    model: LinearisedModel
    basis: Any  # of all setups, a sparse matrix (n, m)
    columns: Array  # of the coefficients, in their units, in the basis (m, C)
    nuisances: Array  # of the instruments, in prior standard deviations (m, k)
    residual: Array  # readings less the prediction at zero (n,)

    @classmethod
    def of(cls, model: LinearisedModel) -> WhitenedRows:
        """Return the readings of a linear model."""
        nuisance, problem, group = model.nuisance, model.problem, model.rows.index
        first, counts = model.rows.first, np.bincount(group)
        means = nuisance.of_means(group)
        precision = np.maximum(nuisance.precision, WIDEST_DATUM**-2.0)
        rows = model.rows.rows(first)
        columns = means.weighing.whiten(np.hstack([rows, means.columns / np.sqrt(precision)]))
        # Readings without weight keep their labels, and are a part of their own.
        part = group_ids(np.column_stack([problem.setup_of_row, problem.weighted]))[first]
        parts = [np.flatnonzero(part == k) for k in range(part.max() + 1)]
        blocks = [_span(columns[of_part]) for of_part in parts]
        order = np.argsort(np.concatenate(parts))
        of_means = sparse.csr_matrix(sparse.block_diag(blocks))[order]
        columns = of_means.T @ columns
        return cls(
            model,
            sparse.diags(1 / np.sqrt(counts[group])) @ of_means[group],
            columns[:, : rows.shape[1]],
            columns[:, rows.shape[1] :],
            nuisance.weighing.whiten(problem.measured - model.value_at_zero),
        )

    def likelihood(self, scales: Scales, slab_root: Array) -> FullLikelihood:
        """Return the likelihood over a background and the slab of some active groups."""
        columns, expected = in_standard_deviations(self.model, self.columns, scales, slab_root)
        return FullLikelihood(
            self.model.nuisance.weighing,
            np.hstack([columns, self.nuisances]),
            self.residual - self.basis @ expected,
            self.basis,
            self.model.rows.index,
            scales,
            slab_root,
        )


def _span(columns: Array) -> Array:
    """Return an orthonormal basis ``(k, r)`` of the span of whitened columns ``(k, q)``."""
    basis, triangle, _ = qr(columns, mode="economic", pivoting=True)
    return np.asarray(basis[:, np.abs(np.diag(triangle)) > _LEAST_LENGTH])


class Prediction(NamedTuple):
    """Some coefficients given all readings but those of some setups."""

    log_likelihood: float  # of all readings but these
    mean: Array  # of the coefficients, in prior standard deviations (p,)
    root: Array  # of their covariance (p, p)

    def relabelled(self, columns: Array, instruments: Array, residual: Array) -> float:
        """Return the log likelihood of all readings if those of the setups have other columns
        ``(k, p)``, nuisances and residual ``(k,)``, all whitened.

        The last row of a triangular factor is the root of the least square, without the loss of
        digits of a difference of squares.
        """
        moved = np.hstack([columns @ self.root, instruments])
        q, rest = moved.shape[1], residual - columns @ self.mean
        rows = np.vstack([np.column_stack([moved, rest]), np.eye(q, q + 1)])
        diagonal = np.abs(np.diag(np.linalg.qr(rows, mode="r")))
        log_determinant = 2 * float(np.log(diagonal[:q]).sum())
        return self.log_likelihood - (float(diagonal[q]) ** 2 + log_determinant) / 2


@dataclass(frozen=True, eq=False, repr=False)
class FullLikelihood:
    """Likelihood of readings under the full model, in units of their noise."""

    weighing: Weighing
    # in the basis (m, q): first those of the machine, then of its instruments, in prior standard
    # deviations
    columns: Array
    residual: Array  # (n,)
    basis: Any  # orthonormal, a sparse matrix (n, m): what is orthogonal to it is noise
    group: NDArray[np.int64]  # number of each reading's row among the different ones (n,)
    scales: Scales
    # root of the covariance that active groups add to the coefficients (C, k)
    slab_root: Array | None = None

    @cached_property
    def _covariance(self) -> Array:
        """``S`` in the basis ``(m, m)``."""
        square = self.columns @ self.columns.T
        # A Cholesky factor is rounded relative to each row, of which datums have the largest.
        square[np.diag_indices_from(square)] *= 1 + _SUM_ROUNDING * len(square)
        square[np.diag_indices_from(square)] += 1.0
        return np.asarray(square)

    @cached_property
    def _cholesky(self) -> Array:
        """Cholesky factor of ``S``."""
        return np.asarray(np.linalg.cholesky(self._covariance), dtype=np.float64)

    @cached_property
    def _root(self) -> Array:
        """``V`` of ``S^-1 = V V^T`` ``(m, m)``."""
        right = np.eye(len(self.columns))
        return np.asarray(solve_triangular(self._cholesky, right, lower=True).T)

    @cached_property
    def _weighted_as_read(self) -> Array:
        """``S^-1`` times the residual of the readings as they stand ``(n,)``."""
        return self._weighted(self.residual)

    def _weighted(self, residual: Array) -> Array:
        """Return ``S^-1`` times a residual ``(n,)``."""
        sums = self.basis.T @ residual
        product = self._root @ (self._root.T @ sums)
        return np.asarray(residual - self.basis @ (sums - product))

    def log_likelihood(self, change: Array) -> Array:
        """Return the log likelihood ``(h,)`` of readings with changes ``(n, h)``, metres."""
        residuals = self.residual[:, None] + self.weighing.whiten(change)
        sums = self.basis.T @ residuals
        projected = solve_triangular(self._cholesky, sums, lower=True)
        noise = residuals - self.basis @ sums
        square = np.sum(noise**2, axis=0) + np.sum(projected**2, axis=0)
        return np.asarray(-(square + _log_determinant(self._cholesky)) / 2)

    def prediction_without(self, rows: Rows, coefficients: Rows) -> Prediction:
        """Return the prediction of some coefficients by all readings but those of whole setups."""
        others = np.setdiff1d(np.arange(len(self.columns)), self.basis[rows].indices)
        cholesky = np.linalg.cholesky(self._covariance[np.ix_(others, others)])
        sums = self.basis.T @ self.residual
        noise = np.delete(self.residual - self.basis @ sums, rows)
        right = np.column_stack([self.columns[np.ix_(others, coefficients)], sums[others]])
        whitened = solve_triangular(cholesky, right, lower=True)
        columns, residual = whitened[:, :-1], whitened[:, -1]
        square = float(noise @ noise + residual @ residual)
        values, vectors = np.linalg.eigh(np.eye(len(coefficients)) - columns.T @ columns)
        return Prediction(
            -(square + _log_determinant(cholesky)) / 2,
            columns.T @ residual,
            vectors * np.sqrt(np.maximum(values, 0.0)),
        )

    def deletion(self, rows: Rows, change: Array | None = None) -> Deletion:
        """Return some readings, with a change of all readings ``(n,)``, metres, against their
        prediction by all others. The difference is exact for whole stations, whose readings share a
        rounding error.
        """
        weighted = self._weighted_as_read
        if change is not None and change.any():
            weighted = self._weighted(self.residual + self.weighing.whiten(change))
        span, inverse = self._inverse_block(rows)
        cholesky = np.asarray(np.linalg.cholesky(inverse))
        sums = span.T @ weighted[rows]
        whitened = solve_triangular(cholesky, sums, lower=True)
        scaled = solve_triangular(cholesky, whitened, lower=True, trans="T")
        noise = weighted[rows] - span @ sums
        _, of_row, counts = np.unique(self.group[rows], return_inverse=True, return_counts=True)
        scatter = weighted[rows] - (np.bincount(of_row, weighted[rows]) / counts)[of_row]
        return Deletion(
            self.weighing.subset(rows).metres(noise + span @ scaled),
            float(whitened @ whitened + noise @ noise),
            _log_determinant(cholesky), float(scatter @ scatter), len(counts),
        )  # fmt: skip

    def _inverse_block(self, rows: Rows) -> tuple[Array, Array]:
        """Return an orthonormal basis ``(k, r)`` of the rows of some readings, and their block of
        ``S^-1`` in it ``(r, r)``; orthogonal to it, the block is the identity.
        """
        part = self.basis[rows]
        present = np.unique(part.indices)
        span, triangle = np.linalg.qr(part[:, present].toarray())
        root = triangle @ self._root[present]
        hat = triangle @ triangle.T - root @ root.T
        return span, np.asarray((1 + _ROUNDING) * np.eye(len(triangle)) - hat)

    def noise_gains(self, rows: Rows, ratios: Sequence[float]) -> Array:
        """Return the gain of log likelihood if the noise of some readings is so many times larger
        ``(r,)``; zeros unless their squares exceed the expected ones by `_LEAST_EXCESS` standard
        deviations.

        With the block B of ``S^-1`` and w of ``S^-1 r``, noise of a variance larger by v changes
        the log likelihood by ``v w^T (1 + v B)^-1 w / 2 - ln|1 + v B| / 2``.
        """
        (span, inverse), weighted = self._inverse_block(rows), self._weighted_as_read[rows]
        sums, scatter_dof = span.T @ weighted, len(rows) - len(inverse)
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
