"""A distance between two places of the tool: a calliper on a printed part, two holes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.geometry import Array
from orthoglide.instruments.meant import wrong_unit
from orthoglide.instruments.observation import (
    Beliefs,
    Ints,
    Observation,
    Row,
    Site,
    Table,
    Taken,
    add,
    length,
    place_of,
    vector,
)

SCALE_SD, OFFSET_SD = 0.01, 2e-4
"""What is known of a setup: a printed part's shrinkage, the width of its pillars."""


class Distance(Observation):
    """Lengths between the tool's places at two commands."""

    kind = "distance"
    words = "distances between holes or pillars"
    reads = "distances"
    fill = "reading_mm is the distance between the two places of the row"
    how = " around the rim and across it, each with its own width and the part's shrinkage"
    fitted = "scale (sd 0.01) and offset (sd 0.2 mm)"
    repeatability = 5e-5  # a calliper's, as owners of linear deltas repeat it
    paired = True
    nuisances = 2

    def formula(self, row: Row, effects: Sequence[Effect]) -> Any:
        """Return the length between both places, times a scale and with an offset."""
        beside = vector(row.mounting)
        apart = add((1, place_of(row.pose, beside)), (-1, place_of(row.other, beside)))
        return length(apart) * (1 + row.nuisance[0]) + row.nuisance[1]

    def mountings(self, table: Table, rows: NDArray[np.intp], site: Site) -> Array:
        """Return where the places are beside the tool."""
        return table.beside[rows]

    def known(self, axis: Ints, beliefs: Beliefs) -> Array:
        """Return what is known of the scale and the offset."""
        return np.array([SCALE_SD, OFFSET_SD])

    def doubts(self, taken: Taken, apart: Array, beliefs: Beliefs) -> str:
        """Return which other unit the distances seem to have."""
        return wrong_unit(taken.value, apart)

    def places(self, ring: Array) -> tuple[Array, Array | None]:
        """Return every other place of the ring, every fourth, and opposites."""
        count = len(ring)
        ends = np.array([(a, (a + k) % count) for k in (2, 4, count // 2) for a in range(count)
                         if k < count // 2 or a < count // 2])  # fmt: skip
        return ring[ends[:, 0]], ring[ends[:, 1]]
