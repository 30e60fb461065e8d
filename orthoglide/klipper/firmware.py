"""The firmware's numbers of a machine, and those that would serve it best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orthoglide.geometry import Array
from orthoglide.machine_file import Firmware

_STEPS = 30


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
