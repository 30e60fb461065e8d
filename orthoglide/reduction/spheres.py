"""The general form of the reduction: three spheres about any carriage points, with any lengths.

Each leg is one bar of length ``lengths[i]`` from the carriage point ``centres[i]`` to the TCP, so
the TCP is the intersection of three spheres. The carriages may be anywhere, so this form checks
every effect that only moves carriages or changes bars.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError, UnreachableError, check_choice
from orthoglide.geometry import LEGS, Array, Mode

DEGENERATE = 1e-9
"""Carriage triangles and TCP tetrahedra flatter than this (relative) count as singular."""

TOUCH_TOLERANCE = 4e-15
"""Legs that just touch give a discriminant of rounding size, of either sign (relative)."""


def batch_position(index: tuple[int, ...], total: int) -> str:
    """Return words for the first pose of a batch that fails, one of ``total``."""
    place = f" at index {index}" if index else ""
    return f"{place} ({total} of the batch fail)" if total > 1 else place


def _gap(centres: Array, lengths: Array, leg: int) -> float:
    """Return by how much a leg is too short (> 0) or too long (< 0) for the circle of the others.

    The gap is infinite where the two others do not meet, and zero where all three do.
    """
    j, k = (leg + 1) % 3, (leg + 2) % 3
    between = centres[k] - centres[j]
    distance = float(np.linalg.norm(between))
    if not abs(lengths[j] - lengths[k]) < distance <= lengths[j] + lengths[k]:
        return float("inf")
    normal = between / distance
    along = (distance**2 + lengths[j] ** 2 - lengths[k] ** 2) / (2 * distance)
    radius = float(np.sqrt(max(lengths[j] ** 2 - along**2, 0.0)))
    offset = centres[leg] - centres[j] - along * normal
    height = float(offset @ normal)
    across = float(np.linalg.norm(offset - height * normal))
    short = float(np.hypot(across - radius, height) - lengths[leg])
    long = float(lengths[leg] - np.hypot(across + radius, height))
    return max(short, 0.0) if short >= long else -max(long, 0.0)


def unreachable_error(
    centres: Array, lengths: Array, index: tuple[int, ...], total: int
) -> UnreachableError:
    """Return the error for legs that do not meet, which names the leg with the smallest gap.

    Args:
        centres: carriage points ``(3, 3)``, metres, by leg.
        lengths: bar lengths ``(3,)``, metres.
        index: index in the batch.
        total: number of poses of the batch that do not meet.

    Returns:
        The error to raise; ``leg`` is empty where no two legs meet.
    """
    place = batch_position(index, total)
    gaps = [_gap(centres, lengths, leg) for leg in range(3)]
    leg = int(np.argmin(np.abs(gaps)))
    if np.isinf(gaps[leg]):
        distances = np.linalg.norm(centres - centres[[1, 2, 0]], axis=-1)
        miss = float(np.max(distances - lengths - lengths[[1, 2, 0]]))
        return UnreachableError(
            f"no two legs meet{place}: their ends stay up to {miss * 1e3:.4g} mm apart; "
            "bring the carriages nearer",
            excess=max(miss, 0.0),
            index=index,
        )
    others = " and ".join(LEGS[k] for k in range(3) if k != leg)
    problem, remedy = ("short", "nearer") if gaps[leg] >= 0 else ("long", "further apart")
    return UnreachableError(
        f"the legs do not meet{place}: leg {LEGS[leg]} is {abs(gaps[leg]) * 1e3:.4g} mm too "
        f"{problem} for where legs {others} meet; bring the carriages {remedy}",
        leg=LEGS[leg],
        excess=abs(gaps[leg]),
        index=index,
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
        index = tuple(int(i) for i in np.argwhere(missed)[0])
        centre = np.broadcast_to(c, (*shape, 3))[index]
        raise unreachable_error(centre, bars[index], index, int(missed.sum()))
    height = np.sqrt(np.maximum(height2, 0.0) / ww) * (-1.0 if mode == "machine" else 1.0)
    return np.asarray(c[..., 0, :] + foot + height[..., None] * w)
