"""Pairs of causes of one coefficient each that stand out together: all of them, in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.least_squares import explained_by_two
from orthoglide.geometry import Array
from orthoglide.ordering import EQUAL_ODDS, descending

_NEAR, _MOST = 4.0, 40  # log odds of pairs that are looked at closely, and their number
_FAR = 8.0  # log odds of scales of theirs that do not count


def likely_pairs(
    seen: Array,
    met: Array,
    logs: Array,
    cost: Array,
    slabs: Sequence[float],
    coarse: Sequence[int],
) -> Iterator[tuple[int, float, int, float, Array]]:
    """The pairs that explain readings nearly as well as the best, each with its scales.

    Args:
        seen: products of the columns of causes ``(scales, n, n)``.
        met: of columns and residual ``(scales, n)``.
        logs: log weights without them, by scale of the background ``(scales,)``.
        cost: log odds against each one's standing out ``(n,)``; infinite for those left out.
        slabs: scales that each may have.
        coarse: scales of the background at which all pairs are compared.

    Yields:
        One and its scale, the other and its scale, and their log weights ``(scales,)``.
    """
    allowed = np.flatnonzero(np.isfinite(cost))
    first, second = (allowed[k] for k in np.triu_indices(len(allowed), 1))
    if not len(first):
        return
    # At one scale for both and few of the background first: off by no more than some log odds.
    few, some = seen[coarse], met[coarse]
    table = np.stack([gains(few, some, (first, second), (tau, tau)) for tau in slabs])
    pooled = np.logaddexp.reduce(table + logs[coarse, None], axis=(0, 1))
    pooled -= cost[first] + cost[second]
    likely = np.flatnonzero(pooled > pooled.max() - _NEAR)
    order = likely[descending(pooled[likely], EQUAL_ODDS)[:_MOST]]
    near = first[order], second[order]
    base = logs[:, None] - cost[near[0]] - cost[near[1]]
    both = list(product(slabs, slabs))
    found = [base + gains(seen, met, near, taus) for taus in both]
    least = max(float(f.max()) for f in found) - _FAR
    for (tau, other), weights in zip(both, found, strict=True):
        for k in np.flatnonzero(weights.max(axis=0) > least):
            yield int(near[0][k]), tau, int(near[1][k]), other, weights[:, k]


def gains(
    seen: Array,
    met: Array,
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
    taus: tuple[float, float],
) -> Array:
    """Log weight that pairs add by standing out, at their scales ``(scales, k)``."""
    (i, j), (tau, other) = pairs, taus
    one, two = 1 + tau**2 * seen[:, i, i], 1 + other**2 * seen[:, j, j]
    cross = tau * other * seen[:, i, j]
    explained, spread = explained_by_two(one, two, cross, tau * met[:, i], other * met[:, j])
    return np.asarray((explained - np.log(spread)) / 2)
