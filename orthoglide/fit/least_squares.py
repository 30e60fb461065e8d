"""The weighted least-squares problem around one point: nuisances, priors, covariance.

Minimised is ``|V (y - f(x) - U z)|^2 + |W x - t|^2 + sum(precision z^2)``, where ``V`` weighs rows
by their noise (see `fit.weighing`), ``U`` holds the nuisances of all factors (see `fit.factors`),
and ``W``, ``t`` what is known before. The
nuisances z are linear and are projected out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.fit.problem import Problem
from orthoglide.fit.weighing import Weighing
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
    value: Array  # rows (n,), nuisances apart, metres
    jacobian: Array  # (n, P)
    reading_poses: tuple[
        ReadingPoses, ...
    ]  # for each factor, what its instruments need to know of the poses


def linearise(problem: Problem, x: Array) -> Linearised:
    """Predicted rows of all factors and their derivatives, by the general mechanism."""
    found = []
    for k, factor in enumerate(problem.factors):
        names, matrix = problem.elementary_parameters(k)
        linear = factor.linearise(problem.machine.model, problem.values(k, x), names)
        found.append((linear.value, linear.jacobian @ matrix, linear.reading_poses))
    values, jacobians, seen = zip(*found, strict=True)
    return Linearised(x, np.concatenate(values), np.concatenate(jacobians), seen)


def predict(problem: Problem, x: Array) -> Array:
    """Predicted rows ``(n,)`` of all factors, nuisances apart, by the general mechanism."""
    model = problem.machine.model
    return np.concatenate(
        [f.predict(model, problem.values(k, x)) for k, f in enumerate(problem.factors)]
    )


def update_instrument_poses(problem: Problem, at: Linearised) -> Problem:
    """The problem with instruments' frames brought to a machine; itself where they are there."""
    factors = tuple(
        f if f.on_legs else f.with_instrument_poses(seen)
        for f, seen in zip(problem.factors, at.reading_poses, strict=True)
    )
    if all(new is old for new, old in zip(factors, problem.factors, strict=True)):
        return problem
    return replace(problem, factors=factors)


def project_out(basis: Array, rows: Array) -> Array:
    """Rows ``(m, ...)`` without their part along orthonormal columns ``(m, q)``."""
    return np.asarray(rows - basis @ (basis.T @ rows))


def whiten_and_project(weighing: Weighing, basis: Array, rows: Array) -> Array:
    """Rows ``(n, ...)``, metres, in units of their noise, past orthonormal columns ``(m, q)`` that
    have more rows, of what is known before: ``(m, ...)``.
    """
    padded = np.zeros((len(basis), *rows.shape[1:]))
    padded[: len(rows)] = weighing.whiten(rows)
    return project_out(basis, padded)


@dataclass(frozen=True, repr=False)
class Nuisances:
    """Columns that the rows contain besides the model."""

    columns: Array  # (n, k), factor by factor
    precision: Array  # about zero (k,): 0 where nothing is known of one
    weighing: Weighing  # the noise of the rows

    @cached_property
    def augmented(self) -> Array:
        """Whitened columns over the rows of their priors ``(n + k, k)``."""
        return np.vstack([self.weighing.whiten(self.columns), np.diag(np.sqrt(self.precision))])

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns that span those of ``augmented`` ``(n + k, rank)``."""
        return orthonormal(self.augmented.copy())

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.columns.shape[1]

    @property
    def unconstrained_count(self) -> int:
        """Number of linearly independent nuisance parameters without a prior."""
        return self.basis.shape[1] - int(np.sum(self.precision > 0))

    def project(self, rows: Array) -> Array:
        """Return rows ``(n, ...)``, whitened and projected past the nuisances ``(n + k, ...)``."""
        return whiten_and_project(self.weighing, self.basis, rows)

    def explained_residual(self, rest: Array) -> Array:
        """Return the part of residuals ``(n, ...)`` that the nuisances explain, metres."""
        basis = self.basis[: len(rest)]
        return self.weighing.metres(basis @ (basis.T @ self.weighing.whiten(rest)))


def nuisances(problem: Problem, seen: tuple[ReadingPoses, ...]) -> Nuisances:
    """Nuisances of all factors, by what a linearisation saw; they are frozen for a fit."""
    blocks = [f.nuisances(s) for f, s in zip(problem.factors, seen, strict=True)]
    widths = np.cumsum([0, *(b.columns.shape[1] for b in blocks)])
    columns = np.zeros((len(problem.measured), int(widths[-1])))
    for block, rows, first, end in zip(
        blocks, problem.factor_rows, widths[:-1], widths[1:], strict=True
    ):
        columns[rows, first:end] = block.columns
    if problem.free_form_errors is not None:
        columns = np.hstack([columns, problem.free_form_errors.columns])
        blocks.append(problem.free_form_errors)
    precision = np.concatenate([b.sd for b in blocks]) ** -2.0
    return Nuisances(columns, precision, problem.weighing)


@dataclass(frozen=True)
class NormalEquations:
    """Projected and whitened problem at one point."""

    residual: Array  # (n + k,), dimensionless
    jacobian: Array  # (n + k, P), a unit of SI
    prior: Array  # rows of what is known before (q, P)
    target: Array  # what these should give (q,)
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
        known = self.prior.T @ (self.prior @ self.x - self.target)
        return np.asarray(known - self.jacobian.T @ self.residual)

    @property
    def information(self) -> Array:
        """Gauss-Newton normal matrix, priors included ``(P, P)``."""
        return np.asarray(self.jacobian.T @ self.jacobian + self.prior.T @ self.prior)

    @property
    def hat_eigenvalues(self) -> Array:
        """Eigenvalues of the hat matrix ``(P,)``: how far the data determine the unknowns."""
        scale = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        full = self.information / scale / scale[:, None]
        data = self.jacobian.T @ self.jacobian / scale / scale[:, None]
        hat = np.linalg.lstsq(full, data, rcond=1e-14)[0]
        return np.asarray(np.clip(np.linalg.eigvals(hat).real, 0.0, 1.0))


def normal_equations(problem: Problem, at: Linearised, nuisance: Nuisances) -> NormalEquations:
    """The projected problem at a linearisation."""
    residual = nuisance.project(problem.measured - at.value)
    jacobian = nuisance.project(at.jacobian)
    return NormalEquations(residual, jacobian, *problem.prior_rows, at.x)


def joint_prior_rows(problem: Problem, nuisance: Nuisances) -> Array:
    """Rows of what is known before, of unknowns and nuisances ``(q + k, P + k)``."""
    from scipy.linalg import block_diag

    matrix, _ = problem.prior_rows
    return np.asarray(block_diag(matrix, nuisance.augmented[len(problem.measured) :]))


def fitted_basis(problem: Problem, nuisance: Nuisances, at: Linearised) -> Array:
    """Orthonormal columns of everything fitted, with its priors ``(n + q + k, P + k)`` or fewer.

    The first ``n`` rows are those of the readings: their squares sum to the leverage.
    """
    every = np.hstack([at.jacobian, nuisance.columns])
    return orthonormal(
        np.vstack([nuisance.weighing.whiten(every), joint_prior_rows(problem, nuisance)])
    )


def orthonormal(columns: Array) -> Array:
    """Return orthonormal columns ``(m, rank)`` that span some columns ``(m, k)``, which are scaled
    in place: of many readings a copy would be large.

    A setup may have fewer readings than numbers. A column that follows from those before it adds
    nothing, and left in, its rounding would become a direction of other readings.
    """
    scale = np.linalg.norm(columns, axis=0)
    columns /= np.where(scale > 0, scale, 1.0)
    basis, triangle = np.linalg.qr(columns)
    new = np.abs(np.diag(triangle)) > _RANK_TOLERANCE
    return basis if new.all() else np.linalg.qr(columns[:, new])[0]


def covariance(jacobian: Array, prior: Array) -> tuple[Array, Array]:
    """Covariance of the unknowns and the directions that nothing determines.

    Columns are scaled to unit length first, so that units do not matter.

    Args:
        jacobian: whitened, projected ``(m, P)``.
        prior: rows of what is known before ``(q, P)``.

    Returns:
        Covariance ``(P, P)`` (of the determined part) and undetermined directions ``(u, P)``, SI.
    """
    augmented = np.vstack([jacobian, prior, np.zeros((jacobian.shape[1],) * 2)])
    scale = np.linalg.norm(augmented, axis=0)
    blind = scale <= 0
    scale = np.where(blind, 1.0, scale)
    _, singular, right = np.linalg.svd(augmented / scale, full_matrices=False)
    seen = singular > 1e-7 * max(float(singular.max(initial=0.0)), 1e-300)
    root = (right[seen].T / singular[seen]) / scale[:, None]
    unseen = right[~seen] / scale
    return root @ root.T, unseen


# An unknown whose sigma is ten times what it would be alone hides behind others.
_WEAK_SINGULAR_VALUE = 0.1
_REPORTED_SHARE = 0.05
# Of what the unknown seen best shows at its tolerance: less is rounding.
_ROUNDING_SHARE = 1e-9
# Singular value of unit columns below which a direction shows nothing but rounding.
_UNSEEN_SINGULAR_VALUE = 1e-6


def weak_directions(
    problem: Problem, jacobian: Array, covariance: Array, *, scale: float = 1.0
) -> tuple[WeakDirection, ...]:
    """Find the weak directions.

    Args:
        problem: whose unknowns these are.
        jacobian: whitened and projected ``(m, P)``, SI, priors apart.
        covariance: of the unknowns as reported ``(P, P)``, SI, scaled.
        scale: of the reported sigmas.

    Returns:
        Weakest first; empty where every unknown is seen well.
    """
    names = problem.names
    norm = np.linalg.norm(jacobian, axis=0)
    # An unknown of which only rounding shows is not seen at all.
    shown = norm * problem.tolerance
    norm = np.where(shown > _ROUNDING_SHARE * shown.max(initial=0.0), norm, 0.0)
    seen = np.where(norm > 0, norm, 1.0)
    # Rows of zeros let fewer readings than unknowns span all directions.
    columns = np.where(norm > 0, jacobian, 0.0) / seen
    padded = np.vstack([columns, np.zeros((len(names), len(names)))])
    _, singular, right = np.linalg.svd(padded, full_matrices=False)
    weak = singular < _WEAK_SINGULAR_VALUE
    if not weak.any():
        return ()
    # In SI, where the basis has the fewest unknowns a direction, so that legs stand apart.
    blind = singular < _UNSEEN_SINGULAR_VALUE
    found = []
    for k, direction in enumerate(canonical_basis(right[weak] / seen, right[blind] / seen)):
        left = float(np.linalg.norm(columns @ (direction * seen)))
        sigma = scale / left if k >= blind.sum() else float("inf")
        with_priors = float(np.sqrt(max(direction @ covariance @ direction, 0.0)))
        size = np.abs(direction)
        unit = problem.machine.catalogue.effect_of(names[largest(size)]).unit
        kept = np.flatnonzero(size >= _REPORTED_SHARE * size.max())
        sign = np.sign(direction[kept[0]])
        shares: dict[str, float] = {names[k]: float(sign * direction[k]) for k in kept}
        found.append(WeakDirection(shares, sigma / unit.si, with_priors / unit.si, unit.name))
    # Sigmas range over decades: equal are those of nearly equal logarithm.
    return tuple(ranked(found, lambda d: float(np.log(d.sigma)), RELATIVE_MARGIN))


def explained_by_two(
    one: Array, two: Array, cross: Array, x: Array, y: Array
) -> tuple[Array, Array]:
    """What two columns with normal priors of size one explain of a residual, and the determinant of
    ``1 + A^T A``, which is no less than 1: where both show the same, rounding may leave less.

    Args:
        one: square of the first column, and 1.
        two: of the second.
        cross: their product.
        x: of the first and the residual.
        y: of the second and it.
    """
    spread = np.maximum(one * two - cross**2, 1.0)
    return (x**2 * two + y**2 * one - 2 * x * y * cross) / spread, spread
