"""Nonlinear least squares of a measuring campaign on the reduction.

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
from orthoglide.reduction.deviations import Dials, Indices, PredictedReadings, predicted
from orthoglide.reduction.kinematics import NOMINAL

RANK_TOLERANCE = 1e-9
"""Directions with smaller singular values (relative, columns scaled) keep their start values."""

TOLERANCE = 1e-13
"""Metres: the iteration ends with a step that is no longer."""

LONGEST_STEP = 5e-3
"""Metres: along weak directions longer steps can end in a minimum far from any machine."""

_MAX_STEPS = 60


@dataclass(frozen=True)
class ReadingFit:
    """Result of ``fit_readings``."""

    values: Array  # parameters (P,), metres; fixed ones keep their start value
    nuisance: Array  # z (k,)
    readings: Array  # fitted readings s f + U z (N,), metres
    residuals: Array  # readings minus fitted (N,), metres
    cost: float  # the objective, dimensionless
    covariance: Array  # of the values at the given sigmas (P, P), square metres; zero where fixed
    rank: int  # number of directions of the free parameters that data and priors determine
    converged: bool  # whether the last step stayed below the tolerance
    iterations: int  # steps taken


_CampaignMaps = tuple[tuple[slice | Indices, Array], ...]


@dataclass(frozen=True)
class _State:
    """An iterate x: readings, whitened residual without the nuisances' share, and objective."""

    x: Array
    values: Array
    residual: Array
    cost: float
    observed: PredictedReadings


@dataclass(frozen=True)
class _Problem:
    """The objective without nuisances, which are projected out.

    Every campaign has a map to its six parameters. ``basis`` spans the whitened nuisances with
    their priors, ``inverse`` is their pseudoinverse.
    """

    dials: Dials
    length: float
    nominal: PredictedReadings | None
    campaign_maps: _CampaignMaps
    target: Array
    weight: Array
    prior: Array
    free: Indices
    columns: Array
    basis: Array
    inverse: Array

    def project(self, rows: Array) -> Array:
        """Return rows ``(N, ...)``, padded for the nuisances' priors, without the share of U."""
        padded = np.zeros((len(self.basis), *rows.shape[1:]))
        padded[: len(rows)] = rows
        return np.asarray(padded - self.basis @ (self.basis.T @ padded))

    def evaluate(self, x: Array) -> _State:
        six = np.empty((len(self.weight), 6))  # offsets and lengths of each reading
        for rows, six_from_x in self.campaign_maps:
            six[rows] = six_from_x @ x
        if self.nominal is None:
            predictions = predicted(self.dials, six, self.length)
            values = predictions.values
        else:
            predictions = self.nominal
            values = predictions.values + np.sum(predictions.gradient * six, axis=-1)
        residual = self.project((self.target - values) * self.weight)
        cost = float(residual @ residual + np.sum((x * self.prior) ** 2))
        return _State(x, values, residual, cost, predictions)

    def jacobian(self, state: _State) -> Array:
        """Return rows of readings, nuisances' priors and parameters' priors; free columns."""
        gradient = state.observed.gradient * self.weight[:, None]
        columns = np.empty((len(self.weight), len(self.free)))
        for rows, six_from_x in self.campaign_maps:
            columns[rows] = gradient[rows] @ six_from_x[:, self.free]
        return np.concatenate([self.project(columns), np.diag(self.prior)[:, self.free]])

    def curvature(self, state: _State) -> Array:
        """Return second derivatives by free parameters, weighted by the residual."""
        total = np.zeros((len(self.free), len(self.free)))
        if self.nominal is not None:
            return total
        weights = state.residual[: len(self.weight)] * self.weight
        reading_curvature = state.observed.curvature(weights)
        for rows, six_from_x in self.campaign_maps:
            columns = six_from_x[:, self.free]
            total += columns.T @ reading_curvature[rows].sum(axis=0) @ columns
        return total

    def step(self, state: _State) -> tuple[Array, float, Array]:
        """Return Newton's step of the free parameters, its gain, and the unwhitening map."""
        basis, unwhiten = _factor(self.jacobian(state))
        gradient = basis.T @ np.concatenate([state.residual, -state.x * self.prior])
        curvature = unwhiten.T @ self.curvature(state) @ unwhiten
        values, vectors = np.linalg.eigh(np.eye(len(gradient)) - (curvature + curvature.T) / 2)
        # Modulus and floor keep every step a descent where the curvature outweighs the readings.
        whitened = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), 0.01))
        return unwhiten @ whitened, float(gradient @ whitened), unwhiten

    def search(self, state: _State, step: Array, gain: float) -> _State | None:
        """Return the state after halving the step until the objective falls; else ``None``."""
        # Rounding of carriages and readings changes the objective by this much.
        size = self.length + np.abs(self.target) + np.abs(state.values)
        slack = 4e-16 * (float(np.linalg.norm(size * self.weight)) * state.cost**0.5 + state.cost)
        for share in 0.5 ** np.arange(40):
            trial = state.x.copy()
            trial[self.free] += step * share
            try:
                moved = self.evaluate(trial)
            except (UnreachableError, NumericsError):
                continue
            if moved.cost <= state.cost - 1e-4 * share * gain + slack:
                return moved
        return None

    def solve(self, start: Array) -> tuple[_State, Array, bool, int]:
        """Return the final state, the unwhitening map, convergence and number of iterations."""
        state, iterations = self.evaluate(start), 0
        while True:
            step, gain, unwhiten = self.step(state)
            longest = float(np.max(np.abs(step), initial=0.0))
            if longest <= TOLERANCE or iterations == _MAX_STEPS:
                return state, unwhiten, longest <= TOLERANCE, iterations
            reach = min(1.0, LONGEST_STEP / longest)
            moved = self.search(state, reach * step, reach * gain)
            if moved is None:
                return state, unwhiten, False, iterations
            state, iterations = moved, iterations + 1

    def fit(self, start: Array, signs: Array) -> ReadingFit:
        """Return the result, with nuisances and covariance, in the dials' signs."""
        state, unwhiten, converged, iterations = self.solve(start)
        residual = self.target - state.values
        z = self.inverse[:, : len(residual)] @ (residual * self.weight)
        residual = signs * (residual - self.columns @ z)
        covariance = np.zeros((len(start), len(start)))
        covariance[np.ix_(self.free, self.free)] = unwhiten @ unwhiten.T
        return ReadingFit(
            state.x, z, signs * self.target - residual, residual, state.cost, covariance,
            unwhiten.shape[1], converged, iterations,
        )  # fmt: skip


def _factor(columns: Array, tolerance: float = RANK_TOLERANCE) -> tuple[Array, Array]:
    """Return orthonormal left vectors of the determined directions, and the map to the columns."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    left, singular, right = np.linalg.svd(columns / scale, full_matrices=False)
    determined = singular > tolerance * max(singular.max(initial=0.0), 1e-300)
    return left[:, determined], (right[determined].T / singular[determined]) / scale[:, None]


def _positive(value: ArrayLike, shape: int, name: str) -> Array:
    array = np.broadcast_to(np.asarray(value, dtype=float), (shape,))
    if not np.all(array > 0):
        raise InputError(f"{name} must be positive standard deviations, in metres")
    return array


def _campaign_maps(maps: ArrayLike | None, group: ArrayLike | None, count: int) -> _CampaignMaps:
    """Return the readings of each campaign and its map ``(6, P)``."""
    campaign_maps = np.eye(6)[None] if maps is None else np.asarray(maps, dtype=float)
    campaigns = np.zeros(count, np.intp) if group is None else np.asarray(group, dtype=np.intp)
    if campaign_maps.ndim != 3 or campaign_maps.shape[1] != 6 or campaigns.shape != (count,):
        raise InputError("maps has the shape (G, 6, P) and group one campaign for every reading")
    if np.any((campaigns < 0) | (campaigns >= len(campaign_maps))):
        raise InputError("group runs from 0 to G - 1, a campaign for every map")
    if len(campaign_maps) == 1:
        return ((slice(None), campaign_maps[0]),)
    return tuple((np.flatnonzero(campaigns == k), m) for k, m in enumerate(campaign_maps))


def _check_measured(
    measured: ArrayLike, sigma: ArrayLike, nuisance: ArrayLike | None, count: int
) -> tuple[Array, Array, Array]:
    """Return the readings, their weights and the columns U, checked."""
    readings = np.asarray(measured, dtype=float)
    if readings.shape != (count,) or not np.isfinite(readings).all():
        raise InputError("measured has one finite reading for every command, in metres")
    columns = np.empty((count, 0)) if nuisance is None else np.asarray(nuisance, dtype=float)
    if columns.ndim != 2 or len(columns) != count:
        raise InputError("nuisance has the shape (N, k), one row for every reading")
    return readings, 1.0 / _positive(sigma, count, "sigma"), columns


def _basis(whitened: Array, precision: ArrayLike) -> tuple[Array, Array]:
    """Return orthonormal columns of the nuisances with their priors, and the pseudoinverse."""
    precisions = np.broadcast_to(np.asarray(precision, dtype=float), whitened.shape[1:])
    basis, unwhiten = _factor(np.concatenate([whitened, np.diag(np.sqrt(precisions))]), 1e-12)
    return basis, unwhiten @ basis.T


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
) -> ReadingFit:
    """Minimise ``|(y - s f(S x) - U z) / sigma|^2 + |x / prior_sd|^2 + sum(precision z^2)``.

    Args:
        commands: ``(N, 3)``, metres; the dials as for :func:`predict_readings`.
        legs: legs touched ``(N,)``.
        axes: base axes the dials read along ``(N,)``.
        gauges: places along the legs' own axes ``(N,)``, metres.
        measured: readings y ``(N,)``, metres.
        sigma: standard deviations of the readings ``(N,)`` or a scalar, metres.
        signs: +1, or -1 where a dial counts the other way, ``(N,)``.
        free: which parameters may move ``(P,)``, booleans; the others stay at x0.
        prior_sd: standard deviations of the parameters about zero ``(P,)``, metres.
        nuisance: columns U ``(N, k)``; a setup's datum is a column of ones on its rows.
        precision: of the nuisances about zero ``(k,)``; 0 for a datum.
        x0: where to start ``(P,)``, metres.
        group: campaign of each reading ``(N,)``, 0 to G - 1.
        maps: offsets and lengths of each campaign from the parameters ``(G, 6, P)``; default: one
            campaign, P = 6.
        geometry: nominal dimensions.
        linear: fit the machine linearised at the nominal: system (11) for any readings.

    Raises:
        InputError: for columns that do not fit together, or legs that do not meet at the start.
        NumericsError: where the start is singular.
    """
    dials = Dials.checked(commands, legs, axes, gauges)
    dial_signs = np.broadcast_to(np.asarray(signs, dtype=float), dials.legs.shape)
    readings, weight, columns = _check_measured(measured, sigma, nuisance, len(dial_signs))
    columns = dial_signs[:, None] * columns  # s y = f + s U z: the dials' signs are gone
    campaigns = _campaign_maps(maps, group, len(dial_signs))
    start = np.array(np.broadcast_to(np.asarray(x0, dtype=float), campaigns[0][1].shape[1:]))
    prior = 1.0 / _positive(prior_sd, len(start), "prior_sd")
    free_positions = np.flatnonzero(np.broadcast_to(np.asarray(free, dtype=bool), start.shape))
    nominal = predicted(dials, np.zeros(6), geometry.L) if linear else None
    problem = _Problem(
        dials, geometry.L, nominal, campaigns, dial_signs * readings, weight, prior,
        free_positions, columns, *_basis(columns * weight[:, None], precision),
    )  # fmt: skip
    return problem.fit(start, dial_signs)
