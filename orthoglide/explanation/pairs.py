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
_NEGLIGIBLE_LOG_ODDS = 8.0  # below the best pair and taus: one in 3000


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
    if not len(first):
        return
    components, products, *_ = partial
    square = np.diagonal(crossed, axis1=1, axis2=2) - (components**2).sum(axis=1)

    def gain(
        at: NDArray[np.intp] | slice, pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
        cross: Array, taus: tuple[float, float],
    ) -> Array:  # fmt: skip
        """Return the log likelihood that pairs gain, less half their log determinant."""
        (i, j), (tau_i, tau_j), squares, shown = pairs, taus, square[at], products[at]
        explained, determinant = explained_by_two(
            (1 + tau_i**2 * squares)[:, i], (1 + tau_j**2 * squares)[:, j],
            tau_i * tau_j * cross, tau_i * shown[:, i], tau_j * shown[:, j],
        )  # fmt: skip
        return (explained - np.log(determinant)) / 2

    # First all pairs at equal taus and few background scales.
    along = components[coarse]
    cross = (crossed[coarse] - along.transpose(0, 2, 1) @ along)[:, first, second]
    table = np.stack([gain(coarse, (first, second), cross, (tau, tau)) for tau in slabs])
    table += log_weights[coarse, None]
    top = table.max(axis=(0, 1))  # faster than by logaddexp
    pooled = top + np.log(np.exp(table - top).sum(axis=(0, 1))) - cost[first] - cost[second]
    likely = np.flatnonzero(pooled > pooled.max() - _NEAR_LOG_ODDS)
    order = likely[descending(pooled[likely], LOG_ODDS_MARGIN)[:_MOST_PAIRS]]
    i, j = first[order], second[order]
    cross = crossed[:, i, j] - (components[:, :, i] * components[:, :, j]).sum(axis=1)
    prior_weights, tau_pairs = log_weights[:, None] - cost[i] - cost[j], [*product(slabs, slabs)]
    weights_by_tau = [prior_weights + gain(slice(None), (i, j), cross, t) for t in tau_pairs]
    least_weight = max(float(f.max()) for f in weights_by_tau) - _NEGLIGIBLE_LOG_ODDS
    for (tau, other_tau), weights in zip(tau_pairs, weights_by_tau, strict=True):
        for k in np.flatnonzero(weights.max(axis=0) > least_weight):
            yield int(i[k]), tau, int(j[k]), other_tau, weights[:, k]
