"""Numbers for people: as many digits as they are worth, and a true minus sign."""

from __future__ import annotations

import math
from typing import NamedTuple

_MAX_DECIMALS = 6
_ROUNDING = 1e-12  # in the units of files: no figure that means anything is smaller
_EXPONENT_FROM = 1e6  # below, a number is no power of ten
MINUS = "−"
SIGMAS_95 = 1.96
"""Half width of a 95 % interval in standard deviations."""


def decimals_for(sigma: float, most: int = _MAX_DECIMALS) -> int:
    """Decimals that show two significant digits of a standard deviation."""
    if not math.isfinite(sigma) or sigma <= 0:
        return 3
    return min(max(1 - math.floor(math.log10(sigma)), 0), most)


def signed(value: float, decimals: int) -> str:
    """A number with its sign; zero has none."""
    text = f"{abs(value):.{decimals}f}"
    if float(text) == 0:
        return text
    return (MINUS if value < 0 else "+") + text


def plain(value: float, decimals: int) -> str:
    """A number with a sign only where it is negative."""
    return signed(value, decimals).lstrip("+")


def compact(value: float, digits: int = 3, plus: bool = False) -> str:
    """Few significant digits, powers of ten where they are shorter; a dash for none.

    Less than a billionth of a micrometre, in millimetres, is rounding and zero. ``plus``: with a
    sign where it is positive, too.
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


_MAX_DECIMALS_MM = 4  # decimals of millimetres that any machine is worth


def with_sigma(value: float, sigma: float, most: int = _MAX_DECIMALS_MM) -> str:
    """Return a number with its standard deviation, both with the decimals that show two significant
    digits of the latter, ``most`` of them: ``0.2610 ± 0.0031``. A standard deviation that these do
    not show is left out.
    """
    if not sigma >= 0.5 * 10.0**-most:
        return plain(value, 3)
    places = decimals_for(sigma, most)
    return f"{plain(value, places)} ± {sigma:.{places}f}"


def hundredths(p: float) -> str:
    """A probability to two decimals; below half of the last only that."""
    return f"{p:.2f}" if p >= 0.005 else "< 0.01"


def probability(p: float) -> str:
    """A probability; below a millionth only that."""
    if not math.isfinite(p):
        return "–"
    return "below 10⁻⁶" if p < 1e-6 else compact(p, 2) if p < 0.1 else f"{p:.2f}"


def distinct_figures(was: float, now: float) -> tuple[str, str]:
    """Two figures of one quantity, with more decimals where they would look alike, or be nothing.

    Two significant digits of the smaller, three decimals at most where these tell them apart. What
    no decimal shows is zero.
    """
    was, now = (v if v >= 10.0**-_MAX_DECIMALS / 2 else 0.0 for v in (was, now))
    for most in (3, _MAX_DECIMALS):
        places = decimals_for(min(was, now), most)
        texts = f"{was:.{places}f}", f"{now:.{places}f}"
        if texts[0] != texts[1] and float(texts[1]) > 0:
            break
    return texts


class ByUnit(NamedTuple):
    """One figure of readings, of lengths and of inclinations apart: the two never add up."""

    length: float  # metres; nan where no length was read
    turn: float  # radians; nan where no inclination was read

    @property
    def shown(self) -> dict[str, float]:
        """What is known of it by the unit in which people read it, mm or mrad."""
        both = zip(("mm", "mrad"), self, strict=True)
        return {unit: value * 1e3 for unit, value in both if math.isfinite(value)}

    def said(self, digits: int = 2) -> str:
        """With its units: ``0.01 mm``, ``0.01 mm and 0.02 mrad``."""
        return " and ".join(f"{compact(v, digits)} {unit}" for unit, v in self.shown.items()) or "–"
