"""A probe that touches a plate: the tool's height above it, the plate's own shape apart."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orthoglide.geometry import Array
from orthoglide.instruments.instrument import Instrument, Mounting, Nuisance, Pose, Varied

_SIDE = 7  # places of a sheet along the plate's diameter


class Probe(Instrument):
    """Heights over a plane that lies anyhow; effects bend it."""

    kind = "plate"
    words = "a probe on a plate"
    reads = "the plate's height"
    fill = "reading_mm is how high the tip is above the plate at the row's command"
    fill_place = (
        "go down until it touches and write the height that the machine shows then under z_mm; "
        "reading_mm is 0 where the nozzle touches, else how high it is as the probe triggers"
    )
    repeatability = 2e-5  # a probe's touch, as owners of linear deltas repeat it
    touches = True

    def value(self, pose: Pose, mounting: Mounting) -> Array:
        """The tool's height."""
        return np.asarray(pose.p[:, 2])

    def gradient(self, pose: Pose, mounting: Mounting) -> Mapping[Varied, Array]:
        """Upward."""
        return {"p": np.tile(np.eye(3)[2], (len(pose.p), 1))}

    def nuisances(self, p: Array, value: Array, mounting: Mounting) -> list[Nuisance]:
        """The plate's height and its two slopes."""
        return [(np.ones(len(p)), np.inf), (p[:, 0], np.inf), (p[:, 1], np.inf)]

    def places(self, ring: Array) -> tuple[Array, Array | None]:
        """A grid over the disc."""
        side = np.linspace(-1.0, 1.0, _SIDE)
        grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= 1 + 1e-9]
        return np.column_stack([grid, np.zeros(len(grid))]), None
