"""The firmware's numbers, as the sections of its file have them."""

from __future__ import annotations

from orthoglide.klipper.config import Config
from orthoglide.machine_file import TOWERS, Firmware

ANGLES = (210.0, 330.0, 90.0)
"""Degrees at which the towers stand where nothing is said."""


def firmware_of(config: Config) -> Firmware:
    """Numbers of ``[printer]`` and ``[stepper_*]``.

    Raises:
        FileError: where one is missing, or not of one machine with the others.
    """
    printer = config.section("printer")
    radius = printer.number("delta_radius", low=10, high=5000) * 1e-3
    towers = [config.section(f"stepper_{name}") for name in TOWERS]
    first = towers[0]
    arm_a = first.number("arm_length", low=10, high=5000)
    endstop_a = first.number("position_endstop", low=1, high=10000)
    arms, ends, angles = [], [], []
    for tower, angle in zip(towers, ANGLES, strict=True):
        arms.append(tower.number("arm_length", arm_a, 10, 5000) * 1e-3)
        ends.append(tower.number("position_endstop", endstop_a, 1, 10000) * 1e-3)
        angles.append(tower.number("angle", angle, -720, 720))
        if not 0.5 * ends[0] < ends[-1] < 2 * ends[0]:
            tower.fail(
                "position_endstop",
                f"is {ends[-1] * 1e3:g} mm, and that of tower {TOWERS[0]} {ends[0] * 1e3:g}: "
                f"carriages of one machine stop at about one height; give both in millimetres",
            )
        if arms[-1] <= 1.02 * radius:
            tower.fail(
                "arm_length",
                f"is {arms[-1] * 1e3:g}, not longer than delta_radius "
                f"({radius * 1e3:g}): are they exchanged?",
            )
    (a, b, c), (d, e, f), (g, h, i) = arms, ends, angles
    return Firmware(radius, (g, h, i), (a, b, c), (d, e, f))
