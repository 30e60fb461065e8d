"""How well each candidate explains a residual: gain, evidence, and the best of the catalogue.

With a candidate's signature S at its tolerance (whitened, projected) and the residual r, the
Gaussian prior of the tolerance gives

    gain     = r^T S (S^T S + 1)^-1 S^T r              (fall of chi2, prior counted)
    evidence = (gain - log det(S^T S + 1)) / 2         (log Bayes factor against no effect)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.explanation.candidates import Candidate
from orthoglide.explanation.signatures import Signatures
from orthoglide.geometry import Array


@dataclass(frozen=True)
class Scoring:
    """Candidates prepared for many residuals at once."""

    candidates: tuple[Candidate, ...]  # `C` of them
    basis: tuple[Array, ...]  # for each, orthonormal columns (m, size) of its signature
    # for each, what the prior leaves of the squared length along them (size,)
    shrink: tuple[Array, ...]
    occam: Array  # for each, log det(S^T S + 1)

    @classmethod
    def of(cls, signatures: Signatures, chosen: Sequence[Candidate]) -> Scoring:
        """Prepare candidates of a fit's signatures."""
        basis, shrink, occam = list[Array](), list[Array](), list[float]()
        for candidate in chosen:
            left, singular, _ = np.linalg.svd(signatures.of(candidate), full_matrices=False)
            kept = singular > 1e-9 * max(float(singular.max(initial=0.0)), 1e-300)
            square = singular[kept] ** 2
            basis.append(left[:, kept])
            shrink.append(square / (square + 1))
            occam.append(float(np.sum(np.log1p(square))))
        return cls(tuple(chosen), tuple(basis), tuple(shrink), np.array(occam))

    def gains(self, residuals: Array) -> Array:
        """Fall of chi2 ``(C, ...)`` for residuals ``(m, ...)``."""
        return np.stack(
            [
                np.tensordot(shrink, (basis.T @ residuals) ** 2, axes=(0, 0))
                for basis, shrink in zip(self.basis, self.shrink, strict=True)
            ]
        )

    def evidences(self, residuals: Array) -> Array:
        """Log Bayes factors against no effect ``(C, ...)`` for residuals ``(m, ...)``."""
        gains = self.gains(residuals)
        return (gains - self.occam.reshape(-1, *[1] * (gains.ndim - 1))) / 2
