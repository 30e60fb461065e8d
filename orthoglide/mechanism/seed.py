"""Where closure starts from: the angles of a perfect leg whose two ends are known."""

from __future__ import annotations

from operator import mul
from typing import Literal

import numpy as np

from orthoglide.errors import UnreachableError
from orthoglide.geometry import Array, Geometry
from orthoglide.mechanism.tree import PASSIVE_NAMES, RELIEF_NAMES, Tree

Mode = Literal["machine", "other"]
"""The machine's own assembly mode, or its mirror image in the plane of the carriages."""

_FAR = 10.0  # bars' lengths: points so far away were perhaps given in other units
UNITS = "give metres in Python, millimetres on the command line and in files"
"""What to do about a point so far away."""


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
    spans = p[:, None] - _centres(geometry, travel)
    passive = [_angles(geometry, leg, spans[:, leg]) for leg in range(3)]
    relief = np.zeros((len(p), 3 * len(RELIEF_NAMES) if len(tree.relief) else 0))
    return np.concatenate([*passive, relief], axis=1)


def commands(geometry: Geometry, p: Array) -> Array:
    """Commands ``(N, 3)`` of perfect legs that hold the TCP at ``p`` ``(N, 3)``, metres.

    Raises:
        UnreachableError: naming the leg that is too short, and the point that it misses most; or
            the point that lies farthest beyond the plane of the carriages.
    """
    reach = p[:, None] - _centres(geometry, np.zeros((1, 3)))  # from each leg's sphere at zero
    along = np.einsum("nli,li->nl", reach, geometry.slides)
    # Far points overflow a square.
    across = np.hypot.reduce(np.cross(reach, geometry.slides), axis=-1)
    excess = across - geometry.L
    short = np.flatnonzero((excess >= 0).any(axis=0))
    if short.size:
        leg, worst = int(short[0]), int(np.argmax(excess[:, short[0]]))
        size = float(excess[worst, leg])
        shown = f"{size * 1e3:.3f}" if size < 1e3 else f"{size * 1e3:g}"
        away = float(np.hypot.reduce(p[worst]))
        far = f" for a point {away:g} m away: {UNITS}" if away > _FAR * geometry.L else ""
        raise UnreachableError(
            f"{_which(worst, p)}leg {geometry.leg_names[leg]} is {shown} mm too short{far}",
            leg=geometry.leg_names[leg],
            excess=size,
            index=(worst,),
        )
    travel = along + np.sqrt(geometry.L**2 - across**2)
    normal, offset = _carriage_plane(geometry, _centres(geometry, travel))
    beyond = np.sum(normal * p, axis=1) - offset
    if (beyond >= 0).any():
        worst = int(np.argmax(beyond))
        raise UnreachableError(
            f"{_which(worst, p)}the machine does not come to the far side of its carriages: the "
            f"tool would stand {beyond[worst] * 1e3:.3f} mm beyond their plane, in the other "
            f"assembly mode",
            excess=float(beyond[worst]),
            index=(worst,),
        )
    return np.asarray(geometry.zero + travel)


def _which(point: int, p: Array) -> str:
    return f"point {point + 1}: " if len(p) > 1 else ""


def _centres(geometry: Geometry, travel: Array) -> Array:
    """`Geometry.centres` ``(N, leg, 3)`` with the carriages at ``travel`` ``(N, 3)``, metres."""
    return np.asarray(geometry.centres + travel[:, :, None] * geometry.slides)


def _angles(geometry: Geometry, leg: int, span: Array) -> Array:
    here = geometry.legs[leg]
    a, b, c = np.moveaxis(span @ here.axes, -1, 0)
    phi = np.arcsin(np.clip(c / geometry.L, -1, 1))
    theta = np.arctan2(-b, -a) - here.lean
    by_name = {"theta": theta, "bar1": phi, "knuckle": -phi, "platform": -theta, "bar2": phi}
    return np.stack([by_name[name] for name in PASSIVE_NAMES], axis=1)


def tool(geometry: Geometry, travel: Array, mode: Mode = "machine") -> Array:
    """TCP ``(N, 3)`` of perfect legs, where three spheres about the carriages meet, metres.

    Args:
        geometry: nominal dimensions.
        travel: of the carriages from mechanical zero, ``(N, 3)``, metres.
        mode: which of the two points, mirror images in the plane of the carriages.

    Returns:
        NaN where the legs do not meet, or the carriages stand in one line.
    """
    centres = _centres(geometry, travel)
    u, v = centres[:, 1] - centres[:, 0], centres[:, 2] - centres[:, 0]
    w = np.cross(u, v)
    uu, vv, ww = (np.sum(x * x, axis=1, keepdims=True) for x in (u, v, w))
    with np.errstate(invalid="ignore", divide="ignore"):
        foot = (uu * np.cross(v, w) + vv * np.cross(w, u)) / (2 * ww)
        height = np.sqrt(geometry.L**2 - np.sum(foot * foot, axis=1, keepdims=True))
        normal, _ = _carriage_plane(geometry, centres)
    return np.asarray(centres[:, 0] + foot + height * normal * (-1 if mode == "machine" else 1))


def below_carriages(geometry: Geometry, travel: Array, p: Array) -> bool:
    """Whether a TCP ``(3,)`` is on the machine's side of perfect legs' carriages.

    As ``ClosureFunctions.side``, in plain numbers: numpy would take longer than closing the loops.
    """
    first, second, third = (geometry.centres + travel[:, None] * geometry.slides).tolist()
    u, v = ([b - a for a, b in zip(first, other, strict=True)] for other in (second, third))
    normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    offset = sum(map(mul, normal, first))
    up = sum(map(mul, normal, geometry.slides[0].tolist())) if geometry.layout.hanging else offset
    below = sum(map(mul, normal, p.tolist())) - offset
    return below > 0 if up < 0 else below < 0


def _carriage_plane(geometry: Geometry, centres: Array) -> tuple[Array, Array]:
    """Plane through the carriages ``(N, leg, 3)``, the platform's size taken out: unit normal
    ``(N, 3)`` away from the machine's side, and offset.

    A machine in its own assembly mode has ``normal . p < offset``.
    """
    normal = np.cross(centres[:, 1] - centres[:, 0], centres[:, 2] - centres[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    offset = np.sum(normal * centres[:, 0], axis=-1)
    up = normal @ geometry.slides[0] if geometry.layout.hanging else offset
    side = np.where(up < 0, -1.0, 1.0)
    return normal * side[:, None], offset * side
