"""Sparse regression: which of many similar columns explain a residual together."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from orthoglide.fit.least_squares import rounding
from orthoglide.geometry import Array

_ROUNDS = 40  # reweightings: with 200 the search ended at the same states

_NEGLIGIBLE = 0.01
"""Prior standard deviation, relative to the initial one, below which a coefficient is dropped: a
third of the smallest slab scale."""


def sparse_prior_sd(gram: Array, products: Array, initial_sd: float) -> Array:
    """Return the prior standard deviations ``(k,)`` at which the residual is likeliest, most of
    them zero.

    All coefficients start with a wide prior. Its variances are reweighted by the readings, and
    those of columns that others can replace fall toward zero (D. Wipf and S. Nagarajan, "Iterative
    reweighted l1 and l2 methods for finding sparse solutions", IEEE JSTSP 4, 2010).

    Args:
        gram: inner products of the whitened columns ``(k, k)``.
        products: inner products of these columns and the whitened residual ``(k,)``.
        initial_sd: standard deviation of every coefficient to start with.
    """
    all_sd, kept = np.zeros(len(products)), np.arange(len(products))
    sd = np.full(len(products), initial_sd)
    for _ in range(_ROUNDS):
        if not len(kept):
            break
        scaled = sd[:, None] * gram
        covariance = scaled * sd + np.eye(len(sd))
        root = np.linalg.cholesky(covariance + rounding(covariance))
        whitened = solve_triangular(root, np.column_stack([scaled, sd * products]), lower=True)
        remaining = np.diag(gram + rounding(gram)) - np.sum(whitened[:, :-1] ** 2, axis=0)
        along = products - whitened[:, -1] @ whitened[:, :-1]
        sd *= np.sqrt(np.abs(along) / np.sqrt(remaining))
        needed = sd > _NEGLIGIBLE * initial_sd
        sd, kept, products = sd[needed], kept[needed], products[needed]
        gram = gram[np.ix_(needed, needed)]
    all_sd[kept] = sd
    return all_sd
