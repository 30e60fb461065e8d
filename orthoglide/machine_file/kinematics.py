"""Where the controller of a linear delta sends the carriages for a place of its tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoglide.geometry import Array, Geometry
from orthoglide.reduction.spheres import intersect_spheres


@dataclass(frozen=True)
class DeltaKinematics:
    """Kinematics of a delta without errors: the tool is where three spheres meet."""

    # where the tool stood if an arm hung straight down from its carriage at mechanical zero, and
    # had no length (3, 3), metres, by leg
    joints: Array
    arm: Array  # length of each leg's arm (3,), metres

    def travel(self, p: Array) -> Array:
        """Travel of the carriages from mechanical zero ``(n, 3)`` for places ``(n, 3)``, metres;
        nan where an arm does not reach.
        """
        apart = p[:, None] - self.joints
        square = self.arm**2 - np.sum(apart[:, :, :2] ** 2, axis=-1)
        return np.asarray(apart[:, :, 2] + np.sqrt(np.where(square > 0, square, np.nan)))

    def places(self, travel: Array) -> Array:
        """Places of the tool ``(n, 3)`` at a travel ``(n, 3)``, metres.

        Raises:
            UnreachableError: where the arms do not meet.
        """
        centres = self.joints + travel[:, :, None] * np.array([0.0, 0.0, 1.0])
        return intersect_spheres(centres, self.arm)

    @classmethod
    def of(cls, geometry: Geometry) -> DeltaKinematics:
        """Return the kinematics of the nominal machine."""
        joints = [leg.carriage - leg.platform for leg in geometry.legs]
        return cls(np.array(joints), np.full(3, geometry.L))
