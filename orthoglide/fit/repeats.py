"""Noise that readings show: scatter of repeats, rounding of the display, roughness of a plate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.geometry import Array, polynomial_columns
from orthoglide.observations import Readings
from orthoglide.observations.arrays import group_ids
from orthoglide.observations.tables import repeat_steps
from orthoglide.ordering import descending, largest

GRID_TOLERANCE = 0.06
"""Distance from a multiple of a dial's step, in steps, that six printed decimals may make."""

_MAX_SCATTER_STEPS = 2.0  # scatter, in steps of a dial, from which rounding is independent
_METRIC_STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6, 1e-6)  # steps of instruments
_INCH_STEPS = (25.4e-6, 12.7e-6)  # a thousandth and half of it: steps of dials
_DISPLAY_TOLERANCE = 1e-3  # of a step, by which a figure that is printed in it may be off
_CHANCE = 1e-3
"""Probability of readings that all fall on a coarser step than their dial has, and of repeats that
scatter more than all others although their noise is equal."""

_MIN_READINGS_ON_GRID = 8  # readings: of a finer grid one in two or more is on the next by chance
_SIGMAS_PER_STEP = 4.0  # sigmas within a step of the dial: scatter alone shows one digit
_MEAN_RANGE = 2 / np.sqrt(np.pi)  # mean difference of two readings, sigmas
_MAX_EDGE_SHARE = 0.25  # share of stations at rounding edges, beyond those that scatter explains
MIN_REPEAT_DOF = 6  # degrees of freedom below which repeats say too little of the noise


def readings_of_finest_step(
    campaigns: Sequence[Readings], step: Sequence[Array]
) -> tuple[Sequence[Readings], float]:
    """Return the readings of dials with the finest step, which show scatter best, and that step;
    ``step``: of every reading's dial, by campaign, each ``(n,)``, metres.
    """
    finest = float(np.concatenate(step).min())
    if all((steps == finest).all() for steps in step):
        return campaigns, finest
    each = zip(campaigns, (steps == finest for steps in step), strict=True)
    return [campaign.subset(rows) for campaign, rows in each if rows.any()], finest


def dial_steps(campaign: Readings, resolution: float) -> Array:
    """Return the step of every reading's dial ``(n,)``, metres: its resolution or a coarser step.

    All differences from the first reading of each setup are multiples of a coarser step: in the
    whole campaign, or in one setup whose repeats show that its readings are in no other unit.
    """
    steps = np.empty(len(campaign))
    setups = [campaign.setup == k for k in range(len(campaign.setups))]
    differences = list[Array]()  # from the first reading of each setup, distinct and nonzero
    for rows in setups:
        finite = campaign.reading[rows & np.isfinite(campaign.reading)]
        distinct = np.unique(np.round(finite - finite[:1], 9))
        differences.append(distinct[distinct != 0])
    common = _coarser_step(np.concatenate(differences), resolution)
    for rows, setup_differences in zip(setups, differences, strict=True):
        larger = _coarser_step(setup_differences, common)
        steps[rows] = larger if _has_coarser_dial(campaign, rows, common, larger) else common
    return steps


def _has_coarser_dial(
    campaign: Readings, rows: NDArray[np.bool_], step: float, larger: float
) -> bool:
    """Return whether repeats in some rows ``(n,)`` scatter less, in their larger step, than others
    in theirs; if not, they are readings of an equal dial in a smaller unit.
    """
    if larger == step:
        return False
    variance, dof = repeat_variance([campaign.subset(rows)])
    other_variance, _ = repeat_variance([campaign.subset(~rows)])
    is_smaller = variance / larger**2 < other_variance / step**2 * np.sqrt(step / larger)
    return bool(is_smaller and dof >= MIN_REPEAT_DOF)


def _coarser_step(differences: Array, step: float) -> float:
    """Return the largest step of which all differences ``(k,)``, metres, distinct in a setup, are
    multiples, unless by chance: ``k`` of them are with probability ``(smaller / larger)^k``.
    """
    for larger in sorted((*_METRIC_STEPS, *_INCH_STEPS)):
        if larger <= step or (step / larger) ** len(differences) >= _CHANCE:
            continue
        nonzero = np.abs(differences).min() > larger / 2
        if nonzero and on_grid(differences, larger, _DISPLAY_TOLERANCE):
            step = larger
    return step


def off_grid(readings: Array, step: float | Array) -> Array:
    """Return the distance of readings ``(n,)`` from multiples of a step, both metres, in steps."""
    return np.abs(readings / step - np.round(readings / step))


def on_grid(readings: Array, step: float | Array, tolerance: float = GRID_TOLERANCE) -> bool:
    """Return whether readings ``(n,)`` are multiples of the step within ``tolerance`` steps."""
    return bool((off_grid(readings, step) < tolerance).all())


def apparent_step(readings: Array) -> float:
    """Return the step of which readings ``(n,)`` are multiples, metres or radians; 0 where there is
    none, or too few readings.
    """
    for step in _METRIC_STEPS if len(readings) >= _MIN_READINGS_ON_GRID else ():
        if on_grid(readings, step, _DISPLAY_TOLERANCE) and np.ptp(readings) > step / 2:
            return step
    return 0.0


def common_rounding(sigma: ArrayLike, resolution: ArrayLike) -> Array:
    """Return the standard deviation of the rounding error that repeats share, metres.

    The rounding of a value x that scatters by s (both in steps of the dial) has the mean
    ``sum_k (-1)^k sin(2 pi k x) exp(-2 (pi k s)^2) / (pi k)``. Over all x its variance is a
    twelfth of a squared step without scatter, and next to nothing once s is half a step.

    Args:
        sigma: of one reading, its rounding counted, metres ``(...)``.
        resolution: step of the dial, metres ``(...)``; 0 where it does not round.
    """
    pairs = np.stack(np.broadcast_arrays(sigma, resolution), axis=-1, dtype=float)
    distinct, index = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    total, step = distinct.T
    scatter = np.sqrt(np.maximum(total**2 - step**2 / 12, 0.0)) / np.where(step > 0, step, 1.0)
    k = np.arange(1, 200)
    share = np.exp(-((2 * np.pi * k * scatter[..., None]) ** 2)) / (2 * (np.pi * k) ** 2)
    shared = step * np.sqrt(share.sum(axis=-1))
    return np.asarray(shared[index].reshape(pairs.shape[:-1]))


def total_variance(within: ArrayLike, resolution: float) -> Array:
    """Return the variance of one rounded reading from that of repeats, square metres.

    Repeats do not show the rounding that they share: with a scatter s before it, one reading
    has ``s^2 + step^2 / 12``, of which repeats show ``s^2 + step^2 / 12 - common(s)^2``. A dial
    that scatters by much less than its step shows hardly any variance at all.
    """
    if resolution <= 0:
        return np.asarray(within, dtype=float)
    scatter = np.concatenate([[0.0], np.geomspace(1e-3, _MAX_SCATTER_STEPS, 400)])
    total = (scatter**2 + 1 / 12) * resolution**2
    visible = np.maximum.accumulate(total - common_rounding(np.sqrt(total), resolution) ** 2)
    variance = np.asarray(within, dtype=float)
    return np.asarray(np.interp(variance, visible, total) + np.maximum(variance - visible[-1], 0.0))


def repeat_variance(campaigns: Sequence[Readings]) -> tuple[float, int]:
    """Return the variance of one reading from repeats, and its degrees of freedom.

    Repeats share the whole command, with the approach of all three axes. Successive ones are
    differenced, so that slow drift hardly counts: ``mean (y_k+1 - y_k)^2 / 2``.
    """
    total, count = 0.0, 0
    for campaign in campaigns:
        steps = repeat_steps(campaign)
        total += float(np.sum(steps**2)) / 2
        count += len(steps)
    # Differences of a run share readings: n of them carry about two thirds n degrees of freedom.
    return (total / count if count else float("nan")), int(np.floor(2 * count / 3))


def scatters_more(variance: Array, dof: Array, least: float) -> NDArray[np.bool_]:
    """Return a mask ``(s,)`` of the setups that scatter more than all others, fewer than half of
    them. The noisiest setup is compared with the pooled others by an F test, then the next.

    Args:
        variance: of one reading, from the repeats of each setup ``(s,)``.
        dof: degrees of freedom of each variance ``(s,)``.
        least: lower limit of the pooled variance: repeats of rounded readings are all equal in some
            setups, and change between two digits in others.
    """
    from scipy.special import fdtrc

    noisier = np.zeros(len(variance), dtype=bool)
    while 2 * (np.sum(noisier) + 1) < len(variance):
        worst = largest(np.where(noisier, -np.inf, variance))
        others = ~noisier & (np.arange(len(variance)) != worst)
        pooled = max(float(np.average(variance[others], weights=dof[others])), least)
        chance = fdtrc(dof[worst], dof[others].sum(), variance[worst] / max(pooled, 1e-300))
        if len(variance) * chance > _CHANCE:
            break
        noisier[worst] = True
    return noisier


def without_noisier_setups(campaigns: Sequence[Readings], step: float) -> Sequence[Readings]:
    """Return the readings without setups whose repeats scatter more than those of the others: one
    loose dial must not count as noise of all; ``step``: of the instruments, metres.
    """
    rows = [table.setup == s for table in campaigns for s in range(len(table.setups))]
    tables = [k for k, table in enumerate(campaigns) for _ in table.setups]
    each = [repeat_variance([campaigns[k].subset(r)]) for k, r in zip(tables, rows, strict=True)]
    variance, dof = np.array(each).T
    repeated = np.flatnonzero(dof > 0)
    noisier = repeated[scatters_more(variance[repeated], dof[repeated], (step / 2) ** 2)]
    kept = [np.ones(len(table), dtype=bool) for table in campaigns]
    for k in noisier:
        kept[tables[k]] &= ~rows[k]
    return [table.subset(rows) for table, rows in zip(campaigns, kept, strict=True)]


def widen_at_rounding_edges(
    campaign: Readings, sigma: Array, common: Array, resolution: Array
) -> Array:
    """Return sigmas ``(n,)`` of dials, at least half a step where a station's visits show two
    neighbouring digits.

    There the true value is at the edge between them, and a dial with little scatter shows one or
    the other. The difference of a whole step would appear to be a slip, or a drift. Where too many
    stations show several digits, the dial scatters more than declared, and no sigma is changed.
    """
    station = group_ids(campaign.stations)
    visits = np.bincount(station)
    low = np.full(len(visits), np.inf)
    high = -low
    np.minimum.at(low, station, campaign.reading)
    np.maximum.at(high, station, campaign.reading)
    spread = (high - low)[station]
    scatter = np.sqrt(np.maximum(sigma**2 + common**2 - resolution**2 / 12, 0.0))
    chance = _MEAN_RANGE * (visits[station] - 1) * scatter / resolution
    differs = spread > 0.5 * resolution
    again = np.flatnonzero(visits[station] > 1)
    if len(again) and np.mean(differs[again]) > _MAX_EDGE_SHARE + np.mean(chance[again]):
        return sigma
    edge = differs & (spread < 1.5 * resolution) & (resolution > _SIGMAS_PER_STEP * sigma)
    return np.where(edge, np.maximum(sigma, resolution / 2), sigma)


# Roughness of a plate -------------------------------------------------------------------------

MAX_NOISE_RATIO = 3.0
"""Ratio of an instrument's noise to the usual one from which a note is made, and up to which
roughness counts as noise of touches; the printers of the tests reach two at most."""

SURFACE_DEGREE = 4
"""Degree of the smooth surface: rigid causes follow polynomials of this degree."""

_APPROACH_DEGREE = 1  # degree of the term that depends on the approach
_MIN_SURFACE_DOF = 12
"""Degrees of freedom below which a surface shows no roughness: on twelve it is known to a fifth, as
its relative standard deviation is one over the root of twice their number."""
_OUTLIER_RATIO = 6.0  # height of an outlier over the scatter of all others
_MAX_OUTLIER_SHARE = 0.05
"""Largest share of a mesh that may be outliers: a larger one is neither a speck nor a clip. With
twice this share, lobes of three of forty sound plates were taken for a clip."""
_PATCH_STARTS = 10  # heights, the furthest from the surface, from which a patch may grow
NEIGHBOUR_DISTANCE = 1.6
"""Distance of neighbours, in distances of the nearest touch: includes a square's diagonal."""
_GROWTH_COST = 2 * float(np.log(8))
"""Further chi2 that a patch must explain for each added touch, which is the best of about eight
neighbours. In pure noise, the best patch of nineteen touches explains 38."""
_MIN_ROUGHNESS = 1e-6  # metres: no plate is smoother


def roughness(xy: Array, height: Array, approach: Array) -> tuple[float, Array]:
    """Return the standard deviation of heights ``(n,)`` about a smooth surface, and the heights of
    outliers above it ``(n,)``, metres; 0 of all others, and with too few heights.

    A bed is rough besides being bent: deviations from a polynomial of the fourth degree, in the
    places over the plate's radius ``(n, 2)``, count as noise of touches, as no rigid cause is less
    smooth. With lost motion the surface depends on the approach ``(n, 3)``, by a smoother term. An
    outlier is a speck or a bad touch, or a patch of neighbours that are off alike, as on a clip.
    """
    smoother = polynomial_columns(xy, _APPROACH_DEGREE)
    by_side = [side[:, None] * smoother for side in approach.T]
    columns = np.hstack([polynomial_columns(xy, SURFACE_DEGREE), *by_side])
    rows_kept, outlier_height, sigma = np.ones(len(height), dtype=bool), np.zeros(len(height)), 0.0
    max_outliers = _MAX_OUTLIER_SHARE * len(height)
    distance = np.linalg.norm(xy[:, None] - xy, axis=2)
    spacing = np.min(distance, where=distance > 0, initial=np.inf)
    near = (distance > 0) & (distance < NEIGHBOUR_DISTANCE * spacing)
    while (fit := _fit_surface(columns[rows_kept], height[rows_kept])) is not None:
        _, residual, dof = fit
        sigma = float(np.sqrt(residual @ residual / dof))
        count, kept = int(np.ceil(max_outliers - np.sum(~rows_kept))), np.flatnonzero(rows_kept)
        if count < 1:
            break
        ratio, error, patch = _outlying_patch(fit, near[np.ix_(kept, kept)], count)
        if ratio < _OUTLIER_RATIO:
            break
        rows_kept[kept[patch]], outlier_height[kept[patch]] = False, error
    return sigma, outlier_height


def _outlying_patch(
    fit: tuple[Array, Array, int], near: NDArray[np.bool_], count: int
) -> tuple[float, float, list[int]]:
    """Return the patch of neighbouring heights, ``count`` of them at most, whose common error is
    most significant: the ratio of that error to its standard deviation, less the cost of growth;
    the error; and the rows of the patch.

    A patch grows from one height by the neighbour that raises the ratio most, until none does.
    """
    basis, residual, dof = fit

    def ratio_and_error(patch: list[int]) -> tuple[float, float]:
        """Return ratio and error of a patch above the surface through all others."""
        free = max(len(patch) - float(np.sum(basis[patch].sum(axis=0) ** 2)), 1e-9)
        gain = float(residual[patch].sum()) ** 2 / free
        others = max(float(residual @ residual) - gain, 0.0) / (dof - 1)
        chi2 = gain / max(others, _MIN_ROUGHNESS**2) - _GROWTH_COST * (len(patch) - 1)
        return float(np.sqrt(max(chi2, 0.0))), residual[patch].sum() / free

    best = (0.0, 0.0, list[int]())
    single = np.abs(residual) / np.sqrt(np.maximum(1 - np.sum(basis**2, axis=1), 1e-9))
    for start in descending(single)[:_PATCH_STARTS]:
        patch, value = [start], ratio_and_error([start])
        while len(patch) < count:
            around = np.setdiff1d(np.flatnonzero(near[patch].any(axis=0)), patch).tolist()
            values = [ratio_and_error([*patch, row]) for row in around]
            grown = largest([v[0] for v in values]) if values else 0
            if not values or values[grown][0] <= value[0]:
                break
            patch, value = [*patch, around[grown]], values[grown]
        if value[0] > best[0]:
            best = (*value, patch)
    return best


def _fit_surface(columns: Array, height: Array) -> tuple[Array, Array, int] | None:
    """Return orthonormal columns, the residual and its degrees of freedom, if these suffice."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, size > 1e-9 * size.max(initial=0.0)]
    dof = len(height) - basis.shape[1]
    if dof < _MIN_SURFACE_DOF:
        return None
    return basis, height - basis @ (basis.T @ height), dof
