"""The Orthoglide: rails along the base axes, each leg's axes a cyclic permutation of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orthoglide.errors import UnreachableError
from orthoglide.layout.leg import Array, Leg, LegNames


@dataclass(frozen=True)
class Orthoglide:
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

    def on_axis(self, L: float, leg: int, travel: Array) -> Array:
        """Return commands ``(..., 3)``, metres, that move the TCP of bars of length ``L`` by
        ``travel`` ``(...)``, metres, along a leg's slide (2008, section 2.4).

        Raises:
            UnreachableError: where the travel is not less than a bar's length.
        """
        excess = float(np.max(np.abs(travel), initial=0.0) - L)
        if excess >= 0:
            name = self.names.legs[leg]
            raise UnreachableError(
                f"legs of {L * 1e3:g} mm cannot follow the TCP {excess * 1e3:g} mm beyond their "
                f"length along {name}",
                leg=name,
                excess=excess,
            )
        rho = np.repeat(np.sqrt(L**2 - travel**2)[..., None], 3, axis=-1)
        rho[..., leg] = L + travel
        return rho

    def stroke_fits(self, L: float, stroke: tuple[float, float]) -> bool:
        """Whether a carriage stays on its side of the origin and within its bars' reach."""
        low, high = stroke
        return -L < low < 0 < high < L

    def points(self, L: float, r: float, stroke: tuple[float, float], count: int) -> Array | None:
        """The workspace is what commands over the stroke reach."""
        return None


ORTHOGLIDE = Orthoglide()
"""The layout of the papers, the default everywhere."""
