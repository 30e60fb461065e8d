"""Kinds of values in files: unit, range, conversion to SI and back.

Keys of the machine file and columns of tables have a kind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from typing import Any

from orthoglide import units
from orthoglide.text import abbreviated, nearest
from orthoglide.units import Unit


@dataclass(frozen=True)
class Kind:
    """Kind of a value in a file.

    Attributes:
        allowed: the allowed values, as words that follow "must be".
        read: converts a value of the file to SI, or raises ValueError with the remedy.
        write: converts a value in SI to that of the file.
        unit: in the file; empty for none.
    """

    allowed: str
    read: Callable[[Any], Any]
    write: Callable[[Any], Any] = lambda value: value
    unit: str = ""


def _quoted_value(value: Any) -> str:
    """Return a value of a file as a message quotes it."""
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a table"
    return abbreviated(repr(value) if isinstance(value, str) else str(value).lower())


def quantity(unit: Unit, low: float = 0.0, high: float = 1e4, closed: bool = False) -> Kind:
    """Return the kind of a number between two limits, which a ``closed`` range includes."""
    allowed = f"above {low:g} and below {high:g}"
    if closed:
        closed_range = f"at least {low:g} and at most {high:g}"
        allowed = f"no more than {high:g} in size" if low == -high else closed_range

    def read(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | Decimal):
            raise ValueError(f"must be a number, not {_quoted_value(value)}")
        number = Decimal(value)
        if not number.is_finite():
            raise ValueError(f"must be a finite number, not {number}")
        if not (low <= number <= high if closed else low < number < high):
            hint = ": is it in metres?" if unit.si == 1e-3 and 0 < number <= low else ""
            raise ValueError(f"must be {allowed}, not {float(number):g}{hint}")
        return units.to_si(number, unit.si)

    return Kind(allowed, read, partial(units.from_si, factor=unit.si), unit.behind.strip())


def list_of(
    each: Kind, count: int, single_allowed: bool = False, check: Callable[..., None] | None = None
) -> Kind:
    """Return the kind of a list of values.

    Args:
        each: kind of each value.
        count: number of values.
        single_allowed: whether a single value may stand for all.
        check: takes the values and raises ValueError where they contradict each other.
    """
    requirement = f"a list of {count} numbers{each.unit and ' in '}{each.unit}"
    if single_allowed:
        requirement = f"a number or {requirement}"

    def read(value: Any) -> tuple[Any, ...]:
        if single_allowed and not isinstance(value, list):
            return (each.read(value),) * count
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"must be {requirement}, not {_quoted_value(value)}")
        values = []
        for number, item in enumerate(value, start=1):
            try:
                values.append(each.read(item))
            except ValueError as error:
                raise ValueError(f"at place {number} {error}") from None
        if check is not None:
            check(*values)
        return tuple(values)

    def write(values: Any) -> list[Any]:
        return [each.write(value) for value in values]

    return Kind(f"{requirement}, each {each.allowed}", read, write, each.unit)


def one_of(values: tuple[Any, ...], remedy: str = "") -> Kind:
    """Return the kind of a word or whole number that is one of a few."""
    *others, last = map(str, values)
    allowed = f"{', '.join(others)} or {last}" if others else last

    def read(value: Any) -> Any:
        if not isinstance(value, bool) and value in values:
            return values[values.index(value)]
        suggestion = nearest(str(value), map(str, values))
        advice = remedy or (f"did you mean {suggestion!r}?" if suggestion else "correct it")
        raise ValueError(f"must be {allowed}, not {_quoted_value(value)}: {advice}")

    return Kind(allowed, read)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"must be text in quotes, not {_quoted_value(value)}")
    return value


TEXT = Kind("text in quotes", _text)
