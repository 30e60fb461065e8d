"""What to expect of a printer bolted together from extrusions: wider than a careful machine."""

from __future__ import annotations

from orthoglide.effects.catalogue import Catalogue
from orthoglide.units import to_si

_OF_PRINTERS = {
    "joint_offset": 2.0, "leg_length": 0.05, "axis_offset": 1.0, "axis_tilt": 3e-3,
    "rail_tilt": 3e-3, "rail_bow": 0.1, "mount_tilt": 1e-2,
    "bar_mismatch": 0.05, "parallelogram_width": 0.3, "encoder_scale": 1e-3, "backlash": 0.05,
}  # fmt: skip
"""Standard deviations in the effects' own units; rods of one set are as even as anybody's."""


def of_printers(catalogue: Catalogue) -> dict[str, float]:
    """Standard deviation to expect of the effects of a printer, SI; others keep their own."""
    return {n: to_si(v, catalogue[n].unit.si) for n, v in _OF_PRINTERS.items()}
