"""One leg of a machine at mechanical zero, the names of three, and what a layout of them owes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError, as_float_array

Array = NDArray[np.float64]
Triple = tuple[float, float, float]


def triple(what: str, given: object) -> Triple:
    """Three finite numbers; ``what`` they are stands in messages.

    Raises:
        InputError: where they are not.
    """
    array = as_float_array(what, given)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{what} must be three finite numbers")
    one, two, three = array.tolist()
    return one, two, three


@dataclass(frozen=True)
class LegNames:
    """How the legs of a layout and the directions across them are called."""

    legs: tuple[str, str, str]  # the three legs
    # for each leg the names of its directions b and c, as parameters carry them
    across: tuple[tuple[str, str], tuple[str, str], tuple[str, str]]
    # numbers that the machine's own controller or firmware holds; with the effects that these are
    # every identification starts
    controller_entries: tuple[str, ...]
    # in words where a carriage stands that went too far down and up its slide, and which way that
    # is
    slide_end_words: tuple[tuple[str, str], tuple[str, str]]
    command: str = "travel"  # how commands are called, in columns of files
    travel: str = "travel from mechanical zero"  # how travel from mechanical zero is called
    axis: str = "axis"  # how a drive with its slide is called: an axis or a tower
    bar: str = "bar"  # how a bar is called: a bar or a rod
    # what its parts are called in place of an Orthoglide's: patterns, each with what replaces it
    noun_replacements: tuple[tuple[str, str], ...] = ()

    @property
    def directions(self) -> frozenset[str]:
        """All names of directions."""
        return frozenset(name for pair in self.across for name in pair)

    @property
    def same_directions(self) -> bool:
        """Whether the legs' directions have the same names, each leg's own meant."""
        return self.across[0] == self.across[1]

    def index(self, leg: str) -> int:
        """0, 1 or 2."""
        return self.legs.index(leg)

    def in_layout_words(self, text: str) -> str:
        """Words of an Orthoglide's parts in the words of this layout."""
        for pattern, noun in self.noun_replacements:
            text = re.sub(pattern, noun, text)
        return text

    def effect_words(self, name: str) -> str:
        """Name of an effect in the words of this layout: a leg's length is that of its bars."""
        words = name.replace("_", " ")
        return (
            self.in_layout_words(words.replace("leg length", "bar length"))
            if self.noun_replacements
            else words
        )


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
