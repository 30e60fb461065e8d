"""Numbers as text: with as many digits as are significant, and a true minus sign."""

from __future__ import annotations

import math
from typing import NamedTuple

_MAX_DECIMALS = 6
_ROUNDING = 1e-12  # in the units of files: smaller values are zero
_EXPONENT_FROM = 1e6  # from here on, numbers are written as powers of ten
MINUS = "−"
SIGMAS_95 = 1.96
"""Half width of a 95 % interval in standard deviations."""


def decimals_for(sigma: float, most: int = _MAX_DECIMALS) -> int:
    """Return the decimals that show two significant digits of a standard deviation."""
    if not math.isfinite(sigma) or sigma <= 0:
        return 3
    return min(max(1 - math.floor(math.log10(sigma)), 0), most)


def signed(value: float, decimals: int) -> str:
    """Return a number with its sign; zero has none."""
    text = f"{abs(value):.{decimals}f}"
    if float(text) == 0:
        return text
    return (MINUS if value < 0 else "+") + text


def plain(value: float, decimals: int) -> str:
    """Return a number with a sign only where it is negative."""
    return signed(value, decimals).lstrip("+")


def compact(value: float, digits: int = 3, plus: bool = False) -> str:
    """Return a number with few significant digits; a dash where it is not finite.

    Powers of ten are used where they are shorter. Less than a billionth of a micrometre, in
    millimetres, counts as zero. ``plus`` adds a sign to positive numbers.
    """
    if plus and value >= _ROUNDING:
        return f"+{compact(value, digits)}"
    if not math.isfinite(value):
        return "–"
    value = value if abs(value) >= _ROUNDING else 0.0
    text = f"{value:.{digits}g}"
    if "e+" in text and abs(value) < _EXPONENT_FROM:
        return f"{float(text):.0f}".replace("-", MINUS)
    if "e" in text:
        mantissa, exponent = text.split("e")
        raised = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
        power = f"10{str(int(exponent)).translate(raised)}"
        text = power if mantissa == "1" else f"{mantissa}·{power}"
    return text.replace("-", MINUS)


def in_mm(metres: float) -> float:
    """Return metres in millimetres to a nanometre, for JSON; zero has no sign."""
    return round(metres * 1e3, 6) + 0.0


def mm_text(metres: float, decimals: int = 6) -> str:
    """Return metres in millimetres, or radians in milliradians, as text for files and tables."""
    return f"{metres * 1e3:z.{decimals}f}"


_MAX_DECIMALS_MM = 4  # decimals of millimetres, beyond the accuracy of any machine


def with_sigma(value: float, sigma: float, most: int = _MAX_DECIMALS_MM) -> str:
    """Return a number with its standard deviation, both with the decimals that show two significant
    digits of the latter, ``most`` of them: ``0.2610 ± 0.0031``. A standard deviation that these do
    not show is left out.
    """
    if not sigma >= 0.5 * 10.0**-most:
        return plain(value, 3)
    places = decimals_for(sigma, most)
    return f"{plain(value, places)} ± {sigma:.{places}f}"


def probability(p: float) -> str:
    """Return a probability as text, or ``below 10⁻⁶``."""
    if not math.isfinite(p):
        return "–"
    return "below 10⁻⁶" if p < 1e-6 else compact(p, 2) if p < 0.1 else f"{p:.2f}"


def distinct_figures(first: float, second: float) -> tuple[str, str]:
    """Return two values of one quantity with enough decimals to tell them apart.

    The smaller value has two significant digits, and at most three decimals if these suffice to
    distinguish the two. A value that no decimal shows is zero.
    """
    first, second = (v if v >= 10.0**-_MAX_DECIMALS / 2 else 0.0 for v in (first, second))
    for max_decimals in (3, _MAX_DECIMALS):
        places = decimals_for(min(first, second), max_decimals)
        texts = f"{first:.{places}f}", f"{second:.{places}f}"
        if texts[0] != texts[1] and float(texts[1]) > 0:
            break
    return texts


class ByUnit(NamedTuple):
    """A figure of readings, separate for lengths and inclinations, which cannot be added."""

    length: float  # metres; nan where no length was read
    turn: float  # radians; nan where no inclination was read

    @property
    def shown(self) -> dict[str, float]:
        """The finite values by their unit, mm or mrad."""
        both = zip(("mm", "mrad"), self, strict=True)
        return {unit: value * 1e3 for unit, value in both if math.isfinite(value)}

    def said(self) -> str:
        """Return the values with their units: ``0.01 mm``, ``0.01 mm and 0.02 mrad``."""
        return " and ".join(f"{compact(v, 2)} {unit}" for unit, v in self.shown.items()) or "–"
