"""Pairs of active causes with one coefficient each: all pairs are compared in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.linear_model import LinearModel
from orthoglide.fit.least_squares import explained_by_two
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_NEAR_LOG_ODDS = 4.0  # below the best pair, within which pairs are compared on the whole grid
_MOST_PAIRS = 40  # most such pairs
_NEGLIGIBLE_LOG_ODDS = 8.0  # below the best pair and taus, from which taus are negligible


def likely_pairs(
    linear: LinearModel,
    gram: Array,
    products: Array,
    given: tuple[Array, Array],
    cost: Array,
    coarse_scales: Sequence[int],
) -> Iterator[tuple[int, float, int, float, Array]]:
    """Yield the pairs that explain the readings nearly as well as the best pair.

    Args:
        linear: the readings.
        gram: inner products of the columns of the causes ``(scales, n, n)``.
        products: inner products of columns and residual ``(scales, n)``.
        given: log weights without a pair, and the chi2 explained then, each ``(scales,)``.
        cost: log odds against each cause being active ``(n,)``; infinite for excluded ones.
        coarse_scales: scales of the background at which all pairs are compared.

    Yields:
        First cause and its tau, second cause and its tau, and log weights ``(scales,)``.
    """
    allowed = np.flatnonzero(np.isfinite(cost))
    first, second = (allowed[k] for k in np.triu_indices(len(allowed), 1))
    if not len(first):
        return
    log_weights, explained_before = given
    slabs, odds = linear.slab_scales, linear.log_odds_by_slab

    def gain(
        at: Sequence[int] | slice, pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
        taus: tuple[float, float],
    ) -> Array:  # fmt: skip
        """Return the log likelihood that pairs gain, less half their log determinant."""
        (i, j), (tau_i, tau_j), grams, shown = pairs, taus, gram[at], products[at]
        explained, determinant = explained_by_two(
            1 + tau_i**2 * grams[:, i, i], 1 + tau_j**2 * grams[:, j, j],
            tau_i * tau_j * grams[:, i, j], tau_i * shown[:, i], tau_j * shown[:, j],
        )  # fmt: skip
        likelihood = linear.log_likelihood_gain(explained, explained_before[at])
        return likelihood - np.log(determinant) / 2 + odds[tau_i] + odds[tau_j]

    # First all pairs at equal taus and few background scales, which is right to some log odds.
    table = np.stack([gain(coarse_scales, (first, second), (tau, tau)) for tau in slabs])
    pooled = np.logaddexp.reduce(table + log_weights[coarse_scales, None], axis=(0, 1))
    pooled -= cost[first] + cost[second]
    likely = np.flatnonzero(pooled > pooled.max() - _NEAR_LOG_ODDS)
    order = likely[descending(pooled[likely], LOG_ODDS_MARGIN)[:_MOST_PAIRS]]
    best_pairs = first[order], second[order]
    prior_weights = log_weights[:, None] - cost[best_pairs[0]] - cost[best_pairs[1]]
    tau_pairs = list(product(slabs, slabs))
    weights_by_tau = [prior_weights + gain(slice(None), best_pairs, taus) for taus in tau_pairs]
    least_weight = max(float(f.max()) for f in weights_by_tau) - _NEGLIGIBLE_LOG_ODDS
    for (tau, other_tau), weights in zip(tau_pairs, weights_by_tau, strict=True):
        for k in np.flatnonzero(weights.max(axis=0) > least_weight):
            yield int(best_pairs[0][k]), tau, int(best_pairs[1][k]), other_tau, weights[:, k]
