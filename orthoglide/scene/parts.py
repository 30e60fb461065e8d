"""What a picture of a machine is made of: its bodies in a posture, its dials, what is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from orthoglide.geometry import Array, Geometry

Part = Literal["drive", "rail", "carriage", "bar", "link", "platform", "dial", "plate"]


@dataclass(frozen=True, eq=False, repr=False)
class Posed:
    """A machine in one closed posture."""

    geometry: Geometry  # its nominal dimensions
    lines: Array  # ends of the bars (leg, bar, end, 3), carriage's end first
    p: Array  # tool (3,)
    travel: Array  # of the carriages from mechanical zero (3,)

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
    """One mounting of a dial."""

    name: str  # of the setup
    at: Array  # the touched point (3,)
    way: Array  # direction in which it counts up (3,), a unit vector

    def face(self, unit: float) -> Array:
        """Where its face is drawn ``(3,)``; a unit of the paper is so many metres."""
        return np.asarray(self.at - 21.5 * unit * self.way)

    def tip(self, unit: float) -> Array:
        """Where the arrow ends that says which way it counts."""
        return np.asarray(self.at + 13.5 * unit * self.way)


@dataclass(frozen=True, eq=False)
class Mark:
    """One part that moves wrongly."""

    part: Part  # what it is
    leg: int  # 0, 1 or 2; -1 of what belongs to no leg
    way: Array  # direction in which it moves, or about which it turns, with its sign (3,)
    label: str  # its size, and the direction in words
    bar: int = 0  # 1 or 2 of a bar; 0 of both, and of other parts
    at: float = 0.0  # travel at which it stands where it is marked, metres
    # travel and amount over the stroke (k, 2) of what a path does, largest 1
    curve: Array | None = None
    both: bool = False  # whether it moves either way
    setup: str = ""  # of a dial


@dataclass(frozen=True, eq=False)
class Option:
    """One explanation as a picture shows it."""

    words: str  # a clause
    marks: tuple[Mark, ...]  # parts that move wrongly
