"""What a picture of a machine is made of: its bodies in a posture, its dials, what is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from orthoglide.geometry import Array, Geometry

Part = Literal["drive", "rail", "carriage", "bar", "link", "platform", "dial", "plate"]


@dataclass(frozen=True, eq=False, repr=False)
class Posed:
    """A machine in one closed posture.

    Attributes:
        geometry: its nominal dimensions.
        lines: ends of the bars ``(leg, bar, end, 3)``, carriage's end first.
        p: tool ``(3,)``.
        travel: of the carriages from mechanical zero ``(3,)``.
    """

    geometry: Geometry
    lines: Array
    p: Array
    travel: Array

    def carriage(self, leg: int) -> Array:
        """Middle of a carriage's joints ``(3,)``."""
        return np.asarray(self.lines[leg, :, 0].mean(axis=0))

    def platform(self, leg: int) -> Array:
        """Middle of the platform's joints of a leg ``(3,)``."""
        return np.asarray(self.lines[leg, :, 1].mean(axis=0))

    def path(self, leg: int, travel: float) -> Array:
        """Where a carriage stands at a travel of the nominal machine ``(3,)``."""
        slide = self.geometry.legs[leg].slide
        return np.asarray(self.carriage(leg) + (travel - self.travel[leg]) * slide)

    def rail(self, leg: int) -> tuple[Array, Array]:
        """Both ends of a rail ``(3,)``, a little beyond the stroke, beside the carriage's path."""
        d, (low, high) = self.geometry.d, self.geometry.stroke
        aside = 0.5 * d * self.geometry.legs[leg].axes[:, 1]
        return self.path(leg, low - 0.6 * d) + aside, self.path(leg, high + 0.6 * d) + aside


@dataclass(frozen=True, eq=False)
class Dial:
    """One mounting of a dial.

    Attributes:
        name: of the setup.
        at: the touched point ``(3,)``.
        way: direction in which it counts up ``(3,)``, a unit vector.
    """

    name: str
    at: Array
    way: Array

    def face(self, unit: float) -> Array:
        """Where its face is drawn ``(3,)``; a unit of the paper is so many metres."""
        return np.asarray(self.at - 21.5 * unit * self.way)

    def tip(self, unit: float) -> Array:
        """Where the arrow ends that says which way it counts."""
        return np.asarray(self.at + 13.5 * unit * self.way)


@dataclass(frozen=True, eq=False)
class Mark:
    """One part that moves wrongly.

    Attributes:
        part: what it is.
        leg: 0, 1 or 2; -1 of what belongs to no leg.
        way: direction in which it moves, or about which it turns, with its sign ``(3,)``.
        label: its size, and the direction in words.
        bar: 1 or 2 of a bar; 0 of both, and of other parts.
        at: travel at which it stands where it is marked, metres.
        curve: travel and amount over the stroke ``(k, 2)`` of what a path does, largest 1.
        both: whether it moves either way.
        setup: of a dial.
    """

    part: Part
    leg: int
    way: Array
    label: str
    bar: int = 0
    at: float = 0.0
    curve: Array | None = None
    both: bool = False
    setup: str = ""


@dataclass(frozen=True, eq=False)
class Option:
    """One explanation as a picture shows it.

    Attributes:
        words: a clause.
        marks: parts that move wrongly.
    """

    words: str
    marks: tuple[Mark, ...]
