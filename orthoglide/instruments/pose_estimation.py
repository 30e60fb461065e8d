"""Where an instrument stands by its own readings: the axes of its frame, the centre of its ball.

What is left of either is small and is fitted with everything else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array, rotation_columns
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of

_MAX_FRAME_STEPS, _SINGULAR_VALUE_CUTOFF = (
    30,
    1e-3,
)  # steps at most; of a turn, by which readings have to show it
_MAX_CENTRE_STEPS, _STEP_TOLERANCE = 50, 1e-13  # at most; metres or radians
_PLANARITY = 1e-2  # of its extent, by which a circle may leave its plane
_MIN_OFFSET_SQUARED = (
    0.25  # square of a distance from the plane, over a circle's radius: zeros make less
)
_CENTRE_PRIOR_WEIGHT = (
    5e-3  # weight of a ball's place against a reading: a noise of 5 um in a millimetre
)


def estimate_frame(
    p: Array,
    axis: NDArray[np.int64],
    value: Array,
    sigma: Array,
    sd: float,
    start: Array | None = None,
) -> Array:
    """Axes of the frame ``(3, 3)``, in the base, in which coordinates were read past a datum each.

    Gauss-Newton; a turn that no reading shows is none.

    Args:
        p: where the machine has what was read ``(n, 3)``, metres.
        axis: of the frame that was read ``(n,)``.
        value: read ``(n,)``, metres.
        sigma: standard deviation of each ``(n,)``, metres.
        sd: how well the frame is known to be the base's, radians; infinite where it is not.
        start: the frame at first; the nearest of those along the base's axes if ``None``, or the
            base's where something is known.
    """
    from scipy.spatial.transform import Rotation

    rows, about = np.arange(len(p)), p - p.mean(axis=0)
    datum = np.eye(3)[axis]

    def left(turn: Array) -> tuple[Array, Array]:
        """The small turn that is left, and what that leaves, in sigmas."""
        seen = about @ turn.T
        columns = np.hstack([rotation_columns(seen, axis), datum]) / sigma[:, None]
        known = Rotation.from_matrix(turn).as_rotvec() / sd
        rest = np.append((value - seen[rows, axis]) / sigma, -known)
        columns = np.vstack([columns, np.eye(3, 6) / sd])
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        step = np.linalg.lstsq(columns / size, rest, rcond=_SINGULAR_VALUE_CUTOFF)[0] / size
        return step[:3], rest - columns @ step

    def cost(turn: Array) -> float:
        rest = left(turn)[1]
        return float(rest @ rest)

    if start is not None:
        turn = start
    elif np.isfinite(sd):
        turn = np.eye(3)
    else:
        every = Rotation.create_group("O").as_matrix()
        turn = best_of(every, lambda one: -float(np.log(max(cost(one), 1e-300))), LOG_ODDS_MARGIN)
    for _ in range(_MAX_FRAME_STEPS):
        step, _ = left(turn)
        turn = Rotation.from_rotvec(step).as_matrix() @ turn
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return np.asarray(turn)


def estimate_sphere_centre(p: Array, distance: Array, near: Array | None = None) -> Array:
    """Centre of the sphere on which points ``(n, 3)`` lie at about these distances ``(n,)``.

    Across a circle's plane its centre could be anywhere: there it stays near a place ``(3,)`` that
    goes with the middle of the points, or as far below the plane as distances that are lengths say.
    """
    if near is None:
        middle = p.mean(axis=0)
        size = max(float(np.sqrt(np.mean((p - middle) ** 2))), 1e-9)
        q = (p - middle) / size
        right = np.sum(q * q, axis=1) - (distance / size) ** 2
        columns = np.column_stack([2 * q, np.ones(len(q))])
        found = np.linalg.lstsq(columns, right, rcond=_PLANARITY)[0][:3]
        if (across := plane_normal(p)) is not None and distance.min() > 0:
            # Lengths say how far beside the plane it stands, and not on which side.
            beside = np.mean((distance / size) ** 2 - np.sum((q - found) ** 2, axis=1))
            if beside > _MIN_OFFSET_SQUARED:
                found = found + np.sqrt(beside) * across
        near = middle + size * found
    centre, longer = near, 0.0
    held = _CENTRE_PRIOR_WEIGHT * np.eye(3, 4)
    for _ in range(_MAX_CENTRE_STEPS):
        toward = p - centre
        length = np.maximum(np.linalg.norm(toward, axis=1), 1e-9)
        slopes = np.column_stack([-toward / length[:, None], np.ones(len(p))])
        rest = np.concatenate([distance - length - longer, _CENTRE_PRIOR_WEIGHT * (near - centre)])
        step = np.linalg.lstsq(np.vstack([slopes, held]), rest, rcond=1e-9)[0]
        centre, longer = centre + step[:3], longer + float(step[3])
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return np.asarray(centre)


def plane_normal(p: Array) -> Array | None:
    """Down across the plane in which points ``(n, 3)`` lie, of length 1; ``None`` where in none."""
    _, size, ways = np.linalg.svd(p - p.mean(axis=0), full_matrices=False)
    if len(size) < 3 or size[2] > _PLANARITY * size[1]:
        return None
    return np.asarray(-np.copysign(1.0, ways[2, 2]) * ways[2])
