"""Screening of data faults: a score test of all of them, after which few are kept.

With ``S = 1 + A D A^T`` the covariance of whitened readings over a background, and r their
residual, the columns F of a fault give its log Bayes factor from ``F^T S^-1 F`` and ``F^T S^-1
r``, with no cause active.
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
    fault_columns, n = None, len(residual)
    if n * sum(s.coefficient_count for s in suspects) <= _MOST_DENSE_NUMBERS:
        fault_columns = nuisance.project(np.hstack([s.full_columns(n) for s in suspects]))
        fault_columns = np.pad(fault_columns, [(0, len(columns) - len(fault_columns)), (0, 0)])
    cost = np.log(len(SLAB_SCALES) / np.array([s.expected_count for s in suspects]))
    chosen = {k for k, s in enumerate(suspects) if s.name in required}
    gram, products = columns.T @ columns, columns.T @ whitened_residual
    for sd in backgrounds:
        if fault_columns is not None:
            scaled = columns * sd
            root = np.linalg.cholesky(scaled @ scaled.T + np.eye(len(scaled)))
            white = (np.linalg.solve(root, side) for side in (fault_columns, whitened_residual))
            gains = _log_bayes_factors(suspects, *white)
        else:
            precision = sd[:, None] * gram * sd + np.eye(len(sd))
            past = residual - rows @ (sd * np.linalg.solve(precision, sd * products))
            past = past - nuisance.explained_residual(past)
            gains = _log_bayes_factors_by_rows(suspects, problem, past)
        for kind in dict.fromkeys(kinds.tolist()):
            of_kind = np.flatnonzero(kinds == kind)
            best = of_kind[descending(gains[of_kind], LOG_ODDS_MARGIN)[:_KEPT_PER_KIND]]
            chosen.update(int(k) for k in best if gains[k] > cost[k] - _SCREENING_MARGIN)
    return [suspects[k] for k in sorted(chosen)]


def _log_bayes_factors(suspects: Sequence[FaultColumns], columns: Array, residual: Array) -> Array:
    """Return log Bayes factors of the faults at their best scales, from columns side by side."""
    sizes = np.array([s.coefficient_count for s in suspects])
    first = np.cumsum(sizes) - sizes
    products, log_bayes_factors = columns.T @ residual, np.empty(len(suspects))
    chi2 = np.array([residual @ residual])
    for size in np.unique(sizes).tolist():
        of_size = np.flatnonzero(sizes == size)
        column_index = first[of_size][:, None] + np.arange(size)
        blocks = columns[:, column_index]
        gram = np.einsum("mgi,mgj->gij", blocks, blocks)
        log_bayes_factors[of_size] = _best_log_bayes_factors(gram, products[column_index], chi2)
    return log_bayes_factors


def _log_bayes_factors_by_rows(
    suspects: Sequence[FaultColumns], problem: Problem, residual: Array
) -> Array:
    """Return the log Bayes factor of each fault at its best scale, from the rows that it moves.

    It neglects that other coefficients can imitate a fault, which holds for few columns among many
    readings.

    Args:
        suspects: the faults.
        problem: the readings.
        residual: of these, with background and nuisances projected out ``(n,)``.
    """
    weight = 1 / (problem.sigma**2 + problem.shared_rounding_sd**2)
    sizes = np.array([s.coefficient_count for s in suspects])
    log_bayes_factors = np.empty(len(suspects))
    single = np.flatnonzero(sizes == 1).tolist()
    if len(single):
        rows = np.concatenate([suspects[k].fault.rows for k in single])
        columns = np.concatenate([suspects[k].columns[:, 0] for k in single])
        counts = [len(suspects[k].fault.rows) for k in single]
        first = np.cumsum([0, *counts[:-1]])
        gram = np.add.reduceat(columns**2 * weight[rows], first)
        products = np.add.reduceat(columns * weight[rows] * residual[rows], first)
        chi2 = np.add.reduceat(residual[rows] ** 2 * weight[rows], first)
        log_bayes_factors[single] = _best_log_bayes_factors(
            gram[:, None, None], products[:, None], chi2
        )
    for k in np.flatnonzero(sizes > 1).tolist():
        rows, fault_block = suspects[k].fault.rows, suspects[k].columns
        weighted = fault_block * weight[rows, None]
        chi2 = np.array(float(residual[rows] ** 2 @ weight[rows]))
        log_bayes_factors[k] = _best_log_bayes_factors(
            fault_block.T @ weighted, weighted.T @ residual[rows], chi2
        )
    return log_bayes_factors


def _best_log_bayes_factors(gram: Array, products: Array, chi2: Array) -> Array:
    """Return log Bayes factors ``(...)`` at the best scale; arguments as of
    :func:`explained_by_group`.
    """
    by_scale = (explained_by_group(gram, products, chi2, tau) for tau in SLAB_SCALES)
    return np.asarray(np.max([explained / 2 - occam for explained, occam in by_scale], axis=0))
