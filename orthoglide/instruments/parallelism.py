"""Two dials on one leg at one posture: how far the leg is from parallel to a surface.

The first technique of the 2008 chapter (Fig. 4a): both dials are set to zero against the reference
surface, so their difference is the leg's own inclination and there is no datum.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.leg_dial import ON_LEG, crossing, on_leg, trouble_on_leg
from orthoglide.instruments.observation import (
    Beliefs,
    Ints,
    Observation,
    Row,
    Setup,
    Site,
    Table,
    add,
    dot,
    vector,
)


class Parallelism(Observation):
    """What the dial at ``gauge2`` shows less what the dial at ``gauge`` shows."""

    kind = "parallelism"
    words = "two dials on a leg"
    reads = "the inclination of leg {1} along {0}"
    fill = "reading_mm is what the dial at gauge2_mm shows less what the dial at gauge_mm shows"
    fitted = "slope of the reference surface, where the machine file has a tolerance for it"
    repeatability = 2e-5 * 2**0.5  # two dials, each as stated in 2008, section 4.1
    dials = 2
    protocol = "parallelism"
    axes = (0, 1, 2)
    of_setup = ("leg", "direction", "gauge_mm", "gauge2_mm", "bar")
    nuisances = 1

    def check(self, setup: Setup) -> str:
        """Return what is wrong with a setup."""
        if setup.gauge2 != setup.gauge:
            return trouble_on_leg(setup)
        return "its two dials stand at one place: correct gauge_mm or gauge2_mm"

    def formula(self, row: Row, effects: Sequence[Effect]) -> Any:
        """Return the difference of two crossings, and what the surface's slope makes of it."""
        stands, other = row.mounting, row.mounting[ON_LEG]
        one, two = (crossing(row.pose, stands, place) for place in (stands[11], other))
        apart = dot(vector(stands, 5), add((1, two), (-1, one)))
        return stands[12] * apart + row.nuisance[0] * (other - stands[11])

    def mountings(self, table: Table, rows: NDArray[np.intp], site: Site) -> Array:
        """Return how the first dials stand, and the places of the second."""
        second = np.array([s.gauge2 for s in table.setups])[table.setup[rows]] + site.geometry.r
        return np.column_stack([on_leg(table, rows, site.geometry), second])

    def known(self, setup: Setup, axis: Ints, beliefs: Beliefs) -> Array:
        """Return what is known of the surface's slope, radians."""
        return np.array([beliefs.surface_slope])
