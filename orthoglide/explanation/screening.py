"""Screening of data faults: a score test of all of them, after which few are kept.

With ``S = 1 + A D A^T`` the covariance of whitened readings over a background, and r their
residual, the columns F of a fault give its log Bayes factor from ``F^T S^-1 F`` and ``F^T S^-1
r``, with no cause active.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy.linalg import solve_triangular

from orthoglide.explanation.fault_columns import FaultColumns
from orthoglide.explanation.linear_model import SLAB_SCALES
from orthoglide.explanation.search import explained_by_group
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import Nuisances
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_KEPT_PER_KIND = 10  # faults kept of each kind, for each background
_SCREENING_MARGIN = 5.0
"""Log odds that a fault may lack to be active alone: another fault may hide as much of it."""

_MOST_DENSE_NUMBERS = 2e6  # size of the faults' columns, above which they are scored sparsely


def screen_data_faults(
    suspects: Sequence[FaultColumns],
    problem: Problem,
    nuisance: Nuisances,
    rows: Array,
    residual: Array,
    whitened: tuple[Array, Array],
    backgrounds: Sequence[Array],
    required: Collection[str] = (),
) -> list[FaultColumns]:
    """Return the faults with the largest log Bayes factors, of each kind and for each background.

    Args:
        suspects: all possible faults.
        problem: the readings.
        nuisance: of these.
        rows: readings by coefficient ``(n, C)``.
        residual: readings less the prediction at zero ``(n,)``.
        whitened: rows and residual, whitened and projected, ``(m, C)`` and ``(m,)``.
        backgrounds: standard deviations of the coefficients ``(C,)``.
        required: names of faults that are kept in any case.
    """
    if not suspects:
        return []
    kinds = np.array([s.fault.kind for s in suspects])
    columns, whitened_residual = whitened
    n = len(residual)
    ends = np.cumsum([s.coefficient_count for s in suspects])
    dense = n * ends[-1] <= _MOST_DENSE_NUMBERS
    if dense:
        fault_columns = nuisance.project(np.hstack([s.full_columns(n) for s in suspects]))
        fault_columns = np.pad(fault_columns, [(0, len(columns) - len(fault_columns)), (0, 0)])
    cost = np.log(len(SLAB_SCALES) / np.array([s.expected_count for s in suspects]))
    chosen = {k for k, s in enumerate(suspects) if s.name in required}
    gram, products = columns.T @ columns, columns.T @ whitened_residual
    for sd in backgrounds:
        if dense:
            scaled = columns * sd
            root = np.linalg.cholesky(scaled @ scaled.T + np.eye(len(scaled)))
            past = solve_triangular(root, whitened_residual, lower=True)
            past_columns = solve_triangular(root, fault_columns, lower=True)
            blocks = np.split(past_columns, ends[:-1], axis=1)
            scored = [(block, past) for block in blocks]
        else:
            precision = sd[:, None] * gram * sd + np.eye(len(sd))
            past = residual - rows @ (sd * np.linalg.solve(precision, sd * products))
            past = past - nuisance.explained_residual(past)
            # That other coefficients can imitate a fault is neglected, as for few columns among
            # many readings.
            weight = 1 / np.hypot(problem.sigma, problem.shared_rounding_sd)
            past = past * weight
            scored = [(s.columns * weight[s.fault.rows, None], past[s.fault.rows])
                      for s in suspects]  # fmt: skip
        gains = _log_bayes_factors(scored)
        for kind in dict.fromkeys(kinds.tolist()):
            of_kind = np.flatnonzero(kinds == kind)
            best = of_kind[descending(gains[of_kind], LOG_ODDS_MARGIN)[:_KEPT_PER_KIND]]
            chosen.update(int(k) for k in best if gains[k] > cost[k] - _SCREENING_MARGIN)
    return [suspects[k] for k in sorted(chosen)]


def _log_bayes_factors(whitened: Sequence[tuple[Array, Array]]) -> Array:
    """Return the log Bayes factor of each fault at its best scale, from the whitened columns
    ``(m, q)`` and residual ``(m,)`` of each.
    """
    products = [columns.T @ residual for columns, residual in whitened]
    sizes, log_bayes_factors = np.array([len(p) for p in products]), np.empty(len(products))
    for size in np.unique(sizes):
        index = np.flatnonzero(sizes == size).tolist()
        gram = np.stack([whitened[k][0].T @ whitened[k][0] for k in index])
        chi2 = np.array([whitened[k][1] @ whitened[k][1] for k in index])
        of_size = np.stack([products[k] for k in index])
        by_scale = (explained_by_group(gram, of_size, chi2, tau) for tau in SLAB_SCALES)
        best = np.max([explained / 2 - occam for explained, occam in by_scale], axis=0)
        log_bayes_factors[index] = best
    return log_bayes_factors
