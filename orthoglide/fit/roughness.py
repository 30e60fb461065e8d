"""Noise of touches: the roughness of a plate, and outlying touches."""

from __future__ import annotations

import numpy as np

from orthoglide.geometry import Array
from orthoglide.ordering import largest

MAX_NOISE_RATIO = 3.0
"""Ratio of an instrument's noise to the usual one from which a note is made, and up to which
roughness counts as noise of touches; the printers of the tests reach two at most."""

SURFACE_DEGREE = 4
"""Degree of the smooth surface: rigid causes follow polynomials of this degree."""

_APPROACH_DEGREE = 1  # degree of the term that depends on the approach
_MIN_DOF = 12
_OUTLIER_RATIO = 6.0  # height of an outlier over the scatter of all others
_MAX_OUTLIER_SHARE = 0.05  # share of a mesh: more are no single touches
_MIN_ROUGHNESS = 1e-6  # metres: no plate is smoother


def _polynomials(xy: Array, degree: int) -> Array:
    """Return the products of powers of both coordinates up to a degree ``(n, k)``."""
    x, y = xy.T
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def roughness(xy: Array, height: Array, approach: Array) -> tuple[float, Array]:
    """Return the standard deviation of heights about a smooth surface, and the heights of outliers
    above it ``(n,)``, metres; 0 of all others, and with too few heights.

    A bed is rough besides being bent: deviations from a polynomial of the fourth degree count as
    noise of touches, as no rigid cause is less smooth. With lost motion the surface depends on the
    approach, by a smoother term. An outlier is a speck, or a bad touch.

    Args:
        xy: on the plate over its radius ``(n, 2)``.
        height: ``(n,)``, metres.
        approach: of each axis ``(n, 3)``.
    """
    smoother = _polynomials(xy, _APPROACH_DEGREE)
    by_side = [side[:, None] * smoother for side in approach.T]
    columns = np.hstack([_polynomials(xy, SURFACE_DEGREE), *by_side])
    rows_kept, outlier_height, sigma = np.ones(len(height), dtype=bool), np.zeros(len(height)), 0.0
    max_outliers = _MAX_OUTLIER_SHARE * len(height)
    while (fit := _fit_surface(columns[rows_kept], height[rows_kept])) is not None:
        basis, residual, dof = fit
        sigma = float(np.sqrt(residual @ residual / dof))
        # Height above the surface through all others, and their scatter about it.
        free = np.maximum(1 - np.sum(basis**2, axis=1), 1e-9)
        other_sigma = np.sqrt(np.maximum(residual @ residual - residual**2 / free, 0.0) / (dof - 1))
        height_error = residual / free
        ratio = np.abs(height_error) * np.sqrt(free) / np.maximum(other_sigma, _MIN_ROUGHNESS)
        worst = largest(ratio)
        if ratio[worst] < _OUTLIER_RATIO or np.sum(~rows_kept) >= max_outliers:
            break
        row = np.flatnonzero(rows_kept)[worst]
        rows_kept[row], outlier_height[row] = False, height_error[worst]
    return sigma, outlier_height


def _fit_surface(columns: Array, height: Array) -> tuple[Array, Array, int] | None:
    """Return orthonormal columns, the residual and its degrees of freedom, if these suffice."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, size > 1e-9 * size.max(initial=0.0)]
    dof = len(height) - basis.shape[1]
    if dof < _MIN_DOF:
        return None
    return basis, height - basis @ (basis.T @ height), dof
