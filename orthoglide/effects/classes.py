"""What to expect of machines by their class: belts and extrusions are no ground steel."""

from __future__ import annotations

from orthoglide.effects.catalogue import Catalogue
from orthoglide.units import to_si

_BELTS = {
    "joint_offset": 2.0, "leg_length": 0.05, "axis_offset": 1.0, "axis_tilt": 3e-3,
    "rail_tilt": 3e-3, "rail_bow": 0.1, "mount_tilt": 1e-2,
    "bar_mismatch": 0.05, "parallelogram_width": 0.3, "encoder_scale": 1e-2, "backlash": 0.05,
}  # fmt: skip
"""Standard deviations in the effects' own units; rods of one set are as even as anybody's. Belts
stretch, and a pulley's or a microstep's number is entered by hand: drives of three per cent too
much were reported."""


_ENTERED = {"leg_length": 1.0}
"""Standard deviations, in the effects' own units, of what parts of one set have in common where an
owner enters it: rods are even to a few hundredths, but their length is read off a rule or a shop's
page. Rods of 217 were entered as 234, 272 as 268, 288 as 270."""

CLASSES = ("laboratory", "belts")
"""Classes of machines: a carefully built one of ground steel, and belts on extrusions."""


def of_belts(catalogue: Catalogue) -> dict[str, float]:
    """Return the standard deviations to expect of a machine of belts, SI; others keep their own."""
    return {n: to_si(v, catalogue[n].unit.si) for n, v in _BELTS.items()}


def entered(catalogue: Catalogue) -> dict[str, float]:
    """Return the standard deviations to expect of what parts of one set have in common, SI."""
    return {n: to_si(v, catalogue[n].unit.si) for n, v in _ENTERED.items()}
