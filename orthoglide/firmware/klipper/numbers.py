"""The firmware's numbers of a delta, and its equations.

With tower i at angle t_i and the one radius R, arms A_i, endstops e_i above the plate, a carriage
at height h_i has the nozzle at (x, y, z) where
``h_i = z + sqrt(A_i^2 - (R cos t_i - x)^2 - (R sin t_i - y)^2)``; at the endstop
``h_i = e_i + sqrt(A_i^2 - R^2)``, and stored positions count steps down from there
(klippy/kinematics/delta.py).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.files import sha256
from orthoglide.firmware.klipper.config import Config
from orthoglide.geometry import Array
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import DeltaKinematics

TOWERS = LinearDelta.names.legs
_DEFAULT_ANGLES = (210.0, 330.0, 90.0)  # degrees at which the towers stand where nothing is given
_MAX_ARM_DIFFERENCE = 0.05
"""Largest relative difference of two arms: those that firmware found on owners' printers differ by
half a per cent, by more after a wrong distance."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Numbers:
    """The numbers of ``[printer]`` and ``[stepper_*]``."""

    # horizontal distance from nozzle to tower joints with the nozzle in the centre, metres
    delta_radius: float
    angle: Triple  # of the towers, degrees
    arm: Triple  # lengths of the arms, metres
    endstop: Triple  # height of the nozzle in the centre with this carriage at its endstop, metres

    @property
    def at_endstop(self) -> Array:
        """Height of the carriages at their endstops ``(3,)``, metres."""
        return np.array(self.endstop) + np.sqrt(np.array(self.arm) ** 2 - self.delta_radius**2)

    @property
    def mean_arm(self) -> float:
        """Length of the bars in the machine file, metres."""
        return round(float(np.mean(self.arm)), 6)

    @property
    def zero(self) -> float:
        """Height of the carriages at mechanical zero of the machine file, metres."""
        return float(np.sqrt(self.mean_arm**2 - self.delta_radius**2))

    @property
    def are_nominal(self) -> bool:
        """Whether no calibration has changed them: default angles, equal endstops."""
        return self.angle == _DEFAULT_ANGLES and len(set(self.endstop)) == 1

    def heights(self, p: Array) -> Array:
        """Return commanded heights of the carriages ``(n, 3)`` for points ``(n, 3)``, metres; nan
        where an arm does not reach.
        """
        return self.kinematics(0.0).travel(p)

    def points(self, heights: Array) -> Array:
        """Return places of the nozzle ``(n, 3)`` for heights of the carriages ``(n, 3)``, metres.

        Raises:
            UnreachableError: if the arms do not meet.
        """
        return self.kinematics(0.0).places(heights)

    def kinematics(self, height: float) -> DeltaKinematics:
        """Return the firmware's kinematics, with travel counted from a height, metres."""
        turn = np.deg2rad(np.array(self.angle))
        towers = self.delta_radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return DeltaKinematics(np.column_stack([towers, np.full(3, height)]), np.array(self.arm))

    def changed(self, change: Array) -> Numbers:
        """Return the numbers changed by ``(6,)``: endstops and radius, metres, angles of a and b,
        radians; or by ``(9,)``, with the arms, metres.
        """
        arm_change = change[6:] if len(change) > 6 else np.zeros(3)
        return Numbers(
            self.delta_radius + float(change[3]),
            _triple(np.array(self.angle) + np.rad2deg([*change[4:6], 0.0])),
            _triple(np.array(self.arm) + arm_change),
            _triple(np.array(self.endstop) + change[:3]),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as a machine file keeps them, millimetres and degrees."""
        return {
            "delta_radius_mm": round(self.delta_radius * 1e3, 9),
            "angle_deg": [round(v, 9) for v in self.angle],
            "arm_length_mm": [round(v * 1e3, 9) for v in self.arm],
            "position_endstop_mm": [round(v * 1e3, 9) for v in self.endstop],
        }

    @property
    def mark(self) -> str:
        """Short identifier of these numbers, which no spreadsheet takes for a number."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        return f"klipper-{sha256(text.encode())[:8]}"

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Numbers:
        """Return the numbers that a machine file keeps.

        Raises:
            KeyError, TypeError, ValueError: if the table was edited.
        """
        return cls(
            float(table["delta_radius_mm"]) * 1e-3,
            _triple(table["angle_deg"]),
            _triple(table["arm_length_mm"], 1e-3),
            _triple(table["position_endstop_mm"], 1e-3),
        )

    @classmethod
    def read(cls, config: Config) -> Numbers:
        """Return the numbers of a file of a printer whose carriages run on three towers.

        Raises:
            FileError: if it is another printer, or a number is missing or contradicts the others.
        """
        printer = config.section("printer")
        kind = printer.entries["kinematics"].text if "kinematics" in printer else "delta"
        if kind.lower() != "delta":
            turning = ", arms that turn about shoulders" * kind.startswith("rotary")
            printer.fail(
                "kinematics",
                f"is {kind[:40]!r}{turning}, not 'delta': only printers whose carriages run on "
                f"three towers are imported, and calibrated",
            )
        radius = printer.number("delta_radius", low=10, high=5000) * 1e-3
        towers = [config.section(f"stepper_{name}") for name in TOWERS]
        arm = towers[0].number("arm_length", low=10, high=5000)
        endstop = towers[0].number("position_endstop", low=1, high=10000)
        arms = [tower.number("arm_length", arm, 10, 5000) * 1e-3 for tower in towers]
        ends = [tower.number("position_endstop", endstop, 1, 10000) * 1e-3 for tower in towers]
        for k, tower in enumerate(towers):
            if not 0.5 * ends[0] < ends[k] < 2 * ends[0]:
                tower.fail(
                    "position_endstop",
                    f"is {ends[k] * 1e3:g} mm, and that of tower {TOWERS[0]} {ends[0] * 1e3:g}: "
                    f"carriages of one machine stop at about one height; give both in millimetres",
                )
            if abs(arms[k] / arms[0] - 1) > _MAX_ARM_DIFFERENCE:
                tower.fail(
                    "arm_length",
                    f"is {arms[k] * 1e3:g} mm, and that of tower {TOWERS[0]} {arms[0] * 1e3:g}: "
                    f"arms of one machine are alike to a few millimetres; correct it, and where "
                    f"DELTA_ANALYZE found it, look for a mistyped distance and run that again",
                )
            if arms[k] <= 1.02 * radius:
                tower.fail(
                    "arm_length",
                    f"is {arms[k] * 1e3:g}, not longer than delta_radius "
                    f"({radius * 1e3:g}): are they exchanged?",
                )
        defaults = zip(towers, _DEFAULT_ANGLES, strict=True)
        angles = [tower.number("angle", angle, -720, 720) for tower, angle in defaults]
        return cls(radius, _triple(angles), _triple(arms), _triple(ends))

    @property
    def values(self) -> dict[tuple[str, str], str]:
        """Values of a ``printer.cfg`` by section and key."""
        values = {("[printer]", "delta_radius"): f"{self.delta_radius * 1e3:.6f}"}
        for k, name in enumerate(TOWERS):
            values[f"[stepper_{name}]", "angle"] = f"{self.angle[k]:.6f}"
            values[f"[stepper_{name}]", "arm_length"] = f"{self.arm[k] * 1e3:.6f}"
            values[f"[stepper_{name}]", "position_endstop"] = f"{self.endstop[k] * 1e3:.6f}"
        return values

    def lines(self) -> list[str]:
        """Return the lines of a ``printer.cfg``."""
        lines = list[str]()
        for (section, key), value in self.values.items():
            lines += [section] * (section not in lines)
            lines.append(f"{key}: {value}")
        return lines


def _triple(values: Iterable[Any], unit: float = 1.0) -> Triple:
    a, b, c = (float(v) * unit for v in values)
    return a, b, c
