"""Which of many faults of the data could stand out: one score test of all of them.

With ``S = 1 + A D A^T`` the covariance of whitened readings, of a background of some scale, and r
what they say, columns F of a fault have the products ``F^T S^-1 F`` and ``F^T S^-1 r``, and gain
what they would gain where nothing else stands out.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from orthoglide.explanation.fault_columns import FaultColumns
from orthoglide.explanation.linear_model import SLAB_SCALES
from orthoglide.explanation.search import explained_by_group
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import Nuisances
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_KEPT_PER_KIND = 10  # of each kind, by each background
_SCREENING_MARGIN = 5.0
"""Log odds that a fault may lack of standing out alone: another that hides it may give as much."""

_MOST_DENSE_NUMBERS = (
    2e6  # numbers: of more, what the background can imitate of a fault is left out
)


def screen_data_faults(
    several: Sequence[FaultColumns],
    problem: Problem,
    nuisance: Nuisances,
    rows: Array,
    rest: Array,
    compact: tuple[Array, Array],
    backgrounds: Sequence[Array],
    also: Collection[str] = (),
) -> list[FaultColumns]:
    """Those that gain most, of each kind and by each background.

    Args:
        several: faults.
        problem: the readings.
        nuisance: of these.
        rows: readings by coefficient ``(n, C)``.
        rest: what they are to explain ``(n,)``.
        compact: the same whitened and past the nuisances, ``(m, C)`` and ``(m,)``.
        backgrounds: standard deviations of the coefficients ``(C,)``.
        also: names of those that are to be among them.
    """
    if not several:
        return []
    kinds = np.array([s.fault.kind for s in several])
    dense = len(rest) * sum(s.coefficient_count for s in several) <= _MOST_DENSE_NUMBERS
    shown = None
    if dense:
        shown = nuisance.project(np.hstack([s.full_columns(len(rest)) for s in several]))
        shown = np.pad(shown, [(0, len(compact[1]) - len(shown)), (0, 0)])
    least = (
        np.log(len(SLAB_SCALES) / np.array([s.expected_count for s in several])) - _SCREENING_MARGIN
    )
    chosen = dict.fromkeys(k for k, s in enumerate(several) if s.name in also)
    found, residual = compact
    gram, met = found.T @ found, found.T @ residual
    for sd in backgrounds:
        if shown is not None:
            spread = found * sd
            root = np.linalg.cholesky(spread @ spread.T + np.eye(len(spread)))
            gains = _log_bayes_factors(
                several, np.linalg.solve(root, shown), np.linalg.solve(root, residual)
            )
        else:
            inside = sd[:, None] * gram * sd + np.eye(len(sd))
            left = rest - rows @ (sd * np.linalg.solve(inside, sd * met))
            gains = _log_bayes_factors_by_rows(
                several, problem, left - nuisance.explained_residual(left)
            )
        for kind in dict.fromkeys(kinds.tolist()):
            own = np.flatnonzero(kinds == kind)
            best = own[descending(gains[own], LOG_ODDS_MARGIN)[:_KEPT_PER_KIND]]
            chosen.update(dict.fromkeys(int(k) for k in best if gains[k] > least[k]))
    return [several[k] for k in sorted(chosen)]


def _log_bayes_factors(several: Sequence[FaultColumns], shown: Array, white: Array) -> Array:
    """Log Bayes factor of each, at its best scale, from whitened columns side by side."""
    sizes = np.array([s.coefficient_count for s in several])
    first = np.cumsum(sizes) - sizes
    met, found = shown.T @ white, np.empty(len(several))
    square = np.array([white @ white])
    for size in np.unique(sizes).tolist():
        own = np.flatnonzero(sizes == size)
        at = first[own][:, None] + np.arange(size)
        columns = shown[:, at]
        inner = np.einsum("mgi,mgj->gij", columns, columns)
        found[own] = _best_log_bayes_factors(inner, met[at], square)
    return found


def _log_bayes_factors_by_rows(
    several: Sequence[FaultColumns], problem: Problem, left: Array
) -> Array:
    """The same of few columns among many readings, which nothing else imitates.

    Args:
        several: the faults.
        problem: the readings.
        left: of these, past background and nuisances ``(n,)``.
    """
    weight = 1 / (problem.sigma**2 + problem.common**2)
    sizes = np.array([s.coefficient_count for s in several])
    found = np.empty(len(several))
    single = np.flatnonzero(sizes == 1).tolist()
    if len(single):
        rows = np.concatenate([several[k].fault.rows for k in single])
        shown = np.concatenate([several[k].columns[:, 0] for k in single])
        counts = [len(several[k].fault.rows) for k in single]
        first = np.cumsum([0, *counts[:-1]])
        inner = np.add.reduceat(shown**2 * weight[rows], first)
        met = np.add.reduceat(shown * weight[rows] * left[rows], first)
        square = np.add.reduceat(left[rows] ** 2 * weight[rows], first)
        found[single] = _best_log_bayes_factors(inner[:, None, None], met[:, None], square)
    for k in np.flatnonzero(sizes > 1).tolist():
        rows, columns = several[k].fault.rows, several[k].columns
        weighed = columns * weight[rows, None]
        square = np.array(float(left[rows] ** 2 @ weight[rows]))
        found[k] = _best_log_bayes_factors(columns.T @ weighed, weighed.T @ left[rows], square)
    return found


def _best_log_bayes_factors(inner: Array, met: Array, square: Array) -> Array:
    """Log Bayes factors ``(...)`` of groups at their best scales; arguments as of `gained`."""
    each = (explained_by_group(inner, met, square, tau) for tau in SLAB_SCALES)
    return np.asarray(np.max([explained / 2 - occam for explained, occam in each], axis=0))
