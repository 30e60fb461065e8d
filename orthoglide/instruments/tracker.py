"""A tracker, a measuring machine or a dial at the tool: one coordinate of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orthoglide.geometry import Array
from orthoglide.instruments.instrument import Instrument, Mounting, Nuisance, Pose, Varied, datums


class Tracker(Instrument):
    """Coordinates of the tool, in a frame that may be turned a little where it has two or more."""

    kind = "tcp"
    words = "a tracker at the tool"
    reads = "the tool along {}"
    fill = "reading_mm is the tool's coordinate along the direction"
    repeatability = 1e-5
    slip_alone = 2e-4
    axes = (0, 1, 2)

    def value(self, pose: Pose, mounting: Mounting) -> Array:
        """The coordinate along the axis."""
        rows = np.arange(len(pose.p))
        return np.asarray(mounting.sign * pose.p[rows, mounting.axis])

    def gradient(self, pose: Pose, mounting: Mounting) -> Mapping[Varied, Array]:
        """The axis."""
        return {"p": mounting.sign[:, None] * np.eye(3)[mounting.axis]}

    def nuisances(self, p: Array, value: Array, mounting: Mounting) -> list[Nuisance]:
        """A datum an axis, and three turns of the frame."""
        if len(np.unique(mounting.axis)) < 2:
            return datums(mounting)
        turns = np.stack([np.cross(e, p) for e in np.eye(3)], axis=2)  # (n, xyz, about)
        own = mounting.sign[:, None] * turns[np.arange(len(p)), mounting.axis]
        return [*datums(mounting), *((column, np.inf) for column in own.T)]

    def displaced(
        self, p: Array, mounting: Mounting, draw: np.random.Generator, sd: float
    ) -> Array | None:
        """In a frame that is shifted and turned."""
        from scipy.spatial.transform import Rotation

        if len(np.unique(mounting.axis)) < 2:
            return None
        shift, turn = draw.normal(scale=sd, size=(2, 3))
        seen = Rotation.from_rotvec(turn).apply(p) + shift
        return np.asarray(mounting.sign * seen[np.arange(len(p)), mounting.axis])
