"""Many readings in the few directions in which anything could show, without a matrix of their own.

Readings are gone through in blocks of whole stations. With whitened, projected columns A of unit
length, ``A^T A = V L V^T`` gives orthonormal directions ``A V L^-1/2``; in these are the columns,
the residual, and what errors of single stations would show. What the residual has beside them is
summed up: its square over the stations, and how many directions that are.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.least_squares import Nuisances
from orthoglide.fit.weighing import Weighing
from orthoglide.geometry import Array

COMPRESSION_THRESHOLD = 5000
"""Readings from which they are gone through in blocks."""

_BLOCK = 4096
_ROUNDING = (
    1e-13  # squared length of a direction, columns of unit length, below which it is rounding
)

StationRemainder = tuple[float, float, float]
"""What stations show beside all columns: squared, in how many directions, and their visits."""


def compress_readings(
    nuisance: Nuisances, rows: Array, rest: Array
) -> tuple[Array, Array, Array, StationRemainder]:
    """Columns and residual in their own directions.

    Args:
        nuisance: of the fit; its weighing whitens.
        rows: columns before that ``(n, C)``, metres.
        rest: what they are to explain ``(n,)``, metres.

    Returns:
        Columns ``(r, C)``, residual ``(r,)``, a root of what errors of one sigma at every station
        show there ``(r, r)``, and what is beside.
    """
    n, count = rows.shape
    basis = nuisance.basis
    taken = np.zeros((basis.shape[1], count + 1))
    for part, weighing in _station_blocks(nuisance.weighing):
        taken += basis[part].T @ weighing.whiten(np.column_stack([rows[part], rest[part]]))
    tail = -basis[n:] @ taken
    gram, shown, between = tail.T @ tail, np.zeros((count + 1,) * 2), 0.0
    for part, weighing in _station_blocks(nuisance.weighing):
        white = weighing.whiten(np.column_stack([rows[part], rest[part]])) - basis[part] @ taken
        gram += white.T @ white
        error = weighing.whiten(weighing.sigma)
        sums = np.add.reduceat((white.T * error).T, weighing.first_rows, axis=0)
        shown += sums.T @ sums
        between += float(np.sum(weighing.station_components(white[:, -1]) ** 2))
    length = np.sqrt(np.diag(gram)[:-1])
    length = np.where(length > 0, length, 1.0)
    values, vectors = np.linalg.eigh(gram[:-1, :-1] / length / length[:, None])
    kept = values > _ROUNDING * max(values.max(initial=0.0), 1.0)
    values, vectors = values[kept], vectors[:, kept]
    to = (vectors / np.sqrt(values)) / length[:, None]
    columns = (vectors * np.sqrt(values)).T * length
    residual = to.T @ gram[:-1, -1]
    stations = nuisance.weighing.first_rows
    beside = max(between - float(residual @ residual), 0.0)
    free = max(len(stations) - nuisance.unconstrained_count - len(values), 0)
    visits = len(rest) / len(stations)
    square = to.T @ shown[:-1, :-1] @ to
    values, vectors = np.linalg.eigh((square + square.T) / 2)
    root = np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    return columns, residual, root, (beside, float(free), visits)


def _station_blocks(weighing: Weighing) -> Iterator[tuple[NDArray[np.int64], Weighing]]:
    """Rows in blocks of whole stations, by station, each with its own weighing."""
    order = np.argsort(weighing.station, kind="stable")
    starts = np.flatnonzero(np.diff(weighing.station[order], prepend=-1))
    cuts = starts[np.unique(np.searchsorted(starts, np.arange(0, len(order), _BLOCK)).clip(
        0, len(starts) - 1))]  # fmt: skip
    for rows in np.split(order, cuts[cuts > 0]):
        yield rows, weighing.subset(rows)
