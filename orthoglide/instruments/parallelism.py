"""Two dials on one leg at one posture: how far the leg is from parallel to a surface.

The first technique of the 2008 chapter (Fig. 4a): both dials are set to zero against the reference
surface, so their difference is the leg's own inclination and there is no datum.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.leg_dial import (
    DIAL_MOUNTING_SIZE,
    PLACE_INDEX,
    SIGN_INDEX,
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
    Rows,
    Setup,
    Table,
    dot,
    linear_combination,
    vector,
)


class Parallelism(Observation):
    """Readings of the dial at ``gauge2`` minus those of the dial at ``gauge``."""

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

    def setup_error(self, setup: Setup) -> str:
        """Return what is wrong with a setup."""
        if setup.gauge2 != setup.gauge:
            return dial_setup_error(setup)
        return "its two dials stand at one place: correct gauge_mm or gauge2_mm"

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the difference of two crossing points, plus the slope of the surface."""
        mounting = row.mounting
        first, second = mounting[PLACE_INDEX], mounting[DIAL_MOUNTING_SIZE]
        x1, x2 = (dial_plane_crossing(row.pose, mounting, place) for place in (first, second))
        difference = dot(vector(mounting, 5), linear_combination((1, x2), (-1, x1)))
        return mounting[SIGN_INDEX] * difference + row.nuisance[0] * (second - first)

    def mounting_values(self, table: Table, rows: Rows, context: MountingContext) -> Array:
        """Return the mountings of the first dials, and the places of the second."""
        second = np.array([s.gauge2 for s in table.setups])[table.setup[rows]] + context.geometry.r
        return np.column_stack([dial_mountings(table, rows, context.geometry), second])

    def nuisance_sds(self, setup: Setup, axis: Ints, priors: InstrumentPriors) -> Array:
        """Return the prior of the surface's slope, radians."""
        return np.array([priors.surface_slope_sd])
