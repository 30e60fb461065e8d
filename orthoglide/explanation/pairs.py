"""Pairs of active causes with one coefficient each: all pairs are compared in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.least_squares import explained_by_two
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

# The first comparison, at equal taus and few backgrounds, is right to some log odds. With each of
# these doubled, or four times the pairs, no result changed.
_NEAR_LOG_ODDS = 4.0  # below the best pair, within which pairs are compared on the whole grid
_MOST_PAIRS = 40  # most such pairs
NEGLIGIBLE_LOG_ODDS = 8.0  # below the best pair and taus: one in 3000


class PartialProducts(NamedTuple):
    """Inner products with the active groups partialled out (Frisch and Waugh 1933), at all scales
    of the background; see `Search`.
    """

    components: Array  # of the columns along the active groups (scales, q, n)
    products: Array  # partial inner products of the columns and the residual (scales, n)
    explained: Array  # chi2 that the active groups explain (scales,)
    log_det: Array  # log determinant of the covariance that they add (scales,)


def likely_pairs(
    slabs: Sequence[float],
    crossed: Array,
    partial: PartialProducts,
    log_weights: Array,
    cost: Array,
    coarse_scales: NDArray[np.bool_],
) -> Iterator[tuple[int, float, int, float, Array]]:
    """Yield the pairs that explain the readings nearly as well as the best pair.

    Args:
        slabs: scales of active groups.
        crossed: inner products of the columns of the causes ``(scales, n, n)``.
        partial: inner products of these columns, given the active groups.
        log_weights: without a pair ``(scales,)``.
        cost: log odds against each cause being active ``(n,)``; infinite for excluded ones.
        coarse_scales: mask of scales at which all pairs are compared ``(scales,)``.

    Yields:
        First cause and its tau, second cause and its tau, and log weights ``(scales,)``.
    """
    allowed = np.flatnonzero(np.isfinite(cost))
    first, second = (allowed[k] for k in np.triu_indices(len(allowed), 1))
    coarse = np.flatnonzero(coarse_scales)
    if not len(first) or not len(coarse):
        return
    components, products, *_ = partial
    square = np.diagonal(crossed, axis1=1, axis2=2) - (components**2).sum(axis=1)

    # First all pairs at equal taus and few background scales, by the best of these.
    prior, best = -cost[first] - cost[second], np.full(len(first), -np.inf)
    for k in coarse:
        cross = (crossed[k] - components[k].T @ components[k])[first, second]
        for tau in slabs:
            found = _gain(square[k], products[k], (first, second), cross, (tau, tau))
            np.maximum(best, found + log_weights[k], out=best)
    best += prior
    likely = np.flatnonzero(best > best.max() - _NEAR_LOG_ODDS - np.log(len(coarse) * len(slabs)))
    i, j = first[likely], second[likely]
    cross = crossed[:, i, j] - (components[:, :, i] * components[:, :, j]).sum(axis=1)
    given = square[coarse], products[coarse], (i, j), cross[coarse]
    gains = np.stack([_gain(*given, (tau, tau)) for tau in slabs])
    pooled = np.logaddexp.reduce(gains + log_weights[coarse, None], axis=(0, 1)) + prior[likely]
    near = np.flatnonzero(pooled > pooled.max() - _NEAR_LOG_ODDS)
    order = near[descending(pooled[near], LOG_ODDS_MARGIN)[:_MOST_PAIRS]]
    i, j, cross = i[order], j[order], cross[:, order]
    prior_weights, tau_pairs = log_weights[:, None] - cost[i] - cost[j], [*product(slabs, slabs)]
    given = square, products, (i, j), cross
    weights_by_tau = [prior_weights + _gain(*given, taus) for taus in tau_pairs]
    least_weight = max(float(f.max()) for f in weights_by_tau) - NEGLIGIBLE_LOG_ODDS
    for (tau, other_tau), weights in zip(tau_pairs, weights_by_tau, strict=True):
        for k in np.flatnonzero(weights.max(axis=0) > least_weight):
            yield int(i[k]), tau, int(j[k]), other_tau, weights[:, k]


def _gain(
    squares: Array,
    products: Array,
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
    cross: Array,
    taus: tuple[float, float],
) -> Array:
    """Return the log likelihood that pairs gain, less half their log determinant ``(..., p)``.

    Args:
        squares: of the causes' columns ``(..., n)``.
        products: of these columns and the residual ``(..., n)``.
        pairs: first and second causes ``(p,)``.
        cross: inner products of their columns ``(..., p)``.
        taus: of the first and of the second causes.
    """
    (i, j), (tau_i, tau_j) = pairs, taus
    explained, determinant = explained_by_two(
        (1 + tau_i**2 * squares)[..., i], (1 + tau_j**2 * squares)[..., j],
        tau_i * tau_j * cross, tau_i * products[..., i], tau_j * products[..., j],
    )  # fmt: skip
    return (explained - np.log(determinant)) / 2
