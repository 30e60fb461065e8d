"""The independent linear delta of the tests: a rigid platform on six bars, with numpy and scipy.

Everything is in the base frame: towers along z, tool at the origin at mechanical zero. A third
derivation beside the package's mechanism and its reduction; nothing here comes from the package.
Leg i has a = z (its slide), b = outward, c = counter-clockwise; bar 1 is on the + side of c.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
LEGS = "abc"
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class DeltaRig:
    """A linear delta with its errors, SI.

    Attributes:
        L, d, r, radius: arm, distance of its two rods, radius of the platform and of the towers.
        angles: of the towers, degrees.
        tool: tip from the middle of the platform's joints.
        stroke: travel from mechanical zero.
        errors: parameter name to value.
        bends: by leg, what its carriage's path has besides: ``(radial, tangential, up)`` of travel.
        turns: by leg, turn of its carriage about its rail, radians, of travel.
        bed: height of the plate besides its named shapes, of x and y.
    """

    L: float = 0.345
    d: float = 0.05
    r: float = 0.032
    radius: float = 0.195
    angles: tuple[float, float, float] = (210.0, 330.0, 90.0)
    tool: tuple[float, float, float] = (0.0, 0.0, -0.04)
    stroke: tuple[float, float] = (-0.14, 0.4)
    errors: Mapping[str, float] = field(default_factory=dict)
    bends: Mapping[str, Callable[[float], tuple[float, float, float]]] = field(default_factory=dict)
    turns: Mapping[str, Callable[[float], float]] = field(default_factory=dict)
    bed: Callable[[float, float], float] | None = None

    def _e(self, name: str) -> float:
        return float(self.errors.get(name, 0.0))

    def _ends(self, travel: Array) -> tuple[Array, Array, Array]:
        """Carriage ends ``(6, 3)``, platform ends from the tool ``(6, 3)``, lengths ``(6,)``."""
        height = np.sqrt(self.L**2 - (self.radius - self.r) ** 2)
        middle, half = np.mean(self.stroke), np.ptp(self.stroke) / 2
        A, B, length = [], [], []
        for k, name in enumerate(LEGS):
            t = np.deg2rad(self.angles[k])
            out = np.array([np.cos(t), np.sin(t), 0.0])
            c = np.cross(UP, out)
            s = travel[k] * (1 + self._e(f"encoder_scale.{name}")) + self._e(f"joint_offset.{name}")
            u = (s - middle) / half
            joint = self.r * out - np.array(self.tool)
            at = joint + (self.radius - self.r) * out + (height + s) * UP
            if name in self.bends:
                at = at + np.array(self.bends[name](travel[k])) @ np.stack([out, c, UP])
            turn = self.turns[name](travel[k]) * UP if name in self.turns else np.zeros(3)
            for way, axis in (("radial", out), ("tangential", c)):
                slope = self._e(f"axis_tilt.{name}.{way}") + self._e(f"rail_tilt.{name}.{way}")
                bow = self._e(f"rail_bow.{name}.{way}") * (u**2 - 1)
                at = at + (self._e(f"axis_offset.{name}.{way}") + slope * s + bow) * axis
                turn = turn + self._e(f"rail_tilt.{name}.{way}") * np.cross(UP, axis)
            turn = turn + self._e(f"rail_torsion.{name}") * u * UP
            turn = (
                turn + self._e(f"mount_tilt.{name}.a") * UP + self._e(f"mount_tilt.{name}.b") * out
            )
            link = c
            # About c, then about b, then about a: the carriage turns about a first, each in turn.
            for axis in (c, out, UP):
                link = Rotation.from_rotvec((turn @ axis) * axis).apply(link)
            wide = self.d + self._e(f"parallelogram_width.{name}")
            mean = self.L + self._e(f"leg_length.{name}")
            for side, bar in ((1, 0.5), (-1, -0.5)):
                A.append(at + side * self.d / 2 * link)
                B.append(joint + side * wide / 2 * c)
                length.append(mean + bar * self._e(f"bar_mismatch.{name}"))
        return np.array(A), np.array(B), np.array(length)

    def pose(self, travel: Array, near: Array) -> tuple[Array, Array]:
        """Tool ``(3,)`` and rotation vector ``(3,)`` at a travel ``(3,)``, from a place nearby."""
        A, B, length = self._ends(np.asarray(travel, dtype=float))

        def miss(x: Array) -> Array:
            ends = x[:3] + Rotation.from_rotvec(x[3:]).apply(B)
            return np.linalg.norm(ends - A, axis=1) - length

        start = np.concatenate([near, np.zeros(3)])
        found = least_squares(miss, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert np.abs(found.fun).max() < 1e-12
        return found.x[:3], found.x[3:]

    def plate(self, x: float, y: float, radius: float, name: str = "bed") -> float:
        """Height of a plate at a place, its shapes named over a radius."""
        u, v = x / radius, y / radius
        shapes = {"plate_bow.{}": u**2 + v**2, "plate_trefoil.{}.cos": u**3 - 3 * u * v**2,
                  "plate_trefoil.{}.sin": 3 * u**2 * v - v**3}  # fmt: skip
        own = sum(self._e(key.format(name)) * value for key, value in shapes.items())
        return own + (self.bed(x, y) if self.bed is not None else 0.0)

    def inverse(self, p: Array) -> Array:
        """Travel ``(3,)`` of the machine without errors at a tool's place ``(3,)``."""
        height = np.sqrt(self.L**2 - (self.radius - self.r) ** 2)
        found = []
        for angle in np.deg2rad(np.array(self.angles)):
            flat = (self.radius - self.r) * np.array([np.cos(angle), np.sin(angle)]) - p[:2]
            found.append(p[2] + np.sqrt(self.L**2 - flat @ flat) - height)
        return np.array(found)
