"""A level on the platform: its turn about a base axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orthoglide.geometry import Array, axial
from orthoglide.instruments.instrument import Instrument, Mounting, Nuisance, Pose, Varied, datums

# Derivative of the axial vector of a matrix by the matrix (3, 3, 3).
_AXIAL = np.stack([axial(np.eye(9).reshape(9, 3, 3))[:, j].reshape(3, 3) for j in range(3)])


class Level(Instrument):
    """Turns of the platform, right-handed about an axis."""

    kind = "incline"
    words = "a level on the platform"
    reads = "the platform's turn about {}"
    fill = "reading_mrad is the platform's turn about the direction, right-handed: 1 mm a metre"
    how = ", read about x and y around the rim"
    repeatability = 2e-5
    slip = slip_alone = 2e-3
    angular = True
    axes = (0, 1)

    def value(self, pose: Pose, mounting: Mounting) -> Array:
        """The turn about the axis."""
        return np.asarray(mounting.sign * axial(pose.R)[np.arange(len(pose.R)), mounting.axis])

    def gradient(self, pose: Pose, mounting: Mounting) -> Mapping[Varied, Array]:
        """Half the difference of two entries of the rotation."""
        return {"R": mounting.sign[:, None, None] * _AXIAL[mounting.axis]}

    def nuisances(self, p: Array, value: Array, mounting: Mounting) -> list[Nuisance]:
        """A datum an axis."""
        return datums(mounting)

    def places(self, ring: Array) -> tuple[Array, Array | None]:
        """The middle and the ring."""
        return np.concatenate([np.zeros((1, 3)), ring]), None
