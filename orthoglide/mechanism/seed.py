"""Where closure starts from: the angles of a perfect leg whose two ends are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import UnreachableError
from orthoglide.geometry import LEGS, Array, Geometry, leg_axes
from orthoglide.mechanism.tree import PASSIVE_NAMES, RELIEF_NAMES, Tree

_FAR = 10.0  # bars' lengths: points so far away were perhaps given in other units


def free_joints(tree: Tree, travel: Array, p: Array) -> Array:
    """Passive joints of perfect legs that hold the platform unturned at ``p``.

    With the leg's span ``w`` from carriage to platform in its axes (a, b, c), the bars lie along
    ``L (-cos theta cos phi, -sin theta cos phi, sin phi)``.

    Args:
        tree: nominal or general; relief joints start at zero.
        travel: of the carriages from mechanical zero, ``(N, 3)``, metres.
        p: TCP ``(N, 3)``, metres.

    Returns:
        Free joints ``(N, n)`` in the order of ``tree.free``. Where a leg is out of reach its
        angles are clipped: closure then says by how much.
    """
    geometry = tree.geometry
    spans = [_span(geometry, leg, travel, p) for leg in range(3)]
    passive = [_angles(geometry, span) for span in spans]
    relief = np.zeros((len(p), 3 * len(RELIEF_NAMES) if len(tree.relief) else 0))
    return np.concatenate([*passive, relief], axis=1)


def commands(geometry: Geometry, p: Array) -> Array:
    """Commands ``(N, 3)`` of perfect legs that hold the TCP at ``p`` ``(N, 3)``, metres.

    Raises:
        UnreachableError: naming the leg that is too short, and the point that it misses most.
    """
    across = np.hypot(p[:, [1, 2, 0]], p[:, [2, 0, 1]])
    excess = across - geometry.L
    short = np.flatnonzero((excess >= 0).any(axis=0))
    if short.size:
        leg, worst = int(short[0]), int(np.argmax(excess[:, short[0]]))
        size = float(excess[worst, leg])
        shown = f"{size * 1e3:.3f}" if size < 1e3 else f"{size * 1e3:g}"
        which = f"point {worst + 1}: " if len(p) > 1 else ""
        away = float(np.hypot.reduce(p[worst]))
        far = f" for a point {away:g} m away" if away > _FAR * geometry.L else ""
        raise UnreachableError(
            f"{which}leg {LEGS[leg]} is {shown} mm too short{far}",
            leg=LEGS[leg],
            excess=size,
            index=(worst,),
        )
    return np.asarray(p + np.sqrt(geometry.L**2 - across**2))


def _span(geometry: Geometry, leg: int, travel: Array, p: Array) -> Array:
    """From the carriage to the platform in the leg's axes ``(N, 3)``; r drops out."""
    carriage = np.zeros_like(p)
    carriage[:, leg] = geometry.L + travel[:, leg]
    return np.asarray((p - carriage)[:, list(leg_axes(leg))])


def _angles(geometry: Geometry, span: Array) -> Array:
    phi = np.arcsin(np.clip(span[:, 2] / geometry.L, -1, 1))
    theta = np.arctan2(-span[:, 1], -span[:, 0])
    by_name = {"theta": theta, "bar1": phi, "knuckle": -phi, "platform": -theta, "bar2": phi}
    return np.stack([by_name[name] for name in PASSIVE_NAMES], axis=1)


def mirrored(lines: Array, r: float, p: Array) -> Array:
    """Mirror image of ``p`` in the plane of the three carriages: the other assembly mode.

    Args:
        lines: ends of the bars ``(N, 3, 2, 2, 3)``.
        r: distance from the TCP to the legs' last revolutes, metres.
        p: TCP ``(N, 3)``.
    """
    normal, offset = carriage_plane(lines, r)
    return p - 2 * (np.sum(normal * p, axis=-1) - offset)[:, None] * normal


def in_machine_mode(lines: Array, r: float, p: Array) -> NDArray[np.bool_]:
    """Whether postures ``(N,)`` stand in the machine's own assembly mode; as :func:`mirrored`."""
    normal, offset = carriage_plane(lines, r)
    return np.asarray(np.sum(normal * p, axis=-1) < offset)


def carriage_plane(lines: Array, r: float) -> tuple[Array, Array]:
    """Plane through the carriages, r removed: unit normal ``(N, 3)`` away from the origin, offset.

    A machine in its own assembly mode has ``normal . p < offset``.
    """
    centres = lines[:, :, :, 0].mean(axis=2) - r * np.eye(3)
    normal = np.cross(centres[:, 1] - centres[:, 0], centres[:, 2] - centres[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    offset = np.sum(normal * centres[:, 0], axis=-1)
    # The legs' order alone would point at the origin once a carriage has passed it.
    side = np.where(offset < 0, -1.0, 1.0)
    return normal * side[:, None], offset * side
