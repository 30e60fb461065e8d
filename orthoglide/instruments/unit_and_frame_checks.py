"""Setups of the tool's instruments that mean something else: another unit, another frame.

A machine that its owner can run stands within millimetres of the nominal one. Readings that are
further from it, and near once a unit or a frame is exchanged, are refused before any fit: a fit
would bend the machine for them.
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
_MAX_RESIDUAL_RATIO = 0.2  # share of it that is left of readings that mean something else
_CONSTANT_SPAN = 1e-5  # metres
_MAX_STRETCH = 0.1  # of coordinates of a machine that is about what it should be
_MIN_READINGS = 4  # readings of a setup that can say so
_LETTERS = "xyz"
_FACTORS = np.array([1.0, *UNIT_MISTAKES])
_FRAMES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
_MIRRORED = np.linalg.det(_FRAMES) < 0


def wrong_frame(p: Array, axis: Ints, value: Array, turn_sd: float) -> str:
    """Return what coordinates seem to be that fit only in another frame or unit, as a clause; empty
    where they fit as they are.

    Where it is not known how the instrument's frame is turned, a turn is taken out later, and is no
    fault.

    Args:
        p: where the machine has the tool ``(m, 3)``, metres.
        axis: of the frame that was read ``(m,)``.
        value: read ``(m,)``, metres.
        turn_sd: how well the frame is known to be the base's, radians.
    """
    if len(value) < _MIN_READINGS:
        return ""
    plain = _residual_rms(np.eye(3), p, axis, value)
    if plain[0] < _MIN_MISFIT:
        return ""
    if np.isinf(turn_sd):
        found = estimate_frame(p, axis, value, np.full(len(p), _MIN_MISFIT), turn_sd)
        if _residual_rms(found, p, axis, value)[0] < max(
            _MIN_MISFIT, _MAX_RESIDUAL_RATIO * plain[0]
        ):
            return ""
    left = np.stack([_residual_rms(turn, p, axis, value) for turn in _FRAMES])
    # Of points in one plane a mirrored frame is as good as one that is turned.
    left[_MIRRORED] /= _MAX_RESIDUAL_RATIO
    best, unit = np.unravel_index(_index_of_smallest(left), left.shape)
    left[_MIRRORED] *= _MAX_RESIDUAL_RATIO
    if left[best, unit] > _MIN_MISFIT and (turn := _nearest_frame(p, axis, value)) is not None:
        shown, far = "", _residual_rms(turn, p, axis, value)[0]
    else:
        turn, far = _FRAMES[best], left[best, unit]
        shown = f", its x, y, z being {', '.join(map(_axis_label, turn))} of the machine"
    factor = float(_FACTORS[unit])
    mirrored, as_is = np.linalg.det(turn) < 0, np.allclose(turn, np.eye(3))
    if far > _MAX_RESIDUAL_RATIO * plain[0]:
        return ""
    if as_is:
        return _unit_error(plain)
    also = "" if factor == 1 else f", and they are {UNIT_MISTAKES[factor]}"
    return (
        f"the coordinates are {compact(plain[0] * 1e3, 2)} mm rms off where this machine can be: "
        f"the frame of the instrument is {'left-handed' if mirrored else 'turned'}{shown}{also}; "
        f"give the coordinates along the machine's axes"
    )


def wrong_unit(value: Array, length: Array) -> str:
    """Return what lengths ``(m,)`` seem to be where a machine has others ``(m,)``, metres."""
    if len(value) < _MIN_READINGS:
        return ""
    return _unit_error(np.stack([_rms(f * value - length) for f in _FACTORS]))


def wrong_bar_unit(p: Array, value: Array) -> str:
    """Return what lengths ``(m,)`` of a ball bar seem to be at places ``(m, 3)``, metres."""
    if len(value) < _MIN_READINGS:
        return ""
    away = np.array([_sphere_residual(p, f * value) for f in _FACTORS])
    return _unit_error(away[:, 0]) or _constant_bar_error(value, away[:, 1])


def _unit_error(left: Array) -> str:
    """Return a clause on a mistaken unit; ``left``: rms by factor ``(factors,)``, metres."""
    best = _index_of_smallest(left)
    if left[0] < _MIN_MISFIT or left[best] > _MAX_RESIDUAL_RATIO * left[0]:
        return ""
    factor = float(_FACTORS[best])
    return (
        f"the readings are {compact(left[0] * 1e3, 2)} mm rms off what this machine can give, and "
        f"fit once they are multiplied by {factor:.4g}, so they seem to be {UNIT_MISTAKES[factor]}: "
        f"give millimetres"
    )


def _nearest_frame(p: Array, axis: Ints, value: Array) -> Array | None:
    """The frame, left-handed or not, in which coordinates were read; ``None`` if they are none."""
    rows = []
    for j in range(3):
        own = np.column_stack([p[axis == j], np.ones(int(np.sum(axis == j)))])
        if np.linalg.matrix_rank(own, tol=1e-2) < 4:
            return None
        rows.append(np.linalg.lstsq(own, value[axis == j], rcond=None)[0][:3])
    left, stretch, right = np.linalg.svd(np.array(rows))
    return np.asarray(left @ right) if np.abs(stretch - 1).max() < _MAX_STRETCH else None


def _residual_rms(turn: Array, p: Array, axis: Ints, value: Array) -> Array:
    """What each factor leaves ``(factors,)``, metres rms, with a datum a direction and a small turn
    of the instrument, were its frame turned.
    """
    seen, rows = p @ turn.T, np.arange(len(p))
    columns = np.column_stack([np.eye(3)[axis], rotation_columns(seen, axis)])
    rest = value[:, None] * _FACTORS - seen[rows, axis][:, None]
    rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=1e-9)[0]
    return np.asarray(np.sqrt(np.mean(rest**2, axis=0)))


def _constant_bar_error(value: Array, longer: Array) -> str:
    """What a ball bar's readings ``(m,)`` seem to be that hardly vary; else empty.

    Its deviations are a real machine's, micrometres and more; of lengths in another unit it is the
    length that tells, by which each factor makes the bar ``longer`` than it can be.
    """
    best = _index_of_smallest(longer)
    if (
        np.ptp(value) > _CONSTANT_SPAN
        or longer[0] < _MIN_MISFIT
        or longer[best] > _MAX_RESIDUAL_RATIO * longer[0]
    ):
        return ""
    return (
        f"the readings vary by less than {_CONSTANT_SPAN * 1e3:g} mm, as those of no machine do, and are "
        f"lengths once they are multiplied by {_FACTORS[best]:.4g}, so they seem to be "
        f"{UNIT_MISTAKES[float(_FACTORS[best])]}: give millimetres"
    )


def _sphere_residual(p: Array, distance: Array) -> tuple[float, float]:
    """Rms of what distances are off a ball's, and their mean, by which a bar is longer."""
    away = distance - np.linalg.norm(p - estimate_sphere_centre(p, distance), axis=1)
    return _rms(away - away.mean()), float(abs(away.mean()))


def _index_of_smallest(left: Array) -> int:
    """Return the place of the smallest distance in the flattened array, metres."""
    return largest(-np.log(np.maximum(left, 1e-12)), LOG_ODDS_MARGIN)


def _rms(rest: Array) -> float:
    return float(np.sqrt(np.mean(rest**2)))


def _axis_label(row: Array) -> str:
    k = int(np.argmax(np.abs(row)))
    return f"{MINUS if row[k] < 0 else ''}{_LETTERS[k]}"
