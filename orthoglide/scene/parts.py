"""Parts of a picture of a machine: its bodies in a posture, its dials, and its errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from orthoglide.geometry import Array, Geometry

Part = Literal["drive", "rail", "carriage", "bar", "link", "platform", "dial", "plate"]


def stroke_commands(geometry: Geometry, leg: int, count: int) -> tuple[Array, Array]:
    """Return travels ``(count,)`` and commands ``(count, 3)`` of a leg through its stroke, metres.

    If the platform hangs the other legs move along, as they could not follow a single leg.
    """
    travel = np.linspace(*geometry.stroke, count)
    commands = np.repeat(geometry.zero[None], count, axis=0)
    commands[:, slice(None) if geometry.layout.hanging else slice(leg, leg + 1)] += travel[:, None]
    return travel, commands


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
        """Place of a carriage of the nominal machine at a travel ``(3,)``."""
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
        """Place of its face ``(3,)``; ``unit``: metres in one unit of the paper."""
        return np.asarray(self.at - 21.5 * unit * self.way)

    def tip(self, unit: float) -> Array:
        """Tip of the arrow in the direction in which it counts up ``(3,)``."""
        return np.asarray(self.at + 13.5 * unit * self.way)


@dataclass(frozen=True, eq=False)
class Mark:
    """One part with an erroneous motion."""

    part: Part  # the part
    leg: int  # 0, 1 or 2; -1 for parts of no leg
    way: Array  # direction of its displacement, or axis of its rotation, with the sign (3,)
    label: str  # its size, and the direction in words
    bar: int = 0  # 1 or 2 for one bar; 0 for both, and for other parts
    at: float = 0.0  # travel at which it is marked, metres
    curve: Array | None = None  # travel and displacement over the stroke (k, 2), largest 1
    both: bool = False  # whether it moves both ways
    setup: str = ""  # setup of a dial


@dataclass(frozen=True, eq=False)
class Option:
    """One explanation in a picture."""

    words: str  # a clause
    marks: tuple[Mark, ...]  # parts with an erroneous motion
