"""Screening of data faults: a score test of all of them, after which few are kept.

With ``S = 1 + A D A^T + B B^T`` the covariance of whitened readings (A their columns, D the
variances of a background, B the columns of active groups) and r their residual, the columns F of a
fault give its log Bayes factor from ``F^T S^-1 F`` and ``F^T S^-1 r``: with no cause active, or
beside those that a search has found, because a large cause hides a fault.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from orthoglide.explanation.compression import COMPRESSION_THRESHOLD, MergedRows
from orthoglide.explanation.fault_columns import FaultColumns, FaultFamily
from orthoglide.explanation.gains import explained_by_group
from orthoglide.explanation.linear_model import SLAB_SCALES, LinearModel
from orthoglide.fit import Problem
from orthoglide.fit.least_squares import Nuisances
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, descending

_KEPT_PER_KIND = 10  # faults kept of each kind, for each background: 20 changed no result
_SCREENING_MARGIN = 5.0
"""Log odds by which a fault may fall short of being active alone, as another fault may hide it."""

_BACKGROUNDS = (0.003, 0.1, 1.0)
"""Tolerances of a sound, a usual and a poor machine, each of which may hide or imitate a fault."""

_MOST_DENSE_NUMBERS = 2e6  # 16 MB of columns of faults, above which they are scored sparsely


@dataclass(frozen=True, eq=False, repr=False)
class Screening:
    """All possible data faults of readings, and the linear model of these without faults."""

    families: Sequence[FaultFamily]
    problem: Problem
    nuisance: Nuisances  # of its readings
    rows: MergedRows  # readings by coefficient (n, C)
    residual: Array  # readings less the prediction at zero (n,)
    linear: LinearModel  # rows and residual, whitened and projected

    def likeliest(self, slab_root: Array | None = None) -> list[FaultColumns]:
        """Return the faults with the largest log Bayes factors, of each kind and for each
        background, and those of corrected commands.

        Args:
            slab_root: of groups that are active beside them ``(C, k)``; of none where absent.
        """
        if not self.families:
            return []
        counts = [len(family) for family in self.families]
        family_of = np.repeat(np.arange(len(counts)), counts)
        kinds = np.array([f.kind for f in self.families])[family_of]
        starts = np.cumsum([0, *counts])
        expected = np.array([f.expected_count for f in self.families])
        least = np.log(len(SLAB_SCALES) / expected)[family_of] - _SCREENING_MARGIN
        chosen = {int(starts[k]) for k, f in enumerate(self.families) if f.corrected}
        no_groups = np.zeros((self.linear.columns.shape[1], 0))
        for gains in self._gains(no_groups if slab_root is None else slab_root):
            chosen.update(_best_of_each_kind(kinds, gains, least))
        return [self.families[family_of[k]][k - starts[family_of[k]]] for k in sorted(chosen)]

    def _gains(self, active: Array) -> Iterator[Array]:
        """Yield the log Bayes factors of all faults ``(N,)`` for each background, with the slab
        root ``(C, k)`` of active groups beside it.
        """
        columns, whitened_residual = self.linear.columns, self.linear.residual
        n = len(self.residual)
        ends = np.cumsum([family.columns[:, 0].size for family in self.families])
        if dense := n <= COMPRESSION_THRESHOLD and n * ends[-1] <= _MOST_DENSE_NUMBERS:
            full_columns = np.hstack([f.full_columns(n) for each in self.families for f in each])
            faults = self.nuisance.project(full_columns)
            faults = np.pad(faults, [(0, len(columns) - len(faults)), (0, 0)])
        for scale in _BACKGROUNDS:
            sd = np.sqrt(self.linear.spike(scale, scale))
            scaled = np.hstack([columns * sd, columns @ active])
            root = np.linalg.cholesky(scaled @ scaled.T + np.eye(len(scaled)))
            remaining = solve_triangular(root, whitened_residual, lower=True)
            if dense:
                whitened_columns = solve_triangular(root, faults, lower=True)
                blocks = np.split(whitened_columns.T, ends[:-1])
                scored = [(block.reshape(len(each), -1, len(remaining)), remaining)
                          for each, block in zip(self.families, blocks, strict=True)]  # fmt: skip
            else:
                mean = scaled.T @ solve_triangular(root, remaining, lower=True, trans="T")
                mean = sd * mean[: len(sd)] + active @ mean[len(sd) :]
                remaining = self.residual - self.rows @ mean
                remaining = remaining - self.nuisance.explained_residual(remaining)
                # That other coefficients can imitate a fault is neglected: they are few among many
                # readings.
                weight = 1 / self.problem.reading_sd
                remaining = remaining * weight
                scored = [((f.columns * weight[f.rows, None]).transpose(0, 2, 1), remaining[f.rows])
                          for f in self.families]  # fmt: skip
            yield np.concatenate([_log_bayes_factors(*each) for each in scored])


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
    explained, occam = explained_by_group(gram, products, chi2, SLAB_SCALES)
    return np.asarray(np.max(explained / 2 - occam, axis=-1))
