"""How an effect is said: sizes, directions, and sentences made of a fitted value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from orthoglide.numerals import MINUS, compact
from orthoglide.parameters import Parameter

_ROUNDING = 1e-13  # SI: less is zero, whose sign is chance


def mm(value: float) -> str:
    """A length, SI, as ``0.123 mm``."""
    return f"{compact(abs(value) * 1e3, 2)} mm"


def mrad(value: float) -> str:
    """An angle, SI, as ``2.5 mrad``."""
    return f"{compact(abs(value) * 1e3, 2)} mrad"


def slope(value: float) -> str:
    """A slope, SI, as a mechanic measures it: ``2.5 mrad (0.25 mm over 100 mm)``."""
    return f"{mrad(value)} ({compact(abs(value) * 100, 2)} mm over 100 mm)"


def percent(value: float) -> str:
    """A ratio as ``0.3 %``."""
    return f"{compact(abs(value) * 100, 2)} %"


_SIDES = {
    "radial": ("the outside", "the centre"),
    "tangential": ("the counter-clockwise side", "the clockwise side"),
}
"""What lies in a direction and against it, of legs that stand around a centre, seen from above."""


def toward(axis: str, value: float) -> str:
    """An axis with the sign of a value: ``z``, ``−z``; or the side, ``the centre``."""
    if axis in _SIDES:
        return _SIDES[axis][bool(value < 0)]
    return axis if value >= 0 else f"{MINUS}{axis}"


def turned(about: str, value: float, tower: bool) -> str:
    """Which way something is turned about its leg's own axis (``a``) or its pivots' (``b``).

    Legs of a tower stand up and turn their pivots outward: there it is said as it is seen.
    """
    if not tower:
        return more(value, "right-handed", "left-handed")
    seen = {"a": "from above", "b": "from outside the tower"}[about]
    return f"{more(value, 'counter-clockwise', 'clockwise')} seen {seen}"


def along(leg: str, axis: str) -> str:
    """Where a square lies along a leg with such a direction across it, and which way is on."""
    if axis in _SIDES:
        return f"stands along tower {leg}, and move 100 mm up"
    return f"lies along {leg}, and move 100 mm outward"


def across(axis: str) -> str:
    """A direction without its sign, behind "in"."""
    return f"{axis} direction" if axis in _SIDES else f"the direction of {axis}"


def more(value: float, positive: str = "more", negative: str = "less") -> str:
    """The word for a value's sign; zero is positive, up to rounding."""
    return positive if value >= -_ROUNDING else negative


def micrometres(value: float, per: str, scale: float = 1e6) -> str:
    """A small ratio, SI, as ``12 µm a metre and kelvin``; ``per`` follows the micrometres."""
    return f"{compact(abs(value) * scale, 2)} µm {per}"


Said = Callable[[Parameter, float], str]


@dataclass(frozen=True)
class Words:
    """How to speak of an effect. What is not given is made of the effect's own sentence.

    Attributes:
        one: clause for one parameter and its fitted value, SI: sign, size and unit in it.
        short: the same cause without its size.
        many: clause for all legs together, without its size.
        size: how a size is said.
        confirm: a test on the machine that confirms it, with the reading to expect.
        common: clause for a value that all legs have together, SI: sign, size and unit in it.
    """

    one: Said | None = None
    short: Callable[[Parameter], str] | None = None
    many: str = ""
    size: Callable[[float], str] | None = None
    confirm: Said | None = None
    common: Callable[[float], str] | None = None
