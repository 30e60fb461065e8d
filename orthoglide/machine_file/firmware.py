"""What the firmware of a delta believes of it, and where it sends the carriages for a place.

With tower i at angle t_i and the one radius R, arms A_i, endstops e_i above the plate, a carriage
at height h_i holds the nozzle at (x, y, z) where
``h_i = z + sqrt(A_i^2 - (R cos t_i - x)^2 - (R sin t_i - y)^2)``; at the endstop
``h_i = e_i + sqrt(A_i^2 - R^2)``, and stored positions count steps down from there.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.errors import InputError
from orthoglide.files import sha256
from orthoglide.geometry import Array, Geometry
from orthoglide.reduction.spheres import intersect_spheres

TOWERS = ("a", "b", "c")
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class DeltaKinematics:
    """Where a controller sends the carriages of a delta for a place of its tool: three spheres."""

    # where the tool stood if an arm hung straight down from its carriage at mechanical zero, and
    # had no length (3, 3), metres, by leg
    joints: Array
    arm: Array  # length of each leg's arm (3,), metres

    def travel(self, p: Array) -> Array:
        """Travel of the carriages from mechanical zero ``(n, 3)`` for places ``(n, 3)``, metres;
        nan where an arm does not reach.
        """
        apart = p[:, None] - self.joints
        square = self.arm**2 - np.sum(apart[:, :, :2] ** 2, axis=-1)
        return np.asarray(apart[:, :, 2] + np.sqrt(np.where(square > 0, square, np.nan)))

    def places(self, travel: Array) -> Array:
        """Places of the tool ``(n, 3)`` at a travel ``(n, 3)``, metres.

        Raises:
            UnreachableError: where the arms do not meet.
        """
        centres = self.joints + travel[:, :, None] * np.array([0.0, 0.0, 1.0])
        return intersect_spheres(centres, self.arm)

    @classmethod
    def of(cls, geometry: Geometry) -> DeltaKinematics:
        """Of the nominal machine."""
        joints = [leg.carriage - leg.platform for leg in geometry.legs]
        return cls(np.array(joints), np.full(3, geometry.L))


@dataclass(frozen=True)
class Firmware:
    """The numbers of ``[printer]`` and ``[stepper_*]``."""

    # horizontal distance from nozzle to tower joints with the nozzle in the centre, metres
    delta_radius: float
    angle: Triple  # of the towers, degrees
    arm: Triple  # length of the arms, metres
    endstop: Triple  # height of the nozzle in the centre with this carriage at its endstop, metres

    @property
    def at_endstop(self) -> Array:
        """Height of the carriages at their endstops ``(3,)``, metres."""
        return np.array(self.endstop) + np.sqrt(np.array(self.arm) ** 2 - self.delta_radius**2)

    @property
    def mean_arm(self) -> float:
        """What the machine file has as the length of its bars, metres."""
        return round(float(np.mean(self.arm)), 6)

    @property
    def zero(self) -> float:
        """Height of the carriages at mechanical zero of the machine file, metres."""
        return float(np.sqrt(self.mean_arm**2 - self.delta_radius**2))

    @property
    def towers(self) -> Array:
        """Where the towers stand ``(3, 2)``, metres."""
        turn = np.deg2rad(np.array(self.angle))
        return self.delta_radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)

    def heights(self, p: Array) -> Array:
        """Heights of the carriages ``(n, 3)`` that the firmware commands for points ``(n, 3)``.

        Raises:
            InputError: for points out of its arms' reach.
        """
        found = self._kinematics(0.0).travel(p)
        if np.isnan(found).any():
            raise InputError("a point lies out of the reach of the arms that the firmware knows")
        return found

    def points(self, heights: Array) -> Array:
        """Where the firmware believes the nozzle is ``(n, 3)``, for heights ``(n, 3)``.

        Raises:
            UnreachableError: where its arms do not meet.
        """
        return self._kinematics(0.0).places(heights)

    @property
    def kinematics(self) -> DeltaKinematics:
        """Where it sends the carriages, from mechanical zero of the machine file."""
        return self._kinematics(self.zero)

    def _kinematics(self, height: float) -> DeltaKinematics:
        """The same where travel counts from a height, metres."""
        joints = np.column_stack([self.towers, np.full(3, height)])
        return DeltaKinematics(joints, np.array(self.arm))

    def as_dict(self) -> dict[str, Any]:
        """As provenance keeps it, millimetres and degrees."""
        return {
            "delta_radius_mm": _mm(self.delta_radius),
            "angle_deg": [round(v, 9) for v in self.angle],
            "arm_length_mm": [_mm(v) for v in self.arm],
            "position_endstop_mm": [_mm(v) for v in self.endstop],
        }

    @property
    def mark(self) -> str:
        """What tells these numbers from others, short; no spreadsheet takes it for a number."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        return f"klipper-{sha256(text.encode())[:8]}"

    @classmethod
    def of(cls, found: Mapping[str, Any]) -> Firmware:
        """From provenance."""
        return cls(
            float(found["delta_radius_mm"]) * 1e-3,
            _three(found["angle_deg"], 1.0),
            _three(found["arm_length_mm"], 1e-3),
            _three(found["position_endstop_mm"], 1e-3),
        )

    def sections(self) -> dict[str, dict[str, str]]:
        """Sections of a ``printer.cfg``, each with its keys and their values."""
        found = {"[printer]": {"delta_radius": f"{self.delta_radius * 1e3:.6f}"}}
        for k, name in enumerate(TOWERS):
            found[f"[stepper_{name}]"] = {
                "angle": f"{self.angle[k]:.6f}",
                "arm_length": f"{self.arm[k] * 1e3:.6f}",
                "position_endstop": f"{self.endstop[k] * 1e3:.6f}",
            }
        return found

    def lines(self) -> list[str]:
        """As a ``printer.cfg`` has it."""
        return [
            line
            for section, keys in self.sections().items()
            for line in (section, *(f"{key}: {value}" for key, value in keys.items()))
        ]


def _three(values: Iterable[Any], unit: float) -> Triple:
    a, b, c = (float(v) * unit for v in values)
    return a, b, c


def _mm(metres: float) -> float:
    return round(metres * 1e3, 9)
