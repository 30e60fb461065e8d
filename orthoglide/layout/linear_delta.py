"""The linear delta: three parallel towers, the platform hanging below their carriages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orthoglide.arguments import public
from orthoglide.errors import InputError, as_float_array
from orthoglide.layout.leg import Array, Layout, Leg, LegNames, Triple, triple

_ACROSS = ("radial", "tangential")
_SLIDE_END_WORDS = (("down", "downward"), ("up", "upward"))
_CONTROLLER_ENTRIES = ("zero", "bar_length", "place")
_NOUN_REPLACEMENTS = (
    (r"\bjoint offset", "carriage offset"),
    (r"\baxis offset", "tower offset"),
    (r"\baxis tilt", "carriage path tilt"),
    (r"\bthe (\w) rail\b", r"tower \1"),
    (r"\brail(s?)\b", r"tower\1"),
    (r"\bbar(s?)\b", r"rod\1"),
    (r"\bplatform\b", "effector"),
    (r"\b(and|warms) (the )?leg\b", r"\1 \2rods"),  # what hangs on the carriage, which is no tower
    (r"\bleg(s?)\b", r"tower\1"),
)
_FLATTEST = float(np.sin(np.deg2rad(15.0)))
"""Sine of the least angle between arm and plate: flatter arms determine the tool's height badly,
and errors of some millimetres make them too short."""


@public
@dataclass(frozen=True)
class LinearDelta(Layout):
    """Towers along z around a plate; commands are travel from mechanical zero, up.

    The base frame's origin is where the nominal tool stands at mechanical zero, the centre of the
    plate. A leg's b points outward (``radial``), its c counter-clockwise (``tangential``).

    Attributes:
        radius: horizontal distance of each tower's carriage joints from the machine's middle, which
            is where the middle of the platform's joints stands at mechanical zero, metres; a single
            number is that of all three.
        angles_deg: of the towers from +x, counter-clockwise, degrees.
        tool: the tool's tip from the middle of the platform's joints, metres; z negative: below.
    """

    radius: Triple
    angles_deg: Triple = (210.0, 330.0, 90.0)
    tool: Triple = (0.0, 0.0, 0.0)

    kind: ClassVar[str] = "linear-delta"
    names: ClassVar[LegNames] = LegNames(
        ("a", "b", "c"), (_ACROSS, _ACROSS, _ACROSS), _CONTROLLER_ENTRIES, _SLIDE_END_WORDS,
        axis="tower", bar="rod", noun_replacements=_NOUN_REPLACEMENTS,
    )  # fmt: skip
    hanging: ClassVar[bool] = True

    def __post_init__(self) -> None:
        radius = as_float_array("layout: radius", self.radius)
        columns = {
            "radius": radius if radius.ndim else np.full(3, radius),
            "angles_deg": self.angles_deg,
            "tool": self.tool,
        }
        for name, values in columns.items():
            object.__setattr__(self, name, triple(f"layout: {name}", values))
        if not min(self.radius) > 0:
            raise InputError("layout: the radius of every tower must be a positive length")
        angles = np.sort(np.mod(self.angles_deg, 360.0))
        gaps = np.diff(angles, append=angles[0] + 360.0)
        if not (gaps.min() > 10.0 and gaps.max() < 175.0):
            stand = ", ".join(f"{v:g}" for v in self.angles_deg)
            raise InputError(
                f"layout: towers a, b, c at {stand} degrees do not stand around a plate, at least "
                f"10 degrees apart and on all sides: correct the angle of one"
            )
        if np.hypot(*self.tool[:2]) >= min(self.radius):
            raise InputError("layout: the tool must stand between the towers")

    def outward(self) -> Array:
        """Direction from the centre to each tower ``(3, 3)``, by leg."""
        angles = np.deg2rad(np.array(self.angles_deg))
        return np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)

    def legs(self, L: float, r: float) -> tuple[Leg, Leg, Leg]:
        """The three legs for bars of length ``L`` and a platform of radius ``r``, metres."""
        up, legs = np.array([0.0, 0.0, 1.0]), []
        for name, radius, out in zip(self.names.legs, self.radius, self.outward(), strict=True):
            platform = r * out - np.array(self.tool)
            height = L**2 - (radius - r) ** 2
            if not height > 0:
                raise InputError(
                    f"layout: arms of {L * 1e3:g} mm do not reach from tower {name} to the "
                    f"platform over the centre: correct L, radius_mm or r"
                )
            carriage = platform + (radius - r) * out + np.sqrt(height) * up
            axes = np.stack([up, out, np.cross(up, out)], axis=1)
            legs.append(Leg(name, carriage, platform, axes))
        a, b, c = legs
        return a, b, c

    def reach(self, L: float, r: float, lowest: float) -> float:
        """Return the radius on the plate within which all carriages stay above ``lowest`` and all
        arms are steeper than 15 degrees (or half as high as over the centre), metres.

        Args:
            L: length of the arms, metres.
            r: radius of the platform, metres.
            lowest: travel from mechanical zero, metres.
        """
        radii = []
        for leg in self.legs(L, r):
            height = leg.carriage[2] - leg.platform[2]
            horizontal = float(np.hypot(*(leg.carriage - leg.platform)[:2]))
            lowest_height = max(height + lowest, min(_FLATTEST * L, height / 2))
            radii.append(np.sqrt(L**2 - lowest_height**2) - horizontal)
        return float(min(radii))

    def points(self, L: float, r: float, stroke: tuple[float, float], count: int) -> Array | None:
        """Return points in a cylinder on the plate, as high as it is wide or as the towers allow.

        Args:
            L: length of the arms, metres.
            r: radius of the platform, metres.
            stroke: travel from mechanical zero, metres.
            count: of points along each axis, before those outside the cylinder are left out.
        """
        radius = self.reach(L, r, stroke[0])
        side = np.linspace(-radius, radius, count)
        heights = [leg.carriage[2] - leg.platform[2] for leg in self.legs(L, r)]
        headroom = float(stroke[1] - (L - min(heights)))  # above the far side of the plate
        z = np.linspace(0.0, min(2 * radius, max(headroom, 0.0)), count)
        grid = np.stack(np.meshgrid(side, side, z, indexing="ij"), axis=-1).reshape(-1, 3)
        return grid[np.hypot(grid[:, 0], grid[:, 1]) <= radius * (1 + 1e-9)]
