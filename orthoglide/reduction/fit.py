"""The reduction's own nonlinear least squares of a measuring campaign.

Minimises ``sum(((y - s f(S x) - U z) / sigma)^2) + sum((x / prior_sd)^2) + sum(precision z^2)``
over parameters x and nuisances z. The nuisances are linear, so they are projected out once; on
x runs Newton's method in the coordinates of the Jacobian's singular vectors, where the second
derivatives are a small correction: Gauss-Newton alone need not converge along the weak
directions (offset plus length), where lack of fit outweighs the readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError, NumericsError, UnreachableError
from orthoglide.geometry import Array, Geometry
from orthoglide.reduction.deviations import Indices, Observed, Readings, observe
from orthoglide.reduction.kinematics import NOMINAL

RANK_TOLERANCE = 1e-9
"""Directions seen less than this (relative, columns scaled) are left where they started."""

LONGEST_STEP = 5e-3
"""Metres: along weak directions a longer one can end in a minimum far from any machine."""


@dataclass(frozen=True)
class ReadingFit:
    """Result of ``fit_readings``.

    Attributes:
        values: parameters ``(P,)``, metres; those held keep their start value.
        six: offsets and lengths of each campaign ``(G, 6)``, metres.
        nuisance: z ``(k,)``.
        readings: fitted readings s f + U z ``(N,)``, metres.
        residuals: readings minus fitted ``(N,)``, metres.
        cost: the objective, dimensionless.
        covariance: of the values at the given sigmas ``(P, P)``, square metres; zero where held.
        rank: how many directions of the free parameters the data and priors determine.
        converged: whether the last step stayed below the tolerance.
        iterations: steps taken.
    """

    values: Array
    six: Array
    nuisance: Array
    readings: Array
    residuals: Array
    cost: float
    covariance: Array
    rank: int
    converged: bool
    iterations: int


@dataclass(frozen=True)
class _State:
    """The problem at one x: whitened residual without the nuisances' share, and the objective."""

    x: Array
    model: Array
    residual: Array
    cost: float
    observed: Observed


@dataclass(frozen=True)
class _Problem:
    dials: Readings
    length: float
    target: Array
    weight: Array
    signs: Array
    free: Indices
    prior: Array
    group: Indices
    maps: Array
    basis: Array
    nominal: Observed | None

    def project(self, rows: Array) -> Array:
        """Readings' rows ``(N, ...)``, padded by the nuisances' priors, without U's share."""
        padded = np.zeros((len(self.basis), *rows.shape[1:]))
        padded[: len(rows)] = rows
        return np.asarray(padded - self.basis @ (self.basis.T @ padded))

    def six(self, x: Array) -> Array:
        return x @ self.maps[0].T if len(self.maps) == 1 else (self.maps @ x)[self.group]

    def at(self, x: Array) -> _State:
        six = self.six(x)
        if self.nominal is None:
            observed = observe(self.dials, six, self.length)
            values = observed.values
        else:
            observed = self.nominal
            values = observed.values + np.sum(observed.gradient * six, axis=-1)
        model = self.signs * values
        residual = self.project((self.target - model) * self.weight)
        cost = float(residual @ residual + np.sum((x * self.prior) ** 2))
        return _State(x, model, residual, cost, observed)

    def jacobian(self, state: _State) -> Array:
        """Augmented rows: readings, nuisances' priors, parameters' priors; free columns."""
        factor = (self.signs * self.weight)[:, None]
        maps = self.maps[:, :, self.free]
        gradient = state.observed.gradient * factor
        if len(maps) == 1:
            columns = gradient @ maps[0]
        else:
            columns = (gradient[:, None, :] @ maps[self.group])[:, 0, :]
        return np.concatenate([self.project(columns), np.diag(self.prior)[:, self.free]])

    def curvature(self, state: _State) -> Array:
        """Second derivatives of the model, weighted by the residual; free parameters."""
        count = len(self.free)
        total = np.zeros((count, count))
        if self.nominal is not None:
            return total
        weights = state.residual[: len(self.weight)] * self.weight * self.signs
        rows = state.observed.curvature(weights)
        for index, six_from_x in enumerate(self.maps[:, :, self.free]):
            block = rows if len(self.maps) == 1 else rows[self.group == index]
            total += six_from_x.T @ block.sum(axis=0) @ six_from_x
        return total


def _factor(jacobian: Array) -> tuple[Array, Array]:
    """Orthonormal left vectors, and the map to free parameters, of the directions seen."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0] = 1.0
    left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    seen = singular > RANK_TOLERANCE * max(singular.max(initial=0.0), 1e-300)
    return left[:, seen], (right[seen].T / singular[seen]) / scale[:, None]


def _step(problem: _Problem, state: _State) -> tuple[Array, Array, Array]:
    """Newton step on the free parameters, its gain, and the map from whitened coordinates."""
    jacobian = problem.jacobian(state)
    left, unwhiten = _factor(jacobian)
    slope = left.T @ np.concatenate([state.residual, -state.x * problem.prior])
    bend = unwhiten.T @ problem.curvature(state) @ unwhiten
    values, vectors = np.linalg.eigh(np.eye(len(slope)) - (bend + bend.T) / 2)
    # Modulus and floor keep every step a descent where the curvature outweighs the readings.
    whitened = vectors @ ((vectors.T @ slope) / np.maximum(np.abs(values), 0.01))
    return unwhiten @ whitened, slope @ whitened, unwhiten


def _search(problem: _Problem, state: _State, step: Array, gain: float) -> _State | None:
    """Halve the step until the objective falls; None where it never does."""
    # Rounding of carriages and readings moves the objective by this much: no fall shows below it.
    size = problem.length + np.abs(problem.target) + np.abs(state.model)
    slack = 4e-16 * (float(np.linalg.norm(size * problem.weight)) * state.cost**0.5 + state.cost)
    for halving in range(40):
        trial = state.x.copy()
        trial[problem.free] += step * 0.5**halving
        try:
            moved = problem.at(trial)
        except (UnreachableError, NumericsError):
            continue
        if moved.cost <= state.cost - 1e-4 * 0.5**halving * gain + slack:
            return moved
    return None


def _basis(nuisance: Array, weight: Array, precision: Array) -> tuple[Array, Array]:
    """Orthonormal columns of the whitened nuisances with their priors, and the pseudoinverse."""
    augmented = np.concatenate([nuisance * weight[:, None], np.diag(np.sqrt(precision))])
    if augmented.shape[1] == 0:
        return augmented, augmented.T
    scale = np.linalg.norm(augmented, axis=0)
    scale[scale == 0] = 1.0
    left, singular, right = np.linalg.svd(augmented / scale, full_matrices=False)
    seen = singular > 1e-12 * singular.max()
    inverse = (right[seen].T / singular[seen]) @ left[:, seen].T / scale[:, None]
    return left[:, seen], inverse


def _positive(value: ArrayLike, shape: int, name: str) -> Array:
    array = np.broadcast_to(np.asarray(value, dtype=float), (shape,))
    if not np.all(array > 0):
        raise InputError(f"{name} must be positive standard deviations, in metres")
    return array


def fit_readings(
    commands: ArrayLike,
    legs: ArrayLike,
    axes: ArrayLike,
    gauges: ArrayLike,
    measured: ArrayLike,
    sigma: ArrayLike,
    *,
    signs: ArrayLike = 1.0,
    free: ArrayLike = True,
    prior_sd: ArrayLike = np.inf,
    nuisance: ArrayLike | None = None,
    precision: ArrayLike = 0.0,
    x0: ArrayLike = 0.0,
    group: ArrayLike | None = None,
    maps: ArrayLike | None = None,
    geometry: Geometry = NOMINAL,
    linear: bool = False,
    tolerance: float = 1e-13,
    max_iterations: int = 60,
) -> ReadingFit:
    """Least ``|(y - s f(S x) - U z) / sigma|^2 + |x / prior_sd|^2 + sum(precision z^2)``.

    Args:
        commands: ``(N, 3)``, metres.
        legs: legs touched ``(N,)``: 0, 1 or 2.
        axes: base axes the dials read along ``(N,)``.
        gauges: places along the legs' own axes ``(N,)``, metres.
        measured: readings y ``(N,)``, metres.
        sigma: standard deviations of the readings ``(N,)`` or a scalar, metres.
        signs: +1, or -1 where a dial counts the other way, ``(N,)``.
        free: which parameters may move ``(P,)``, booleans.
        prior_sd: standard deviations of the parameters about zero ``(P,)``, metres; inf for none.
        nuisance: columns U ``(N, k)``; a setup's datum is a column of ones on its rows.
        precision: of the nuisances about zero ``(k,)``; 0 for a datum.
        x0: where to start ``(P,)``, metres; parameters not free stay there.
        group: campaign of each reading ``(N,)``, 0 to G - 1.
        maps: offsets and lengths of each campaign from the parameters ``(G, 6, P)``; default: one
            campaign, P = 6.
        geometry: nominal dimensions.
        linear: fit the machine linearised at the nominal instead: system (11) for any readings.
        tolerance: largest change of a parameter at which to stop, metres.
        max_iterations: most steps to take.

    Returns:
        The fit; look at ``converged`` and ``rank``.

    Raises:
        InputError: for columns that do not fit together.
        UnreachableError: where the legs do not meet at the start.
        NumericsError: where the start is singular.
    """
    dials = Readings.checked(commands, legs, axes, gauges)
    count = len(dials.legs)
    selector = np.eye(6)[None] if maps is None else np.asarray(maps, dtype=float)
    groups = np.zeros(count, np.intp) if group is None else np.asarray(group, dtype=np.intp)
    if selector.ndim != 3 or selector.shape[1] != 6 or groups.shape != (count,):
        raise InputError("maps has the shape (G, 6, P) and group one campaign for every reading")
    if np.any((groups < 0) | (groups >= len(selector))):
        raise InputError("group runs from 0 to G - 1, a campaign for every map")
    total = selector.shape[2]
    weight = 1.0 / _positive(sigma, count, "sigma")
    columns = np.empty((count, 0)) if nuisance is None else np.asarray(nuisance, dtype=float)
    if columns.ndim != 2 or len(columns) != count:
        raise InputError("nuisance has the shape (N, k), one row for every reading")
    target = np.asarray(measured, dtype=float)
    if target.shape != (count,) or not np.isfinite(target).all():
        raise InputError("measured has one finite reading for every command, in metres")
    known = np.broadcast_to(np.asarray(precision, dtype=float), columns.shape[1:])
    basis, inverse = _basis(columns, weight, known)
    problem = _Problem(
        dials=dials,
        length=geometry.L,
        target=target,
        weight=weight,
        signs=np.broadcast_to(np.asarray(signs, dtype=float), (count,)),
        free=np.flatnonzero(np.broadcast_to(np.asarray(free, dtype=bool), (total,))),
        prior=1.0 / _positive(prior_sd, total, "prior_sd"),
        group=groups,
        maps=selector,
        basis=basis,
        nominal=observe(dials, np.zeros(6), geometry.L) if linear else None,
    )
    start = np.array(np.broadcast_to(np.asarray(x0, dtype=float), (total,)))
    state, unwhiten, converged, iterations = _iterate(problem, start, tolerance, max_iterations)
    whitened = np.zeros(len(basis))
    whitened[:count] = (target - state.model) * weight
    z = inverse @ whitened
    fitted = state.model + columns @ z
    covariance = np.zeros((total, total))
    covariance[np.ix_(problem.free, problem.free)] = unwhiten @ unwhiten.T
    return ReadingFit(
        values=state.x,
        six=selector @ state.x,
        nuisance=z,
        readings=fitted,
        residuals=target - fitted,
        cost=state.cost,
        covariance=covariance,
        rank=unwhiten.shape[1],
        converged=converged,
        iterations=iterations,
    )


def _iterate(
    problem: _Problem, start: Array, tolerance: float, most: int
) -> tuple[_State, Array, bool, int]:
    state = problem.at(start)
    iteration = 0
    while True:
        step, gain, unwhiten = _step(problem, state)
        small = float(np.max(np.abs(step), initial=0.0)) <= tolerance
        if small or iteration == most:
            return state, unwhiten, small, iteration
        reach = min(1.0, LONGEST_STEP / float(np.max(np.abs(step))))
        moved = _search(problem, state, reach * step, reach * float(gain))
        if moved is None:
            return state, unwhiten, False, iteration
        state = moved
        iteration += 1
