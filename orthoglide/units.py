"""The border between files and SI: units, kinds of values, and exact conversion.

A number in a file is a decimal; it becomes SI by shifting its decimal point and is rounded to
binary once. Writing shifts the shortest decimal back. So 310.25 mm is read as the float nearest
to 0.31025 m and written as 310.25 again, and every round trip is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from typing import Any, NamedTuple


class Unit(NamedTuple):
    """A unit: its name and its value in SI, a power of ten for units of files."""

    name: str
    si: float

    @property
    def behind(self) -> str:
        """The suffix of a number in a sentence: empty for a ratio."""
        return "" if self.name == "1" else f" {self.name}"

    @property
    def spoken(self) -> Unit:
        """The unit of reports: milliradians, percent."""
        factor, name = _DISPLAY_UNITS.get(self.name, (1.0, self.name))
        return Unit(name, self.si / factor)


_DISPLAY_UNITS = {
    "rad": (1e3, "mrad"),
    "1": (1e2, "%"),
    "mm/N": (1e3, "µm/N"),
    "1/K": (1e6, "µm/(m K)"),
    "1/s": (3600e6, "µm/(m h)"),
}


NOISE_LIMITS = (1e-9, 1e-3)
"""Limits of the standard deviation of a reading, metres: an atom, and beyond any dial."""

MM, RAD, ONE = Unit("mm", 1e-3), Unit("rad", 1.0), Unit("1", 1.0)

INCH = 25.4
"""In millimetres."""

MICROSTEP_RATIOS = (1.0, *(2.0**k for k in (1, -1, 2, -2, 3, -3, 4, -4)))
"""Ratios of the travel of a step before and after microsteps were changed, likeliest first."""

PULLEY_RATIOS = tuple(
    2.0**k * m for k in (0, 1, -1, 2, -2) for m in (5 / 4, 4 / 5, 4 / 3, 3 / 4, 6 / 5, 5 / 6)
)
"""The same after a pulley or a motor was changed, which is rarer: pulleys of 16, 20, 24 and 32
teeth, beside microsteps."""

UNIT_MISTAKES = {
    1e3: "in metres instead of millimetres",
    1e-3: "in micrometres instead of millimetres",
    INCH: "in inches instead of millimetres",
    1 / INCH: "in millimetres taken for inches",
    10.0: "in centimetres, or with the decimal point one place off",
    0.1: "with the decimal point one place off",
    100.0: "in hundredths, or with the decimal point two places off",
    0.01: "in hundredths of a millimetre",
}
"""Factors that correct readings in a wrong unit, with the mistake in words."""


@dataclass(frozen=True)
class Kind:
    """Kind of a value in a file."""

    # converts a value of the file to SI, or raises ValueError with the remedy
    read: Callable[[Any], Any]
    write: Callable[[Any], Any] = lambda value: value  # converts a value in SI to that of the file
    unit: str = ""  # in the file; empty for none
    choices: tuple[str, ...] = ()  # the allowed words of a column of words


def to_si(number: str | int | float | Decimal, factor: float = 1.0) -> float:
    """The SI value nearest to a decimal given in a unit worth ``factor`` (a power of ten).

    Zero has no sign: random generators refuse a standard deviation of -0.
    """
    mantissa, _, exponent = str(number).lower().partition("e")
    return float(f"{mantissa}e{int(exponent or 0) + _decimal_exponent(factor)}") + 0.0


def from_si(value: float, factor: float = 1.0) -> Decimal:
    """The shortest decimal in a unit worth ``factor`` that `to_si` turns back into ``value``."""
    return Decimal(f"{Decimal(repr(float(value) + 0.0)).scaleb(-_decimal_exponent(factor)):f}")


@cache
def _decimal_exponent(factor: float) -> int:
    return Decimal(repr(factor)).adjusted()
