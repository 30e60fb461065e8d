"""Pairs of causes of one coefficient each that stand out together: all of them, in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from orthoglide.explanation.linear_model import LinearModel
from orthoglide.fit.least_squares import explained_by_two
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_NEAR_LOG_ODDS, _MOST_PAIRS = (
    4.0,
    40,
)  # log odds of pairs that are looked at closely, and their number
Pairs = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Indices of the first and the second of each pair."""

_NEGLIGIBLE_LOG_ODDS = 8.0  # log odds of scales of theirs that do not count


def likely_pairs(
    linear: LinearModel,
    seen: Array,
    met: Array,
    base: tuple[Array, Array],
    cost: Array,
    coarse: Sequence[int],
) -> Iterator[tuple[int, float, int, float, Array]]:
    """The pairs that explain readings nearly as well as the best, each with its scales.

    Args:
        linear: the readings.
        seen: products of the columns of causes ``(scales, n, n)``.
        met: of columns and residual ``(scales, n)``.
        base: log weights without them, and what is explained of chi2 then, by scale of the
            background, each ``(scales,)``.
        cost: log odds against each one's standing out ``(n,)``; infinite for those left out.
        coarse: scales of the background at which all pairs are compared.

    Yields:
        One and its scale, the other and its scale, and their log weights ``(scales,)``.
    """
    allowed = np.flatnonzero(np.isfinite(cost))
    first, second = (allowed[k] for k in np.triu_indices(len(allowed), 1))
    if not len(first):
        return
    # At one scale for both and few of the background first: off by no more than some log odds.
    (logs, before), slabs, odds = base, linear.slab_scales, linear.log_odds_by_slab

    def gain(at: Sequence[int] | slice, pairs: Pairs, taus: tuple[float, float]) -> Array:
        explained, occam = explained_by_pair(seen[at], met[at], pairs, taus)
        return (
            linear.log_likelihood_gain(explained, before[at])
            - occam
            + odds[taus[0]]
            + odds[taus[1]]
        )

    table = np.stack([gain(coarse, (first, second), (tau, tau)) for tau in slabs])
    pooled = np.logaddexp.reduce(table + logs[coarse, None], axis=(0, 1))
    pooled -= cost[first] + cost[second]
    likely = np.flatnonzero(pooled > pooled.max() - _NEAR_LOG_ODDS)
    order = likely[descending(pooled[likely], LOG_ODDS_MARGIN)[:_MOST_PAIRS]]
    near = first[order], second[order]
    paid = logs[:, None] - cost[near[0]] - cost[near[1]]
    both = list(product(slabs, slabs))
    found = [paid + gain(slice(None), near, taus) for taus in both]
    least = max(float(f.max()) for f in found) - _NEGLIGIBLE_LOG_ODDS
    for (tau, other), weights in zip(both, found, strict=True):
        for k in np.flatnonzero(weights.max(axis=0) > least):
            yield int(near[0][k]), tau, int(near[1][k]), other, weights[:, k]


def explained_by_pair(
    seen: Array, met: Array, pairs: Pairs, taus: tuple[float, float]
) -> tuple[Array, Array]:
    """Return what pairs explain of chi2, and half their log determinant, ``(scales, k)`` each."""
    (i, j), (tau, other) = pairs, taus
    one, two = 1 + tau**2 * seen[:, i, i], 1 + other**2 * seen[:, j, j]
    cross = tau * other * seen[:, i, j]
    explained, spread = explained_by_two(one, two, cross, tau * met[:, i], other * met[:, j])
    return explained, np.log(spread) / 2
