"""A probe that touches a plate: height of the tool above the plate and its shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.observation import (
    TOOL_OFFSET_COLUMNS,
    InstrumentPose,
    InstrumentPriors,
    Mounted,
    Observation,
    ReadingVariables,
    Setup,
    SetupReadings,
    reading_point,
    vector,
)

_GRID_SIZE = 7  # points of a sheet along the plate's diameter


class PlateTouch(Observation):
    """Heights above a plane of free height and slopes, which effects bend."""

    kind = "plate"
    instrument_phrase = "a probe on a plate"
    quantity_phrase = "the plate's height"
    sheet_instruction = "reading_mm is how high the tip is above the plate at the row's command"
    sheet_instruction_place = (
        "go down until it touches and write the height that the machine shows then under z_mm; "
        "reading_mm is 0 where the nozzle touches, else how high it is as the probe triggers"
    )
    nuisance_summary = "height and two slopes of the plate"
    repeatability = 2e-5  # a probe's touch, as owners of linear deltas repeat it
    touches = True
    setup_columns = (*TOOL_OFFSET_COLUMNS, "turned_deg")
    nuisance_count = 3
    # Row by row, slopes that change bend the plate as a bowl does; no plate tilts evenly.
    drifting_count = 1

    def is_affected_by(self, effect: Effect, setup: Setup | None = None) -> bool:
        """Return whether an effect bends the plate."""
        return bool(effect.plate)

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the tool's height above the plane and its shapes, which begin at the fifth number
        of the mounting. The mean height of the probe's offset is subtracted, as a probe is set
        against the nozzle.
        """
        p = reading_point(row.pose, vector(row.mounting))
        height = p[2] - row.mounting[3]
        plane = row.nuisance[0] + row.nuisance[1] * p[0] + row.nuisance[2] * p[1]
        for k, value in enumerate(row.effect_parameters):
            height = height - value * row.mounting[4 + k]
        return height - plane

    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the probe's offset from the tool, its mean height, and the value of each shape of
        the plate.
        """
        lift = mounted.by_reading(pose.mean_lift for pose in mounted.instrument_poses)
        shapes = [shape for effect in mounted.effects for shape in effect.shapes.values()]
        x, y = mounted.normalized_plate_xy[mounted.rows].T
        shape_values = [np.broadcast_to(shape(x, y), x.shape) for shape in shapes]
        return np.column_stack([mounted.beside, lift, *shape_values])

    def estimate_pose(
        self, readings: SetupReadings, initial: InstrumentPose | None, priors: InstrumentPriors
    ) -> InstrumentPose:
        """Return the mean height of the probe's offset from the tool."""
        return InstrumentPose(mean_lift=float(readings.offset_from_tool[:, 2].mean()))

    def sheet_points(self, ring: Array) -> tuple[Array, Array | None]:
        """Return a grid over the disc."""
        side = np.linspace(-1.0, 1.0, _GRID_SIZE)
        grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= 1 + 1e-9]
        return np.column_stack([grid, np.zeros(len(grid))]), None
