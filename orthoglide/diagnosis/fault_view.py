"""What a fit leaves, seen through station means, past faults and effects that are known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.repeat_faults import span
from orthoglide.diagnosis.signatures import Signatures
from orthoglide.geometry import Array


@dataclass(frozen=True)
class View:
    """A residual past everything known, and its station means.

    Attributes:
        seen: signatures, columns and residual past what is free ``(m, ...)``.
        averaging: orthonormal columns ``(m, g)``.
    """

    seen: Signatures
    averaging: Array

    @classmethod
    def of(cls, seen: Signatures) -> View:
        """Prepare the station means."""
        groups = seen.groups
        indicator = np.eye(int(groups.max()) + 1)[groups]
        shown = seen.whiten(indicator)
        left, singular, _ = np.linalg.svd(shown, full_matrices=False)
        kept = singular > 1e-6 * max(float(singular.max(initial=0.0)), 1e-300)
        return cls(seen, left[:, kept])

    @cached_property
    def residual(self) -> Array:
        """Station means of the residual ``(g,)``."""
        return np.asarray(self.averaging.T @ self.seen.residual)

    @cached_property
    def dof(self) -> float:
        """What noise alone makes of the square of ``residual``."""
        return float(np.sum(self.averaging[: self.seen.count] ** 2))

    @property
    def chi2(self) -> float:
        """Square of ``residual``."""
        return float(self.residual @ self.residual)

    def shown(self, readings: Array) -> Array:
        """Readings ``(n, ...)`` in metres as station means ``(g, ...)``."""
        return np.asarray(self.averaging.T @ self.seen.whiten(readings))

    def evidence(self, after: Array, size: int = 0) -> Array:
        """Log Bayes factor where chi2 falls to ``after``, with ``size`` readings' worth freed."""
        dof = max(self.dof - size, 1e-9)
        floor = dof * self.floor
        before = max(self.chi2, floor)
        return np.asarray(dof / 2 * np.log(before / np.maximum(after, floor)))

    @cached_property
    def floor(self) -> float:
        """Least chi2 a degree of freedom: the noise itself, or the rounding where it is unsure."""
        problem = self.seen.estimate.problem
        if problem.noise.source != "repeats":
            return 1.0
        return min(1.0, (problem.machine.spec.dial.resolution / problem.noise.typical) ** 2 / 12)

    @cached_property
    def scoring(self) -> Scoring:
        """Candidates on station means."""
        means = replace(self.seen, columns=self.averaging.T @ self.seen.columns)
        return Scoring.of(means, self.seen.candidates)

    @cached_property
    def rival(self) -> tuple[float, int]:
        """Evidence and place of the best effect of the catalogue."""
        if not self.seen.candidates:
            return -np.inf, -1
        gain = self.scoring.gains(self.residual)
        evidence = self.evidence(self.chi2 - gain) - self.scoring.occam / 2
        return float(evidence.max()), int(evidence.argmax())


def set_free(seen: Signatures, columns: Array) -> Signatures:
    """Signatures and residual past more columns of readings ``(n, k)``."""
    basis = span(seen.whiten(columns))
    return replace(
        seen,
        fitted=np.hstack([seen.fitted, basis]),
        columns=seen.columns - basis @ (basis.T @ seen.columns),
        residual=seen.residual - basis @ (basis.T @ seen.residual),
    )


def with_effect(seen: Signatures, place: int) -> Signatures:
    """Signatures and residual past an effect of the catalogue, its tolerance as a prior."""
    shape = seen.of(seen.candidates[place])
    size = shape.shape[1]
    basis = span(np.vstack([shape, np.eye(size)]))

    def longer(rows: Array) -> Array:
        return np.vstack([rows, np.zeros((size, rows.shape[1]))])

    columns, residual = longer(seen.columns), longer(seen.residual[:, None])
    return replace(
        seen,
        fitted=np.hstack([longer(seen.fitted), basis]),
        columns=columns - basis @ (basis.T @ columns),
        residual=(residual - basis @ (basis.T @ residual))[:, 0],
    )
