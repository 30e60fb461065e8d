"""Values to JSON and back, by the types of their fields.

A field of a dataclass is written under its own name. A `Key` in its annotation gives it another
name, another unit, or fewer digits; in modules that do not import results, the metadata of the
field contain the same. The keys of ``derived()`` are written for readers of the file and never
read back.
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from orthoglide.effects import Catalogue
from orthoglide.geometry import Array, Geometry
from orthoglide.layout import LegNames
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.numerals import ByUnit
from orthoglide.text import abbreviated

DIGITS = 10
"""Significant digits of a number; further digits are rounding."""

SHORT_DIGITS = 6
"""Significant digits of probabilities and of estimates from random draws."""

CONTEXT_TYPES = (Catalogue, Geometry, LegNames, Machine)
"""Types with one instance for the whole result: `encoded` leaves out fields of these types, and
`decoded` fills them from the instances that it is given."""


@dataclass(frozen=True)
class Key:
    """How a field is written in the file."""

    name: str = ""  # name of the key; empty: the name of the field
    suffix: str = ""  # appended to the name, such as "_mm"
    si: float = 1.0  # SI value of one unit of the file
    digits: int = DIGITS
    places: int | None = None  # decimals, in place of a number of digits
    omit_if_nan: bool = False  # whether the key is left out where the value is nan
    null: float = math.nan  # value that null is read as
    inline: bool = False  # whether the keys of the value are merged into those of its owner
    in_file: bool = True  # if not, the field is neither written nor read and needs a default

    def key(self, field: str) -> str:
        """Return the key of a field."""
        return f"{self.name or field}{self.suffix}"

    def number(self, value: float) -> float | None:
        """Return a number in the unit and with the digits of the file; ``None`` if not finite."""
        return self.numbers(np.array(float(value)))[0]

    def numbers(self, values: Array) -> list[float | None]:
        """Return the numbers of an array as a flat list."""
        scaled: list[float] = (values.ravel() / self.si).tolist()
        if self.places is not None:
            rounded = [round(v, self.places) + 0.0 if math.isfinite(v) else v for v in scaled]
        else:
            spec = f".{self.digits}g"
            rounded = [float(format(v, spec)) for v in scaled]
        return [v if math.isfinite(v) else None for v in rounded]


_MM = 1e-3  # SI value of a millimetre, and of a milliradian

Metres = Annotated[float, Key(suffix="_mm", si=_MM)]
SampledMetres = Annotated[float, Key(suffix="_mm", si=_MM, digits=SHORT_DIGITS)]
Share = Annotated[float, Key(digits=SHORT_DIGITS)]
in_mm = Key(si=_MM).number
"""Return metres in millimetres, or radians in milliradians, with the digits of the file."""

in_mm_short = Key(si=_MM, digits=SHORT_DIGITS).number
"""Like `in_mm`, with the digits of probabilities and estimates from random draws."""

MetresField = Annotated[Array, Key(suffix="_mm", si=_MM, digits=SHORT_DIGITS)]


def _split_hint(hint: Any, key: Key) -> tuple[Any, Key]:
    """Return a type without its annotations, and the key among these or else the given one."""
    if get_origin(hint) is not Annotated:
        return hint, key
    hint, *extras = get_args(hint)
    return hint, next((extra for extra in extras if isinstance(extra, Key)), key)


@cache
def _field_keys(cls: type) -> dict[str, tuple[Any, Key]]:
    """Return the type and the key of every field of a dataclass."""
    keys = {}
    hints = get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        hint, key = _split_hint(hints[field.name], Key())
        key = replace(key, **field.metadata)
        keys[field.name] = hint, replace(key, in_file=key.in_file and hint not in CONTEXT_TYPES)
    return keys


def encoded(value: Any, key: Key = Key()) -> Any:  # frozen
    """Return a value as JSON.

    Raises:
        TypeError: for a type that JSON does not have.
    """
    match value:
        case None | bool() | int():
            return value
        case Note():
            return {"kind": value.kind, "text": str(value), "lines": list(value.lines)}
        case str():
            return str(value)
        case float():
            return key.number(value)
        case np.ndarray():
            if value.dtype.kind != "f":
                return value.tolist()
            return np.array(key.numbers(value), dtype=object).reshape(value.shape).tolist()
        case Mapping():
            return {str(name): encoded(item, key) for name, item in value.items()}
        case _ if is_dataclass(value):
            return dict(_encoded_fields(value))
        case list() | tuple():
            return [encoded(item, key) for item in value]
    raise TypeError(f"no JSON of {type(value).__name__}")


def _encoded_fields(value: Any) -> Any:
    cls: Any = type(value)
    for name, (_, key) in _field_keys(cls).items():
        item, name_in_file = getattr(value, name), key.key(name)
        if not key.in_file:
            continue
        if isinstance(item, ByUnit):
            number = Key(si=_MM, digits=key.digits).number
            yield f"{name_in_file}_mm", number(item.length)
            if math.isfinite(item.turn):
                yield f"{name_in_file}_mrad", number(item.turn)
        elif key.inline:
            yield from encoded(item).items()
        elif not (key.omit_if_nan and isinstance(item, float) and not math.isfinite(item)):
            yield name_in_file, encoded(item, key)
    if hasattr(value, "derived"):
        yield from value.derived().items()


def decoded(hint: Any, data: Any, shared: Mapping[type, Any], key: Key = Key()) -> Any:
    """Return JSON data, as `encoded` returned them, as a value of a type.

    A missing key is read as the default of its field, if it has one. ``shared`` has the instance of
    each type in ``CONTEXT_TYPES``, and of others that the file leaves out; ``key`` says how numbers
    are written.

    Raises:
        KeyError, TypeError, ValueError: if the data are not of this type.
    """
    hint, key = _split_hint(hint, key)
    origin, inner = get_origin(hint), get_args(hint)
    if hint is Any:
        return data
    if origin is Literal:
        return _checked(data, data in inner if isinstance(data, str) else False, " or ".join(inner))
    if origin in (Union, types.UnionType):
        if data is None and type(None) in inner:
            return None
        return decoded(next(item for item in inner if item is not type(None)), data, shared, key)
    if hint is float:
        is_number = type(data) in (int, float) and math.isfinite(data)
        return key.null if data is None else float(_checked(data, is_number, "number")) * key.si
    if hint is Note:
        return Note(data["text"], data["kind"], tuple(data["lines"]))
    if hint in (bool, int, str):
        return _checked(data, type(data) is hint, hint.__name__)
    if origin is np.ndarray:
        (kind,) = get_args(inner[1])
        floating = issubclass(kind, np.floating)
        return np.array(data, dtype=float) * key.si if floating else np.array(data, dtype=kind)
    if origin is not None and issubclass(origin, Sequence):
        _checked(data, isinstance(data, list), "list")
        fixed = origin is tuple and inner[1:] != (Ellipsis,)
        hints = inner if fixed else inner[:1] * len(data)
        return tuple(decoded(h, v, shared, key) for h, v in zip(hints, data, strict=True))
    if origin is not None and issubclass(origin, Mapping):
        _checked(data, isinstance(data, dict), "object")
        return {name: decoded(inner[1], item, shared, key) for name, item in data.items()}
    if is_dataclass(hint):
        cls: Any = hint
        return cls(**decoded_fields(hint, data, shared))
    raise TypeError(f"no {hint} from JSON")


def _checked(data: Any, is_valid: bool, expected: str) -> Any:
    if not is_valid:
        raise TypeError(f"expected {expected}, found {abbreviated(repr(data))}")
    return data


def decoded_fields(cls: Any, data: Any, shared: Mapping[type, Any]) -> dict[str, Any]:
    """Return the fields of a dataclass by name, without those that have their default; arguments
    and errors as for `decoded`.
    """
    values: dict[str, Any] = {}
    for field in fields(cls):
        hint, key = _field_keys(cls)[field.name]
        name_in_file = key.key(field.name)
        if not key.in_file:
            values |= {field.name: shared[hint]} if hint in shared else {}
        elif hint is ByUnit:
            parts = (data.get(f"{name_in_file}_{unit}") for unit in ("mm", "mrad"))
            values[field.name] = ByUnit(*(math.nan if v is None else v * _MM for v in parts))
        elif key.inline:
            values[field.name] = decoded(hint, data, shared)
        elif key.omit_if_nan and name_in_file not in data:
            values[field.name] = math.nan
        elif name_in_file in data or field.default is field.default_factory is MISSING:
            values[field.name] = decoded(hint, data[name_in_file], shared, key)
    return values
