"""What touches show of their noise: a plate's roughness, and touches that are none of it."""

from __future__ import annotations

import numpy as np

from orthoglide.geometry import Array
from orthoglide.ordering import largest

MAX_NOISE_RATIO = 3.0
"""Times the noise that is usual of an instrument, from which that is said; of a plate's roughness
no more counts as noise of its touches: the printers that are tested with have two at most."""

SURFACE_DEGREE = 4
"""Of the smoothest surface: no rigid cause makes more waves than a polynomial of this degree."""

_APPROACH_DEGREE = 1  # degree of what approach from the other side adds
_MIN_DOF = 12
_OUTLIER_RATIO = 6.0  # times what the other heights scatter, of one that is none of them
_MAX_OUTLIER_SHARE = 0.05  # share of a mesh: more are no single touches
_MIN_ROUGHNESS = 1e-6  # metres: no plate is smoother


def _polynomials(place: Array, degree: int) -> Array:
    """Powers of both coordinates up to a degree ``(n, k)``."""
    x, y = place.T
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def roughness(place: Array, height: Array, approach: Array) -> tuple[float, Array]:
    """Standard deviation of heights about the smoothest surface, and by how much single ones are
    off it ``(n,)``, metres; 0 where there are too few, or a height is as rough as the others.

    A bed is rough besides being bent: what no polynomial of the fourth degree follows, which is
    more than any rigid cause makes, counts as noise of its touches. From the other side a machine
    with lost motion shows another surface: smoother, as the drives' shares in the height are. A
    touch that is far off the surface of all others is a speck, or a bad touch.

    Args:
        place: on the plate over its radius ``(n, 2)``.
        height: ``(n,)``, metres.
        approach: of each axis ``(n, 3)``.
    """
    smoother = _polynomials(place, _APPROACH_DEGREE)
    columns = np.hstack(
        [_polynomials(place, SURFACE_DEGREE), *(side[:, None] * smoother for side in approach.T)]
    )
    kept, stray, rough = np.ones(len(height), dtype=bool), np.zeros(len(height)), 0.0
    while (fit := _fit_surface(columns[kept], height[kept])) is not None:
        basis, rest, dof = fit
        rough = float(np.sqrt(rest @ rest / dof))
        # As all others have the surface, and by what they scatter about it.
        free = np.maximum(1 - np.sum(basis**2, axis=1), 1e-9)
        others = np.sqrt(np.maximum(rest @ rest - rest**2 / free, 0.0) / (dof - 1))
        off = rest / free
        far = np.abs(off) * np.sqrt(free) / np.maximum(others, _MIN_ROUGHNESS)
        worst = largest(far)
        if far[worst] < _OUTLIER_RATIO or np.sum(~kept) >= _MAX_OUTLIER_SHARE * len(kept):
            break
        at = np.flatnonzero(kept)[worst]
        kept[at], stray[at] = False, off[worst]
    return rough, stray


def _fit_surface(columns: Array, height: Array) -> tuple[Array, Array, int] | None:
    """Orthonormal columns, what they leave, and its degrees of freedom, where these are enough."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, size > 1e-9 * size.max(initial=0.0)]
    dof = len(height) - basis.shape[1]
    if dof < _MIN_DOF:
        return None
    return basis, height - basis @ (basis.T @ height), dof
