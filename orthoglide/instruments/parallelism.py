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
from orthoglide.instruments.leg_dial import (
    DIAL_MOUNTING_SIZE,
    dial_mountings,
    dial_plane_crossing,
    dial_setup_error,
)
from orthoglide.instruments.observation import (
    InstrumentPriors,
    Ints,
    MountingContext,
    Observation,
    ReadingVariables,
    Setup,
    Table,
    add,
    dot,
    vector,
)


class Parallelism(Observation):
    """What the dial at ``gauge2`` shows less what the dial at ``gauge`` shows."""

    kind = "parallelism"
    instrument_phrase = "two dials on a leg"
    quantity_phrase = "the inclination of leg {1} along {0}"
    sheet_instruction = (
        "reading_mm is what the dial at gauge2_mm shows less what the dial at gauge_mm shows"
    )
    nuisance_summary = (
        "slope of the reference surface, where the machine file has a tolerance for it"
    )
    repeatability = 2e-5 * 2**0.5  # two dials, each as stated in 2008, section 4.1
    dials = 2
    protocol = "parallelism"
    axes = (0, 1, 2)
    setup_columns = ("leg", "direction", "gauge_mm", "gauge2_mm", "bar")
    nuisance_count = 1

    def check(self, setup: Setup) -> str:
        """Return what is wrong with a setup."""
        if setup.gauge2 != setup.gauge:
            return dial_setup_error(setup)
        return "its two dials stand at one place: correct gauge_mm or gauge2_mm"

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the difference of two crossings, and what the surface's slope makes of it."""
        stands, other = row.mounting, row.mounting[DIAL_MOUNTING_SIZE]
        one, two = (dial_plane_crossing(row.pose, stands, place) for place in (stands[11], other))
        apart = dot(vector(stands, 5), add((1, two), (-1, one)))
        return stands[12] * apart + row.nuisance[0] * (other - stands[11])

    def mounting_values(self, table: Table, rows: NDArray[np.intp], site: MountingContext) -> Array:
        """Return how the first dials stand, and the places of the second."""
        second = np.array([s.gauge2 for s in table.setups])[table.setup[rows]] + site.geometry.r
        return np.column_stack([dial_mountings(table, rows, site.geometry), second])

    def nuisance_sds(self, setup: Setup, axis: Ints, beliefs: InstrumentPriors) -> Array:
        """Return what is known of the surface's slope, radians."""
        return np.array([beliefs.surface_slope_sd])
