"""Texts for sizes and directions, and the sentences by which an effect describes its value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from orthoglide.errors import InputError
from orthoglide.layout import LinearDelta, Orthoglide
from orthoglide.numerals import MINUS, compact
from orthoglide.parameters import Parameter

_ROUNDING = 1e-13  # SI: a smaller value counts as zero and has no sign


_DISPLAY_FACTORS = {"mm": 1e3, "mrad": 1e3, "%": 100.0, "µm": 1e6}
"""Units of texts with their number in one SI unit."""


def quantity(value: float, unit: str) -> str:
    """Return the absolute value of an SI value as text, in mm, mrad, % or µm: ``0.12 mm``."""
    return f"{compact(abs(value) * _DISPLAY_FACTORS[unit], 2)} {unit}"


_TOWER_SIDES = {
    "radial": ("the outside", "the centre"),
    "tangential": ("the counter-clockwise side", "the clockwise side"),
}
"""By direction of a tower: the side toward which it points, and the opposite side, from above."""


def toward(axis: str, value: float) -> str:
    """Return the direction in which a value points: ``z`` or ``−z`` for a base axis, ``the
    outside`` or ``the centre`` for the radial direction of a tower.
    """
    if axis in _TOWER_SIDES:
        return _TOWER_SIDES[axis][bool(value < 0)]
    return axis if value >= 0 else f"{MINUS}{axis}"


def rotation_sense(about: str, value: float, tower: bool) -> str:
    """Return the sense of a rotation.

    Args:
        about: axis of the rotation: ``a``, the leg's own axis, or ``b``, the axis of its pivots.
        value: angle; its sign is the sense.
        tower: whether the leg is a tower. The sense is then stated as seen from above or from
            outside the tower, else as right-handed or left-handed.
    """
    if not tower:
        return sign_word(value, "right-handed", "left-handed")
    viewpoint = {"a": "from above", "b": "from outside the tower"}[about]
    return f"{sign_word(value, 'counter-clockwise', 'clockwise')} seen {viewpoint}"


def along(leg: str, axis: str) -> str:
    """Return where to set a square against a leg, and how to move along it, a clause; the name of
    the direction ``axis`` shows whether the leg is a tower.
    """
    if axis in _TOWER_SIDES:
        return f"stands along tower {leg}, and move up"
    return f"lies along {leg}, and move outward"


def across(axis: str) -> str:
    """Return a direction without its sign, to follow the word "in"."""
    return f"{axis} direction" if axis in _TOWER_SIDES else f"the direction of {axis}"


def sign_word(value: float, positive: str = "more", negative: str = "less") -> str:
    """Return the word for the sign of a value; zero up to rounding counts as positive."""
    return positive if value >= -_ROUNDING else negative


@dataclass(frozen=True)
class _Multiple:
    """A multiple of an SI value, with the factor as format: ``{mm:0.1}``."""

    value: float
    unit: str

    def __format__(self, factor: str) -> str:
        return quantity(self.value * float(factor or 1), self.unit)


def _hinge_axis(parameter: Parameter) -> str:
    """Return words for an axis of a leg: its own, a, or that of its pivots, b."""
    names, along_leg = Orthoglide.names, parameter.direction == "a"
    axis = "the leg's own axis" if along_leg else "the axis of its pivots"
    if parameter.leg not in names.legs:  # whose legs lie along base axes
        return axis
    letter = parameter.leg if along_leg else names.across[names.index(parameter.leg)][0]
    return f"{letter}, {axis}"


_BLANKS: Mapping[str, Callable[[Parameter, float], Any]] = {
    "leg": lambda p, v: p.leg,
    "setup": lambda p, v: p.setup,
    "of_setup": lambda p, v: f" of {p.setup}" if p.setup else "",
    "in_setup": lambda p, v: f" in {p.setup}" if p.setup else "",
    "toward": lambda p, v: toward(p.direction, v),
    "away": lambda p, v: toward(p.direction, -v),
    "across": lambda p, v: across(p.direction),
    "along": lambda p, v: along(p.leg, p.direction),
    "axis": lambda p, v: _hinge_axis(p),
    "sense": lambda p, v: rotation_sense(p.direction, v, p.leg in LinearDelta.names.legs),
}


_ALL_BLANKS = ("size", *_DISPLAY_FACTORS, *_BLANKS, "high_side")


@dataclass(frozen=True)
class _Blanks:
    """The contents of the blanks of a text."""

    parameter: Parameter
    value: float
    size: str
    high_side: float

    def __getitem__(self, blank: str) -> Any:
        if blank == "size":
            return self.size
        if blank == "high_side":
            return f"{self.high_side:.0f}"
        if blank in _DISPLAY_FACTORS:
            return _Multiple(self.value, blank)
        if blank in _BLANKS:
            return _BLANKS[blank](self.parameter, self.value)
        positive, bar, negative = blank.partition("|")
        if not bar:
            raise InputError(
                f"the words of an effect have the blank {{{blank}}}: use "
                f"{', '.join(_ALL_BLANKS)}, or two words, {{more|less}}"
            )
        return sign_word(self.value, positive, negative)


Clause = str | Callable[..., str]
"""A text with blanks, or a function that returns the text."""


def filled(
    text: str, parameter: Parameter, value: float, size: str = "", high_side: float = 0.0
) -> str:
    """Return a text with its blanks filled from a parameter, its value, SI, the text of its size,
    and the direction of a high side, degrees; see `Words`.

    Raises:
        InputError: for an unknown blank, or braces that are none.
    """
    try:
        return text.format_map(_Blanks(parameter, value, size, high_side))
    except InputError:
        raise
    except (AttributeError, IndexError, ValueError) as error:
        raise InputError(
            f"the words of an effect, {text!r}, are not a text with valid blanks: {error}"
        ) from None


@dataclass(frozen=True)
class Words:
    """The texts that describe an effect. Those that are absent are made of ``Effect.sentence``.

    Each is a text with blanks, or a function with the arguments named below. Blanks are ``{leg}``
    and ``{setup}`` of the parameter, ``{of_setup}`` and ``{in_setup}``, which are empty without
    one; ``{size}`` of its value; ``{mm}``, ``{mrad}``, ``{µm}`` and ``{%}``, the value in another
    unit, ``{mm:0.1}`` a tenth of it; ``{more|less}``, one of two words by its sign; and by its
    direction ``{toward}`` and ``{away}``, ``{across}`` without sign, ``{along}`` to set a square,
    ``{axis}`` with ``{sense}`` of a rotation, and ``{high_side}`` of a plate, degrees.

    Attributes:
        one: clause for one parameter and its value, SI, with sign, size and unit.
        short: clause for one parameter without a size.
        many: clause for the effect on all legs, without a size and without blanks.
        size: text of a size, SI, with its unit.
        confirm: test that confirms one parameter of some value, SI, on the machine, with the
            reading to expect.
        common: clause for a value, SI, that all legs have in common, with sign, size and unit.
        noun: noun phrase without placeholders, in place of the names of the parameters.
    """

    one: Clause | None = None
    short: Clause | None = None
    many: str = ""
    size: Clause | None = None
    confirm: Clause | None = None
    common: Clause | None = None
    noun: str = ""

    def __post_init__(self) -> None:
        sample = Parameter("effect", "x", "z")
        for text in (self.one, self.short, self.size, self.confirm, self.common):
            if isinstance(text, str):
                filled(text, sample, 0.0)  # raises InputError for an unknown blank
