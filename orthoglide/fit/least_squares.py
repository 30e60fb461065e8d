"""The weighted least-squares problem around one point: nuisances, priors, covariance.

Minimised is ``|(y - f(x) - U z) / sigma|^2 + |x / prior|^2 + sum(precision z^2)``, where ``U``
holds a column of ones a setup (its datum, free), a column a setup for where the dial stands along
the leg (known to its placement) and, where readings scatter less than they are rounded, one a
station for the rounding its visits share. The nuisances z are linear and are projected out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array


@dataclass(frozen=True)
class Linearised:
    """Predicted readings around one point.

    Attributes:
        x: unknowns ``(P,)``, SI.
        value: readings ``(n,)``, datums apart, metres.
        jacobian: ``(n, P)``.
        by_gauge: by the dial's place along the leg ``(n,)``.
    """

    x: Array
    value: Array
    jacobian: Array
    by_gauge: Array


def linearise(problem: Problem, x: Array) -> Linearised:
    """Predicted readings of all campaigns and their derivatives, by the general mechanism."""
    values, jacobians, slopes = [], [], []
    model = problem.machine.model
    for k, campaign in enumerate(problem.campaigns):
        names, matrix = problem.elementary(k)
        readings = model.linearised(problem.values(k, x), campaign, names)
        values.append(readings.value)
        jacobians.append(readings.jacobian @ matrix)
        slopes.append(readings.by_gauge)
    return Linearised(x, np.concatenate(values), np.concatenate(jacobians), np.concatenate(slopes))


def predict(problem: Problem, x: Array) -> Array:
    """Predicted readings ``(n,)`` of all campaigns, datums apart, by the general mechanism."""
    model = problem.machine.model
    return np.concatenate(
        [model.readings(problem.values(k, x), c) for k, c in enumerate(problem.campaigns)]
    )


@dataclass(frozen=True)
class Nuisances:
    """Columns that the readings contain besides the model.

    Attributes:
        columns: ``(n, k)``: datums, then placements (metres a metre), then common roundings.
        precision: about zero ``(k,)``: 0 for a datum, 1 / placement^2, 1 / rounding^2.
        basis: orthonormal columns of the whitened, prior-augmented columns ``(n + k, k)``.
        weight: 1 / sigma ``(n,)``.
    """

    columns: Array
    precision: Array
    basis: Array
    weight: Array

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.columns.shape[1]

    def project(self, rows: Array) -> Array:
        """Whitened rows ``(n, ...)`` without what the nuisances explain, ``(n + k, ...)``."""
        padded = np.zeros((len(self.basis), *rows.shape[1:]))
        padded[: len(rows)] = (rows.T * self.weight).T
        return np.asarray(padded - self.basis @ (self.basis.T @ padded))

    def solve(self, rest: Array) -> Array:
        """The nuisances ``(k,)`` that fit best what the model leaves ``(n,)``, metres."""
        augmented = np.vstack(
            [self.columns * self.weight[:, None], np.diag(np.sqrt(self.precision))]
        )
        target = np.concatenate([rest * self.weight, np.zeros(self.count)])
        return np.asarray(np.linalg.lstsq(augmented, target, rcond=1e-12)[0])


def nuisances(problem: Problem, by_gauge: Array) -> Nuisances:
    """Datums and placements of all setups.

    Args:
        problem: gives setups, noise and the placement's standard deviation.
        by_gauge: derivative of each reading by the dial's place ``(n,)``; frozen for a fit.
    """
    n, setups = len(problem.measured), problem.setup_count
    datum = np.zeros((n, setups))
    datum[np.arange(n), problem.setup_of_row] = 1.0
    placement = problem.placement
    columns, precision = datum, np.zeros(setups)
    if placement > 0:
        columns = np.hstack([datum, datum * by_gauge[:, None]])
        precision = np.concatenate([precision, np.full(setups, placement**-2)])
    if problem.noise.common > 0:
        station = problem.station
        columns = np.hstack([columns, np.eye(int(station.max()) + 1)[station]])
        rounded = np.full(int(station.max()) + 1, problem.noise.common**-2)
        precision = np.concatenate([precision, rounded])
    weight = 1 / problem.sigma
    augmented = np.vstack([columns * weight[:, None], np.diag(np.sqrt(precision))])
    scale = np.linalg.norm(augmented, axis=0)
    basis, _ = np.linalg.qr(augmented / scale)
    return Nuisances(columns, precision, basis, weight)


@dataclass(frozen=True)
class Normal:
    """Projected and whitened problem at one point.

    Attributes:
        residual: ``(n + k,)``, dimensionless.
        jacobian: ``(n + k, P)``, a unit of SI.
        prior: 1 / prior standard deviation ``(P,)``; 0 where there is none.
        x: ``(P,)``.
    """

    residual: Array
    jacobian: Array
    prior: Array
    x: Array

    @property
    def cost(self) -> float:
        """chi2: data, nuisances and priors."""
        return float(self.residual @ self.residual + np.sum((self.prior * self.x) ** 2))

    @property
    def gradient(self) -> Array:
        """Half the gradient of the cost by the unknowns ``(P,)``."""
        return np.asarray(-self.jacobian.T @ self.residual + self.prior**2 * self.x)

    @property
    def information(self) -> Array:
        """Gauss-Newton normal matrix, priors included ``(P, P)``."""
        return np.asarray(self.jacobian.T @ self.jacobian + np.diag(self.prior**2))


def normal(problem: Problem, at: Linearised, nuisance: Nuisances) -> Normal:
    """The projected problem at a linearisation."""
    residual = nuisance.project(problem.measured - at.value)
    jacobian = nuisance.project(at.jacobian)
    return Normal(residual, jacobian, 1 / problem.prior_sd, at.x)


def covariance(jacobian: Array, prior: Array) -> tuple[Array, Array]:
    """Covariance of the unknowns and the directions that nothing determines.

    Columns are scaled to unit length first, so that units do not matter.

    Args:
        jacobian: whitened, projected ``(m, P)``.
        prior: 1 / prior standard deviation ``(P,)``.

    Returns:
        Covariance ``(P, P)`` (of the determined part) and undetermined directions ``(u, P)``, SI.
    """
    augmented = np.vstack([jacobian, np.diag(prior)])
    scale = np.linalg.norm(augmented, axis=0)
    blind = scale <= 0
    scale = np.where(blind, 1.0, scale)
    _, singular, right = np.linalg.svd(augmented / scale, full_matrices=False)
    seen = singular > 1e-7 * max(float(singular.max(initial=0.0)), 1e-300)
    root = (right[seen].T / singular[seen]) / scale[:, None]
    unseen = right[~seen] / scale
    return root @ root.T, unseen
