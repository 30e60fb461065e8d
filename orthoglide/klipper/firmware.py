"""What the firmware believes of a delta, its equations, and the numbers that would serve it best.

With tower i at angle t_i and the one radius R, arms A_i, endstops e_i above the plate, a carriage
at height h_i holds the nozzle at (x, y, z) where
``h_i = z + sqrt(A_i^2 - (R cos t_i - x)^2 - (R sin t_i - y)^2)``; at the endstop
``h_i = e_i + sqrt(A_i^2 - R^2)``, and stored positions count steps down from there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orthoglide.errors import InputError
from orthoglide.files import sha256
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.reduction.spheres import intersect_spheres

TOWERS = ("a", "b", "c")
Triple = tuple[float, float, float]

_STEPS = 30


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
        flat = p[:, None, :2] - self.towers
        square = np.array(self.arm) ** 2 - np.sum(flat**2, axis=-1)
        if not (square > 0).all():
            raise InputError("a point lies out of the reach of the arms that the firmware knows")
        return np.asarray(p[:, 2:] + np.sqrt(square))

    def points(self, heights: Array) -> Array:
        """Where the firmware believes the nozzle is ``(n, 3)``, for heights ``(n, 3)``.

        Raises:
            UnreachableError: where its arms do not meet.
        """
        centres = np.concatenate(
            [np.broadcast_to(self.towers, (len(heights), 3, 2)), heights[:, :, None]], axis=2
        )
        return intersect_spheres(centres, np.array(self.arm))

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
        a, b, c = (
            tuple(float(v) * unit for v in found[key])
            for key, unit in (
                ("angle_deg", 1.0), ("arm_length_mm", 1e-3), ("position_endstop_mm", 1e-3),
            )
        )  # fmt: skip
        return cls(float(found["delta_radius_mm"]) * 1e-3, _three(a), _three(b), _three(c))

    def lines(self) -> list[str]:
        """As a ``printer.cfg`` has it."""
        found = ["[printer]", f"delta_radius: {self.delta_radius * 1e3:.6f}"]
        for name, angle, arm, endstop in zip(
            TOWERS, self.angle, self.arm, self.endstop, strict=True
        ):
            found += [
                f"[stepper_{name}]", f"angle: {angle:.6f}", f"arm_length: {arm * 1e3:.6f}",
                f"position_endstop: {endstop * 1e3:.6f}",
            ]  # fmt: skip
        return found


def firmware_of(machine: Machine) -> Firmware | None:
    """What the firmware believes of a machine that was imported; ``None`` of another."""
    kept = machine.spec.provenance.get("klipper")
    if not isinstance(kept, Mapping):
        return None
    try:
        return Firmware.of(kept)
    except (KeyError, TypeError, ValueError):  # the table was edited
        return None


def _three(values: tuple[float, ...]) -> Triple:
    a, b, c = values
    return a, b, c


def _mm(metres: float) -> float:
    return round(metres * 1e3, 9)


FITTED = 6
"""Numbers that are fitted: three endstops, the radius, two angles; arms and one angle stay."""


def shifted(old: Firmware, by: Array) -> Firmware:
    """Other numbers by ``(6,)``: endstops and radius, metres; angles of a and b, radians."""
    a, b, c = (e + d for e, d in zip(old.endstop, by[:3].tolist(), strict=True))
    turned = np.rad2deg(by[4:])
    angle = (old.angle[0] + float(turned[0]), old.angle[1] + float(turned[1]), old.angle[2])
    return replace(
        old, endstop=(a, b, c), delta_radius=old.delta_radius + float(by[3]), angle=angle
    )


SIDEWAYS = 0.03
"""Weight of an error along the plate against one of height: prints are a tenth of a millimetre
high, and what a probe says of the tool's place along the plate is uncertain."""


def refitted(
    old: Firmware, points: Array, below: Array, known: Array | None = None
) -> tuple[Firmware, Array]:
    """The numbers with which the firmware brings its nozzle nearest to points.

    Weighted least squares on where it then believes the nozzle is, by Gauss-Newton.

    Args:
        old: its present numbers.
        points: wanted ``(n, 3)``, metres.
        below: where the carriages stand when the tool is truly there, from their endstops
            (negative: below) ``(n, 3)``, metres.
        known: weight of each point ``(n,)``; all count alike if ``None``.

    Returns:
        The new numbers, and how far it then believes to be from the points ``(n, 3)``, metres.
    """
    each = np.ones(len(points)) if known is None else known / known.max()
    weight = each[:, None] * np.array([SIDEWAYS, SIDEWAYS, 1.0])

    def miss(firmware: Firmware) -> Array:
        return firmware.points(below + firmware.at_endstop) - points

    new, width = old, 1e-6
    for _ in range(_STEPS):
        columns = [
            (miss(shifted(new, width * e)) - miss(shifted(new, -width * e))) * weight / (2 * width)
            for e in np.eye(FITTED)
        ]
        matrix = np.stack(columns, axis=-1).reshape(-1, FITTED)
        right = -(miss(new) * weight).reshape(-1)
        step = np.linalg.lstsq(matrix, right, rcond=None)[0]
        new = shifted(new, np.asarray(step, dtype=float))
        if np.abs(step).max() < 1e-11:
            break
    return new, miss(new)
