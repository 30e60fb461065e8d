"""Pose of an instrument from its own readings, and readings in another unit or frame by mistake.

The errors of the estimates are small and are fitted with all other parameters. A usable machine is
within millimetres of its nominal: readings that are further from it, but agree in another unit or
frame, are refused before any fit, which would bend the machine to them.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array, rotation_columns
from orthoglide.instruments.observation import Ints
from orthoglide.numerals import MINUS, compact
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of, largest
from orthoglide.units import UNIT_MISTAKES

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


_MIN_MISFIT = 3e-3  # metres, rms: zeros off by centimetres strain the tool's path by less
_CONSTANT_SPAN = 1e-5  # metres
_MAX_RESIDUAL_RATIO = 0.2  # misfit after the mistake is corrected, over that before
_MIN_READINGS = 4  # readings that a setup needs to be tested
_LETTERS = "xyz"
_FACTORS = np.array([1.0, *UNIT_MISTAKES])
_FRAMES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
_MIRRORED = np.linalg.det(_FRAMES) < 0


def wrong_frame(p: Array, axis: Ints, value: Array, turn_sd: float) -> str:
    """Return a clause on coordinates that fit only in another frame or unit; empty if they fit.

    A rotation is no mistake where it has no prior, as it is estimated later.

    Args:
        p: measured points on the machine ``(m, 3)``, metres.
        axis: axis of the frame that was read ``(m,)``.
        value: coordinates read ``(m,)``, metres.
        turn_sd: prior standard deviation of the frame's rotation, radians.
    """
    if len(value) < _MIN_READINGS:
        return ""
    rms = _residual_rms(np.eye(3), p, axis, value)
    if rms[0] < _MIN_MISFIT:
        return ""
    if np.isinf(turn_sd):
        frame = estimate_frame(p, axis, value, np.full(len(p), _MIN_MISFIT), turn_sd)
        limit = max(_MIN_MISFIT, _MAX_RESIDUAL_RATIO * rms[0])
        if _residual_rms(frame, p, axis, value)[0] < limit:
            return ""
    candidates = np.stack([_residual_rms(frame, p, axis, value) for frame in _FRAMES])
    # For points in one plane a mirrored frame fits as well as a rotated one, which is preferred.
    penalty = np.where(_MIRRORED, 1 / _MAX_RESIDUAL_RATIO, 1.0)
    best, unit = np.unravel_index(
        _index_of_smallest(candidates * penalty[:, None]), candidates.shape
    )
    frame, residual = _FRAMES[best], candidates[best, unit]
    if residual > _MAX_RESIDUAL_RATIO * rms[0]:
        return ""
    if np.allclose(frame, np.eye(3)):
        return _unit_error(rms)
    handedness = "left-handed" if np.linalg.det(frame) < 0 else "turned"
    factor = float(_FACTORS[unit])
    unit_clause = "" if factor == 1 else f", and they are {UNIT_MISTAKES[factor]}"
    return (
        f"the coordinates are {compact(rms[0] * 1e3, 2)} mm rms off where this machine can be: "
        f"the frame of the instrument is {handedness}, its x, y, z being "
        f"{', '.join(map(_axis_label, frame))} of the machine{unit_clause}; "
        f"give the coordinates along the machine's axes"
    )


def wrong_unit(value: Array, residual: Callable[[Array], Array]) -> str:
    """Return a clause on the unit of lengths ``(m,)`` that fit only in another one, by their
    residuals ``(m,)``, metres; empty if they fit.
    """
    if len(value) < _MIN_READINGS:
        return ""
    return _unit_error(np.array([np.sqrt(np.mean(residual(f * value) ** 2)) for f in _FACTORS]))


def wrong_unit_of_constant(value: Array, offset: Callable[[Array], float]) -> str:
    """Return a clause on the unit of lengths that hardly vary; empty if they do vary.

    Deviations of a real machine are micrometres or more, but a constant fits in any unit. That is
    found from the offset of a bar's length.

    Args:
        value: lengths read ``(m,)``, metres.
        offset: returns the mean residual of lengths ``(m,)``, metres.
    """
    if len(value) < _MIN_READINGS or np.ptp(value) > _CONSTANT_SPAN:
        return ""
    span = f"{_CONSTANT_SPAN * 1e3:g} mm"
    finding = f"vary by less than {span}, as those of no machine do, and are lengths"
    return _unit_error(np.array([abs(offset(f * value)) for f in _FACTORS]), finding)


def _unit_error(misfit: Array, finding: str = "") -> str:
    """Return a clause on a mistaken unit, from the misfit by factor ``(factors,)``, metres; empty
    if the misfit is small, or no factor makes it small.
    """
    best = _index_of_smallest(misfit)
    if misfit[0] < _MIN_MISFIT or misfit[best] > _MAX_RESIDUAL_RATIO * misfit[0]:
        return ""
    factor, size = float(_FACTORS[best]), compact(misfit[0] * 1e3, 2)
    finding = finding or f"are {size} mm rms off what this machine can give, and fit"
    return (
        f"the readings {finding} once they are multiplied by {factor:.4g}, so they seem to be "
        f"{UNIT_MISTAKES[factor]}: give millimetres"
    )


def _residual_rms(frame: Array, p: Array, axis: Ints, value: Array) -> Array:
    """Return the rms residual by factor ``(factors,)``, metres, for an instrument in a frame, with
    a datum per axis and a small rotation fitted.
    """
    coordinates, rows = p @ frame.T, np.arange(len(p))
    columns = np.column_stack([np.eye(3)[axis], rotation_columns(coordinates, axis)])
    residual = value[:, None] * _FACTORS - coordinates[rows, axis][:, None]
    residual = residual - columns @ np.linalg.lstsq(columns, residual, rcond=1e-9)[0]
    return np.asarray(np.sqrt(np.mean(residual**2, axis=0)))


def _index_of_smallest(values: Array) -> int:
    """Return the index of the smallest misfit in the flattened array, metres."""
    return largest(-np.log(np.maximum(values, 1e-12)), LOG_ODDS_MARGIN)


def _axis_label(row: Array) -> str:
    k = int(np.argmax(np.abs(row)))
    return f"{MINUS if row[k] < 0 else ''}{_LETTERS[k]}"
