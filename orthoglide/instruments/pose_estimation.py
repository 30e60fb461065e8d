"""Pose of an instrument from its own readings: axes of its frame, centre of its ball.

The errors of these estimates are small and are fitted with all other parameters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array, rotation_columns
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of

_MAX_FRAME_STEPS, _MAX_CENTRE_STEPS = 30, 50
_STEP_TOLERANCE = 1e-13  # metres or radians
_SINGULAR_VALUE_CUTOFF = 1e-3  # relative: rotations that the readings determine less are left out
_PLANARITY = 1e-2  # largest distance of points from their plane, over their extent
_MIN_OFFSET_SQUARED = 0.25  # squared height over radius; errors of zeros cause less
_CENTRE_PRIOR_WEIGHT = 5e-3  # weight of the initial centre: noise of 5 um against a millimetre


def estimate_frame(
    p: Array,
    axis: NDArray[np.int64],
    value: Array,
    sigma: Array,
    sd: float,
    start: Array | None = None,
) -> Array:
    """Return the axes, in the base, of the frame in which coordinates were read ``(3, 3)``.

    Each axis has a free datum. Gauss-Newton; rotations that the readings do not determine are zero.

    Args:
        p: measured points on the machine ``(n, 3)``, metres.
        axis: axis of the frame that was read ``(n,)``.
        value: coordinates read ``(n,)``, metres.
        sigma: standard deviation of each ``(n,)``, metres.
        sd: prior standard deviation of the rotation from the base, radians; may be infinite.
        start: initial frame; if ``None``, the base's, or without a prior the best of those along
            the base's axes.
    """
    from scipy.spatial.transform import Rotation

    rows, centred = np.arange(len(p)), p - p.mean(axis=0)
    datum = np.eye(3)[axis]

    def linearise(rotation: Array) -> tuple[Array, Array]:
        """Return the Gauss-Newton step, and the whitened residuals after it."""
        coordinates = centred @ rotation.T
        columns = np.hstack([rotation_columns(coordinates, axis), datum]) / sigma[:, None]
        deviation = Rotation.from_matrix(rotation).as_rotvec() / sd
        residual = np.append((value - coordinates[rows, axis]) / sigma, -deviation)
        columns = np.vstack([columns, np.eye(3, 6) / sd])
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        step = np.linalg.lstsq(columns / scale, residual, rcond=_SINGULAR_VALUE_CUTOFF)[0] / scale
        return step[:3], residual - columns @ step

    def cost(rotation: Array) -> float:
        residual = linearise(rotation)[1]
        return float(residual @ residual)

    if start is not None:
        rotation = start
    elif np.isfinite(sd):
        rotation = np.eye(3)
    else:
        axis_rotations = Rotation.create_group("O").as_matrix()
        rotation = best_of(
            axis_rotations, lambda r: -float(np.log(max(cost(r), 1e-300))), LOG_ODDS_MARGIN
        )
    for _ in range(_MAX_FRAME_STEPS):
        step, _ = linearise(rotation)
        rotation = Rotation.from_rotvec(step).as_matrix() @ rotation
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return np.asarray(rotation)


def estimate_sphere_centre(p: Array, distance: Array, initial: Array | None = None) -> Array:
    """Return the centre of the sphere from which points ``(n, 3)`` have measured distances
    ``(n,)``, up to a common offset.

    The distances do not determine the centre across the plane of a circle: there it stays near
    the initial centre ``(3,)``. Without one, it is in the plane, or below it by the height that
    distances which are lengths give.
    """
    if initial is None:
        mean = p.mean(axis=0)
        scale = max(float(np.sqrt(np.mean((p - mean) ** 2))), 1e-9)
        q = (p - mean) / scale
        squares = np.sum(q * q, axis=1) - (distance / scale) ** 2
        columns = np.column_stack([2 * q, np.ones(len(q))])
        solution = np.linalg.lstsq(columns, squares, rcond=_PLANARITY)[0][:3]
        if (normal := plane_normal(p)) is not None and distance.min() > 0:
            # Lengths give the height above the plane, but not the side.
            squared_height = np.mean((distance / scale) ** 2 - np.sum((q - solution) ** 2, axis=1))
            if squared_height > _MIN_OFFSET_SQUARED:
                solution = solution + np.sqrt(squared_height) * normal
        initial = mean + scale * solution
    centre, bar_length = initial, 0.0
    prior_rows = _CENTRE_PRIOR_WEIGHT * np.eye(3, 4)
    for _ in range(_MAX_CENTRE_STEPS):
        from_centre = p - centre
        length = np.maximum(np.linalg.norm(from_centre, axis=1), 1e-9)
        jacobian = np.column_stack([-from_centre / length[:, None], np.ones(len(p))])
        residual = np.concatenate(
            [distance - length - bar_length, _CENTRE_PRIOR_WEIGHT * (initial - centre)]
        )
        step = np.linalg.lstsq(np.vstack([jacobian, prior_rows]), residual, rcond=1e-9)[0]
        centre, bar_length = centre + step[:3], bar_length + float(step[3])
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return np.asarray(centre)


def plane_normal(p: Array) -> Array | None:
    """Return the downward unit normal of the plane of points ``(n, 3)``; ``None`` without plane."""
    _, singular_values, directions = np.linalg.svd(p - p.mean(axis=0), full_matrices=False)
    if len(singular_values) < 3 or singular_values[2] > _PLANARITY * singular_values[1]:
        return None
    return np.asarray(-np.copysign(1.0, directions[2, 2]) * directions[2])
