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
    """Other numbers by ``(6,)``: endstops and radius, metres; angles of a and b, radians; or
    ``(9,)``, with the arms, metres.
    """
    a, b, c = (e + d for e, d in zip(old.endstop, by[:3].tolist(), strict=True))
    turned, longer = np.rad2deg(by[4:6]), by[6:].tolist() or [0.0] * 3
    angle = (old.angle[0] + float(turned[0]), old.angle[1] + float(turned[1]), old.angle[2])
    d, e, f = (arm + more for arm, more in zip(old.arm, longer, strict=True))
    radius = old.delta_radius + float(by[3])
    return replace(old, endstop=(a, b, c), delta_radius=radius, angle=angle, arm=(d, e, f))


SIDEWAYS = 0.03
"""Weight of an error along the plate against one of height: prints are a tenth of a millimetre
high, and what a probe says of the tool's place along the plate is uncertain."""

MEASURED = 0.2
"""The same where distances were read: around the rim a calliper's is a fifth as good as a touch."""


def refitted(
    old: Firmware,
    points: Array,
    below: Array,
    known: Array | None = None,
    kept: Array | None = None,
    *,
    arms: bool = False,
) -> tuple[Firmware, Array]:
    """The numbers with which the firmware brings its nozzle nearest to points.

    Weighted least squares on where it then believes the nozzle is, by Gauss-Newton.

    Args:
        old: its present numbers.
        points: wanted ``(n, 3)``, metres.
        below: where the carriages stand when the tool is truly there, from their endstops
            (negative: below) ``(n, 3)``, metres.
        known: weight of each point ``(n,)``; all count alike if ``None``.
        kept: what of errors along the plate counts ``(2 n, 2 n)``; all if ``None``.
        arms: whether their lengths are fitted as well, as the firmware does by distances.

    Returns:
        The new numbers, and how far it then believes to be from the points ``(n, 3)``, metres.
    """
    each = np.ones(len(points)) if known is None else known / known.max()
    weight = np.append(each, (MEASURED if arms else SIDEWAYS) * np.repeat(each, 2))

    def miss(firmware: Firmware) -> Array:
        return firmware.points(below + firmware.at_endstop) - points

    def weighed(firmware: Firmware) -> Array:
        off = miss(firmware)
        ways = off[:, :2].ravel()
        return np.asarray(weight * np.append(off[:, 2], ways if kept is None else kept @ ways))

    new, width, count = old, 1e-6, FITTED + (len(old.arm) if arms else 0)
    for _ in range(_STEPS):
        columns = [
            (weighed(shifted(new, width * e)) - weighed(shifted(new, -width * e))) / (2 * width)
            for e in np.eye(count)
        ]
        step = np.linalg.lstsq(np.stack(columns, axis=-1), -weighed(new), rcond=None)[0]
        new = shifted(new, np.asarray(step, dtype=float))
        if np.abs(step).max() < 1e-11:
            break
    return new, miss(new)
