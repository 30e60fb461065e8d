"""Choices and orders among values that may be equal up to rounding.

Two causes that give the same readings have the same probability, and two stations that mirror each
other are worth the same. Which of them has the larger number in its sixteenth digit depends on the
processor, the compiler and the number of threads. Every choice that decides what is printed is
therefore made here: values that differ by no more than a margin count as equal, and among equals
the first one stands first, in the order in which they were given.

The margin is far above rounding and far below what anybody would notice, so that two runs disagree
only where a difference lies within rounding of the margin itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")
Array = NDArray[np.float64]

RELATIVE_MARGIN = 1e-6
"""Margin of values, relative to the largest of them."""

LOG_ODDS_MARGIN = 1e-5
"""Margin of log probabilities, log odds and log Bayes factors: a factor of 1.00001."""

_ROUNDING = 1e-9  # of the largest value: what no margin goes below


def largest(values: ArrayLike, within: float | None = None) -> int:
    """Return the index, in the flattened array, of the first value within the margin of the largest
    one.

    The margin ``within`` is ``RELATIVE_MARGIN`` of the largest finite value where absent, and no
    less than a billionth of that value.
    """
    flat = np.asarray(values, dtype=float).ravel()
    best = int(np.argmax(flat))
    if not np.isfinite(flat[best]):
        return best
    return int(np.argmax(flat >= flat[best] - _margin(flat, within)))


def descending(values: ArrayLike, within: float | None = None) -> list[int]:
    """Return the indices of all values, the largest first and equal ones in their order.

    Arguments as for :func:`largest`. Values are equal if they lie within the margin of the largest
    of their group.
    """
    flat = np.asarray(values, dtype=float).ravel()
    sizes, margin, head = flat.tolist(), _margin(flat, within), np.nan
    group, number = np.empty(len(flat), dtype=int), 0
    for k in np.argsort(-flat, kind="stable").tolist():
        if not sizes[k] >= head - margin:  # the first one, or one that is less than its group
            head, number = sizes[k], number + 1
        group[k] = number
    return np.argsort(group, kind="stable").tolist()


def best_of(items: Iterable[T], key: Callable[[T], float], within: float | None = None) -> T:
    """Return the first item whose key is the largest up to the margin; as ``max`` does else.

    Raises:
        ValueError: if there are no items.
    """
    candidates = list(items)
    if not candidates:
        raise ValueError("there are no items to choose from")
    return candidates[largest([key(item) for item in candidates], within)]


def ranked(items: Iterable[T], key: Callable[[T], float], within: float | None = None) -> list[T]:
    """Return the items with the largest key first and equal ones in their order."""
    candidates = list(items)
    return [candidates[k] for k in descending([key(item) for item in candidates], within)]


def canonical_basis(rows: Array, within: Array | None = None) -> Array:
    """Return the canonical basis of the space that independent rows ``(k, P)`` span: rows of unit
    length in the order of their pivots.

    The result depends on the space alone, and not on the rows by which it is given: the singular
    vectors of nearly equal singular values are an arbitrary basis, which rounding turns. It is the
    reduced row echelon form, in which every row has the entry of its own pivot column and those of
    no other pivot. Pivots are the columns of largest norm in any orthonormal basis, as in a QR
    decomposition with column pivoting, of equal ones the first. ``within`` are independent rows
    ``(q, P)`` of a subspace, which are the first directions: their basis is that of the subspace,
    and the other rows vanish at its pivots.
    """
    space, pivots, bases = _orthonormal(rows), list[int](), list[Array]()
    if within is not None and 0 < len(within) < len(rows):
        inner = _orthonormal(within)
        pivots = _pivots(inner)
        bases.append(_echelon(inner, pivots))
        # Combinations of the rows that vanish at these pivots.
        vanishing = np.linalg.svd(space[:, pivots].T)[2][len(pivots) :]
        space = _orthonormal(vanishing @ space)
    pivots = _pivots(space)
    bases.append(_echelon(space, pivots))
    basis = np.concatenate(bases)
    return np.asarray(basis / np.linalg.norm(basis, axis=1)[:, None])


def _echelon(space: Array, pivots: list[int]) -> Array:
    """Return the rows of a space of which each is 1 at its own pivot and 0 at the others."""
    return np.asarray(np.linalg.solve(space[:, pivots], space))


def _orthonormal(rows: Array) -> Array:
    return np.asarray(np.linalg.qr(rows.T)[0].T)


def _pivots(space: Array) -> list[int]:
    """Return one pivot column for every orthonormal row ``(k, P)``, the largest column first."""
    pivots: list[int] = []
    for _ in range(len(space)):
        size = np.linalg.norm(space, axis=0)
        size[pivots] = 0.0
        pivots.append(largest(size))
        direction = space[:, pivots[-1]] / size[pivots[-1]]
        space = space - np.outer(direction, direction @ space)
    return pivots


def _margin(values: Sequence[float] | Array, within: float | None) -> float:
    finite = np.abs(np.asarray(values)[np.isfinite(values)])
    size = float(finite.max(initial=0.0))
    return RELATIVE_MARGIN * size if within is None else max(within, _ROUNDING * size)
