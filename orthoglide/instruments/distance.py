"""A distance between two places of the tool: a calliper on a printed part, two holes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orthoglide.geometry import Array
from orthoglide.instruments.instrument import (
    Instrument,
    Mounting,
    Nuisance,
    Pose,
    Varied,
    unit_vectors,
)

SCALE_SD, OFFSET_SD = 0.01, 2e-4
"""What is known of a setup: a printed part's shrinkage, the width of its pillars."""


class Distance(Instrument):
    """Lengths between the tool's places at two commands."""

    kind = "distance"
    words = "distances between holes or pillars"
    reads = "distances"
    fill = "reading_mm is the distance between the two places of the row"
    how = " around the rim and across it, each with its own width and the part's shrinkage"
    repeatability = 5e-5  # a calliper's, as owners of linear deltas repeat it
    paired = True

    def value(self, pose: Pose, mounting: Mounting) -> Array:
        """The length between both."""
        return np.asarray(np.linalg.norm(pose.apart, axis=1))

    def gradient(self, pose: Pose, mounting: Mounting) -> Mapping[Varied, Array]:
        """From the second place to the first."""
        return {"apart": unit_vectors(pose.apart)}

    def nuisances(self, p: Array, value: Array, mounting: Mounting) -> list[Nuisance]:
        """A scale and an offset."""
        return [(value, SCALE_SD), (np.ones(len(p)), OFFSET_SD)]

    def places(self, ring: Array) -> tuple[Array, Array | None]:
        """Every other place of the ring, every fourth, and opposites."""
        count = len(ring)
        ends = np.array([(a, (a + k) % count) for k in (2, 4, count // 2) for a in range(count)
                         if k < count // 2 or a < count // 2])  # fmt: skip
        return ring[ends[:, 0]], ring[ends[:, 1]]
