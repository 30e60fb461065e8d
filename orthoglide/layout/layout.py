"""What a layout owes."""

from __future__ import annotations

from typing import ClassVar, Protocol

from orthoglide.layout.leg import Array, Leg, LegNames


class Layout(Protocol):
    """Where three legs stand. Immutable, compared by value."""

    kind: ClassVar[str]  # its name in machine files

    @property
    def names(self) -> LegNames:
        """Of legs and directions."""

    @property
    def hanging(self) -> bool:
        """Whether the platform hangs below the carriages, the slides being parallel; else it stands
        between them and the origin.
        """

    def legs(self, L: float, r: float) -> tuple[Leg, Leg, Leg]:
        """The three legs for bars of length ``L`` and a platform of radius ``r``, metres.

        Raises:
            InputError: where the bars cannot reach.
        """

    def zero(self, L: float) -> float:
        """Command of every drive at mechanical zero, metres."""

    def stroke_fits(self, L: float, stroke: tuple[float, float]) -> bool:
        """Whether travel from mechanical zero may run between these limits, metres."""

    def points(self, L: float, r: float, stroke: tuple[float, float], count: int) -> Array | None:
        """Points ``(n, 3)`` that fill the workspace evenly; ``None``: commands over the stroke do.

        Args:
            L: length of the bars, metres.
            r: radius of the platform, metres.
            stroke: travel from mechanical zero.
            count: of points along each axis.
        """
