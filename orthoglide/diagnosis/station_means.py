"""What a fit leaves, averaged over the visits to each station, past faults and effects at hand.

A systematic error repeats at every visit to a station, so hypotheses are compared on these means.
All vectors are whitened and free of what the fit explains. An effect that is taken into the model
widens the noise by ``S S^T``, S its signature at its tolerance: everything is whitened anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.faults import Fault
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.fit import Problem
from orthoglide.geometry import Array


def orthonormal(columns: Array, tolerance: float = 1e-9) -> Array:
    """Orthonormal basis of columns ``(m, k)``."""
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, singular > tolerance * max(singular.max(initial=0.0), 1e-300)])


def past(basis: Array, rows: Array) -> Array:
    """Rows ``(m, ...)`` without their part along orthonormal columns ``(m, q)``."""
    return np.asarray(rows - basis @ (basis.T @ rows))


@dataclass(frozen=True)
class StationMeans:
    """A residual and the signatures of all effects as station means, ``g`` of them.

    Attributes:
        signatures: with ``columns`` ``(g, E)`` and ``residual`` ``(g,)`` as station means.
        by_reading: station means of one metre in each reading ``(g, n)``.
        averaging: the part of each station mean that lies in each reading ``(n, g)``, whitened.
        dof: what noise alone makes of the residual's square.
    """

    signatures: Signatures
    by_reading: Array
    averaging: Array
    dof: float

    @classmethod
    def of(cls, signatures: Signatures, known: Sequence[Fault] = ()) -> StationMeans:
        """Average over stations, the rows of known faults set free."""
        problem, n = signatures.estimate.problem, signatures.count
        groups = signatures.groups
        stations = signatures.whiten(np.eye(int(groups.max()) + 1)[groups])
        if known:
            free = np.hstack([fault.columns(problem) for fault in known])
            stations = past(orthonormal(signatures.whiten(free)), stations)
        # By the small Gram matrix: stations are far fewer than readings.
        values, vectors = np.linalg.eigh(stations.T @ stations)
        kept = values > 1e-12 * max(values.max(initial=0.0), 1e-300)
        averaging = stations @ (vectors[:, kept] / np.sqrt(values[kept]))
        means = replace(
            signatures,
            columns=averaging.T @ signatures.columns,
            residual=averaging.T @ signatures.residual,
        )
        rows = averaging[:n]
        weighing = signatures.estimate.nuisance.weighing
        return cls(means, rows.T @ weighing.whiten(np.eye(n)), rows, float(np.sum(rows**2)))

    @property
    def problem(self) -> Problem:
        """Of the fit."""
        return self.signatures.estimate.problem

    @property
    def residual(self) -> Array:
        """Station means of the residual ``(g,)``."""
        return self.signatures.residual

    @property
    def chi2(self) -> float:
        """Square of ``residual``."""
        return float(self.residual @ self.residual)

    @cached_property
    def floor(self) -> float:
        """Least chi2 a degree of freedom: the noise itself, or the rounding where it is unsure."""
        if self.problem.noise.source != "repeats":
            return 1.0
        step = self.problem.machine.spec.dial.resolution
        return min(1.0, (step / self.problem.noise.typical) ** 2 / 12)

    def evidence(self, after: Array, size: int = 0) -> Array:
        """Log Bayes factor where chi2 falls to ``after``, with ``size`` readings' worth freed.

        Student's form, the noise known no better than what is left says of it.
        """
        dof = max(self.dof - size, 1e-9)
        least = dof * self.floor
        before = max(self.chi2, least)
        return np.asarray(dof / 2 * np.log(before / np.maximum(after, least)))

    @cached_property
    def scoring(self) -> Scoring:
        """All candidates of the catalogue."""
        return Scoring.of(self.signatures, self.signatures.candidates)

    @cached_property
    def best_effect(self) -> tuple[float, int]:
        """Evidence and place of the best effect of the catalogue."""
        if not self.signatures.candidates:
            return -np.inf, -1
        left = self.chi2 - self.scoring.gains(self.residual)
        evidence = self.evidence(left) - self.scoring.occam / 2
        return float(evidence.max()), int(evidence.argmax())

    def beside(self, place: int) -> StationMeans:
        """The same with an effect of the catalogue in the model, its tolerance as a prior."""
        candidate = self.signatures.candidates[place]
        left, singular, _ = np.linalg.svd(self.signatures.of(candidate), full_matrices=False)
        left = left * np.sqrt(1 - 1 / np.sqrt(1 + singular**2))
        means = replace(
            self.signatures,
            columns=past(left, self.signatures.columns),
            residual=past(left, self.residual),
        )
        taken = float(np.sum(singular**2 / (1 + singular**2)))
        return replace(
            self, signatures=means, by_reading=past(left, self.by_reading), dof=self.dof - taken
        )
