"""One leg at mechanical zero, the names of three legs, and the interface of layouts."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError, as_float_array
from orthoglide.parameters import spaced

Array = NDArray[np.float64]
Triple = tuple[float, float, float]


def triple(noun: str, values: object) -> Triple:
    """Return three finite numbers; messages call them ``noun``.

    Raises:
        InputError: where they are not.
    """
    array = as_float_array(noun, values)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{noun} must be three finite numbers")
    x, y, z = array.tolist()
    return x, y, z


@dataclass(frozen=True)
class LegNames:
    """Names of the legs of a layout, of directions across them, and of parts."""

    legs: tuple[str, str, str]  # the three legs
    # for each leg the names of its directions b and c in parameters
    across: tuple[tuple[str, str], tuple[str, str], tuple[str, str]]
    # numbers of the machine's controller or firmware; every identification starts with the effects
    # that these correct
    controller_entries: tuple[str, ...]
    # words for the position of a carriage that is too far down or up its slide, and for that
    # direction
    slide_end_words: tuple[tuple[str, str], tuple[str, str]]
    command: str = "travel"  # name of commands, in columns of files
    travel: str = "travel from mechanical zero"  # name of that quantity
    axis: str = "axis"  # name of a drive with its slide: axis or tower
    bar: str = "bar"  # name of a bar: bar or rod
    # nouns in place of those of an Orthoglide: patterns, each with its replacement
    noun_replacements: tuple[tuple[str, str], ...] = ()

    @property
    def directions(self) -> frozenset[str]:
        """All names of directions."""
        return frozenset(name for pair in self.across for name in pair)

    @property
    def same_directions(self) -> bool:
        """Whether directions have the same names on all legs, relative to each leg."""
        return self.across[0] == self.across[1]

    def index(self, leg: str) -> int:
        """0, 1 or 2."""
        return self.legs.index(leg)

    def in_layout_words(self, text: str) -> str:
        """Return a text about an Orthoglide in the words of this layout."""
        for pattern, noun in self.noun_replacements:
            text = re.sub(pattern, noun, text)
        return text

    def effect_words(self, name: str) -> str:
        """Return the name of an effect in the words of this layout."""
        words = spaced(name)
        if self.noun_replacements:  # a tower's length is not that of its bars
            words = words.replace("leg length", "bar length")
        return self.in_layout_words(words)


@dataclass(frozen=True, eq=False)
class Leg:
    """A leg of the nominal machine at mechanical zero, its tool at the origin."""

    name: str  # of the leg
    carriage: Array  # the carriage's joint (3,), base frame, metres
    platform: Array  # the platform's joint (3,), from the tool, base frame, metres
    # rotation (3, 3) with the leg's axes as columns, right-handed: a, its slide; b, the pivots of
    # its parallelogram; c, its short links. Its bars lie across c.
    axes: Array

    @property
    def slide(self) -> Array:
        """Direction a of its rail ``(3,)``."""
        return np.asarray(self.axes[:, 0])

    @property
    def lean(self) -> float:
        """Angle of its bars at mechanical zero about c, from -a toward -b, radians."""
        a, b, _ = (self.carriage - self.platform) @ self.axes
        return float(np.arctan2(b, a))


class Layout(ABC):
    """Placement of three legs. Immutable, compared by value."""

    kind: ClassVar[str]  # its name in machine files

    @property
    @abstractmethod
    def names(self) -> LegNames:
        """Names of legs and directions."""

    @property
    @abstractmethod
    def hanging(self) -> bool:
        """Whether the platform hangs below the carriages, the slides being parallel; else it stands
        between them and the origin.
        """

    @abstractmethod
    def legs(self, L: float, r: float) -> tuple[Leg, Leg, Leg]:
        """The three legs for bars of length ``L`` and a platform of radius ``r``, metres.

        Raises:
            InputError: where the bars cannot reach.
        """

    def zero(self, L: float) -> float:
        """Command of every drive at mechanical zero, metres: 0 where commands are travel."""
        return 0.0

    def stroke_fits(self, L: float, stroke: tuple[float, float]) -> bool:
        """Return whether carriages stay ahead of the tool over a stroke, metres, and within the
        reach of bars of length ``L``; parallel slides have no upper limit.
        """
        low, high = stroke
        return -L < low < 0 < high and (self.hanging or high < L)

    def points(self, L: float, r: float, stroke: tuple[float, float], count: int) -> Array | None:
        """Return points ``(n, 3)`` that fill the workspace evenly; ``None`` where it is defined by
        commands over the stroke.

        Args:
            L: length of the bars, metres.
            r: radius of the platform, metres.
            stroke: travel from mechanical zero.
            count: of points along each axis.
        """
        return None
