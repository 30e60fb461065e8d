"""A parsed TOML file with the line of each key; sections that read and write its tables; kinds of
values in them.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from typing import Any, NoReturn

from orthoglide import units
from orthoglide.errors import FileError, InputError
from orthoglide.text import abbreviated, leaves, nearest, unprintable_problem
from orthoglide.units import Kind, Unit

_MAX_REASON_LENGTH = 120
_MAX_BITS = 1024  # of a whole number: as far as floats go


class Document:
    """A parsed TOML file; a path of keys leads to each value, and errors name the file.

    Raises:
        FileError: if the text is not TOML; methods raise it for wrong values.
    """

    def __init__(self, text: str, file: str) -> None:
        self.text, self.file = text, file
        try:
            self.data = tomllib.loads(text, parse_float=Decimal)
            if any(type(v) is int and v.bit_length() > _MAX_BITS for v in leaves(self.data)):
                raise OverflowError
        except tomllib.TOMLDecodeError as error:
            reason, _, position = str(error).partition(" (at ")
            match = re.match(r"line (\d+)", position)
            line = int(match[1]) if match else len(text.rstrip("\n").split("\n"))
            reason = abbreviated(reason[:1].lower() + reason[1:], _MAX_REASON_LENGTH)
            raise FileError(
                f"is not TOML, {reason}: mend this line", file=file, line=line
            ) from None
        except (ArithmeticError, RecursionError, ValueError):  # int() refuses thousands of digits
            raise FileError(
                "holds a number or nesting out of all range: remove it", file=file
            ) from None
        if problem := unprintable_problem(self.data):
            raise FileError(problem, file=file)

    def fail(self, message: str, *path: str) -> NoReturn:
        """Refuse the file for the value at a path."""
        raise FileError(message, file=self.file, line=_key_line(self.text, path))

    def table(self, *path: str) -> dict[str, Any]:
        """Return the table at a path, which is empty where there is none."""
        value: Any = self.data
        for key in path:
            value = value.get(key, {})
        if not isinstance(value, dict):
            self.fail(f"{'.'.join(path)} must be a table, not a single value", *path)
        return value

    def check_keys(self, names: Collection[str], *path: str) -> None:
        """Refuse the first key of a table that is none of ``names``."""
        for key in self.table(*path):
            if key not in names:
                table = f"[{path[0]}]" if path else "the machine file"
                self.fail(
                    f"{table} has no key {abbreviated(key)!r}: {key_hint(key, names)}", *path, key
                )

    def value(self, parse: Callable[[Any], Any], *path: str) -> Any:
        """Return the parsed value at a path; a ValueError of ``parse`` names the remedy."""
        *within, key = path
        table = self.table(*within)
        if key not in table:
            self.fail(f"{'.'.join(within) or 'the machine file'} has no {key!r}: add it", *within)
        try:
            return parse(table[key])
        except ValueError as error:
            self.fail(f"{'.'.join(path)} {error}", *path)


def key_hint(key: str, names: Collection[str]) -> str:
    """Return what to write in place of an unknown key."""
    near = nearest(key, names)
    return f"did you mean {near!r}?" if near else f"it takes {', '.join(names)}"


_KEY = r"(?:\"[^\"]*\"|'[^']*'|[\w-]+)"
_DOTTED = rf"{_KEY}(?:\s*\.\s*{_KEY})*"


def _key_line(text: str, path: tuple[str, ...]) -> int | None:
    """Return the line of a key, or that of the table that should hold it."""
    header: tuple[str, ...] = ()
    best: tuple[int, int | None] = (0, None)
    for number, line in enumerate(text.split("\n"), start=1):
        if match := re.match(rf"\s*\[({_DOTTED})\]", line):
            header = full = _split_dotted_key(match[1])
        elif match := re.match(rf"\s*({_DOTTED})\s*=", line):
            full = header + _split_dotted_key(match[1])
        else:
            continue
        if full == path[: len(full)] and len(full) > best[0]:
            best = (len(full), number)
    return best[1]


def _split_dotted_key(dotted: str) -> tuple[str, ...]:
    return tuple(key.strip("\"'") for key in re.findall(_KEY, dotted))


@dataclass(frozen=True)
class Key:
    """One key of a section."""

    name: str  # in the file, with its unit unless the section's name contains it
    kind: Kind  # type, unit and range of its value
    meaning: str  # sentences for the documentation
    required: bool = False  # whether a file must have it
    # name of the attribute in Python; if empty, the key without ``_mm``; None if there is none
    attribute: str | None = ""

    @property
    def field_name(self) -> str | None:
        """Return the name of the attribute that holds the value in Python."""
        return self.name.removesuffix("_mm") if self.attribute == "" else self.attribute


@dataclass(frozen=True)
class Section:
    """A table of a file."""

    name: str  # in the file; empty for the keys outside any table
    record_class: type  # the class whose attributes hold its values
    keys: tuple[Key, ...]  # in the order of writing
    tables: tuple[str, ...] = ()  # names of the tables within it

    def read(self, document: Document, *path: str) -> dict[str, Any]:
        """Return the values of a table in SI by attribute; the path is the section's name if empty.

        Raises:
            FileError: for an unknown key, a missing key and a wrong value.
        """
        path = path or ((self.name,) if self.name else ())
        document.check_keys((*(key.name for key in self.keys), *self.tables), *path)
        values = {}
        for key in self.keys:
            if key.required or key.name in document.table(*path):
                values[key.field_name] = document.value(key.kind.read, *path, key.name)
        return {name: value for name, value in values.items() if name is not None}

    def build_record(self, document: Document, *path: str, **further: Any) -> Any:
        """Return the record of a table, with further values; arguments as for `read`.

        Raises:
            FileError: as `read`, and for what the record refuses.
        """
        values = self.read(document, *path)
        try:
            return self.record_class(**values, **further)
        except InputError as error:
            document.fail(str(error), *(path or (self.name,)))

    def write(self, record: Any) -> dict[str, Any]:
        """Return a table of the file from the attributes of a record, without those of None."""
        values = record if isinstance(record, Mapping) else vars(record)
        entries = ((key, values.get(key.field_name)) for key in self.keys)
        return {key.name: key.kind.write(value) for key, value in entries if value is not None}


# -- kinds of values ------------------------------------------------------------------------------


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

    return Kind(read, partial(units.from_si, factor=unit.si), unit.behind.strip())


def list_of(
    each: Kind, count: int, single_allowed: bool = False, check: Callable[..., None] | None = None
) -> Kind:
    """Return the kind of a list of values, of which a single one may stand for all; ``check``
    raises a ValueError where they contradict each other.
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

    return Kind(read, write, each.unit)


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

    return Kind(read)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"must be text in quotes, not {_quoted_value(value)}")
    return value


TEXT = Kind(_text)
