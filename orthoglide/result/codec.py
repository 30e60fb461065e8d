"""Values to JSON and back, as the types of their fields say.

A field of a dataclass stands in the file under its own name. One that is annotated with a `Key`
stands there under another name, in another unit, or with fewer digits; where the module of a class
knows nothing of results, the metadata of the field say the same. What a class gives as
``derived()`` is written for readers of the file and never read back.
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array, Geometry
from orthoglide.layout import LegNames
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.numerals import ByUnit
from orthoglide.result.request import Request
from orthoglide.text import abbreviated

DIGITS = 10
"""Significant digits of a number; further digits are rounding."""

SHORT_DIGITS = 6
"""Significant digits of probabilities and of estimates from random draws."""

CONTEXT_TYPES = (Geometry, LegNames, Machine, Request)
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
        """Return a number in the unit and with the digits of the file; ``None`` for nan or
        infinity.
        """
        return self.numbers(np.array(float(value)))[0]

    def numbers(self, values: Array) -> list[float | None]:
        """Return the numbers of an array, of which there may be many, one behind the other."""
        given: list[float] = (values.ravel() / self.si).tolist()
        if self.places is not None:
            found = [round(v, self.places) + 0.0 if math.isfinite(v) else v for v in given]
        else:
            to = f".{self.digits}g"
            found = [float(format(v, to)) for v in given]
        if np.isfinite(values).all():
            return [*found]
        return [v if math.isfinite(v) else None for v in found]


_MM = 1e-3  # and a milliradian

Metres = Annotated[float, Key(suffix="_mm", si=_MM)]
SampledMetres = Annotated[float, Key(suffix="_mm", si=_MM, digits=SHORT_DIGITS)]
Share = Annotated[float, Key(digits=SHORT_DIGITS)]
in_mm = Key(si=_MM).number
"""Returns metres in millimetres, or radians in milliradians, as the file has them."""

in_mm_short = Key(si=_MM, digits=SHORT_DIGITS).number
"""Like `in_mm`, with the digits of probabilities and estimates from random draws."""

MetresField = Annotated[Array, Key(suffix="_mm", si=_MM, digits=SHORT_DIGITS)]


@cache
def _field_keys(cls: type) -> dict[str, tuple[Any, Key]]:
    """Return the type and the key of every field of a dataclass that is in the file."""
    found = {}
    every = get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        hint, key = every[field.name], Key()
        if get_origin(hint) is Annotated:
            hint, *more = get_args(hint)
            key = next((one for one in more if isinstance(one, Key)), key)
        key = replace(key, **field.metadata)
        if hint not in CONTEXT_TYPES and key.in_file:
            found[field.name] = hint, key
    return found


def required_keys(cls: type) -> set[str]:
    """Return the keys without which no value of a dataclass can be read."""
    plain = {field.name for field in fields(cls) if field.default is MISSING}
    return {
        key.key(name)
        for name, (hint, key) in _field_keys(cls).items()
        if name in plain and not (key.inline or key.omit_if_nan or hint is ByUnit)
    }


def encoded(value: Any, key: Key = Key()) -> Any:  # frozen
    """Return a value as JSON.

    Raises:
        TypeError: for a type that JSON has no form for.
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
            return _nested(key.numbers(value), value.shape)
        case Mapping():
            return {str(name): encoded(one, key) for name, one in value.items()}
        case _ if is_dataclass(value):
            return dict(_encoded_fields(value))
        case list() | tuple():
            return [encoded(one, key) for one in value]
    raise TypeError(f"no JSON of {type(value).__name__}")


def _nested(flat: list[Any], shape: tuple[int, ...]) -> Any:
    """Return the elements of an array as nested lists."""
    if not shape:
        return flat[0]
    for width in shape[:0:-1]:
        flat = [flat[k : k + width] for k in range(0, len(flat), width)] if width else []
    return flat or np.empty(shape).tolist()


def _encoded_fields(value: Any) -> Any:
    cls: Any = type(value)
    for name, (_, key) in _field_keys(cls).items():
        one, called = getattr(value, name), key.key(name)
        if isinstance(one, ByUnit):
            yield from _encoded_units(one, key, name)
        elif key.inline:
            yield from encoded(one).items()
        elif not (key.omit_if_nan and isinstance(one, float) and not math.isfinite(one)):
            yield called, encoded(one, key)
    if hasattr(value, "derived"):
        yield from value.derived().items()


def _encoded_units(value: ByUnit, key: Key, name: str) -> Any:
    """Yield the length in millimetres, and the inclination in milliradians if it is known."""
    name = key.key(name)
    yield f"{name}_mm", Key(si=_MM, digits=key.digits).number(value.length)
    if math.isfinite(value.turn):
        yield f"{name}_mrad", Key(si=_MM, digits=key.digits).number(value.turn)


def decoded(hint: Any, data: Any, shared: Mapping[type, Any], key: Key = Key()) -> Any:
    """Return JSON data as a value of a type.

    A key that is missing is read as the default of its field, if it has one.

    Args:
        hint: the type.
        data: as `encoded` returned it.
        shared: the instance of each type in ``CONTEXT_TYPES``.
        key: how numbers are written in the file.

    Raises:
        KeyError, TypeError, ValueError: if the data are none of this type.
    """
    if get_origin(hint) is Annotated:
        hint, *more = get_args(hint)
        key = next((one for one in more if isinstance(one, Key)), key)
    origin, inner = get_origin(hint), get_args(hint)
    if hint is Any:
        return data
    if origin is Literal:
        return _checked(data, data in inner if isinstance(data, str) else False, " or ".join(inner))
    if origin in (Union, types.UnionType):
        if data is None and type(None) in inner:
            return None
        return decoded(next(one for one in inner if one is not type(None)), data, shared, key)
    if hint is float:
        known = type(data) in (int, float) and math.isfinite(data)
        return key.null if data is None else float(_checked(data, known, "number")) * key.si
    if hint is Note:
        return Note(data["text"], data["kind"], tuple(data["lines"]))
    if hint in (bool, int, str):
        return _checked(data, type(data) is hint, hint.__name__)
    if origin is np.ndarray:
        return _array(hint, data, key)
    if origin in (tuple, list) or (isinstance(origin, type) and issubclass(origin, Sequence)):
        _checked(data, isinstance(data, list), "list")
    if origin is tuple:
        several = inner[:1] * len(data) if inner[1:] == (Ellipsis,) else inner
        return tuple(decoded(h, v, shared, key) for h, v in zip(several, data, strict=True))
    if origin is not None and issubclass(origin, Mapping):
        _checked(data, isinstance(data, dict), "object")
        return {name: decoded(inner[1], one, shared, key) for name, one in data.items()}
    if origin is not None and issubclass(origin, Sequence):
        return tuple(decoded(inner[0], one, shared, key) for one in data)
    if is_dataclass(hint):
        return _decoded_fields(hint, data, shared)
    raise TypeError(f"no {hint} from JSON")


def _checked(data: Any, right: bool, what: str) -> Any:
    if not right:
        raise TypeError(f"{abbreviated(repr(data))} is no {what}")
    return data


def _array(hint: Any, data: Any, key: Key) -> NDArray[Any]:
    (kind,) = get_args(get_args(hint)[1])
    if issubclass(kind, np.floating):
        return np.array(data, dtype=float) * key.si
    return np.array(data, dtype=kind)


def _decoded_fields(cls: Any, data: Any, shared: Mapping[type, Any]) -> Any:
    found: dict[str, Any] = {}
    every = get_type_hints(cls)
    for field in fields(cls):
        hint, key = _field_keys(cls).get(field.name, (every[field.name], None))
        if key is None:
            if hint in shared:
                found[field.name] = shared[hint]
            continue
        called = key.key(field.name)
        if hint is ByUnit:
            parts = (data.get(f"{called}_{unit}") for unit in ("mm", "mrad"))
            found[field.name] = ByUnit(*(math.nan if v is None else v * _MM for v in parts))
        elif key.inline:
            found[field.name] = decoded(hint, data, shared)
        elif key.omit_if_nan and called not in data:
            found[field.name] = math.nan
        elif called not in data and (
            field.default is not MISSING or field.default_factory is not MISSING
        ):
            continue
        else:
            found[field.name] = decoded(hint, data[called], shared, key)
    return cls(**found)
