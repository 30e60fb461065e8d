"""The weighted least-squares problem around one point: nuisances, priors, covariance.

Minimised is ``|V (y - f(x) - U z)|^2 + |W x - t|^2 + sum(precision z^2)``, where ``V`` weighs rows
by their noise (see `fit.noise`), ``U`` holds the nuisances of all factors (see `fit.factors`),
and ``W``, ``t`` are the priors. The nuisances z are linear and are projected out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.factors import Factor
from orthoglide.fit.noise import NO_WEIGHT, Weighing
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array
from orthoglide.ordering import RELATIVE_MARGIN, canonical_basis, largest, ranked
from orthoglide.prediction import ReadingPoses
from orthoglide.result.fits import WeakDirection

_RANK_TOLERANCE = 1e-10
"""Share of a column that is orthogonal to all others, below which it is rounding."""


@dataclass(frozen=True, repr=False)
class Linearised:
    """Predicted rows around one point."""

    x: Array  # unknowns (P,), SI
    value: Array  # rows (n,), without nuisances, metres
    jacobian: Array  # (n, P)
    reading_poses: tuple[ReadingPoses, ...]  # poses in which each factor's readings are taken


def linearise(problem: Problem, x: Array, parts: Mapping[int, Factor] | None = None) -> Linearised:
    """Return the predicted rows of all factors, or of parts of some, and their derivatives."""
    by_factor = []
    for k, factor in (dict(enumerate(problem.factors)) if parts is None else parts).items():
        names, matrix = problem.elementary_parameters(k)
        linear = factor.linearise(problem.machine.model, problem.values(k, x), names)
        by_factor.append((linear.value, linear.jacobian @ matrix, linear.reading_poses))
    values, jacobians, reading_poses = zip(*by_factor, strict=True)
    return Linearised(x, np.concatenate(values), np.concatenate(jacobians), reading_poses)


def predict(problem: Problem, x: Array) -> Array:
    """Return the predicted rows ``(n,)`` of all factors, without nuisances."""
    model = problem.machine.model
    return np.concatenate(
        [f.predict(model, problem.values(k, x)) for k, f in enumerate(problem.factors)]
    )


def update_instrument_poses(problem: Problem, linear: Linearised) -> Problem:
    """Return the problem with instruments placed by a machine; itself if their poses stay."""
    factors = tuple(
        f if f.on_legs else f.with_instrument_poses(poses)
        for f, poses in zip(problem.factors, linear.reading_poses, strict=True)
    )
    if all(new is old for new, old in zip(factors, problem.factors, strict=True)):
        return problem
    return replace(problem, factors=factors)


def linearise_placed(problem: Problem, x: Array) -> tuple[Problem, Linearised]:
    """Return the problem with instruments placed by the machine at ``x``, and it linearised."""
    linear = linearise(problem, x)
    placed = update_instrument_poses(problem, linear)
    return (problem, linear) if placed is problem else (placed, linearise(placed, x))


def project_out(basis: Array, rows: Array) -> Array:
    """Return rows ``(m, ...)`` without their part along orthonormal columns ``(m, q)``, or rows
    ``V`` of such columns: with the hat matrix ``V V^T`` of a fit, the residual of these rows.
    """
    return np.asarray(rows - basis @ (basis.T @ rows))


def whiten_and_project(weighing: Weighing, basis: Array, rows: Array) -> Array:
    """Return rows ``(n, ...)``, metres, whitened and without their part along orthonormal columns
    ``(m, q)``, whose rows beyond ``n`` are those of priors: ``(m, ...)``.
    """
    padded = np.zeros((len(basis), *rows.shape[1:]))
    padded[: len(rows)] = weighing.whiten(rows)
    return project_out(basis, padded)


@dataclass(frozen=True, repr=False)
class Nuisances:
    """Columns that the rows contain besides the model."""

    columns: Array  # (n, k), factor by factor
    precision: Array  # prior precision about zero (k,); 0 without a prior
    weighing: Weighing  # the noise of the rows

    @property
    def augmented(self) -> Array:
        """Whitened columns over the rows of their priors ``(n + k, k)``."""
        return np.vstack([self.weighing.whiten(self.columns), np.diag(np.sqrt(self.precision))])

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns that span those of ``augmented`` ``(n + k, rank)``."""
        return orthonormal(self.augmented)

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.columns.shape[1]

    @property
    def unconstrained_count(self) -> int:
        """Number of linearly independent nuisance parameters without a prior."""
        return self.basis.shape[1] - int(np.sum(self.precision > 0))

    def of_means(self, index: NDArray[np.int64]) -> Nuisances:
        """Return the nuisances of the means of groups of readings, which have equal columns, noise
        and station in each group; ``index``: group of each reading ``(n,)``.
        """
        first, counts = np.unique(index, return_index=True, return_counts=True)[1:]
        readings = self.weighing.subset(first)
        weighing = replace(readings, sigma=readings.sigma / np.sqrt(counts))
        return Nuisances(self.columns[first], self.precision, weighing)

    def log_density(self, weighted: NDArray[np.bool_]) -> float:
        """Return the log density of readings that are as predicted, over all nuisances and up to a
        constant: ``-(ln|C| + ln|U^T C^-1 U + precision|) / 2`` with their covariance C. Readings
        without weight count as with it.

        Args:
            weighted: whether each reading has weight ``(n,)``.
        """
        gram = (columns := self.augmented).T @ columns
        length = np.sqrt(np.diag(gram))
        values = np.linalg.eigvalsh(gram / length / length[:, None])
        of_noise = self.weighing.log_determinant - 2 * np.log(NO_WEIGHT) * np.sum(~weighted)
        of_nuisances = 2 * np.log(length).sum() + np.log(values[values > _RANK_TOLERANCE]).sum()
        return -float(of_noise + of_nuisances) / 2

    def project(self, rows: Array) -> Array:
        """Return rows ``(n, ...)``, whitened, with the nuisances projected out ``(n + k, ...)``."""
        return whiten_and_project(self.weighing, self.basis, rows)

    def explained_residual(self, residual: Array) -> Array:
        """Return the part of residuals ``(n, ...)`` that the nuisances explain, metres."""
        basis = self.basis[: len(residual)]
        return self.weighing.metres(basis @ (basis.T @ self.weighing.whiten(residual)))


def nuisances(problem: Problem, reading_poses: tuple[ReadingPoses, ...]) -> Nuisances:
    """Return the nuisances of all factors, frozen at the poses of a linearisation."""
    from scipy.linalg import block_diag

    blocks = [f.nuisances(poses) for f, poses in zip(problem.factors, reading_poses, strict=True)]
    columns = block_diag(*(block.columns for block in blocks))
    if problem.free_form_nuisances is not None:
        columns = np.hstack([columns, problem.free_form_nuisances.columns])
        blocks.append(problem.free_form_nuisances)
    precision = np.concatenate([b.sd for b in blocks]) ** -2.0
    return Nuisances(columns, precision, problem.weighing)


@dataclass(frozen=True)
class NormalEquations:
    """Projected and whitened problem at one point."""

    residual: Array  # (n + k,), dimensionless
    jacobian: Array  # (n + k, P), a unit of SI
    prior: Array  # rows of the priors (q, P)
    target: Array  # their expected values (q,)
    x: Array  # (P,)

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals, nuisance parameters included."""
        return float(self.residual @ self.residual)

    def prior_chi2(self, x: Array) -> float:
        """Return the sum of squares of the prior at the unknowns ``x`` ``(P,)``."""
        return float(np.sum((self.prior @ x - self.target) ** 2))

    @property
    def cost(self) -> float:
        """The objective: sum of squares of residuals, nuisance parameters and prior."""
        return self.chi2 + self.prior_chi2(self.x)

    @property
    def gradient(self) -> Array:
        """Half the gradient of the cost by the unknowns ``(P,)``."""
        prior_gradient = self.prior.T @ (self.prior @ self.x - self.target)
        return np.asarray(prior_gradient - self.jacobian.T @ self.residual)

    @cached_property
    def information(self) -> Array:
        """Gauss-Newton normal matrix, priors included ``(P, P)``."""
        return np.asarray(self.jacobian.T @ self.jacobian + self.prior.T @ self.prior)

    @property
    def single_sd(self) -> Array:
        """Standard deviation of each unknown if all others were known ``(P,)``, SI."""
        return np.asarray(1 / np.sqrt(np.maximum(np.diag(self.information), 1e-300)))

    @property
    def hat_eigenvalues(self) -> Array:
        """Eigenvalues of the hat matrix ``(P,)``: shares of unknowns that the data determine."""
        scale = np.outer(self.single_sd, self.single_sd)
        data = self.jacobian.T @ self.jacobian * scale
        hat = np.linalg.lstsq(self.information * scale, data, rcond=1e-14)[0]
        return np.asarray(np.clip(np.linalg.eigvals(hat).real, 0.0, 1.0))


def normal_equations(problem: Problem, linear: Linearised, nuisance: Nuisances) -> NormalEquations:
    """Return the projected problem at a linearisation."""
    residual = nuisance.project(problem.measured - linear.value)
    jacobian = nuisance.project(linear.jacobian)
    return NormalEquations(residual, jacobian, *problem.prior_rows, linear.x)


def fitted_basis(problem: Problem, nuisance: Nuisances, linear: Linearised) -> Array:
    """Return orthonormal columns of all fitted parameters with their priors
    ``(n + q + k, P + k)``, or fewer columns.

    The first ``n`` rows are those of the readings: their squares sum to the leverage.
    """
    from scipy.linalg import block_diag

    whitened = nuisance.weighing.whiten(np.hstack([linear.jacobian, nuisance.columns]))
    priors = problem.prior_rows[0], nuisance.augmented[len(problem.measured) :]
    columns = np.vstack([whitened, block_diag(*priors)])
    del whitened  # of many readings it is large
    return orthonormal(columns)


def orthonormal(columns: Array) -> Array:
    """Return orthonormal columns ``(m, rank)`` that span ``columns`` ``(m, k)``; these are scaled
    in place to save memory.

    A setup may have fewer readings than nuisances. Columns that depend on those before are left
    out: their rounding errors would become directions of other readings.
    """
    scale = np.linalg.norm(columns, axis=0)
    columns /= np.where(scale > 0, scale, 1.0)
    basis, triangle = np.linalg.qr(columns)
    independent = np.abs(np.diag(triangle)) > _RANK_TOLERANCE
    return basis if independent.all() else np.linalg.qr(columns[:, independent])[0]


def covariance(jacobian: Array, prior: Array) -> tuple[Array, Array]:
    """Return the covariance ``(P, P)`` of the unknowns, of its determined part, and the directions
    ``(u, P)`` that nothing determines, SI, by a whitened jacobian ``(m, P)`` and priors ``(q, P)``.
    """
    # Columns are scaled to unit length, so that units do not matter.
    scale = np.hypot(np.linalg.norm(jacobian, axis=0), np.linalg.norm(prior, axis=0))
    scale = np.where(scale <= 0, 1.0, scale)
    singular, directions = _singular_directions(np.vstack([jacobian, prior]) / scale)
    determined = singular > 1e-7 * max(float(singular.max(initial=0.0)), 1e-300)
    root = (directions[determined].T / singular[determined]) / scale[:, None]
    return root @ root.T, directions[~determined] / scale


def _singular_directions(columns: Array) -> tuple[Array, Array]:
    """Return the singular values ``(P,)`` of columns ``(m, P)`` and their directions ``(P, P)``.

    A triangle takes the place of many rows, and rows of zeros let few rows span all directions.
    """
    triangle = np.linalg.qr(columns, mode="r")
    missing = columns.shape[1] - len(triangle)
    _, singular, directions = np.linalg.svd(np.pad(triangle, [(0, missing), (0, 0)]))
    return singular, directions


_WEAK_SINGULAR_VALUE = 0.1  # an unknown whose sigma is ten times that of it alone is weak
_UNSEEN_SINGULAR_VALUE = 1e-6  # of unit columns: below it a direction shows rounding only
_REPORTED_SHARE = 0.05  # of the largest component of a direction: smaller ones are not reported
_ROUNDING_SHARE = 1e-9  # of the largest effect at tolerance: less is rounding


def weak_directions(
    problem: Problem, jacobian: Array, covariance: Array, *, scale: float = 1.0
) -> tuple[WeakDirection, ...]:
    """Return the directions that the readings hardly determine, weakest first, by the whitened and
    projected jacobian ``(m, P)``, SI, without priors; ``covariance`` ``(P, P)`` and ``scale`` are
    those of the reported sigmas.
    """
    names = problem.names
    norm = np.linalg.norm(jacobian, axis=0)
    # An unknown whose effect is rounding counts as without effect.
    effect_size = norm * problem.tolerance
    norm = np.where(effect_size > _ROUNDING_SHARE * effect_size.max(initial=0.0), norm, 0.0)
    column_norm = np.where(norm > 0, norm, 1.0)
    columns = np.where(norm > 0, jacobian, 0.0) / column_norm
    singular, right_vectors = _singular_directions(columns)
    weak = singular < _WEAK_SINGULAR_VALUE
    if not weak.any():
        return ()
    # In SI the basis has the fewest unknowns a direction, which separates the legs.
    unseen, right_vectors = singular < _UNSEEN_SINGULAR_VALUE, right_vectors / column_norm
    directions = []
    for k, direction in enumerate(canonical_basis(right_vectors[weak], right_vectors[unseen])):
        response = float(np.linalg.norm(columns @ (direction * column_norm)))
        sigma = scale / response if k >= unseen.sum() else float("inf")
        with_priors = float(np.sqrt(max(direction @ covariance @ direction, 0.0)))
        magnitude = np.abs(direction)
        unit = problem.machine.catalogue.effect_of(names[largest(magnitude)]).unit
        reported = np.flatnonzero(magnitude >= _REPORTED_SHARE * magnitude.max())
        sign = np.sign(direction[reported[0]])
        shares: dict[str, float] = {names[j]: float(sign * direction[j]) for j in reported}
        directions.append(WeakDirection(shares, sigma / unit.si, with_priors / unit.si, unit.name))
    # Sigmas range over decades: equal are those of nearly equal logarithm.
    return tuple(ranked(directions, lambda d: float(np.log(d.sigma)), RELATIVE_MARGIN))


def explained_by_two(
    first: Array, second: Array, cross: Array, x: Array, y: Array
) -> tuple[Array, Array]:
    """Return the square that two columns with standard normal priors explain of a residual, and the
    determinant of ``1 + A^T A``, kept at 1 or more where rounding makes it less: from the squares
    of both columns, plus 1, their product, and the products ``x``, ``y`` of each and the residual.
    """
    spread = np.maximum(first * second - cross**2, 1.0)
    return (x**2 * second + y**2 * first - 2 * x * y * cross) / spread, spread


_SUM_ROUNDING = 1e-15  # of a sum of squares, relative to it: some machine epsilons


def rounding(gram: Array) -> Array:
    """Return what keeps Gram matrices ``(..., q, q)``, or differences of them and smaller ones,
    positive definite although their sums are rounded: a multiple of the identity.
    """
    trace = np.asarray(np.trace(gram, axis1=-2, axis2=-1))
    return np.asarray(_SUM_ROUNDING * trace[..., None, None] * np.eye(gram.shape[-1]))
