"""What a value of a file may be: its unit, its range, how it becomes SI and how it is written back.

A key of the machine file has such a kind, and a column of a table can have one.
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
    """What a value of a file is.

    Attributes:
        allowed: the values that are allowed, as "must be" continues.
        read: turns a value of the file into SI, or raises ValueError with what would be right.
        write: turns a value in SI into that of the file.
        unit: in the file; empty where it has none.
    """

    allowed: str
    read: Callable[[Any], Any]
    write: Callable[[Any], Any] = lambda value: value
    unit: str = ""


def _quoted_value(value: Any) -> str:
    """Return a value of a file as a message repeats it."""
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a table"
    return abbreviated(repr(value) if isinstance(value, str) else str(value).lower())


def quantity(unit: Unit, low: float = 0.0, high: float = 1e4, closed: bool = False) -> Kind:
    """Return the kind of a number between two limits in its unit, which a ``closed`` range has."""
    allowed = f"above {low:g} and below {high:g}"
    if closed:
        both = f"at least {low:g} and at most {high:g}"
        allowed = f"no more than {high:g} in size" if low == -high else both

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
    """Return the kind of a list of values; a single one stands for all where they may be ``single_allowed``.

    ``check`` takes the values and raises ValueError where they do not go together.
    """
    needed = f"{'a number or ' * single_allowed}a list of {count} numbers{each.unit and ' in '}{each.unit}"

    def read(value: Any) -> tuple[Any, ...]:
        if single_allowed and not isinstance(value, list):
            return (each.read(value),) * count
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"must be {needed}, not {_quoted_value(value)}")
        found = []
        for place, one in enumerate(value, start=1):
            try:
                found.append(each.read(one))
            except ValueError as error:
                raise ValueError(f"at place {place} {error}") from None
        if check is not None:
            check(*found)
        return tuple(found)

    return Kind(
        f"{needed}, each {each.allowed}",
        read,
        lambda values: [each.write(value) for value in values],
        each.unit,
    )


def one_of(values: tuple[Any, ...], remedy: str = "") -> Kind:
    """Return the kind of a word or whole number that is one of a few."""
    *others, last = map(str, values)
    allowed = f"{', '.join(others)} or {last}" if others else last

    def read(value: Any) -> Any:
        if not isinstance(value, bool) and value in values:
            return values[values.index(value)]
        near = nearest(str(value), map(str, values))
        told = remedy or (f"did you mean {near!r}?" if near else "correct it")
        raise ValueError(f"must be {allowed}, not {_quoted_value(value)}: {told}")

    return Kind(allowed, read)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"must be text in quotes, not {_quoted_value(value)}")
    return value


TEXT = Kind("text in quotes", _text)
