"""Readings of the tool that were given in another unit or another frame by mistake.

A usable machine is within millimetres of its nominal. Readings that are further from it, but
agree in another unit or frame, are refused before any fit, which would bend the machine to them.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product

import numpy as np

from orthoglide.geometry import Array, rotation_columns
from orthoglide.instruments.observation import Ints
from orthoglide.instruments.pose_estimation import estimate_frame
from orthoglide.numerals import MINUS, compact
from orthoglide.ordering import LOG_ODDS_MARGIN, largest
from orthoglide.units import UNIT_MISTAKES

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
    """Return a clause on the unit of lengths that fit only in another one; empty if they fit.

    Args:
        value: lengths read ``(m,)``, metres.
        residual: returns the residuals of lengths ``(m,)``, metres.
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
