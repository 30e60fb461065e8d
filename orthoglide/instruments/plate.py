"""A probe that touches a plate: the tool's height above it, the plate's own shape apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.observation import (
    PLATE_TURN_COLUMN,
    TOOL_OFFSET_COLUMNS,
    InstrumentPose,
    InstrumentPriors,
    Ints,
    MountingContext,
    Observation,
    ReadingVariables,
    Setup,
    SetupReadings,
    Table,
    reading_point,
    vector,
)

_GRID_SIZE = 7  # places of a sheet along the plate's diameter


class PlateTouch(Observation):
    """Heights over a plane that lies anyhow; effects bend it."""

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
    setup_columns = (*TOOL_OFFSET_COLUMNS, PLATE_TURN_COLUMN)
    nuisance_count = 3

    def is_affected_by(self, effect: Effect) -> bool:
        """Return whether an effect bends the plate."""
        return bool(effect.plate)

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the tool's height above the plane and its shapes, which begin at the mounting's
        fifth number. A probe is set against the nozzle, so the height that its place beside the
        tool brings in the mean is none.
        """
        p = reading_point(row.pose, vector(row.mounting))
        height = p[2] - row.mounting[3]
        plane = row.nuisance[0] + row.nuisance[1] * p[0] + row.nuisance[2] * p[1]
        for k, value in enumerate(row.effect_parameters):
            height = height - value * row.mounting[4 + k]
        return height - plane

    def mounting_values(self, table: Table, rows: NDArray[np.intp], site: MountingContext) -> Array:
        """Return where the probe is beside the tool, by how much that lifts it, and a unit of each
        of the plate's shapes there.
        """
        lift = np.array([stand.mean_lift for stand in site.instrument_poses])[table.setup[rows]]
        shapes = [shape for effect in site.effects for shape in effect.shapes.values()]
        x, y = site.normalized_plate_xy[rows].T
        bent = [np.broadcast_to(shape(x, y), x.shape) for shape in shapes]
        return np.column_stack([table.beside[rows], lift, *bent])

    def nuisance_sds(self, setup: Setup, axis: Ints, beliefs: InstrumentPriors) -> Array:
        """Return that nothing is known of the plane's height and slopes."""
        return np.full(3, np.inf)

    def estimate_pose(
        self, taken: SetupReadings, near: InstrumentPose | None, beliefs: InstrumentPriors
    ) -> InstrumentPose:
        """Return by how much the place beside the tool is higher in the mean."""
        return InstrumentPose(mean_lift=float(taken.offset_from_tool[:, 2].mean()))

    def places(self, ring: Array) -> tuple[Array, Array | None]:
        """Return a grid over the disc."""
        side = np.linspace(-1.0, 1.0, _GRID_SIZE)
        grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= 1 + 1e-9]
        return np.column_stack([grid, np.zeros(len(grid))]), None
