"""A tracker, a measuring machine or a dial at the tool: one coordinate of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.instruments.instrument import Instrument, Mounting, Nuisance, Pose, Varied, datums

HELD_SD = 0.02
"""How well a dial that is held at the tool points along its direction, radians: a degree."""


class Tracker(Instrument):
    """Coordinates of the tool, in a frame that may be turned; of a dial that reads one of them the
    direction is known, and not exactly.
    """

    kind = "tcp"
    words = "a tracker at the tool"
    reads = "the tool along {}"
    fill = "reading_mm is the tool's coordinate along the direction"
    repeatability = 1e-5
    slip_alone = 2e-4
    axes = (0, 1, 2)

    def value(self, pose: Pose, mounting: Mounting) -> Array:
        """The coordinate along the axis."""
        return np.asarray(np.sum(mounting.along * pose.p, axis=1))

    def gradient(self, pose: Pose, mounting: Mounting) -> Mapping[Varied, Array]:
        """The axis."""
        return {"p": mounting.along}

    def nuisances(self, p: Array, value: Array, mounting: Mounting) -> list[Nuisance]:
        """A datum an axis, and three turns of the frame."""
        turns = [np.sum(np.cross(e, p) * mounting.along, axis=1) for e in np.eye(3)]
        sd = self.turn_sd(mounting.axis)
        return [*datums(mounting), *((column, sd) for column in turns)]

    def turn_sd(self, axis: NDArray[np.int64]) -> float:
        """Not at all where it has two axes or more."""
        return HELD_SD if len(np.unique(axis)) < 2 else np.inf

    def displaced(
        self, p: Array, mounting: Mounting, draw: np.random.Generator, sd: float
    ) -> Array | None:
        """In a frame that is shifted and turned."""
        from scipy.spatial.transform import Rotation

        shift, turn = draw.normal(scale=sd, size=(2, 3))
        own = np.einsum("nij,nj->ni", mounting.turn, p)
        seen = Rotation.from_rotvec(turn).apply(own) + shift
        return np.asarray(mounting.sign * seen[np.arange(len(p)), mounting.axis])
