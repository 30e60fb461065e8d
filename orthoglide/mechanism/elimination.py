"""Linear systems of symbols, eliminated in an order chosen once from numbers.

A pivot that is chosen while numbers are known is a branch; chosen beforehand it leaves code without
branches, which a computer evaluates for many postures at once. The order is Markowitz': pivots that
fill least (Duff, Erisman and Reid 1986, chapter 7), among those that no sample finds small.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array

# Of a pivot to the largest of its column, in every sample: what elimination may lose by it.
_SMALLEST = 0.2

Row = dict[int, Any]


def pivots(samples: Array, filled: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Pivots (row, column) of square matrices in the order of their elimination.

    Args:
        samples: matrices ``(S, n, n)``, all regular.
        filled: which entries can differ from zero, ``(n, n)``.
    """
    values, filled = samples.copy(), filled.copy()
    rows, columns = np.arange(len(filled)), np.arange(len(filled))
    order = []
    while rows.size:
        left = np.abs(values[:, rows[:, None], columns])
        share = (left / np.maximum(left.max(axis=1, keepdims=True), 1e-300)).min(axis=0)
        some = filled[np.ix_(rows, columns)]
        fill = np.outer(some.sum(axis=1) - 1, some.sum(axis=0) - 1)
        cost = np.where(share > min(_SMALLEST, share.max() / 2), fill - share / 2, np.inf)
        i, j = np.unravel_index(np.argmin(cost), cost.shape)
        row, column = int(rows[i]), int(columns[j])
        order.append((row, column))
        rows, columns = np.delete(rows, i), np.delete(columns, j)
        for other in rows[filled[rows, column]]:
            factor = values[:, other, column] / values[:, row, column]
            values[:, other] -= factor[:, None] * values[:, row]
            filled[other] |= filled[row]
    return order


def solve(A: Any, B: Any, order: list[tuple[int, int]]) -> Any:
    """``A^-1 B`` of symbols, sparse where it is zero.

    Args:
        A: SX ``(n, n)``.
        B: SX ``(n, m)``.
        order: of the pivots, see :func:`pivots`.
    """
    left, right = _rows(A), _rows(B)
    for k, (row, column) in enumerate(order):
        left[row][column] = 1 / left[row][column]
        for other, _ in order[k + 1 :]:
            if column in left[other]:
                factor = left[other].pop(column) * left[row][column]
                _subtract(left[other], factor, left[row], column)
                _subtract(right[other], factor, right[row], None)
    for k, (row, column) in reversed(list(enumerate(order))):
        for known, place in order[k + 1 :]:
            if place in left[row]:
                _subtract(right[row], left[row][place], right[known], None)
        right[row] = {j: v * left[row][column] for j, v in right[row].items()}
    found = ca.SX(*B.shape)
    for row, column in order:
        for j, value in right[row].items():
            found[column, j] = value
    return found


def _rows(matrix: Any) -> list[Row]:
    rows: list[Row] = [{} for _ in range(matrix.size1())]
    for k, (i, j) in enumerate(zip(*matrix.sparsity().get_triplet(), strict=True)):
        rows[i][j] = matrix.nz[k]
    return rows


def _subtract(row: Row, factor: Any, other: Row, without: int | None) -> None:
    for j, value in other.items():
        if j != without:
            row[j] = row[j] - factor * value if j in row else -(factor * value)
