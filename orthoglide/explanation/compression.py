"""Compression of many readings: equal rows are stored once, and directions that no coefficient
moves are dropped.

Visits to a station have equal rows, except where a column depends on time or on earlier moves. With
equal weights, the mean of readings with equal rows is sufficient for the coefficients.

Rows are processed in blocks of whole stations. With whitened, projected columns A of unit
length, a pivoted Cholesky factorisation selects independent ones ``A_k`` with ``A_k^T A_k = L_k
L_k^T``. Columns, residual and station errors are expressed in the orthonormal directions ``A_k
L_k^-T``. Of the residual orthogonal to them only the sum of squares over the stations, and its
degrees of freedom, are kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpstrf

from orthoglide.errors import NumericsError
from orthoglide.explanation.linear_model import NO_REMAINDER, StationRemainder
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import Nuisances
from orthoglide.fit.noise import Weighing
from orthoglide.geometry import Array
from orthoglide.observations.arrays import equal_rows

COMPRESSION_THRESHOLD = 1500
"""Number of readings above which they are compressed: their squares are more numbers than data
faults are screened with densely, which needs the readings as they are."""

MOST_RANKED_READINGS = 10_000
"""Number of readings up to which misreadings are ranked, for which all columns are kept by reading:
for more, four matrices by unknowns take over 0.4 GB."""

_BLOCK = 2048  # readings in a block, which is hardly larger than readings that are not compressed
_ROUNDING = 1e-12  # square of what others leave of a unit column, below which it is rounding


@dataclass(frozen=True, eq=False, repr=False)
class MergedRows:
    """A matrix ``(n, C)`` as blocks of columns side by side, whose equal rows are stored once.

    Blocks are not copied into one array, which would need as much memory again. Those of readings
    that are not ranked have single precision: the square of its rounding is below ``_ROUNDING``.
    """

    # columns by distinct row, and the index of each row among these (n,); parameters come first
    blocks: tuple[tuple[Array, NDArray[np.int64]], ...]
    index: NDArray[np.int64]  # from `equal_rows`: number of each row among the distinct ones (n,)

    def beside(self, blocks: Iterable[Array]) -> MergedRows:
        """Return the matrix with further blocks, of all rows ``(n, K)``, or of the first of each
        set of equal rows ``(m, K)``; columns of all rows may differ within such a set.
        """
        first, every, index = self.first, np.arange(len(self.index)), self.index
        precision = np.float64 if len(every) <= MOST_RANKED_READINGS else np.float32
        added = list[tuple[Array, NDArray[np.int64]]]()
        for given in blocks:
            block: Array = given.astype(precision, copy=False)
            merged = block if len(block) == len(first) else block[first]
            is_merged = merged is block or np.array_equal(merged[index], block)
            added.append((merged, index) if is_merged else (block, every))
        varying = [block for block, rows in added if rows is every]
        if varying:
            index = equal_rows(np.column_stack([index, *varying]))
        return MergedRows((*self.blocks, *added), index)

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """First of each set of equal rows ``(m,)``."""
        return np.unique(self.index, return_index=True)[1]

    @cached_property
    def _ends(self) -> NDArray[np.intp]:
        """Index of the column after each block ``(blocks,)``."""
        return np.cumsum([block.shape[1] for block, _ in self.blocks])

    def reduced_to(self, columns: NDArray[np.intp]) -> MergedRows:
        """Return the matrix without the blocks that have none of some columns, which saves memory.

        All columns keep their numbers; only those of the blocks that stay may be read.
        """
        kept = np.isin(np.arange(self._ends[-1]), columns)
        blocks = [
            (block if part.any() else np.empty((0, len(part))), index)
            for (block, index), part in zip(
                self.blocks, np.split(kept, self._ends[:-1]), strict=True
            )
        ]
        return replace(self, blocks=tuple(blocks))

    def rows(self, which: NDArray[np.int64]) -> Array:
        """Return some rows ``(k, C)``."""
        return np.hstack([block[index[which]] for block, index in self.blocks])

    def columns(self, which: Any = slice(None)) -> Array:
        """Return some columns ``(n, k)``, by an index of NumPy, or all of them."""
        chosen = np.arange(self._ends[-1])[which]
        number = np.searchsorted(self._ends, chosen, side="right")
        columns = np.empty((len(self.index), len(chosen)))
        for k in np.unique(number).tolist():
            (block, index), in_block = self.blocks[k], number == k
            columns[:, in_block] = block[:, chosen[in_block] - self._ends[k]][index]
        return columns

    def __matmul__(self, vector: Array) -> Array:
        """Return the product with a vector ``(C,)``: ``(n,)``."""
        parts = zip(self.blocks, np.split(vector, self._ends[:-1]), strict=True)
        return np.asarray(sum((block @ part)[index] for (block, index), part in parts))


@dataclass(frozen=True, eq=False, repr=False)
class WhitenedReadings:
    """Readings in units of their noise, with the instruments' nuisances projected out."""

    columns: Array  # by coefficient (m, C)
    residual: Array  # readings less the prediction at zero (m,)
    # an error of one sigma at each station (m, s), or another root of the same covariance (m, m)
    stations: Array
    station_remainder: StationRemainder

    @classmethod
    def of(
        cls, problem: Problem, nuisance: Nuisances, rows: MergedRows, residual: Array
    ) -> WhitenedReadings:
        """Whiten columns ``(n, C)`` and residual ``(n,)``, metres or radians."""
        if len(residual) > COMPRESSION_THRESHOLD:
            return cls(*compress_readings(nuisance, rows, residual))
        station_errors = np.eye(int(problem.station.max()) + 1)[problem.station]
        station_errors *= problem.sigma[:, None]
        project = nuisance.project
        return cls(
            project(rows.columns()), project(residual), project(station_errors), NO_REMAINDER
        )

    def with_prior_rows(self, prior_rows: tuple[Array, Array], units: Array) -> WhitenedReadings:
        """Append the rows of an earlier posterior ``(k, P)``, in units of the coefficients."""
        matrix, target = prior_rows
        matrix = np.pad(matrix, [(0, 0), (0, len(units) - matrix.shape[1])]) * units
        no_errors = np.zeros((len(target), self.stations.shape[1]))
        return replace(
            self,
            columns=np.vstack([self.columns, matrix]),
            residual=np.concatenate([self.residual, target]),
            stations=np.vstack([self.stations, no_errors]),
        )


def compress_readings(
    nuisance: Nuisances, rows: MergedRows, residual: Array
) -> tuple[Array, Array, Array, StationRemainder]:
    """Return columns and residual in orthonormal directions of the readings.

    Args:
        nuisance: of the fit, with the weighing that whitens, constant over equal rows.
        rows: columns ``(n, C)``, metres.
        residual: of the readings ``(n,)``, metres.

    Returns:
        Columns ``(r, C)``, residual ``(r,)``, a root of the covariance of independent station
        errors of one sigma ``(r, r)``, and the remainder of the stations.
    """
    first, counts = np.unique(rows.index, return_index=True, return_counts=True)[1:]
    sigma, nuisance = nuisance.weighing.sigma[first], nuisance.of_means(rows.index)
    residual_rows = (np.bincount(rows.index, residual) / counts)[:, None], rows.index
    readings = MergedRows((*rows.blocks, residual_rows), rows.index)
    basis, blocks = nuisance.basis, [*_station_blocks(nuisance.weighing)]
    parts = [basis[k].T @ of_block.whiten(readings.rows(first[k])) for k, of_block in blocks]
    nuisance_part: Array = np.sum(parts, axis=0)
    tail = -basis[len(first) :] @ nuisance_part
    gram, station_chi2 = tail.T @ tail, 0.0
    station_gram = np.zeros_like(gram)
    for block, weighing in blocks:
        whitened = weighing.whiten(readings.rows(first[block]))
        whitened -= basis[block] @ nuisance_part
        gram_of_block = whitened.T @ whitened
        gram += gram_of_block
        unit_error = weighing.whiten(sigma[block])
        if len(weighing.first_rows) < len(block) or (unit_error != 1.0).any():
            errors = (whitened.T * unit_error).T
            station_sums = np.add.reduceat(errors, weighing.first_rows, axis=0)
            gram_of_block = station_sums.T @ station_sums
        station_gram += gram_of_block
        station_chi2 += float(np.sum(weighing.station_components(whitened[:, -1]) ** 2))
    squares = np.diag(gram)[:-1]
    length = np.sqrt(np.where(squares == 0, 1.0, squares))
    factor, order = _pivoted_cholesky(gram[:-1, :-1] / length / length[:, None])
    rank = factor.shape[1]
    columns, kept, root = np.empty((rank, len(order))), order[:rank], factor[:rank]
    columns[:, order] = factor.T
    columns *= length

    def in_directions(products: Array) -> Array:
        """Return inner products with the directions from those with the columns kept."""
        return np.asarray(solve_triangular(root, (products.T / length[kept]).T, lower=True))

    compressed_residual = in_directions(gram[kept, -1])
    stations = nuisance.weighing.first_rows
    remainder = max(station_chi2 - float(compressed_residual @ compressed_residual), 0.0)
    dof = max(len(stations) - nuisance.unconstrained_count - rank, 0)
    square = in_directions(in_directions(station_gram[np.ix_(kept, kept)]).T)
    values, vectors = np.linalg.eigh((square + square.T) / 2)
    station_root = np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    remaining = StationRemainder(remainder, float(dof), len(residual) / len(stations))
    return columns, compressed_residual, station_root, remaining


def _pivoted_cholesky(gram: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the lower factor ``(C, r)`` of a Gram matrix ``(C, C)`` of unit columns, and the order
    of the columns ``(C,)``, of which the first r are independent.

    Raises:
        NumericsError: if a column is not finite, which the factorisation would drop.
    """
    if not np.isfinite(gram).all():
        raise NumericsError("the readings' derivatives are not finite: check the machine's sizes")
    factor, order, rank, _ = dpstrf(gram, tol=_ROUNDING, lower=1, overwrite_a=1)
    return np.tril(factor[:, :rank]), order - 1


def _station_blocks(weighing: Weighing) -> Iterator[tuple[NDArray[np.int64], Weighing]]:
    """Yield the rows of blocks of whole stations, sorted by station, with the weighing of each
    block.
    """
    order = np.argsort(weighing.station, kind="stable")
    starts = np.flatnonzero(np.diff(weighing.station[order], prepend=-1))
    cuts = starts[np.unique(np.searchsorted(starts, np.arange(0, len(order), _BLOCK)).clip(
        0, len(starts) - 1))]  # fmt: skip
    for rows in np.split(order, cuts[cuts > 0]):
        yield rows, weighing.subset(rows)
