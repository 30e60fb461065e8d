"""Signatures of all effects at a fitted machine, past what the fit itself explains.

With a candidate's signature S at its tolerance (whitened, projected) and the residual r, the
Gaussian prior of the tolerance gives the candidate's gain and evidence:

    gain     = r^T S (S^T S + 1)^-1 S^T r              (fall of chi2, prior counted)
    evidence = (gain - log det(S^T S + 1)) / 2         (log Bayes factor against no effect)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.explanation.candidates import Candidate, candidates
from orthoglide.fit import Estimate, with_effects_freed
from orthoglide.fit.excitation import excited_effects
from orthoglide.fit.least_squares import fitted_basis, linearise, project_out, whiten_and_project
from orthoglide.fit.unknowns import weight_matrix
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

# A signature that one tolerance lifts less than this above the noise, in all, is not seen.
_LEAST_SIGNAL = 0.3


@dataclass(frozen=True)
class Signatures:
    """What every effect would show in these readings.

    All vectors are whitened by the noise and projected past datums, placements and everything the
    fit has freed, with its priors: rows are the augmented readings ``(m,)``.
    """

    estimate: Estimate  # the fit around which effects are linearised
    names: tuple[str, ...]  # elementary unknowns beyond the fit (E,)
    tolerance: Array  # of these (E,), SI
    columns: Array  # signatures (m, E), a unit of SI
    residual: Array  # what the fit leaves (m,)
    fitted_basis: Array  # orthonormal columns of what is projected out (m, q)
    candidates: tuple[Candidate, ...]  # all that are made of these
    # names that these readings cannot show, whatever their size within reason
    invisible: tuple[Parameter, ...]

    @property
    def count(self) -> int:
        """Number of readings."""
        return len(self.estimate.problem.measured)

    def whiten(self, readings: Array) -> Array:
        """Readings ``(n, ...)`` in metres as whitened, projected vectors ``(m, ...)``."""
        return whiten_and_project(self.estimate.nuisance.weighing, self.fitted_basis, readings)

    def signature(self, candidate: Candidate) -> Array:
        """Signature of a candidate at its tolerance ``(m, size)``."""
        return self.columns @ self.weights_at_tolerance(candidate)

    def weights_at_tolerance(self, candidate: Candidate) -> Array:
        """Elementary unknowns at tolerance for each of a candidate's parameters ``(E, size)``."""
        matrix = weight_matrix(self.names, candidate.weights)
        size = np.array([self.tolerance[np.flatnonzero(column)].max() for column in matrix.T])
        return np.asarray(matrix * size)


def signatures(estimate: Estimate) -> Signatures:
    """Linearise all effects of the catalogue at a fit, whose unknowns and nuisances are projected
    out; none where all of them are free already, as those of the machine are since a calibration.
    """
    problem, nuisance = estimate.problem, estimate.nuisance
    effects = excited_effects(problem)
    wide, own = with_effects_freed(problem, [e.name for e in effects]), len(problem.unknowns)
    at = linearise(wide, wide.zero_padded(estimate.x))
    fitted = fitted_basis(problem, nuisance, estimate.at)
    columns = whiten_and_project(nuisance.weighing, fitted, at.jacobian[:, own:])
    # What the fit leaves of the readings and of what was known before, past what it freed.
    _, target = problem.prior_rows
    left, n = np.zeros(len(fitted)), len(problem.measured)
    rest = problem.measured - at.value + at.jacobian[:, :own] @ estimate.x
    left[:n] = nuisance.weighing.whiten(rest)
    left[n : n + len(target)] = target
    tolerance = np.array([u.tolerance for u in wide.unknowns[own:]])
    names = tuple(u.name for u in wide.unknowns[own:])
    seen = np.linalg.norm(columns, axis=0) * tolerance > _LEAST_SIGNAL
    kept = np.flatnonzero(seen)
    visible = tuple(names[k] for k in kept)
    return Signatures(
        estimate,
        visible,
        tolerance[kept],
        columns[:, kept],
        project_out(fitted, left),
        fitted,
        candidates(visible, effects, problem.machine.catalogue),
        tuple(n for n, s in zip(names, seen, strict=True) if not s),
    )


@dataclass(frozen=True)
class Scoring:
    """Candidates prepared for many residuals at once."""

    candidates: tuple[Candidate, ...]  # `C` of them
    basis: tuple[Array, ...]  # for each, orthonormal columns (m, size) of its signature
    # for each, what the prior leaves of the squared length along them (size,)
    shrink: tuple[Array, ...]
    occam: Array  # for each, log det(S^T S + 1)

    @classmethod
    def prepare(cls, signatures: Signatures, chosen: Sequence[Candidate]) -> Scoring:
        """Prepare candidates of a fit's signatures."""
        basis, shrink, occam = list[Array](), list[Array](), list[float]()
        for candidate in chosen:
            left, singular, _ = np.linalg.svd(signatures.signature(candidate), full_matrices=False)
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
