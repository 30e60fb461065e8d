"""The independent linear delta of the tests: a rigid platform on six bars, with numpy and scipy.

Everything is in the base frame: towers along z, tool at the origin at mechanical zero. A third
derivation beside the package's mechanism and its reduction; nothing here comes from the package.
Leg i has a = z (its slide), b = outward, c = counter-clockwise; bar 1 is on the + side of c.

Rails, brackets and bends follow the true travel: that which a drive reaches with all its errors and
under the load. The force on a drive is the load's virtual work on its carriage, in the loaded pose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.rig import rotation

Array = NDArray[np.float64]
LEGS = "abc"
UP = np.array([0.0, 0.0, 1.0])
ON_LEG = (
    "joint_offset", "encoder_scale", "backlash", "drive_compliance", "rail_torsion", "leg_length",
    "bar_mismatch", "parallelogram_width", "thermal_growth", "thermal_drift",
)  # fmt: skip
WITH_MEMBERS = {
    "screw_error": ("sin", "cos"),
    "mount_tilt": ("a", "b"),
    **dict.fromkeys(
        ("axis_offset", "axis_tilt", "rail_tilt", "rail_bow"), ("radial", "tangential")
    ),
}
ON_PLATE = (
    "plate_bow.{}", "plate_trefoil.{}.cos", "plate_trefoil.{}.sin", "plate_saddle.{}.cos",
    "plate_saddle.{}.sin", "plate_ring.{}",
)  # fmt: skip


def parameter_names(plates: tuple[str, ...] = ()) -> Iterator[str]:
    """Every parameter of a rig, those of the plates given included."""
    for leg in LEGS:
        yield from (f"{family}.{leg}" for family in ON_LEG)
        for family, members in WITH_MEMBERS.items():
            yield from (f"{family}.{leg}.{member}" for member in members)
    yield from (shape.format(plate) for plate in plates for shape in ON_PLATE)


@dataclass(frozen=True)
class DeltaRig:
    """A linear delta with its errors, SI.

    Attributes:
        L, d, r, radius: arm, distance of its two rods, radius of the platform and of the towers.
        angles: of the towers, degrees.
        tool: tip from the middle of the platform's joints.
        stroke: travel from mechanical zero.
        errors: parameter name to value.
        screw_pitch: lead of the drives' screws; 0 without screws.
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
    screw_pitch: float = 0.0
    bends: Mapping[str, Callable[[float], tuple[float, float, float]]] = field(default_factory=dict)
    turns: Mapping[str, Callable[[float], float]] = field(default_factory=dict)
    bed: Callable[[float, float], float] | None = None

    def _e(self, name: str) -> float:
        return float(self.errors.get(name, 0.0))

    def __post_init__(self) -> None:
        plates = tuple({n.split(".")[1] for n in self.errors if n.startswith("plate_")})
        unknown = set(self.errors) - set(parameter_names(plates))
        assert not unknown, f"the delta has no parameters {sorted(unknown)}"
        waves = any(v for n, v in self.errors.items() if n.startswith("screw_error"))
        assert self.screw_pitch or not waves, "a screw error needs a pitch"

    def _travel(self, told: Array, approach: Array) -> Array:
        """Travel ``(3,)`` that the drives reach without a load."""
        reached = np.zeros(3)
        for k, name in enumerate(LEGS):
            reached[k] = told[k] * (1 + self._e(f"encoder_scale.{name}"))
            # Half of the lost motion behind the command, on the side where the drive came from.
            reached[k] += self._e(f"joint_offset.{name}") - self._e(f"backlash.{name}") * (
                approach[k] / 2
            )
            if self.screw_pitch:
                turned = 2 * np.pi * told[k] / self.screw_pitch
                reached[k] += self._e(f"screw_error.{name}.sin") * np.sin(turned)
                reached[k] += self._e(f"screw_error.{name}.cos") * np.cos(turned)
        return reached

    def _lengths(self, time: float, warming: float) -> Array:
        """Of the six bars ``(6,)``."""
        length = []
        for name in LEGS:
            grown = self._e(f"thermal_growth.{name}") * warming
            grown += self._e(f"thermal_drift.{name}") * time
            mean = (self.L + self._e(f"leg_length.{name}")) * (1 + grown)
            half = self._e(f"bar_mismatch.{name}") / 2
            length += [mean + half, mean - half]
        return np.array(length)

    def _ends(self, told: Array, reached: Array) -> tuple[Array, Array]:
        """Carriage ends ``(6, 3)`` and platform ends from the tool ``(6, 3)``."""
        height = np.sqrt(self.L**2 - (self.radius - self.r) ** 2)
        middle, half = np.mean(self.stroke), np.ptp(self.stroke) / 2
        A, B = [], []
        for k, name in enumerate(LEGS):
            t = np.deg2rad(self.angles[k])
            out = np.array([np.cos(t), np.sin(t), 0.0])
            c = np.cross(UP, out)
            s = reached[k]
            u = (s - middle) / half
            joint = self.r * out - np.array(self.tool)
            at = joint + (self.radius - self.r) * out + (height + s) * UP
            if name in self.bends:
                at = at + np.array(self.bends[name](told[k])) @ np.stack([out, c, UP])
            turn = self.turns[name](told[k]) * UP if name in self.turns else np.zeros(3)
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
                link = rotation((turn @ axis) * axis) @ link
            wide = self.d + self._e(f"parallelogram_width.{name}")
            for side in (1, -1):
                A.append(at + side * self.d / 2 * link)
                B.append(joint + side * wide / 2 * c)
        return np.array(A), np.array(B)

    def pose(
        self,
        travel: Array,
        near: Array,
        *,
        approach: Array | float = 0.0,
        time: float = 0.0,
        warming: float = 0.0,
        load: float = 0.0,
    ) -> tuple[Array, Array]:
        """Tool ``(3,)`` and rotation vector ``(3,)`` at a travel ``(3,)``, from a place nearby.

        Args:
            travel: commanded.
            near: place of the tool to start from.
            approach: direction of each drive's last move ``(3,)``: +1, -1 or 0 (unknown).
            time: seconds.
            warming: kelvin since the first reading.
            load: newtons at the tool along base -z.
        """
        told = np.asarray(travel, dtype=float)
        free = self._travel(told, np.broadcast_to(approach, 3))
        length, reached = self._lengths(time, warming), free
        give = np.array([self._e(f"drive_compliance.{name}") for name in LEGS])
        start = np.concatenate([near, np.zeros(3)])
        for _ in range(20):
            A, B = self._ends(told, reached)
            start = self._closed(A, B, length, start)
            before = reached
            if load and give.any():
                reached = free + give * self._forces(told, reached, B, start, load)
            if np.abs(reached - before).max() < 1e-15:
                return start[:3], start[3:]
        raise AssertionError("the loaded pose was not found")

    def _closed(self, A: Array, B: Array, length: Array, start: Array) -> Array:
        """Tool and rotation vector ``(6,)`` where all bars have their lengths, by Newton."""
        place, R = start[:3], rotation(start[3:])
        for _ in range(30):
            arm = B @ R.T
            bar = place + arm - A
            size = np.linalg.norm(bar, axis=1)
            along = bar / size[:, None]
            rows = np.concatenate([along, np.cross(arm, along)], axis=1)
            step = np.linalg.solve(rows, length - size)
            place, R = place + step[:3], rotation(step[3:]) @ R
            if np.abs(step).max() < 1e-13:
                break
        assert np.abs(size - length).max() < 1e-12
        return np.concatenate([place, Rotation.from_matrix(R).as_rotvec()])

    def _forces(self, told: Array, reached: Array, B: Array, at: Array, load: float) -> Array:
        """Force on each drive ``(3,)`` along its travel, newtons: what its bars pull there.

        The bars' tensions hold the platform against the load; they do work where the carriage's
        ends move with the drive, which a turning carriage does too.
        """
        A, _ = self._ends(told, reached)
        arms = Rotation.from_rotvec(at[3:]).apply(B)
        pull = arms + at[:3] - A  # of a bar on its carriage
        pull /= np.linalg.norm(pull, axis=1)[:, None]
        balance = np.concatenate([pull, np.cross(arms, pull)], axis=1).T
        tension = np.linalg.solve(balance, np.concatenate([-load * UP, np.zeros(3)]))
        step, work = 1e-6, np.zeros(3)
        for k in range(3):
            moved = step * np.eye(3)[k]
            ends = [self._ends(told, reached + s * moved)[0] for s in (1, -1)]
            path = (ends[0] - ends[1]) / (2 * step)
            work[k] = float(np.sum(tension[:, None] * pull * path))
        return work

    def plate(self, x: float, y: float, radius: float, name: str = "bed") -> float:
        """Height of a plate at a place, its shapes named over a radius."""
        u, v = x / radius, y / radius
        three, two = (u + 1j * v) ** 3, (u + 1j * v) ** 2
        ring = 4 * (abs(two) ** 2 - abs(two))  # zero in the middle and at the rim
        shapes = (abs(two), three.real, three.imag, two.real, two.imag, ring)
        own = sum(
            self._e(key.format(name)) * value for key, value in zip(ON_PLATE, shapes, strict=True)
        )
        return own + (self.bed(x, y) if self.bed is not None else 0.0)

    def inverse(self, p: Array) -> Array:
        """Travel ``(3,)`` of the machine without errors at a tool's place ``(3,)``."""
        height = np.sqrt(self.L**2 - (self.radius - self.r) ** 2)
        found = []
        for angle in np.deg2rad(np.array(self.angles)):
            flat = (self.radius - self.r) * np.array([np.cos(angle), np.sin(angle)]) - p[:2]
            found.append(p[2] + np.sqrt(self.L**2 - flat @ flat) - height)
        return np.array(found)
