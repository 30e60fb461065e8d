"""Legs without errors: start of the closure, and commands that bring the tool to a point.

While the platform is not turned, leg i lets the tool move on a sphere about
``centre_i + slide_i t_i``: the middle of its bars' carriage ends less that of their platform ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.errors import UnreachableError
from orthoglide.geometry import Array, Geometry, Mode
from orthoglide.mechanism.tree import PASSIVE_NAMES, RELIEF_NAMES, Tree

SIDE_ROUNDING = 1e-15
"""Dimensionless side of the carriages' plane (see `assembly_mode`) below which its sign is noise: a
thousandth of a bar's length from the plane it is of the order of 1e-6 or more."""

_FAR = 10.0  # bar lengths: points so far away were perhaps given in other units
_NEARER_REMEDY = "move the point towards the middle of the workspace"
UNITS_REMEDY = "give metres in Python, millimetres on the command line and in files"
"""Remedy for a point so far away."""


@dataclass(frozen=True)
class Spheres:
    """Three spheres on which the tool lies while the platform is not turned."""

    centres: Array  # at mechanical zero (leg, 3), metres
    slides: Array  # directions in which they move (leg, 3)
    lengths: Array  # radii (leg,), metres
    zero: Array  # command at mechanical zero (3,), metres
    hanging: bool  # whether the platform hangs below parallel rails
    names: tuple[str, ...]  # of the legs

    @classmethod
    def of_geometry(cls, geometry: Geometry) -> Spheres:
        """Return the spheres of nominal dimensions."""
        lengths, names = np.full(3, geometry.L), geometry.leg_names
        hanging = geometry.layout.hanging
        return cls(geometry.centres, geometry.slides, lengths, geometry.zero, hanging, names)

    def centres_at(self, travel: Array) -> Array:
        """Return the centres ``(N, leg, 3)`` for carriages at ``travel`` ``(N, 3)``, metres."""
        return np.asarray(self.centres + travel[:, :, None] * self.slides)


def free_joints(tree: Tree, spheres: Spheres, travel: Array, p: Array) -> Array:
    """Return the free joints ``(N, n)``, in the order of ``tree.free``, of legs without errors that
    hold the platform unturned at ``p`` ``(N, 3)`` with carriages at ``travel`` ``(N, 3)``, metres.

    With the leg's span ``w`` from carriage to platform in its axes (a, b, c), the bars lie along
    ``L (-cos theta cos phi, -sin theta cos phi, sin phi)``; relief joints start at zero. The angles
    of a leg out of reach are clipped; the closure then fails and reports the misfit.
    """
    spans = p[:, None] - spheres.centres_at(travel)
    passive = [_passive_angles(tree, spheres.lengths[leg], leg, spans[:, leg]) for leg in range(3)]
    relief = np.zeros((len(p), 3 * len(RELIEF_NAMES) if len(tree.relief) else 0))
    return np.concatenate([*passive, relief], axis=1)


def commands(spheres: Spheres, p: Array) -> Array:
    """Return commands ``(N, 3)`` of legs without errors that hold the TCP at ``p`` ``(N, 3)``.

    Raises:
        UnreachableError: naming the leg that is too short and its farthest point, or the point
            farthest beyond the plane of the carriages.
    """
    reach = p[:, None] - spheres.centres_at(np.zeros((1, 3)))  # from each leg's sphere at zero
    along = np.einsum("nli,li->nl", reach, spheres.slides)
    # Far points overflow a square.
    across = np.hypot.reduce(np.cross(reach, spheres.slides), axis=-1)
    excess = across - spheres.lengths
    short_legs = np.flatnonzero((excess >= 0).any(axis=0))
    if short_legs.size:
        leg, worst = int(short_legs[0]), int(np.argmax(excess[:, short_legs[0]]))
        size = float(excess[worst, leg])
        excess_text = f"{size * 1e3:.3f}" if size < 1e3 else f"{size * 1e3:g}"
        distance = float(np.hypot.reduce(p[worst]))
        name, hint = spheres.names[leg], f": {_NEARER_REMEDY}"
        if distance > _FAR * spheres.lengths[leg]:
            hint = f" for a point {distance:g} m away: {UNITS_REMEDY}"
        message = f"{_point_prefix(worst, p)}leg {name} is {excess_text} mm too short{hint}"
        raise UnreachableError(message, leg=name, excess=size, index=(worst,))
    travel = along + np.sqrt(spheres.lengths**2 - across**2)
    normal, offset = _carriage_plane(spheres, spheres.centres_at(travel))
    beyond = np.sum(normal * p, axis=1) - offset
    if (beyond >= 0).any():
        worst = int(np.argmax(beyond))
        raise UnreachableError(
            f"{_point_prefix(worst, p)}the machine does not come to the far side of its "
            f"carriages: the tool would stand {beyond[worst] * 1e3:.3f} mm beyond their plane, in "
            f"the other assembly mode; {_NEARER_REMEDY}",
            excess=float(beyond[worst]),
            index=(worst,),
        )
    return np.asarray(spheres.zero + travel)


def _point_prefix(point: int, p: Array) -> str:
    return f"point {point + 1}: " if len(p) > 1 else ""


def _passive_angles(tree: Tree, length: float, leg: int, span: Array) -> Array:
    model, name = tree.model, tree.leg_names[leg]
    slide, pivot = (
        model.jointPlacements[model.getJointId(f"{name}_{j}")] for j in ("slide", "theta")
    )
    lean = np.arctan2(pivot.rotation[1, 0], pivot.rotation[0, 0])
    a, b, c = np.moveaxis(span @ slide.rotation, -1, 0)
    phi = np.arcsin(np.clip(c / length, -1, 1))
    theta = np.arctan2(-b, -a) - lean
    by_name = {"theta": theta, "bar1": phi, "knuckle": -phi, "platform": -theta, "bar2": phi}
    return np.stack([by_name[name] for name in PASSIVE_NAMES], axis=1)


def tool_position(spheres: Spheres, travel: Array, mode: Mode = "machine") -> Array:
    """Return the TCP ``(N, 3)`` of legs without errors, where the three spheres meet, metres: one
    of two points, mirror images in the plane of the carriages at ``travel`` ``(N, 3)``.

    Returns:
        NaN where the legs do not meet, or the carriages stand in one line.
    """
    centres, squares = spheres.centres_at(travel), spheres.lengths**2
    u, v = centres[:, 1] - centres[:, 0], centres[:, 2] - centres[:, 0]
    w = np.cross(u, v)
    along_u = (np.sum(u * u, axis=1, keepdims=True) + squares[0] - squares[1]) / 2
    along_v = (np.sum(v * v, axis=1, keepdims=True) + squares[0] - squares[2]) / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        foot = along_u * np.cross(v, w) + along_v * np.cross(w, u)
        foot /= np.sum(w * w, axis=1, keepdims=True)
        height = np.sqrt(squares[0] - np.sum(foot * foot, axis=1, keepdims=True))
        normal, _ = _carriage_plane(spheres, centres)
    return np.asarray(centres[:, 0] + foot + height * normal * (-1 if mode == "machine" else 1))


def assembly_mode(spheres: Spheres, travel: Array, p: Array) -> Mode | None:
    """Return the assembly mode of a machine with its TCP at ``p`` ``(3,)``.

    Errors of the parts are neglected in the plane of the carriages.

    Returns:
        ``None`` where the difference between the modes is rounding: the carriages stand in one
        line, or in one plane with the tool or the origin.
    """
    (centres,), length = spheres.centres_at(travel[None]), float(spheres.lengths.max())
    normal = np.cross(centres[1] - centres[0], centres[2] - centres[0]) / length**2
    far_side = spheres.slides[0] if spheres.hanging else centres[0] / length
    side = float(normal @ (p - centres[0])) / length * float(normal @ far_side)
    return None if abs(side) <= SIDE_ROUNDING else "machine" if side < 0 else "other"


def _carriage_plane(spheres: Spheres, centres: Array) -> tuple[Array, Array]:
    """Return the plane through the spheres' centres ``(N, leg, 3)``: unit normal and offset.

    The normal ``(N, 3)`` points away from the machine, which has ``normal . p < offset`` in its own
    assembly mode.
    """
    normal = np.cross(centres[:, 1] - centres[:, 0], centres[:, 2] - centres[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    offset = np.sum(normal * centres[:, 0], axis=-1)
    up = normal @ spheres.slides[0] if spheres.hanging else offset
    side = np.where(up < 0, -1.0, 1.0)
    return normal * side[:, None], offset * side
