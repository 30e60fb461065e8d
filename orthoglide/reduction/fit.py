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
from orthoglide.reduction.deviations import Dials, Indices, PredictedReadings, predicted
from orthoglide.reduction.kinematics import NOMINAL

RANK_TOLERANCE = 1e-9
"""Directions seen less than this (relative, columns scaled) are left where they started."""

TOLERANCE = 1e-13
"""Metres: a step no longer than this is the last."""

LONGEST_STEP = 5e-3
"""Metres: along weak directions a longer one can end in a minimum far from any machine."""

_MAX_STEPS = 60


@dataclass(frozen=True)
class ReadingFit:
    """Result of ``fit_readings``."""

    values: Array  # parameters (P,), metres; those held keep their start value
    offsets_and_lengths: Array  # offsets and lengths of each campaign (G, 6), metres
    nuisance: Array  # z (k,)
    readings: Array  # fitted readings s f + U z (N,), metres
    residuals: Array  # readings minus fitted (N,), metres
    cost: float  # the objective, dimensionless
    covariance: Array  # of the values at the given sigmas (P, P), square metres; zero where held
    rank: int  # how many directions of the free parameters the data and priors determine
    converged: bool  # whether the last step stayed below the tolerance
    iterations: int  # steps taken


_CampaignMaps = tuple[tuple[slice | Indices, Array], ...]


@dataclass(frozen=True)
class _State:
    """One x: readings, whitened residual without the nuisances' share, and the objective."""

    x: Array
    values: Array
    residual: Array
    cost: float
    observed: PredictedReadings


@dataclass(frozen=True)
class _Problem:
    """The objective, its nuisances projected out; every campaign has a map to its six parameters.

    ``basis`` spans the whitened nuisances with their priors, ``inverse`` is their pseudoinverse.
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
        """Readings' rows ``(N, ...)``, padded by the nuisances' priors, without U's share."""
        padded = np.zeros((len(self.basis), *rows.shape[1:]))
        padded[: len(rows)] = rows
        return np.asarray(padded - self.basis @ (self.basis.T @ padded))

    def evaluate(self, x: Array) -> _State:
        six = np.empty((len(self.weight), 6))
        for rows, six_from_x in self.campaign_maps:
            six[rows] = six_from_x @ x
        if self.nominal is None:
            seen = predicted(self.dials, six, self.length)
            values = seen.values
        else:
            seen = self.nominal
            values = seen.values + np.sum(seen.gradient * six, axis=-1)
        residual = self.project((self.target - values) * self.weight)
        cost = float(residual @ residual + np.sum((x * self.prior) ** 2))
        return _State(x, values, residual, cost, seen)

    def jacobian(self, state: _State) -> Array:
        """Augmented rows: readings, nuisances' priors, parameters' priors; free columns."""
        gradient = state.observed.gradient * self.weight[:, None]
        columns = np.empty((len(self.weight), len(self.free)))
        for rows, six_from_x in self.campaign_maps:
            columns[rows] = gradient[rows] @ six_from_x[:, self.free]
        return np.concatenate([self.project(columns), np.diag(self.prior)[:, self.free]])

    def curvature(self, state: _State) -> Array:
        """Second derivatives of the model, weighted by the residual; free parameters."""
        total = np.zeros((len(self.free), len(self.free)))
        if self.nominal is not None:
            return total
        bend = state.observed.curvature(state.residual[: len(self.weight)] * self.weight)
        for rows, six_from_x in self.campaign_maps:
            columns = six_from_x[:, self.free]
            total += columns.T @ bend[rows].sum(axis=0) @ columns
        return total

    def step(self, state: _State) -> tuple[Array, float, Array]:
        """Newton step of the free parameters, its gain, and the map from whitened coordinates."""
        left, unwhiten = _factor(self.jacobian(state))
        slope = left.T @ np.concatenate([state.residual, -state.x * self.prior])
        bend = unwhiten.T @ self.curvature(state) @ unwhiten
        values, vectors = np.linalg.eigh(np.eye(len(slope)) - (bend + bend.T) / 2)
        # Modulus and floor keep every step a descent where the curvature outweighs the readings.
        whitened = vectors @ ((vectors.T @ slope) / np.maximum(np.abs(values), 0.01))
        return unwhiten @ whitened, float(slope @ whitened), unwhiten

    def search(self, state: _State, step: Array, gain: float) -> _State | None:
        """Halve the step until the objective falls; None where it never does."""
        # Rounding of carriages and readings moves the objective so much: no fall shows below it.
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
        """Where Newton's method ends, its last map, whether it converged and after how many."""
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
        """The result, with the nuisances and the covariance, as the dials count."""
        state, unwhiten, converged, iterations = self.solve(start)
        left = self.target - state.values
        z = self.inverse[:, : len(left)] @ (left * self.weight)
        left = signs * (left - self.columns @ z)
        covariance = np.zeros((len(start), len(start)))
        covariance[np.ix_(self.free, self.free)] = unwhiten @ unwhiten.T
        six = np.array([six_from_x @ state.x for _, six_from_x in self.campaign_maps])
        return ReadingFit(
            state.x, six, z, signs * self.target - left, left, state.cost, covariance,
            unwhiten.shape[1], converged, iterations,
        )  # fmt: skip


def _factor(columns: Array, tolerance: float = RANK_TOLERANCE) -> tuple[Array, Array]:
    """Orthonormal left vectors of the directions seen, and the map from these to the factors."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    left, singular, right = np.linalg.svd(columns / scale, full_matrices=False)
    seen = singular > tolerance * max(singular.max(initial=0.0), 1e-300)
    return left[:, seen], (right[seen].T / singular[seen]) / scale[:, None]


def _positive(value: ArrayLike, shape: int, name: str) -> Array:
    array = np.broadcast_to(np.asarray(value, dtype=float), (shape,))
    if not np.all(array > 0):
        raise InputError(f"{name} must be positive standard deviations, in metres")
    return array


def _campaign_maps(maps: ArrayLike | None, group: ArrayLike | None, count: int) -> _CampaignMaps:
    """Each campaign's readings and its map ``(6, P)``."""
    found = np.eye(6)[None] if maps is None else np.asarray(maps, dtype=float)
    groups = np.zeros(count, np.intp) if group is None else np.asarray(group, dtype=np.intp)
    if found.ndim != 3 or found.shape[1] != 6 or groups.shape != (count,):
        raise InputError("maps has the shape (G, 6, P) and group one campaign for every reading")
    if np.any((groups < 0) | (groups >= len(found))):
        raise InputError("group runs from 0 to G - 1, a campaign for every map")
    if len(found) == 1:
        return ((slice(None), found[0]),)
    return tuple((np.flatnonzero(groups == k), one) for k, one in enumerate(found))


def _check_measured(
    measured: ArrayLike, sigma: ArrayLike, nuisance: ArrayLike | None, count: int
) -> tuple[Array, Array, Array]:
    """Readings, their weights and the columns U, checked."""
    readings = np.asarray(measured, dtype=float)
    if readings.shape != (count,) or not np.isfinite(readings).all():
        raise InputError("measured has one finite reading for every command, in metres")
    columns = np.empty((count, 0)) if nuisance is None else np.asarray(nuisance, dtype=float)
    if columns.ndim != 2 or len(columns) != count:
        raise InputError("nuisance has the shape (N, k), one row for every reading")
    return readings, 1.0 / _positive(sigma, count, "sigma"), columns


def _basis(whitened: Array, precision: ArrayLike) -> tuple[Array, Array]:
    """Orthonormal columns of the nuisances with their priors, and the pseudoinverse."""
    known = np.broadcast_to(np.asarray(precision, dtype=float), whitened.shape[1:])
    left, unwhiten = _factor(np.concatenate([whitened, np.diag(np.sqrt(known))]), 1e-12)
    return left, unwhiten @ left.T


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
    """Least ``|(y - s f(S x) - U z) / sigma|^2 + |x / prior_sd|^2 + sum(precision z^2)``.

    Args:
        commands: ``(N, 3)``, metres; the dials as for :func:`observe`.
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
    counted = np.broadcast_to(np.asarray(signs, dtype=float), dials.legs.shape)
    y, weight, columns = _check_measured(measured, sigma, nuisance, len(counted))
    columns = counted[:, None] * columns  # s y = f + s U z: the dials' signs are gone
    parts = _campaign_maps(maps, group, len(counted))
    start = np.array(np.broadcast_to(np.asarray(x0, dtype=float), parts[0][1].shape[1:]))
    prior = 1.0 / _positive(prior_sd, len(start), "prior_sd")
    moving = np.flatnonzero(np.broadcast_to(np.asarray(free, dtype=bool), start.shape))
    nominal = predicted(dials, np.zeros(6), geometry.L) if linear else None
    problem = _Problem(
        dials, geometry.L, nominal, parts, counted * y, weight, prior, moving, columns,
        *_basis(columns * weight[:, None], precision),
    )  # fmt: skip
    return problem.fit(start, counted)
