"""Three legs given freely: position of each carriage, direction of its slide and short links."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from orthoglide.arguments import public
from orthoglide.errors import InputError
from orthoglide.layout.leg import Array, Layout, Leg, LegNames, Triple, triple
from orthoglide.parameters import MEMBERS
from orthoglide.text import abbreviated

_SMALLEST_BAR_DISTANCE = 1.6e-4
"""Fraction of the bars' length by which lengths may be off: circles of bars and platform that touch
to within that count as touching. Else the joint would lie off the line of centres by the root of
the error: with bars of 300 mm a millimetre for 0.02 mm."""

_PERPENDICULAR_TOLERANCE = 1e-6
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,19}")  # parts of joints' and parameters' names
_PARALLEL_TOLERANCE = 1e-9
_SLIDE_END_WORDS = (("back", "backward along the slide"), ("on", "onward along the slide"))


@public
@dataclass(frozen=True)
class FreeLeg:
    """One leg at mechanical zero, in the base frame, the tool at the origin.

    Attributes:
        name: of the leg.
        origin: the carriage's joint, metres.
        slide: direction of its travel, away from the platform.
        link: direction of its short links, across the slide.
    """

    name: str
    origin: Triple
    slide: Triple
    link: Triple

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(
                f"layout: a leg cannot be called {abbreviated(self.name)!r}: take up to 20 letters "
                f"(a to z) and digits"
            )
        if self.name in MEMBERS:
            raise InputError(
                f"layout: a leg cannot be called {self.name!r}, as structured parameters are: take "
                f"another name"
            )
        for name in ("origin", "slide", "link"):
            values = triple(f"leg {self.name}: {name}", getattr(self, name))
            object.__setattr__(self, name, values)

    @cached_property
    def axes(self) -> Array:
        """Rotation ``(3, 3)`` with the leg's axes as columns.

        Raises:
            InputError: where slide and link are no two directions at right angles.
        """
        a, c = np.array(self.slide), np.array(self.link)
        if min(np.linalg.norm(a), np.linalg.norm(c)) < _PERPENDICULAR_TOLERANCE:
            raise InputError(f"leg {self.name}: slide and link must be directions, not 0")
        a, c = a / np.linalg.norm(a), c / np.linalg.norm(c)
        if abs(a @ c) > _PERPENDICULAR_TOLERANCE:
            raise InputError(
                f"leg {self.name}: its link must lie across its slide, and they are "
                f"{np.rad2deg(np.arccos(np.clip(a @ c, -1, 1))):.4g} degrees apart"
            )
        c -= (a @ c) * a
        c /= np.linalg.norm(c)
        return np.stack([a, np.cross(c, a), c], axis=1)


@public
@dataclass(frozen=True)
class FreeLegs(Layout):
    """Legs wherever they are; commands are travel from mechanical zero along the slides.

    The bars of a leg are perpendicular to its short links at mechanical zero, where the platform is
    not rotated. Its joint at the platform therefore lies in the plane through the carriage's joint
    perpendicular to the link, at distance L from that joint and r from the platform's middle. Of
    the two solutions the one nearer to the plane across the slide through that middle counts.

    Attributes:
        free: the three legs.
        tool: the tool's tip from the middle of the platform's joints, metres.
    """

    free: tuple[FreeLeg, FreeLeg, FreeLeg]
    tool: Triple = (0.0, 0.0, 0.0)

    kind: ClassVar[str] = "legs"

    def __post_init__(self) -> None:
        names = [leg.name for leg in self.free]
        if not len(set(names)) == len(names) == 3:
            raise InputError(f"layout: three legs need three names, not {', '.join(names)}")
        object.__setattr__(self, "tool", triple("layout: tool", self.tool))
        for leg in self.free:
            _ = leg.axes  # raises an error for invalid directions

    @cached_property
    def names(self) -> LegNames:
        """Names of the legs as given; directions are ``b`` and ``c`` of each leg."""
        one, two, three = (leg.name for leg in self.free)
        entries = ("zero", "bar_length", *["place"] * self.hanging)
        return LegNames((one, two, three), (("b", "c"),) * 3, entries, _SLIDE_END_WORDS)

    @cached_property
    def hanging(self) -> bool:
        """Whether all slides are parallel."""
        slides = np.stack([leg.axes[:, 0] for leg in self.free])
        return bool((slides @ slides[0] > 1 - _PARALLEL_TOLERANCE).all())

    def legs(self, L: float, r: float) -> tuple[Leg, Leg, Leg]:
        """The three legs for bars of length ``L`` and a platform of radius ``r``, metres."""
        one, two, three = (self._leg(leg, L, r) for leg in self.free)
        return one, two, three

    def _leg(self, leg: FreeLeg, L: float, r: float) -> Leg:
        carriage, middle = np.array(leg.origin), -np.array(self.tool)
        # In the leg's axes from the platform's middle: the carriage, the radius of the platform's
        # circle, and the distance toward the carriage at which the bars' circle intersects it.
        a, b, c = (carriage - middle) @ leg.axes
        distance, radius = float(np.hypot(a, b)), float(np.sqrt(max(r**2 - c**2, 0.0)))
        along = (distance**2 + radius**2 - L**2) / (2 * distance) if distance > 0 else np.inf
        if abs(c) > r or not -radius <= along <= radius + _SMALLEST_BAR_DISTANCE * L:
            raise InputError(
                f"leg {leg.name}: bars of {L * 1e3:g} mm do not reach from its origin to a joint "
                f"{r * 1e3:g} mm from the platform's middle across its link: correct one of them"
            )
        touches = along > radius - _SMALLEST_BAR_DISTANCE * L
        along, across = (distance - L, 0.0) if touches else (along, np.sqrt(radius**2 - along**2))
        # In the leg's plane (a, b): along the line to the carriage, and to either side of it.
        joints = [
            np.array([along * a - side * across * b, along * b + side * across * a]) / distance
            for side in (1.0, -1.0)
        ]
        joint = min(joints, key=lambda place: abs(place[0]))
        if a - joint[0] <= 0:
            raise InputError(f"leg {leg.name}: its slide points toward the platform: turn it round")
        platform = middle + leg.axes @ np.array([joint[0], joint[1], c])
        return Leg(leg.name, carriage, platform, leg.axes)

    def points(self, L: float, r: float, stroke: tuple[float, float], count: int) -> Array | None:
        """Return a cube about mechanical zero with ``count`` points along each edge, whose edge is
        the shorter side of the ``stroke``, whatever ``L`` and ``r`` are.
        """
        side = np.linspace(-0.5, 0.5, count) * min(-stroke[0], stroke[1])
        return np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
