"""Compression of many readings to the directions that coefficients move.

Readings are processed in blocks of whole stations. With whitened, projected columns A of unit
length, ``A^T A = V L V^T`` gives orthonormal directions ``A V L^-1/2``, in which columns, residual
and station errors are expressed. Of the residual orthogonal to them only the sum of squares over
the stations, and its degrees of freedom, are kept.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.least_squares import Nuisances
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array

COMPRESSION_THRESHOLD = 5000
"""Number of readings above which they are compressed."""

_BLOCK = 4096  # readings in a block
_ROUNDING = 1e-13  # eigenvalue below which a direction is rounding, for columns of unit length

StationRemainder = tuple[float, float, float]
"""Residual of station means orthogonal to all columns: chi2, degrees of freedom, visits."""


def compress_readings(
    nuisance: Nuisances, rows: Array, residual: Array
) -> tuple[Array, Array, Array, StationRemainder]:
    """Return columns and residual in their own directions.

    Args:
        nuisance: of the fit, with the weighing that whitens.
        rows: columns ``(n, C)``, metres.
        residual: of the readings ``(n,)``, metres.

    Returns:
        Columns ``(r, C)``, residual ``(r,)``, a root of the covariance of independent station
        errors of one sigma ``(r, r)``, and the remainder of the stations.
    """
    n, count = rows.shape
    basis = nuisance.basis
    nuisance_part = np.zeros((basis.shape[1], count + 1))
    for block, weighing in _station_blocks(nuisance.weighing):
        whitened = weighing.whiten(np.column_stack([rows[block], residual[block]]))
        nuisance_part += basis[block].T @ whitened
    tail = -basis[n:] @ nuisance_part
    gram, station_gram, station_chi2 = tail.T @ tail, np.zeros((count + 1,) * 2), 0.0
    for block, weighing in _station_blocks(nuisance.weighing):
        whitened = weighing.whiten(np.column_stack([rows[block], residual[block]]))
        whitened -= basis[block] @ nuisance_part
        gram += whitened.T @ whitened
        unit_error = weighing.whiten(weighing.sigma)
        station_sums = np.add.reduceat((whitened.T * unit_error).T, weighing.first_rows, axis=0)
        station_gram += station_sums.T @ station_sums
        station_chi2 += float(np.sum(weighing.station_components(whitened[:, -1]) ** 2))
    length = np.sqrt(np.diag(gram)[:-1])
    length = np.where(length > 0, length, 1.0)
    values, vectors = np.linalg.eigh(gram[:-1, :-1] / length / length[:, None])
    kept = values > _ROUNDING * max(values.max(initial=0.0), 1.0)
    values, vectors = values[kept], vectors[:, kept]
    transform = (vectors / np.sqrt(values)) / length[:, None]
    columns = (vectors * np.sqrt(values)).T * length
    compressed_residual = transform.T @ gram[:-1, -1]
    stations = nuisance.weighing.first_rows
    remainder = max(station_chi2 - float(compressed_residual @ compressed_residual), 0.0)
    dof = max(len(stations) - nuisance.unconstrained_count - len(values), 0)
    visits = len(residual) / len(stations)
    square = transform.T @ station_gram[:-1, :-1] @ transform
    values, vectors = np.linalg.eigh((square + square.T) / 2)
    root = np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    return columns, compressed_residual, root, (remainder, float(dof), visits)


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
