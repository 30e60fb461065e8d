"""Screening of data faults: a score test of all of them, after which few are kept.

With ``S = 1 + A D A^T`` the covariance of whitened readings over a background, and r their
residual, the columns F of a fault give its log Bayes factor from ``F^T S^-1 F`` and ``F^T S^-1
r``, with no cause active.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from orthoglide.explanation.compression import MergedRows
from orthoglide.explanation.fault_columns import FaultColumns, FaultFamily
from orthoglide.explanation.linear_model import SLAB_SCALES, LinearModel
from orthoglide.explanation.search import explained_by_group
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import Nuisances
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_KEPT_PER_KIND = 10  # faults kept of each kind, for each background: 20 changed no result
_SCREENING_MARGIN = 5.0
"""Log odds that a fault may lack to be active alone: another fault may hide as much of it."""

_BACKGROUNDS = (0.003, 0.1, 1.0)  # tolerances: each may hide or imitate a data fault
_MOST_DENSE_NUMBERS = 2e6  # 16 MB of columns of faults, above which they are scored sparsely


def screen_data_faults(
    suspects: Sequence[FaultFamily],
    problem: Problem,
    nuisance: Nuisances,
    rows: MergedRows,
    residual: Array,
    linear: LinearModel,
) -> list[FaultColumns]:
    """Return the faults with the largest log Bayes factors, of each kind and for each background,
    and those of corrected commands.

    Args:
        suspects: all possible faults.
        problem: the readings.
        nuisance: of these.
        rows: readings by coefficient ``(n, C)``.
        residual: readings less the prediction at zero ``(n,)``.
        linear: rows and residual, whitened and projected.
    """
    if not suspects:
        return []
    counts = [len(s) for s in suspects]
    family = np.repeat(np.arange(len(suspects)), counts)
    kinds = np.array([s.kind for s in suspects])[family]
    columns, whitened_residual = linear.columns, linear.residual
    n, starts = len(residual), np.cumsum([0, *counts])
    ends = np.cumsum([s.columns[:, 0].size for s in suspects])
    dense = n * ends[-1] <= _MOST_DENSE_NUMBERS
    if dense:
        full_columns = np.hstack([fault.full_columns(n) for s in suspects for fault in s])
        fault_columns = nuisance.project(full_columns)
        fault_columns = np.pad(fault_columns, [(0, len(columns) - len(fault_columns)), (0, 0)])
    cost = np.log(len(SLAB_SCALES) / np.array([s.expected_count for s in suspects])[family])
    chosen = {int(starts[k]) for k, s in enumerate(suspects) if s.corrected}
    gram, products = columns.T @ columns, columns.T @ whitened_residual
    for sd in (np.sqrt(linear.spike(scale, scale)) for scale in _BACKGROUNDS):
        if dense:
            scaled = columns * sd
            root = np.linalg.cholesky(scaled @ scaled.T + np.eye(len(scaled)))
            remaining = solve_triangular(root, whitened_residual, lower=True)
            whitened_columns = solve_triangular(root, fault_columns, lower=True)
            blocks = np.split(whitened_columns.T, ends[:-1])
            scored = [(block.reshape(len(s), -1, len(remaining)), remaining)
                      for s, block in zip(suspects, blocks, strict=True)]  # fmt: skip
        else:
            precision = sd[:, None] * gram * sd + np.eye(len(sd))
            remaining = residual - rows @ (sd * np.linalg.solve(precision, sd * products))
            remaining = remaining - nuisance.explained_residual(remaining)
            # That other coefficients can imitate a fault is neglected, as for few columns among
            # many readings.
            weight = 1 / problem.reading_sd
            remaining = remaining * weight
            scored = [((s.columns * weight[s.rows, None]).transpose(0, 2, 1), remaining[s.rows])
                      for s in suspects]  # fmt: skip
        gains = np.concatenate([_log_bayes_factors(*each) for each in scored])
        chosen.update(_best_of_each_kind(kinds, gains, cost - _SCREENING_MARGIN))
    return [suspects[family[k]][k - starts[family[k]]] for k in sorted(chosen)]


def _best_of_each_kind(kinds: NDArray[np.str_], gains: Array, least: Array) -> Iterator[int]:
    """Yield the indices of the faults of each kind that gain most, if they gain the least."""
    for kind in dict.fromkeys(kinds.tolist()):
        of_kind = np.flatnonzero(kinds == kind)
        best = of_kind[descending(gains[of_kind], LOG_ODDS_MARGIN)[:_KEPT_PER_KIND]]
        yield from (int(k) for k in best if gains[k] > least[k])


def _log_bayes_factors(columns: Array, residual: Array) -> Array:
    """Return the log Bayes factor of each fault of a family at its best scale ``(N,)``.

    Args:
        columns: of each fault, whitened ``(N, q, m)``.
        residual: of the rows of each, whitened ``(N, m)``, or of all rows ``(m,)``.
    """
    gram, chi2 = columns @ columns.transpose(0, 2, 1), np.sum(residual**2, axis=-1)
    products = (columns @ residual[..., None])[..., 0]
    by_scale = (explained_by_group(gram, products, chi2, tau) for tau in SLAB_SCALES)
    return np.asarray(np.max([explained / 2 - occam for explained, occam in by_scale], axis=0))
