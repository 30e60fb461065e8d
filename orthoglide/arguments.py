"""Arguments of public functions: one that its annotation excludes is named."""

from __future__ import annotations

import collections.abc
import sys
from collections.abc import Collection, Mapping
from contextlib import suppress
from functools import cache, wraps
from inspect import Parameter, isfunction, signature
from itertools import islice
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

from orthoglide.errors import InputError, OrthoglideError, as_float_array
from orthoglide.text import abbreviated

T = TypeVar("T")
_VARIADIC = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
_BARE_ERRORS = (TypeError, ValueError, AttributeError, LookupError)


def public(entry: T) -> T:
    """Return a function, or a class with its methods, that names a wrong argument.

    Where an error escapes that the package did not raise, and an argument is not what its
    annotation says, that argument is the cause, and an `InputError` says so. A constructor refuses
    attributes that are not, even where no error escapes, as they are used only later.
    """
    if isinstance(entry, type):
        for name, member in list(vars(entry).items()):
            if name == "__init__" or not name.startswith("_"):
                if isinstance(member, classmethod | staticmethod):
                    setattr(entry, name, type(member)(public(member.__func__)))
                elif isfunction(member):
                    setattr(entry, name, public(member))
        return entry
    function: Any = entry

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            result = function(*args, **options)
        except _BARE_ERRORS as error:
            if not isinstance(error, OrthoglideError):
                with suppress(TypeError):  # these are not the arguments that the function has
                    given = signature(function).bind(*args, **options).arguments
                    _refuse_wrong_types(function, given, error)
            raise
        if function.__name__ == "__init__":
            _refuse_wrong_types(function, vars(args[0]))
        return result

    checked: Any = call
    return checked


def _refuse_wrong_types(
    function: Any, values: Mapping[str, Any], cause: Exception | None = None
) -> None:
    """Raise an `InputError` for the first value that is not what the annotation of the parameter of
    this name says.
    """
    for name, (parameter, hint) in _annotated_parameters(function).items():
        value = values.get(name, parameter.default)
        if value is not parameter.default and not _is_of_type(value, hint):
            choices = get_args(hint) if get_origin(hint) is Literal else ()
            expected = f"one of {', '.join(choices)}" if choices else parameter.annotation
            found = f"{abbreviated(repr(value).partition(chr(10))[0])} ({type(value).__name__})"
            raise InputError(f"{name} must be {expected}, not {found}") from cause


@cache
def _annotated_parameters(function: Any) -> dict[str, tuple[Parameter, Any]]:
    """Return the parameters of a function with their types; without those of which the type is
    imported for type checkers only.
    """
    names = {**vars(sys.modules[function.__module__]), "ArrayLike": _Numbers}
    annotated = dict[str, tuple[Parameter, Any]]()
    for name, parameter in signature(function).parameters.items():
        if isinstance(parameter.annotation, str) and parameter.kind not in _VARIADIC:
            with suppress(NameError):
                annotated[name] = parameter, eval(parameter.annotation, names)
    return annotated


class _Numbers:
    """Stands for what numpy takes as an array of numbers."""


_MOST_CHECKED = 2  # first items of a collection: one of another kind begins with wrong ones


@cache
def _accepted(kind: Any) -> Any:
    """Return the types of values that may be given where a type is asked for."""
    import numpy as np

    sequences = collections.abc.Sequence, collections.abc.Set, np.ndarray
    wider = {bool: (Integral, np.bool_), int: Integral, float: Real}
    return wider.get(kind, sequences if kind in (*sequences, tuple, list) else kind)


@cache
def _parts(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the type without its arguments, and these."""
    return get_origin(hint) or hint, get_args(hint)


def _is_of_type(value: Any, hint: Any) -> bool:
    """Return whether a value may be given where a type is asked for: any list but a text for a
    sequence, and anything with the numbers of an array for an array.
    """
    kind, parts = _parts(hint)
    if kind in (Union, UnionType):
        return any(_is_of_type(value, part) for part in parts)
    if kind is Literal:
        return isinstance(value, str) and value in parts
    if kind is Any or not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return True
    if kind is _Numbers or kind.__name__ == "ndarray":
        return _has_numbers(value)
    if kind is collections.abc.Callable:
        return callable(value)
    is_accepted = isinstance(value, _accepted(kind))
    if not is_accepted or not parts or not isinstance(value, Collection):
        return is_accepted  # an iterator is read once only
    if isinstance(value, str | bytes) or getattr(value, "shape", None) == ():
        return False
    if kind is tuple and Ellipsis not in parts:
        return len(value) == len(parts) and all(map(_is_of_type, value, parts))
    of_keys = all(_is_of_type(item, parts[0]) for item in islice(value, _MOST_CHECKED))
    if not isinstance(value, Mapping) or len(parts) < 2:
        return of_keys
    return of_keys and _is_of_type(list(value.values()), list[parts[1]])  # type: ignore[valid-type]


def _has_numbers(value: Any) -> bool:
    try:
        as_float_array("an array", value)
    except InputError:
        return False
    return value is not None
