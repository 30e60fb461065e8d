"""Whether a machine file still has the lengths by which imported travel is counted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from orthoglide.geometry import Geometry
from orthoglide.layout import LinearDelta
from orthoglide.machine_file.document import Document

_SAME = 2e-6  # metres


def check_travel(document: Document, geometry: Geometry, provenance: Mapping[str, Any]) -> None:
    """Refuse lengths that would move mechanical zero away from where travel is counted from.

    A firmware counts from where its own radius and arms put a carriage: the joints of the platform
    may stand further out than was assumed, but only together with those of the carriages.

    Raises:
        FileError: naming the line and what would be right.
    """
    kept, layout = provenance.get("klipper"), geometry.layout
    if not isinstance(kept, Mapping) or not isinstance(layout, LinearDelta):
        return
    try:
        reach = float(kept["delta_radius_mm"]) * 1e-3
        arm = float(np.mean([float(length) for length in kept["arm_length_mm"]])) * 1e-3
    except (KeyError, TypeError, ValueError):  # the table was edited
        return
    if any(abs(radius - geometry.r - reach) > _SAME for radius in layout.radius):
        document.fail(
            f"radius_mm less r must stay the firmware's delta_radius, {reach * 1e3:.6g} mm, by "
            f"which travel was counted: with r = {geometry.r * 1e3:.6g} put "
            f"{(reach + geometry.r) * 1e3:.9g} three times",
            "layout",
            "radius_mm",
        )
    if abs(geometry.L - arm) > _SAME:
        document.fail(
            f"L must stay the mean of the firmware's arms, {arm * 1e3:.6f} mm, by which travel was "
            f"counted: give lengths that were measured under [parameters]",
            "geometry_mm",
            "L",
        )
