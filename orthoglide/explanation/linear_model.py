"""The linear model of the readings, and the grid of background scales."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product, takewhile
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular, svd

from orthoglide.geometry import Array

BACKGROUND_SCALES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Scales of the inactive effects of the catalogue, in tolerances."""

FREE_FORM_PRIOR = 0.1
"""Prior probability of a free-form error, relative to a cause of the catalogue: known faults
of machines are more frequent. Several forms of an error at one place share it equally."""

EXPECTED_CAUSES = 3.0
"""Prior mean number of active causes (Poisson): who measures a machine has a reason to."""

_UNSEEN = 1e-6
"""Sigmas: a direction to which the largest slab adds less counts as invisible."""

_LEAST_DIRECTION = 1e-2
"""Sigmas: directions of the readings that all coefficients together move by less are left out."""

TWENTY_TO_ONE = 3.0
"""Log odds that decide a comparison, and that a rare hypothesis has against it beforehand: those of
a 95 % credible set."""

RARE_LOG_PRIOR = -TWENTY_TO_ONE
"""Log prior weight of a background beyond all tolerances, and of noise larger than repeats show."""

FREE_FORM_SCALES = (0.003, 0.03, 0.1, 0.3)
"""Scales of the inactive free functions, in their units."""

NOISE_SCALES = (1.0, 1.7, 3.0, 5.0, 9.0, 16.0, 30.0)
"""Scales of noise beyond the declared one: standard deviations of an independent error of each
station, in sigmas of a reading. Steps of 1.7 lose at most 0.1 of ln Z on 50 readings."""

_BACKGROUND_SCALES_WITH_NOISE = (0.003, 0.1, 0.3, 1.0, 3.0)
"""Scales of the catalogue that are combined with larger noise, under which small ones are equal."""

NEGLIGIBLE_LOG_WEIGHT = 40.0
"""Log weight below the best one from which a weight is lost in rounding: exp(-40) is 4e-18."""

SOUND_BACKGROUND = 0.03
"""Tolerances: largest background scale of a machine that counts as sound."""

SLAB_SCALES = (0.3, 1.0, 3.0, 10.0)
"""Scales tau of active groups, in tolerances or units of the group."""


@dataclass(frozen=True, eq=False, repr=False)
class Group:
    """Coefficients that are active or inactive together."""

    name: str  # of what it stands for
    coefficients: NDArray[np.intp]  # indices of the coefficients that it moves (q,)
    weights: Array  # from the group's k parameters to those coefficients (q, k)
    free_form: bool  # whether it is a free function
    relative_prior: float = 1.0  # prior probability, relative to a single cause of the catalogue
    unit: float = 1.0  # standard deviation of its slab at tau one, tolerances
    # prior mean number of a data fault or a change; None for errors of the machine, whose prior
    # follows from `relative_prior`
    expected: float | None = None
    of_data: bool = False  # whether it is a data fault
    # what it stands for: a `Candidate`, `FreeForm` or `FaultColumns`; none of a change
    source: Any = None

    @property
    def size(self) -> int:
        """Number of the group's parameters."""
        return self.weights.shape[1]


class StationRemainder(NamedTuple):
    """Residual of station means orthogonal to all columns; none where no direction was dropped."""

    chi2: float = 0.0
    dof: float = 0.0  # degrees of freedom
    visits: float = 1.0  # per station


NO_REMAINDER = StationRemainder()


@dataclass(frozen=True, eq=False, repr=False)
class LinearModel:
    """Whitened readings as a linear model of all coefficients."""

    columns: Array  # whitened, nuisances projected out, by coefficient in tolerances (m, C)
    residual: Array  # readings less the prediction at zero, whitened (m,)
    fixed_sd: Array  # prior sd of coefficients without background scale (C,); else nan
    free_form: NDArray[np.bool_]  # which belong to free functions (C,)
    # mask of residual shapes of plates (C,): they explain readings, but are not reported
    plate_shapes: NDArray[np.bool_]
    groups: tuple[Group, ...]  # that may be active
    # an error of one sigma at each station (m, s), or another root of the same covariance (m, m)
    stations: Array
    # scales that the effects' background may have, in tolerances
    background_scales: tuple[float, ...] = BACKGROUND_SCALES
    slab_scales: tuple[float, ...] = SLAB_SCALES  # scales of active groups
    # scale beyond which a background is unlikely, and the log of its prior weight
    wide_background: tuple[float, float] = (max(BACKGROUND_SCALES), 0.0)
    noise_weight: float = RARE_LOG_PRIOR  # log of the prior weight of noise larger than declared
    # power of its ratio to the declared noise with which that weight falls: 1 where no repeats show
    # the noise, and in the search of changes
    noise_decay: float = 0.0
    station_remainder: StationRemainder = NO_REMAINDER
    max_active: int = 6  # active groups in one state: 9 changed no result

    def spike(self, background_scale: float, free_form_scale: float) -> Array:
        """Return the prior variance of each inactive coefficient ``(C,)``."""
        background = np.where(self.free_form, free_form_scale, background_scale)
        return np.where(np.isfinite(self.fixed_sd), self.fixed_sd, background) ** 2

    @property
    def of_background(self) -> NDArray[np.bool_]:
        """Mask of the coefficients whose prior is the background ``(C,)``."""
        return ~self.free_form & ~np.isfinite(self.fixed_sd)

    @cached_property
    def prior_covariances(self) -> tuple[Array, Array, Array, Array]:
        """Prior covariances of the readings at scale one, each ``(m, m)``.

        Of coefficients with a fixed prior, of free functions, of the background, and of station
        errors.
        """
        fixed, A = np.isfinite(self.fixed_sd), self.columns
        free, background = A[:, self.free_form & ~fixed], A[:, self.of_background]
        parts = A[:, fixed] * self.fixed_sd[fixed], free, background, self.stations
        of_fixed, of_free, of_background, of_stations = (columns @ columns.T for columns in parts)
        return of_fixed, of_free, of_background, of_stations

    @cached_property
    def group_columns(self) -> Array:
        """Visible columns of all groups side by side ``(m, K)``."""
        blocks = [np.zeros((len(self.columns), 0))]  # there may be no group
        for group, directions in zip(self.groups, self.visible_directions, strict=True):
            blocks.append(self.columns[:, group.coefficients] @ directions)
        return np.hstack(blocks)

    @cached_property
    def visible_directions(self) -> tuple[Array, ...]:
        """Combinations of coefficients of each group that the readings can see ``(q, r)``.

        The slab is isotropic in the group's parameters, so any rotation of them is equivalent.
        """
        directions = []
        for group in self.groups:
            rotation = np.eye(1)
            if group.size > 1:
                signatures = group.unit * self.columns[:, group.coefficients] @ group.weights
                _, sizes, vectors = np.linalg.svd(signatures, full_matrices=False)
                rotation = vectors[: max(1, int((sizes * max(self.slab_scales) > _UNSEEN).sum()))].T
            directions.append(group.unit * group.weights @ rotation)
        return tuple(directions)


class Basis:
    """The linear model whitened by all but the background, in eigenvectors of the background.

    All background scales share these directions and differ in their weights only.

    Attributes:
        free_form_scale: scale of the inactive free functions.
        noise: sd of an independent error of each station, in sigmas of a reading.
        largest_log_z: log marginal likelihood, its prior weight counted, of readings that some
            groups explain completely, without background; with one, or with groups, it is less.
    """

    def __init__(self, linear: LinearModel, free_form_scale: float, noise: float) -> None:
        self.linear, self.free_form_scale, self.noise = linear, free_form_scale, noise
        fixed, free, _, stations = linear.prior_covariances
        cov = fixed + free_form_scale**2 * free + noise**2 * stations
        cov[np.diag_indices_from(cov)] += 1.0
        self._root = np.linalg.cholesky(cov)
        _, dof, visits = linear.station_remainder
        self.station_variance = 1 + noise**2 * visits
        self.largest_log_z = (
            linear.noise_weight * (noise > 0)
            - linear.noise_decay * float(np.log1p(noise**2)) / 2
            - dof * float(np.log(self.station_variance)) / 2
            - float(np.log(np.diag(self._root)).sum())
        )

    @cached_property
    def _whitened_background(self) -> tuple[Array, Array]:
        """Variance that a background of one tolerance adds to each direction ``(m,)``, and the
        matrix from rows of the linear model to whitened ones ``(m, m)``.

        The background has fewer coefficients than there are directions, so most have none of it.
        """
        background = self.linear.columns[:, self.linear.of_background]
        left, sizes = left_singular(solve_triangular(self._root, background, lower=True))
        directions, variance = qr(left)[0], np.zeros(len(left))
        directions[:, : len(sizes)], variance[: len(sizes)] = left, sizes**2
        return variance, solve_triangular(self._root, directions, lower=True, trans="T").T

    @property
    def background_variance(self) -> Array:
        """Variance that a background of one tolerance adds to each direction ``(m,)``."""
        return self._whitened_background[0]

    @property
    def whiten(self) -> Array:
        """Matrix from rows of the linear model to whitened ones ``(m, m)``."""
        return self._whitened_background[1]

    @cached_property
    def residual(self) -> Array:
        """Whitened residual ``(m,)``."""
        return np.asarray(self.whiten @ self.linear.residual)

    @cached_property
    def group_columns(self) -> Array:
        """Whitened columns of all groups, see :attr:`LinearModel.group_columns`."""
        return np.asarray(self.whiten @ self.linear.group_columns)

    @cached_property
    def columns(self) -> Array:
        """Whitened columns by coefficient ``(m, C)``."""
        return np.asarray(self.whiten @ self.linear.columns)


class Scale:
    """One point of the grid of scales: the linear model whitened by its background."""

    def __init__(self, basis: Basis, background_scale: float) -> None:
        self.basis, self.background_scale = basis, background_scale
        self.free_form_scale, self.noise = basis.free_form_scale, basis.noise
        self.spike = basis.linear.spike(background_scale, basis.free_form_scale)
        self.weight = 1 / np.sqrt(1 + background_scale**2 * basis.background_variance)
        # Larger noise than declared is rare only if repeats determine the noise.
        self.rare = (background_scale > 1) + (basis.noise > 0 and basis.linear.noise_weight < 0)
        widest_usual, weight = basis.linear.wide_background
        self.log_z = (
            basis.largest_log_z
            + RARE_LOG_PRIOR * (background_scale > 1)
            + weight * (background_scale > widest_usual)
            - 0.5 * basis.linear.station_remainder.chi2 / basis.station_variance
            - 0.5 * float(self.residual @ self.residual)
            + float(np.log(self.weight).sum())
        )

    @property
    def columns(self) -> Array:
        """Whitened columns by coefficient ``(m, C)``."""
        return self.basis.columns * self.weight[:, None]

    def products_with_columns(self, rows: Array) -> Array:
        """Return inner products of rows ``(..., m)`` with all columns ``(..., C)``."""
        return np.asarray(((rows * self.weight) @ self.basis.whiten) @ self.basis.linear.columns)

    @property
    def residual(self) -> Array:
        """Whitened residual ``(m,)``."""
        return self.basis.residual * self.weight

    def some_group_columns(self, at: NDArray[np.intp]) -> Array:
        """Return some of the whitened group columns ``(m, k)``."""
        return self.basis.group_columns[:, at] * self.weight[:, None]


def scale_grid(linear: LinearModel) -> tuple[Scale, ...]:
    """Return the grid of scales, without the larger noises that have no weight in any state."""
    declared_noise = [Basis(linear, free, 0.0) for free in FREE_FORM_SCALES]
    grid = [Scale(basis, s) for s, basis in product(linear.background_scales, declared_noise)]
    least = max(scale.log_z for scale in grid) - NEGLIGIBLE_LOG_WEIGHT
    larger_noise = (Basis(linear, FREE_FORM_SCALES[0], noise) for noise in NOISE_SCALES)
    possible = list(takewhile(lambda basis: basis.largest_log_z > least, larger_noise))
    fewer = [s for s in linear.background_scales if s in _BACKGROUND_SCALES_WITH_NOISE]
    return (*grid, *(Scale(basis, s) for s, basis in product(fewer, possible)))


def identity_group(
    name: str, indices: Sequence[int] | NDArray[np.intp], *, free_form: bool, **others: Any
) -> Group:
    """Return a group whose parameters are the coefficients themselves; ``others``: its fields."""
    coefficients = np.array(indices, dtype=np.intp)
    return Group(name, coefficients, np.eye(len(coefficients)), free_form, **others)


def drop_unseen_directions(linear: LinearModel) -> LinearModel:
    """Return the model in the directions of the readings that the coefficients move, and those of
    station errors. If these are independent of the first and have one variance, as where no station
    was visited twice, their sum of squares is kept as `StationRemainder` instead.
    """
    rows = np.column_stack([linear.columns, linear.stations, linear.residual])
    if len(rows) > rows.shape[1]:
        rows = np.asarray(np.linalg.qr(rows, mode="r"))
    count, remainder = linear.columns.shape[1], linear.station_remainder
    values, vectors = np.linalg.eigh(rows[:, :count] @ rows[:, :count].T)
    is_moved = values > _LEAST_DIRECTION**2
    moved, others = vectors[:, is_moved].T @ rows, vectors[:, ~is_moved].T @ rows[:, count:]
    errors, residual = others[:, :-1], others[:, -1]
    covariance = errors @ errors.T
    variance = float(np.sum(covariance**2) / max(np.trace(covariance), _LEAST_DIRECTION**2))
    is_uniform = _is_zero(covariance @ covariance - variance * covariance)
    if is_uniform and _is_zero(moved[:, count:-1] @ errors.T):
        rows = moved
        if dof := round(np.trace(covariance) / max(variance, _LEAST_DIRECTION**2)):
            chi2 = float(residual @ covariance @ residual) / variance
            remainder = StationRemainder(chi2, float(dof), variance)
    else:
        values, vectors = np.linalg.eigh(rows[:, :-1] @ rows[:, :-1].T)
        rows = vectors[:, values > _LEAST_DIRECTION**2].T @ rows
    return replace(
        linear, columns=rows[:, :count], stations=rows[:, count:-1], residual=rows[:, -1],
        station_remainder=remainder,
    )  # fmt: skip


def _is_zero(covariance: Array) -> bool:
    """Return whether a covariance is less than that of a direction that is left out."""
    return bool(np.abs(covariance).max(initial=0.0) < _LEAST_DIRECTION**2)


def marginal_covariances(
    linear: LinearModel, index: NDArray[np.intp]
) -> Callable[[Scale, Array], Array]:
    """Return a function that computes the posterior covariance ``(k, k)`` of some coefficients.

    Its arguments are the scale of the background, and a root ``(C, q)`` of the additional prior
    covariance (the slab) of the groups that are active. The usual form, prior minus gain, loses all
    digits where the readings determine a direction a million times better than the prior. Here the
    other coefficients are marginalised as noise, and the precisions of prior and data are added.

    Args:
        linear: the readings.
        index: of the coefficients ``(k,)``.
    """
    marginalised = np.ones(len(linear.fixed_sd), dtype=bool)
    marginalised[index] = False
    others = replace(linear, columns=linear.columns * marginalised)
    fixed, free, background, stations = others.prior_covariances

    @cache  # many states share a scale
    def whitened(scale: Scale) -> tuple[Array, Array, Array]:
        covariance = fixed + scale.free_form_scale**2 * free
        covariance += scale.background_scale**2 * background
        covariance += scale.noise**2 * stations + np.eye(len(covariance))
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        columns = linear.columns[:, index] * np.sqrt(scale.spike[index])
        columns = np.asarray(solve_triangular(root, columns, lower=True))
        return root, columns, columns.T @ columns

    def covariance(scale: Scale, slab_root: Array) -> Array:
        root, columns, gram = whitened(scale)
        active = solve_triangular(root, linear.columns @ slab_root, lower=True)
        crossed = columns.T @ active
        precision = np.block([[gram, crossed], [crossed.T, active.T @ active]])
        precision += np.eye(len(precision))
        units = np.hstack([np.diag(np.sqrt(scale.spike[index])), slab_root[index]])
        scaled_root = solve_triangular(np.linalg.cholesky(precision), units.T, lower=True)
        return np.asarray(scaled_root.T @ scaled_root)

    return covariance


def left_singular(columns: Array) -> tuple[Array, Array]:
    """Return left singular vectors ``(m, q)`` and singular values ``(q,)`` of columns.

    LAPACK's divide and conquer fails to converge for some regular matrices. Then its slower
    algorithm is used.
    """
    try:
        left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    except np.linalg.LinAlgError:
        left, singular, _ = svd(columns, full_matrices=False, lapack_driver="gesvd")
    return left, singular


def shrink_along(rows: Array, left: Array, shrink: Array) -> Array:
    """Return rows ``(m, ...)`` shrunk along orthonormal directions ``(m, q)``."""
    return np.asarray(rows - (left * shrink) @ (left.T @ rows))
