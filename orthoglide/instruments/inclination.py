"""A level at the tool: rotation of the platform about a base axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.observation import (
    Mounted,
    Observation,
    ReadingVariables,
    dot,
    linear_combination,
    vector,
)


class Inclination(Observation):
    """Rotations of the platform, right-handed about an axis."""

    kind = "incline"
    instrument_phrase = "a level at the tool"
    quantity_phrase = "the tool's turn about {}"
    sheet_instruction = (
        "reading_mrad is the tool's turn about the direction, right-handed: 1 mm a metre"
    )
    suggestion_suffix = ", read about x and y around the rim"
    nuisance_summary = "datum of each direction"
    repeatability = 2e-5
    angular = True
    setup_columns = ()
    axes = (0, 1)
    nuisance_count = 3

    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the rotation about the axis (sine of the angle times its axis) plus a datum."""
        R = [vector(row.pose, 3 + 3 * k) for k in range(3)]
        doubled = [R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]]
        turned = linear_combination((0.5, doubled), (1, vector(row.nuisance)))
        return dot(vector(row.mounting), turned)

    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the axis of each row, with its sign."""
        return mounted.signed_axes

    def sheet_points(self, ring: Array) -> tuple[Array, Array | None]:
        """Return the middle and the ring."""
        return np.concatenate([np.zeros((1, 3)), ring]), None
