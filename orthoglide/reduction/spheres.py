"""The general form of the reduction: three spheres about any carriage points, with any lengths.

Each leg is one bar of length ``lengths[i]`` from the carriage point ``centres[i]`` to the TCP, so
the TCP is the intersection of three spheres. The carriages may be anywhere, so this form checks
every effect that only moves carriages or changes bars.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError, UnreachableError, check_choice
from orthoglide.geometry import Array, Mode

DEGENERATE = 1e-9
"""Carriage triangles and TCP tetrahedra flatter than this (relative) count as singular."""

TOUCH_TOLERANCE = 4e-15
"""Legs that just touch give a discriminant of rounding size, of either sign (relative)."""


def unreachable_error(missed: NDArray[np.bool_]) -> UnreachableError:
    """Return the error for the poses of a batch ``(...)`` that are out of reach."""
    index, count = tuple(map(int, np.argwhere(missed)[0])), int(np.sum(missed))
    place = f" at index {index}" if index else ""
    place += f" ({count} of the batch fail)" if count > 1 else ""
    return UnreachableError(
        f"the legs do not meet{place}: come nearer to mechanical zero, and give metres", index=index
    )


def intersect_spheres(centres: ArrayLike, lengths: ArrayLike, mode: Mode = "machine") -> Array:
    """Return the point p with ``|p - centres[i]| = lengths[i]`` for the three legs.

    There are two such points, mirror images in the plane of the carriages: ``"machine"`` is on the
    side ``-(c_y - c_x) x (c_z - c_x)``, that of the origin on the Orthoglide.

    Args:
        centres: carriage points ``(..., 3, 3)``, indices (leg, coordinate), metres.
        lengths: bar lengths ``(..., 3)`` or a scalar, metres.
        mode: assembly mode, ``"machine"`` or ``"other"``.

    Returns:
        TCP ``(..., 3)``, metres (2008, eq. (2) with the carriages anywhere).

    Raises:
        UnreachableError: where the legs do not meet.
        InputError: for carriages in one line or values that are not finite.
    """
    check_choice("assembly mode", mode, ("machine", "other"))
    c = np.asarray(centres, dtype=float)
    if c.shape[-2:] != (3, 3):
        raise InputError(f"centres have the shape (..., 3, 3), leg by coordinate, not {c.shape}")
    shape = np.broadcast_shapes(c.shape[:-1], np.shape(lengths))
    bars = np.broadcast_to(np.asarray(lengths, dtype=float), shape)
    u, v = c[..., 1, :] - c[..., 0, :], c[..., 2, :] - c[..., 0, :]
    w = np.cross(u, v)
    uu, vv, ww = (np.sum(x * x, axis=-1) for x in (u, v, w))
    if not (np.isfinite(bars).all() and np.all(ww > DEGENERATE**2 * uu * vv)):
        raise InputError("the carriage points and lengths must be finite and not in one line")
    squares = bars * bars
    along_u = (uu + squares[..., 0] - squares[..., 1]) / 2
    along_v = (vv + squares[..., 0] - squares[..., 2]) / 2
    foot = along_u[..., None] * np.cross(v, w) + along_v[..., None] * np.cross(w, u)
    foot = foot / ww[..., None]
    height2 = squares[..., 0] - np.sum(foot * foot, axis=-1)
    missed = height2 < -TOUCH_TOLERANCE * squares[..., 0]
    if np.any(missed):
        raise unreachable_error(missed)
    height = np.sqrt(np.maximum(height2, 0.0) / ww) * (-1.0 if mode == "machine" else 1.0)
    return np.asarray(c[..., 0, :] + foot + height[..., None] * w)
