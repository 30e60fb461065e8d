"""What groups of columns explain of a residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orthoglide.fit.least_squares import explained_by_two
from orthoglide.geometry import Array


def explained_by_group(
    gram: Array,
    products: Array,
    chi2_bound: Array,
    taus: Sequence[float],
    least: Array | float = -np.inf,
) -> tuple[Array, Array]:
    """Return what each group explains of chi2, and half the log determinant, both ``(..., taus)``.

    At given scales of background and noise, ``explained / 2 - occam`` is the log Bayes factor.

    Args:
        gram: Gram matrices of the groups' columns ``(..., k, k)``.
        products: inner products of these columns and the residual ``(..., k)``.
        chi2_bound: upper bound of the squared residual, broadcast to ``(...)``.
        taus: scales of the slab, ascending.
        least: chi2 that a group of more than two coefficients must explain at the largest tau; if
            it explains less, minus infinity is returned at all taus. Broadcast to ``(...)``.
    """
    count, tau, along = products.shape[-1], np.array(taus), products[..., None] * np.array(taus)
    squares = gram.diagonal(axis1=-2, axis2=-1)[..., None] * tau**2
    if count == 1:
        variance = 1 + squares[..., 0, :]
        return np.asarray(along[..., 0, :] ** 2 / variance), np.asarray(np.log(variance) / 2)
    if count == 2:
        (first, second), (x, y) = (np.moveaxis(of_both, -2, 0) for of_both in (1 + squares, along))
        cross = gram[..., 0, 1, None] * tau**2
        explained, determinant = explained_by_two(first, second, cross, x, y)
        return explained, np.asarray(np.log(determinant) / 2)
    bordered = np.zeros((*products.shape[:-1], count + 1, count + 1))
    bordered[..., :count, :count] = gram
    bordered[..., count, :count] = products
    # The last pivot of the bordered matrix is the corner less what the group explains. The corner
    # exceeds that by far, so that rounding cannot make the pivot negative.
    corner = np.broadcast_to(2.0 * chi2_bound + 1.0, products.shape[:-1])
    bordered[..., count, count] = corner
    explained, occam = np.zeros((2, *products.shape[:-1], len(tau)))
    explained -= np.inf
    kept, places = np.ones(products.shape[:-1], dtype=bool), range(count)
    for t in reversed(range(len(taus))):
        found = bordered[kept]
        found[:, places, places] += taus[t] ** -2.0
        root = np.linalg.cholesky(found).diagonal(axis1=-2, axis2=-1)
        explained[kept, t] = corner[kept] - root[:, count] ** 2
        occam[kept, t] = np.log(taus[t] * root[:, :count]).sum(axis=-1)
        if t == len(taus) - 1:  # a group explains less at smaller scales
            kept = explained[..., t] > least
            explained[~kept, t] = -np.inf
    return explained, occam
