"""Signatures of all effects at a fitted machine, with what the fit itself explains projected out.

With a candidate's signature S at its tolerance (whitened, projected) and the residual r, the
Gaussian prior of the tolerance gives the candidate's gain and evidence:

    gain     = r^T S (S^T S + 1)^-1 S^T r              (reduction of chi2, prior included)
    evidence = (gain - log det(S^T S + 1)) / 2         (log Bayes factor against no effect)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.explanation.candidates import Candidate, candidates
from orthoglide.explanation.linear_model import left_singular, shrink_along
from orthoglide.explanation.search import explained_by_group
from orthoglide.fit import Estimate, with_effects_freed
from orthoglide.fit.assembling import excited_effects
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
    fitted_basis: Array  # orthonormal columns of the directions projected out (m, q)
    candidates: tuple[Candidate, ...]  # all that are made of these unknowns
    invisible: tuple[Parameter, ...]  # unknowns that these readings cannot show

    def whiten(self, readings: Array) -> Array:
        """Return readings ``(n, ...)``, metres, as whitened and projected vectors ``(m, ...)``."""
        return whiten_and_project(self.estimate.nuisance.weighing, self.fitted_basis, readings)

    def weighted_by_background(self, vectors: Array) -> Array:
        """Return vectors ``(m, k)`` whitened by the noise and ``BACKGROUND`` tolerances of every
        effect together, whose covariance is ``1 + U diag(s^2) U^T``.
        """
        background = self.columns * (BACKGROUND * self.tolerance)
        left, singular = left_singular(background)
        return shrink_along(vectors, left, 1 - 1 / np.sqrt(1 + singular**2))

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

    def evidences(self, residuals: Array) -> Array:
        """Return the log Bayes factor of each candidate against no effect ``(C, k)``, for residuals
        ``(m, k)``.
        """
        evidences, chi2 = [], np.sum(residuals**2, axis=0)
        for candidate in self.candidates:
            columns = self.signature(candidate)
            gram, products = columns.T @ columns, residuals.T @ columns
            explained, occam = explained_by_group(gram, products, chi2, tau=1.0)
            evidences.append(explained / 2 - occam)
        return np.stack(evidences)


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
        basis,
        candidates(visible, effects, problem.machine.catalogue),
        tuple(n for n, is_visible in zip(names, visible_mask, strict=True) if not is_visible),
    )


def noise_residuals(signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Return whitened, projected residuals ``(m, draws)`` of a sound machine.

    They contain the noise with its rounding, placements, and ``BACKGROUND`` tolerances of every
    effect, by which `Signatures.weighted_by_background` weights them.
    """
    problem = signatures.estimate.problem
    rows = signatures.whiten(_draw_noise(signatures, rng, draws))
    # Where a prior shrinks an unknown, part of it remains in the residual.
    reading_count, prior_count = len(problem.measured), len(problem.prior_rows[0])
    prior_rows = np.zeros((len(signatures.fitted_basis), draws))
    prior_rows[reading_count:][:prior_count] = rng.standard_normal((prior_count, draws))
    rows += project_out(signatures.fitted_basis, prior_rows)
    background = rng.standard_normal((len(signatures.names), draws))
    background *= BACKGROUND * signatures.tolerance[:, None]
    return signatures.weighted_by_background(rows + signatures.columns @ background)


def _draw_noise(signatures: Signatures, rng: np.random.Generator, draws: int) -> Array:
    """Draw noise of all readings ``(n, draws)``, metres: scatter, rounding and placement."""
    problem, nuisance = signatures.estimate.problem, signatures.estimate.nuisance
    n, resolution = len(problem.measured), problem.resolution
    variance = problem.sigma**2 + problem.shared_rounding_sd**2 - resolution**2 / 12
    scatter = np.sqrt(np.maximum(variance, 0.0))
    noise = rng.standard_normal((n, draws)) * scatter[:, None]
    has_prior = nuisance.precision > 0  # the placements of the dials
    if has_prior.any():
        placements = rng.standard_normal((int(has_prior.sum()), draws))
        placements /= np.sqrt(nuisance.precision[has_prior])[:, None]
        noise += nuisance.columns[:, has_prior] @ placements
    return np.asarray(noise + rng.uniform(-0.5, 0.5, (n, draws)) * resolution[:, None])
