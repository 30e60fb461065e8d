"""Sparse regression: which of many similar columns explain a residual together."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from orthoglide.fit.least_squares import rounding
from orthoglide.geometry import Array

_ROUNDS = 40  # reweightings: with 200 the search ended at the same states

_NEGLIGIBLE = 0.01
"""Size of a column, in the largest slab, below which it is left out of further rounds: a third of
the smallest slab."""


def sparse_sizes(gram: Array, products: Array, largest: float) -> Array:
    """Return the standard deviation of each coefficient that makes the residual likeliest ``(k,)``,
    zero for most of them.

    All coefficients start with a wide prior. Its variances are reweighted by the readings, and
    those of columns that others can replace fall toward zero (D. Wipf and S. Nagarajan, "Iterative
    reweighted l1 and l2 methods for finding sparse solutions", IEEE JSTSP 4, 2010).

    Args:
        gram: inner products of the whitened columns ``(k, k)``.
        products: of the columns and the residual ``(k,)``.
        largest: standard deviation to start with.
    """
    sizes, kept = np.zeros(len(products)), np.arange(len(products))
    size = np.full(len(products), largest)
    for _ in range(_ROUNDS):
        if not len(kept):
            break
        scaled = size[:, None] * gram
        covariance = scaled * size + np.eye(len(size))
        root = np.linalg.cholesky(covariance + rounding(covariance))
        whitened = solve_triangular(root, np.column_stack([scaled, size * products]), lower=True)
        remaining = np.diag(gram + rounding(gram)) - np.sum(whitened[:, :-1] ** 2, axis=0)
        along = products - whitened[:, -1] @ whitened[:, :-1]
        size *= np.sqrt(np.abs(along) / np.sqrt(remaining))
        needed = size > _NEGLIGIBLE * largest
        size, kept, products = size[needed], kept[needed], products[needed]
        gram = gram[np.ix_(needed, needed)]
    sizes[kept] = size
    return sizes
