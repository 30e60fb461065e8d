"""A distance between two places of the tool: a calliper on a printed part, two holes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.observation import (
    TOOL_OFFSET_COLUMNS,
    InstrumentPriors,
    Ints,
    Mounted,
    Observation,
    ReadingVariables,
    Setup,
    SetupReadings,
    length,
    linear_combination,
    reading_point,
    vector,
)
from orthoglide.instruments.unit_mistakes import wrong_unit

PRINTED = "printed"
SHRINKAGE_BY_MATERIAL = {"": (0.0, 0.01), PRINTED: (0.003, 0.003), "metal": (0.0, 2e-4)}
"""Shrinkage of a part over its commanded length, and its standard deviation, by material. An
unknown material may be anything; prints of usual plastics shrink by 0.2 to 0.5 per cent as they
cool; a rule, a jig or a milled part is true to two hundredths of a millimetre on 100 mm."""

DISTANCE_OFFSET_SD = 2e-4
"""Metres: the width of pillars or holes of a setup, and the nozzle's own track on a print."""


class Distance(Observation):
    """Lengths between the tool's places at two commands."""

    kind = "distance"
    instrument_phrase = "distances between holes or pillars"
    quantity_phrase = "distances"
    sheet_instruction = "reading_mm is the distance between the two places of the row"
    suggestion_suffix = (
        " around the rim and across it, each with its own width and the part's shrinkage"
    )
    nuisance_summary = "scale, by its `material`, and offset (sd 0.2 mm)"
    repeatability = 5e-5  # a calliper's, as owners of linear deltas repeat it
    paired = True
    setup_columns = (*TOOL_OFFSET_COLUMNS, "material")
    nuisance_count = 2

    def is_affected_by(self, effect: Effect, setup: Setup | None = None) -> bool:
        """Return whether an effect changes the size of a part; of other than printed ones, none."""
        return effect.part is not None and (setup is None or setup.material == PRINTED)

    def shared_nuisance_name(self, setup: Setup, index: int) -> str:
        """Return one name for the scale of all printed parts of a file."""
        return PRINTED if index == 0 and setup.material == PRINTED else ""

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the distance between both points, times a scale and with an offset."""
        offset = vector(row.mounting)
        separation = linear_combination(
            (1, reading_point(row.pose, offset)), (-1, reading_point(row.second_pose, offset))
        )
        reading = length(separation) * (1 - row.mounting[3])
        for effect, value in zip(effects, row.effect_parameters, strict=True):
            if effect.part is not None:
                reading = effect.part(reading, value)
        return reading * (1 + row.nuisance[0]) + row.nuisance[1]

    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the offset from the tool, and the shrinkage of the part."""
        shrinkage = (SHRINKAGE_BY_MATERIAL[setup.material][0] for setup in mounted.table.setups)
        return np.column_stack([mounted.beside, mounted.by_reading(shrinkage)])

    def nuisance_sds(self, setup: Setup, axis: Ints, priors: InstrumentPriors) -> Array:
        """Return the prior standard deviations of the scale and the offset."""
        return np.array([SHRINKAGE_BY_MATERIAL[setup.material][1], DISTANCE_OFFSET_SD])

    def find_unit_or_frame_error(
        self, readings: SetupReadings, distance: Array, priors: InstrumentPriors
    ) -> str:
        """Return a sentence on the unit that the distances seem to have by mistake."""
        return wrong_unit(readings.value, lambda value: value - distance)

    def sheet_points(self, ring: Array) -> tuple[Array, Array | None]:
        """Return pairs of points of the ring that are two apart, four apart, and opposite."""
        count = len(ring)
        ends = np.array([(a, (a + k) % count) for k in (2, 4, count // 2) for a in range(count)
                         if k < count // 2 or a < count // 2])  # fmt: skip
        return ring[ends[:, 0]], ring[ends[:, 1]]
