"""Signatures of all effects at a fitted machine, past what the fit itself explains.

With a candidate's signature S at its tolerance (whitened, projected) and the residual r, the
Gaussian prior of the tolerance gives the candidate's gain and evidence:

    gain     = r^T S (S^T S + 1)^-1 S^T r              (reduction of chi2, prior included)
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

BACKGROUND = 0.02
"""Size of every effect on a sound machine, in tolerances."""

_LEAST_SIGNAL = 0.3  # least signature of one tolerance that is visible, in sigmas over all readings


@dataclass(frozen=True)
class Signatures:
    """Signatures of all effects in the readings.

    All vectors are whitened by the noise. Datums, placements and all parameters of the fit, with
    their priors, are projected out. Rows are the augmented readings ``(m,)``.
    """

    estimate: Estimate  # the fit around which effects are linearised
    names: tuple[str, ...]  # elementary unknowns beyond the fit (E,)
    tolerance: Array  # of these (E,), SI
    columns: Array  # signatures (m, E), per SI unit
    residual: Array  # of the fit (m,)
    fitted_basis: Array  # orthonormal columns of the directions projected out (m, q)
    candidates: tuple[Candidate, ...]  # all that are made of these unknowns
    invisible: tuple[Parameter, ...]  # unknowns that these readings cannot show

    @property
    def count(self) -> int:
        """Number of readings."""
        return len(self.estimate.problem.measured)

    def whiten(self, readings: Array) -> Array:
        """Return readings ``(n, ...)``, metres, as whitened and projected vectors ``(m, ...)``."""
        return whiten_and_project(self.estimate.nuisance.weighing, self.fitted_basis, readings)

    def weighted_by_background(self, vectors: Array) -> Array:
        """Return vectors ``(m, k)`` whitened by the noise and ``BACKGROUND`` tolerances of every
        effect together, whose covariance is ``1 + U diag(s^2) U^T``.
        """
        background = self.columns * (BACKGROUND * self.tolerance)
        u, s, _ = np.linalg.svd(background, full_matrices=False)
        return np.asarray(vectors + u @ ((1 / np.sqrt(1 + s**2) - 1)[:, None] * (u.T @ vectors)))

    def signature(self, candidate: Candidate) -> Array:
        """Return the signature of a candidate at its tolerance ``(m, size)``."""
        return self.columns @ self.weights_at_tolerance(candidate)

    def weights_at_tolerance(self, candidate: Candidate) -> Array:
        """Return elementary unknowns for one tolerance of each parameter of a candidate ``(E,
        size)``.
        """
        matrix = weight_matrix(self.names, candidate.weights)
        size = np.array([self.tolerance[np.flatnonzero(column)].max() for column in matrix.T])
        return np.asarray(matrix * size)


def signatures(estimate: Estimate) -> Signatures:
    """Linearise all effects of the catalogue at a fit, with its unknowns and nuisances projected
    out.

    There are none if all effects are free already, as after a calibration.
    """
    problem, nuisance = estimate.problem, estimate.nuisance
    effects = excited_effects(problem)
    full_problem = with_effects_freed(problem, [e.name for e in effects])
    base_count = len(problem.unknowns)
    at = linearise(full_problem, full_problem.zero_padded(estimate.x))
    basis = fitted_basis(problem, nuisance, estimate.at)
    columns = whiten_and_project(nuisance.weighing, basis, at.jacobian[:, base_count:])
    # The residual of the readings and of the prior rows.
    _, target = problem.prior_rows
    residual, reading_count = np.zeros(len(basis)), len(problem.measured)
    reading_residual = problem.measured - at.value + at.jacobian[:, :base_count] @ estimate.x
    residual[:reading_count] = nuisance.weighing.whiten(reading_residual)
    residual[reading_count : reading_count + len(target)] = target
    tolerance = np.array([u.tolerance for u in full_problem.unknowns[base_count:]])
    names = tuple(u.name for u in full_problem.unknowns[base_count:])
    visible_mask = np.linalg.norm(columns, axis=0) * tolerance > _LEAST_SIGNAL
    kept = np.flatnonzero(visible_mask)
    visible = tuple(names[k] for k in kept)
    return Signatures(
        estimate,
        visible,
        tolerance[kept],
        columns[:, kept],
        project_out(basis, residual),
        basis,
        candidates(visible, effects, problem.machine.catalogue),
        tuple(n for n, is_visible in zip(names, visible_mask, strict=True) if not is_visible),
    )


@dataclass(frozen=True)
class Scoring:
    """Candidates prepared to be scored on many residuals."""

    candidates: tuple[Candidate, ...]  # `C` of them
    basis: tuple[Array, ...]  # for each, orthonormal columns (m, size) of its signature
    shrink: tuple[Array, ...]  # for each, shrinkage of squared components by the prior (size,)
    occam: Array  # for each, log det(S^T S + 1)

    @classmethod
    def prepare(cls, signatures: Signatures, chosen: Sequence[Candidate]) -> Scoring:
        """Return the candidates of a fit's signatures, prepared."""
        basis, shrink, occam = list[Array](), list[Array](), list[float]()
        for candidate in chosen:
            vectors, singular, _ = np.linalg.svd(
                signatures.signature(candidate), full_matrices=False
            )
            kept = singular > 1e-9 * max(float(singular.max(initial=0.0)), 1e-300)
            squares = singular[kept] ** 2
            basis.append(vectors[:, kept])
            shrink.append(squares / (squares + 1))
            occam.append(float(np.sum(np.log1p(squares))))
        return cls(tuple(chosen), tuple(basis), tuple(shrink), np.array(occam))

    def gains(self, residuals: Array) -> Array:
        """Return the reductions of chi2 ``(C, ...)`` for residuals ``(m, ...)``."""
        return np.stack(
            [
                np.tensordot(shrink, (basis.T @ residuals) ** 2, axes=(0, 0))
                for basis, shrink in zip(self.basis, self.shrink, strict=True)
            ]
        )

    def evidences(self, residuals: Array) -> Array:
        """Return log Bayes factors against no effect ``(C, ...)`` for residuals ``(m, ...)``."""
        gains = self.gains(residuals)
        return (gains - self.occam.reshape(-1, *[1] * (gains.ndim - 1))) / 2
