"""A picture of a machine: bodies in a posture, dials, errors, and the paper with its labels."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
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


WIDTH, HEIGHT = 440.0, 400.0
"""Size of the drawing in units in which its letters are 13 high, readable on a phone."""

LETTER_WIDTH = 8.6
"""Average width of a bold letter in wide fonts."""

_ABOVE, _BELOW, _EDGE = 11.0, 3.5, 3.0  # height above and below the base line; margin of the paper
_GAPS = (4.0, 12.0, 22.0, 34.0, 50.0)  # distances that are tried
_DIRECTIONS = 16  # directions that are tried
_TEXT_COST, _LINE_COST, _DISTANCE_COST = 1e3, 6.0, 0.6  # of a covered text, of a point, of a unit
_LINE_STEP = 5.0  # distance of the points that represent a line

Point = tuple[float, float]
Box = tuple[float, float, float, float]
"""Left, top, right and bottom."""


def text_box(x: float, y: float, text: str) -> Box:
    """Return the box of a line of bold letters with the given middle of its base line."""
    half = LETTER_WIDTH * len(text) / 2
    return x - half, y - _ABOVE, x + half, y + _BELOW


def circle_box(x: float, y: float, radius: float) -> Box:
    """Return the box of a circle."""
    return x - radius, y - radius, x + radius, y + radius


def lettering(x: float, y: float, text: str, colour: str, halo: float) -> str:
    """Return a text centred on its base line, on a halo of paper."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" font-weight="600" '
        f'fill="var(--m-{colour})" stroke="var(--m-paper)" stroke-width="{halo:g}" '
        f'paint-order="stroke">{escape(text)}</text>'
    )


@dataclass
class Paper:
    """A parallel projection of the base frame, with the places that are occupied."""

    view: Array  # unit vectors to the right, down and toward the eye (3, 3)
    scale: float  # paper units a metre
    shift: Array  # paper coordinates of the base frame's origin (2,)
    occupied: list[Box] = field(default_factory=list)  # boxes that no text may cover
    lines: list[Point] = field(default_factory=list)  # points of lines, better not covered

    @property
    def unit(self) -> float:
        """Metres in one unit of the paper."""
        return 1 / self.scale

    @property
    def toward_eye(self) -> Array:
        """Unit vector toward the eye ``(3,)``."""
        return np.asarray(self.view[2])

    def project(self, point: Array) -> Point:
        """Return paper coordinates of a point ``(3,)``."""
        x, y = (self.shift + self.scale * (self.view[:2] @ point)).tolist()
        return x, y

    def copy(self) -> Paper:
        """Return a copy that can be changed independently."""
        return replace(self, occupied=list(self.occupied), lines=list(self.lines))

    def add_line(self, points: Iterable[Array]) -> None:
        """Note a line through points ``(3,)``."""
        for (x1, y1), (x2, y2) in itertools.pairwise(map(self.project, points)):
            count = max(int(math.hypot(x2 - x1, y2 - y1) / _LINE_STEP), 1)
            shares = [k / count for k in range(count + 1)]
            self.lines += [(x1 + s * (x2 - x1), y1 + s * (y2 - y1)) for s in shares]

    def place_text(self, at: Array, text: str, tail: Array | None = None) -> str:
        """Return a text beside a point as SVG; ``tail``: start of an arrow that ends there."""
        if not text:
            return ""
        x, y = self.project(at)
        if tail is not None:
            self.add_line([tail, at])
        x, y = min(self._candidate_positions(x, y, text), key=lambda p: self._cost(p, (x, y), text))
        self.occupied.append(text_box(x, y, text))
        return lettering(x, y, text, "mark", 3.5)

    def _candidate_positions(self, x: float, y: float, text: str) -> Sequence[Point]:
        """Return middles of base lines around a point, all within the paper."""
        half, positions = LETTER_WIDTH * len(text) / 2, []
        for gap, angle in itertools.product(
            _GAPS, np.arange(_DIRECTIONS) * 2 * math.pi / _DIRECTIONS
        ):
            px = x + (half + gap) * math.cos(angle)
            py = y + (_ABOVE + _BELOW) / 2 + (_ABOVE + gap) * math.sin(angle) - _BELOW
            px = min(max(px, half + _EDGE), WIDTH - half - _EDGE)
            positions.append((px, min(max(py, _ABOVE + _EDGE), HEIGHT - _BELOW - _EDGE)))
        return positions

    def _cost(self, position: Point, point: Point, text: str) -> float:
        left, top, right, bottom = text_box(*position, text)
        covered = sum(left < b[2] and b[0] < right and top < b[3] and b[1] < bottom
                      for b in self.occupied)  # fmt: skip
        crossed = sum(left < x < right and top < y < bottom for x, y in self.lines)
        aside = max(left - point[0], point[0] - right, 0.0)
        away = math.hypot(aside, max(top - point[1], point[1] - bottom, 0.0))
        return _TEXT_COST * covered + _LINE_COST * crossed + _DISTANCE_COST * away
