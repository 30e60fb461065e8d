"""Readings of the tool that were given in another unit or another frame by mistake.

A usable machine is within millimetres of its nominal. Readings that are further from it, but
agree in another unit or frame, are refused before any fit, which would bend the machine to them.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from orthoglide.geometry import Array, rotation_columns
from orthoglide.instruments.observation import Ints
from orthoglide.instruments.pose_estimation import estimate_frame, estimate_sphere_centre
from orthoglide.numerals import MINUS, compact
from orthoglide.ordering import LOG_ODDS_MARGIN, largest
from orthoglide.units import UNIT_MISTAKES

_MIN_MISFIT = 3e-3  # metres, rms: zeros off by centimetres strain the tool's path by less
_MAX_RESIDUAL_RATIO = 0.2  # misfit after the mistake is corrected, over that before
_CONSTANT_SPAN = 1e-5  # metres
_MAX_STRETCH = 0.1  # relative, of coordinates of a usable machine
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
    axes = f", its x, y, z being {', '.join(map(_axis_label, frame))} of the machine"
    if residual > _MIN_MISFIT and (nearest := _nearest_frame(p, axis, value)) is not None:
        frame, residual, axes = nearest, _residual_rms(nearest, p, axis, value)[0], ""
    if residual > _MAX_RESIDUAL_RATIO * rms[0]:
        return ""
    if np.allclose(frame, np.eye(3)):
        return _unit_error(rms)
    handedness = "left-handed" if np.linalg.det(frame) < 0 else "turned"
    factor = float(_FACTORS[unit])
    unit_clause = "" if factor == 1 else f", and they are {UNIT_MISTAKES[factor]}"
    return (
        f"the coordinates are {compact(rms[0] * 1e3, 2)} mm rms off where this machine can be: "
        f"the frame of the instrument is {handedness}{axes}{unit_clause}; "
        f"give the coordinates along the machine's axes"
    )


def wrong_unit(value: Array, length: Array) -> str:
    """Return a clause on the unit of distances ``(m,)``, given those expected ``(m,)``, metres."""
    if len(value) < _MIN_READINGS:
        return ""
    return _unit_error(np.stack([_rms(f * value - length) for f in _FACTORS]))


def wrong_bar_unit(p: Array, value: Array) -> str:
    """Return a clause on the unit of a ball bar's lengths ``(m,)`` at points ``(m, 3)``, metres."""
    if len(value) < _MIN_READINGS:
        return ""
    rms, offsets = np.array([_sphere_residual(p, f * value) for f in _FACTORS]).T
    return _unit_error(rms) or _constant_bar_error(value, offsets)


def _unit_error(rms: Array) -> str:
    """Return a clause on a mistaken unit, from the rms misfit by factor ``(factors,)``, metres."""
    misfit = f"are {compact(rms[0] * 1e3, 2)} mm rms off what this machine can give, and fit"
    return _unit_clause(rms, misfit)


def _unit_clause(misfits: Array, finding: str) -> str:
    """Return a clause with a finding and the factor of the smallest misfit ``(factors,)``, metres;
    empty if the misfit is small, or no factor makes it small.
    """
    best = _index_of_smallest(misfits)
    if misfits[0] < _MIN_MISFIT or misfits[best] > _MAX_RESIDUAL_RATIO * misfits[0]:
        return ""
    factor = float(_FACTORS[best])
    return (
        f"the readings {finding} once they are multiplied by {factor:.4g}, so they seem to be "
        f"{UNIT_MISTAKES[factor]}: give millimetres"
    )


def _nearest_frame(p: Array, axis: Ints, value: Array) -> Array | None:
    """Return the frame, left-handed or not, closest to an affine fit of the coordinates; ``None``
    if the fit is undetermined or stretches them.
    """
    rows = []
    for j in range(3):
        columns = np.column_stack([p[axis == j], np.ones(int(np.sum(axis == j)))])
        if np.linalg.matrix_rank(columns, tol=1e-2) < 4:
            return None
        rows.append(np.linalg.lstsq(columns, value[axis == j], rcond=None)[0][:3])
    u, singular_values, vt = np.linalg.svd(np.array(rows))
    return np.asarray(u @ vt) if np.abs(singular_values - 1).max() < _MAX_STRETCH else None


def _residual_rms(frame: Array, p: Array, axis: Ints, value: Array) -> Array:
    """Return the rms residual by factor ``(factors,)``, metres, for an instrument in a frame, with
    a datum per axis and a small rotation fitted.
    """
    coordinates, rows = p @ frame.T, np.arange(len(p))
    columns = np.column_stack([np.eye(3)[axis], rotation_columns(coordinates, axis)])
    residual = value[:, None] * _FACTORS - coordinates[rows, axis][:, None]
    residual = residual - columns @ np.linalg.lstsq(columns, residual, rcond=1e-9)[0]
    return np.asarray(np.sqrt(np.mean(residual**2, axis=0)))


def _constant_bar_error(value: Array, offsets: Array) -> str:
    """Return a clause on the unit of a ball bar's readings ``(m,)`` that hardly vary; else empty.

    Deviations of a real machine are micrometres or more. The unit of constant readings is found
    from the offset of the bar's length by factor ``(factors,)``, metres.
    """
    if np.ptp(value) > _CONSTANT_SPAN:
        return ""
    span = f"{_CONSTANT_SPAN * 1e3:g} mm"
    finding = f"vary by less than {span}, as those of no machine do, and are lengths"
    return _unit_clause(offsets, finding)


def _sphere_residual(p: Array, distance: Array) -> tuple[float, float]:
    """Return the rms residual of distances from a ball's centre, and the size of their offset."""
    residual = distance - np.linalg.norm(p - estimate_sphere_centre(p, distance), axis=1)
    return _rms(residual - residual.mean()), float(abs(residual.mean()))


def _index_of_smallest(values: Array) -> int:
    """Return the index of the smallest misfit in the flattened array, metres."""
    return largest(-np.log(np.maximum(values, 1e-12)), LOG_ODDS_MARGIN)


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _axis_label(row: Array) -> str:
    k = int(np.argmax(np.abs(row)))
    return f"{MINUS if row[k] < 0 else ''}{_LETTERS[k]}"
