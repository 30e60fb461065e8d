"""Texts for sizes and directions, and the sentences by which an effect describes its value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from orthoglide.numerals import MINUS, compact
from orthoglide.parameters import Parameter

_ROUNDING = 1e-13  # SI: a smaller value counts as zero and has no sign


def mm(value: float) -> str:
    """Return the absolute value of a length in metres as text: ``0.12 mm``."""
    return f"{compact(abs(value) * 1e3, 2)} mm"


def mrad(value: float) -> str:
    """Return the absolute value of an angle in radians as text: ``2.5 mrad``."""
    return f"{compact(abs(value) * 1e3, 2)} mrad"


def slope(value: float) -> str:
    """Return the absolute value of a slope in radians as text, also as the deviation over 100 mm
    that a mechanic measures: ``2.5 mrad (0.25 mm over 100 mm)``.
    """
    return f"{mrad(value)} ({compact(abs(value) * 100, 2)} mm over 100 mm)"


def percent(value: float) -> str:
    """Return the absolute value of a ratio as text: ``0.3 %``."""
    return f"{compact(abs(value) * 100, 2)} %"


_TOWER_SIDES = {
    "radial": ("the outside", "the centre"),
    "tangential": ("the counter-clockwise side", "the clockwise side"),
}
"""By direction of a leg of a tower the sides that lie along it and against it, seen from above."""


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
    """Return where to set a square against a leg, and how to move along it, a clause.

    Args:
        leg: name of the leg.
        axis: direction across the leg; its name shows whether the leg is a tower.
    """
    if axis in _TOWER_SIDES:
        return f"stands along tower {leg}, and move 100 mm up"
    return f"lies along {leg}, and move 100 mm outward"


def across(axis: str) -> str:
    """Return a direction without its sign, to follow the word "in"."""
    return f"{axis} direction" if axis in _TOWER_SIDES else f"the direction of {axis}"


def sign_word(value: float, positive: str = "more", negative: str = "less") -> str:
    """Return the word for the sign of a value; zero up to rounding counts as positive."""
    return positive if value >= -_ROUNDING else negative


def micrometres(value: float, per: str, scale: float = 1e6) -> str:
    """Return the absolute value of a small ratio as text: ``12 µm a metre and kelvin``.

    Args:
        value: ratio, SI.
        per: words that follow the micrometres.
        scale: micrometres for a ratio of one.
    """
    return f"{compact(abs(value) * scale, 2)} µm {per}"


ValueClause = Callable[[Parameter, float], str]
"""Returns a clause for a parameter and its value, SI."""


@dataclass(frozen=True)
class Words:
    """The texts that describe an effect. Those that are absent are made of ``Effect.sentence``.

    Attributes:
        one: returns the clause for one parameter and its value, SI, with sign, size and unit.
        short: returns the clause for one parameter without a size.
        many: clause for the effect on all legs, without a size.
        size: returns the text of a size, SI, with its unit.
        confirm: returns a test that confirms one parameter of some value, SI, on the machine, with
            the reading to expect.
        common: returns the clause for a value, SI, that all legs have in common, with sign, size
            and unit.
    """

    one: ValueClause | None = None
    short: Callable[[Parameter], str] | None = None
    many: str = ""
    size: Callable[[float], str] | None = None
    confirm: ValueClause | None = None
    common: Callable[[float], str] | None = None
