"""Setups of the tool's instruments that mean something else: another unit, another frame.

A machine that its owner can run stands within millimetres of the nominal one. Readings that are
further from it, and near once a unit or a frame is exchanged, are refused before any fit: a fit
would bend the machine for them.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from orthoglide.geometry import Array, small_turns
from orthoglide.instruments.observation import Ints
from orthoglide.instruments.placing import centre_of, frame_of
from orthoglide.numerals import MINUS, compact
from orthoglide.ordering import EQUAL_ODDS, largest
from orthoglide.units import MISTAKEN

_FAR = 3e-3  # metres, rms: zeros off by centimetres strain the tool's path by less
_MENDED = 0.2  # share of it that is left of readings that mean something else
_STILL = 1e-5  # metres
_STRETCH = 0.1  # of coordinates of a machine that is about what it should be
_FEWEST = 4  # readings of a setup that can say so
_LETTERS = "xyz"
_FACTORS = np.array([1.0, *MISTAKEN])
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
    if len(value) < _FEWEST:
        return ""
    plain = _left(np.eye(3), p, axis, value)
    if plain[0] < _FAR:
        return ""
    if np.isinf(turn_sd):
        found = frame_of(p, axis, value, np.full(len(p), _FAR), turn_sd)
        if _left(found, p, axis, value)[0] < max(_FAR, _MENDED * plain[0]):
            return ""
    left = np.stack([_left(turn, p, axis, value) for turn in _FRAMES])
    # Of points in one plane a mirrored frame is as good as one that is turned.
    left[_MIRRORED] /= _MENDED
    best, unit = np.unravel_index(_least(left), left.shape)
    left[_MIRRORED] *= _MENDED
    if left[best, unit] > _FAR and (turn := _nearest_frame(p, axis, value)) is not None:
        shown, far = "", _left(turn, p, axis, value)[0]
    else:
        turn, far = _FRAMES[best], left[best, unit]
        shown = f", its x, y, z being {', '.join(map(_axis, turn))} of the machine"
    factor = float(_FACTORS[unit])
    mirrored, as_is = np.linalg.det(turn) < 0, np.allclose(turn, np.eye(3))
    if far > _MENDED * plain[0]:
        return ""
    if as_is:
        return _unit(plain)
    also = "" if factor == 1 else f", and they are {MISTAKEN[factor]}"
    return (
        f"the coordinates are {compact(plain[0] * 1e3, 2)} mm rms off where this machine can be: "
        f"the frame of the instrument is {'left-handed' if mirrored else 'turned'}{shown}{also}; "
        f"give the coordinates along the machine's axes"
    )


def wrong_unit(value: Array, length: Array) -> str:
    """Return what lengths ``(m,)`` seem to be where a machine has others ``(m,)``, metres."""
    if len(value) < _FEWEST:
        return ""
    return _unit(np.stack([_rms(f * value - length) for f in _FACTORS]))


def wrong_bar(p: Array, value: Array) -> str:
    """Return what lengths ``(m,)`` of a ball bar seem to be at places ``(m, 3)``, metres."""
    if len(value) < _FEWEST:
        return ""
    away = np.array([_off_sphere(p, f * value) for f in _FACTORS])
    return _unit(away[:, 0]) or _still(value, away[:, 1])


def _unit(left: Array) -> str:
    """Return a clause on a mistaken unit; ``left``: rms by factor ``(factors,)``, metres."""
    best = _least(left)
    if left[0] < _FAR or left[best] > _MENDED * left[0]:
        return ""
    factor = float(_FACTORS[best])
    return (
        f"the readings are {compact(left[0] * 1e3, 2)} mm rms off what this machine can give, and "
        f"fit once they are multiplied by {factor:.4g}, so they seem to be {MISTAKEN[factor]}: "
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
    return np.asarray(left @ right) if np.abs(stretch - 1).max() < _STRETCH else None


def _left(turn: Array, p: Array, axis: Ints, value: Array) -> Array:
    """What each factor leaves ``(factors,)``, metres rms, with a datum a direction and a small turn
    of the instrument, were its frame turned.
    """
    seen, rows = p @ turn.T, np.arange(len(p))
    columns = np.column_stack([np.eye(3)[axis], small_turns(seen, axis)])
    rest = value[:, None] * _FACTORS - seen[rows, axis][:, None]
    rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=1e-9)[0]
    return np.asarray(np.sqrt(np.mean(rest**2, axis=0)))


def _still(value: Array, longer: Array) -> str:
    """What a ball bar's readings ``(m,)`` seem to be that hardly vary; else empty.

    Its deviations are a real machine's, micrometres and more; of lengths in another unit it is the
    length that tells, by which each factor makes the bar ``longer`` than it can be.
    """
    best = _least(longer)
    if np.ptp(value) > _STILL or longer[0] < _FAR or longer[best] > _MENDED * longer[0]:
        return ""
    return (
        f"the readings vary by less than {_STILL * 1e3:g} mm, as those of no machine do, and are "
        f"lengths once they are multiplied by {_FACTORS[best]:.4g}, so they seem to be "
        f"{MISTAKEN[float(_FACTORS[best])]}: give millimetres"
    )


def _off_sphere(p: Array, distance: Array) -> tuple[float, float]:
    """Rms of what distances are off a ball's, and their mean, by which a bar is longer."""
    away = distance - np.linalg.norm(p - centre_of(p, distance), axis=1)
    return _rms(away - away.mean()), float(abs(away.mean()))


def _least(left: Array) -> int:
    """Return the place of the smallest distance in the flattened array, metres."""
    return largest(-np.log(np.maximum(left, 1e-12)), EQUAL_ODDS)


def _rms(rest: Array) -> float:
    return float(np.sqrt(np.mean(rest**2)))


def _axis(row: Array) -> str:
    k = int(np.argmax(np.abs(row)))
    return f"{MINUS if row[k] < 0 else ''}{_LETTERS[k]}"
