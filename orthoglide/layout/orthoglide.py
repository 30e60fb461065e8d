"""The Orthoglide: rails along the base axes, each leg's axes a cyclic permutation of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orthoglide.layout.leg import Layout, Leg, LegNames


@dataclass(frozen=True)
class Orthoglide(Layout):
    """Three square rails (Pashkevich et al. 2008, section 2.1).

    Leg x has a = x, b = y, c = z, and so on in turn. Commands are joint coordinates rho as in eq.
    (2): the distance of a carriage from the origin along its axis, r removed.
    """

    kind: ClassVar[str] = "orthoglide"
    names: ClassVar[LegNames] = LegNames(
        ("x", "y", "z"),
        (("y", "z"), ("z", "x"), ("x", "y")),
        ("zero", "bar_length"),
        (("in", "toward the origin"), ("out", "away from the origin")),
        command="rho",
        travel="rho - L",
    )
    hanging: ClassVar[bool] = False

    def legs(self, L: float, r: float) -> tuple[Leg, Leg, Leg]:
        """The three legs, as of any layout."""
        x, y, z = (self._leg(k, L, r) for k in range(3))
        return x, y, z

    def _leg(self, leg: int, L: float, r: float) -> Leg:
        axes = np.eye(3)[:, [leg, (leg + 1) % 3, (leg + 2) % 3]]
        return Leg(self.names.legs[leg], (L + r) * axes[:, 0], r * axes[:, 0], axes)

    def zero(self, L: float) -> float:
        """Rho at mechanical zero: L."""
        return L


ORTHOGLIDE = Orthoglide()
"""The layout of the papers, the default everywhere."""
