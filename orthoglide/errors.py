"""Exceptions of the package, each with its evidence as attributes.

``InputError`` and its subclasses are mistakes of the caller (exit code 2 on the command line);
``NumericsError`` and its subclasses are failed computations (exit code 3).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from inspect import get_annotations
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from orthoglide.text import printable_path

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class OrthoglideError(Exception):
    """Base class of the exceptions of this package.

    Args:
        message: what is wrong, in words.
        evidence: values of attributes that the class declares.
    """

    def __init__(self, message: str, **evidence: Any) -> None:
        super().__init__(message)
        for name, value in evidence.items():
            if not any(name in get_annotations(base) for base in type(self).__mro__):
                raise TypeError(f"{type(self).__name__} declares no {name!r}")
            setattr(self, name, value)


class InputError(OrthoglideError, ValueError):
    """An argument cannot be used; the message states the remedy."""


class FileError(InputError):
    """A file cannot be used.

    Args:
        message: the problem and its remedy, in one sentence.
        file: the file's name as the caller gave it; what cannot be printed is replaced.
        line: number of the line in question, if any, counted from 1 with the header as line 1.
    """

    def __init__(
        self, message: str, *, file: str | PathLike[str] = "", line: int | None = None
    ) -> None:
        self.file = printable_path(file)
        place = ", ".join(filter(None, (self.file, "" if line is None else f"line {line}")))
        super().__init__(f"{place}: {message}" if place else message)
        self.line = line
        self.reason = message


class UnreachableError(InputError):
    """A command or pose is out of the legs' reach."""

    leg: str = ""
    """Name of the leg that is too short, or empty where no single leg is."""
    excess: float = 0.0
    """By how much, metres (positive)."""
    index: tuple[int, ...] = ()
    """Index in the batch; empty for a single pose."""


class UnidentifiableError(InputError):
    """The readings cannot determine the requested parameters."""

    directions: tuple[Mapping[str, float], ...] = ()
    """Each a mapping from parameter name to its share in an undetermined direction."""


class NumericsError(OrthoglideError, ArithmeticError):
    """A computation did not reach the accuracy it promises."""


class ClosureError(NumericsError):
    """The loops could not be closed."""

    residuals: Mapping[str, float] = MappingProxyType({})
    """Closure residual by loop: metres for points, and for the platform's frames the larger of
    metres and radians."""
    index: tuple[int, ...] = ()
    """Index in the batch; empty for a single posture."""


class SolverError(NumericsError):
    """An optimiser stopped without a solution that passes the checks of this package."""

    evidence: Mapping[str, Any] = MappingProxyType({})
    """The figures behind it."""


class CrossCheckError(NumericsError):
    """Two independent derivations disagree beyond what rounding or theory allow."""

    difference: float = float("nan")
    """The largest difference, metres."""


def check_choice(noun: str, value: object, choices: Iterable[str]) -> None:
    """Raise an `InputError`, which lists the choices, for a value that is none of them."""
    choices = tuple(choices)
    if value not in choices:
        raise InputError(f"there is no {noun} {value!r}: it is one of {', '.join(choices)}")


def check_type(noun: str, value: Any, kind: type | tuple[type, ...], expected: str) -> None:
    """Raise an `InputError`, which says what is expected, for a value of another type."""
    if not isinstance(value, kind):
        raise InputError(f"{noun} must be {expected}, not a {type(value).__name__}")


def check_list(noun: str, value: object) -> None:
    """Raise an `InputError` unless a value is a list of names; a text would be read by letters."""
    if isinstance(value, str):
        raise InputError(f"{noun} is a list of names: give [{value!r}], not {value!r}")
    if not isinstance(value, Collection) or not all(isinstance(name, str) for name in value):
        raise InputError(f"{noun} is a list of names, such as ['NAME'], not {value!r}")


def as_path(path: str | PathLike[str]) -> Path:
    """Return a path.

    Raises:
        InputError: for any other type; the system takes a number for an open file.
    """
    check_type("a path", path, (str, PathLike), "the name of a file or folder")
    return Path(path)


def check_integer(noun: str, value: object, minimum: int) -> int:
    """Return a whole number; raise an `InputError` where it is less than the minimum."""
    if not isinstance(value, Integral) or value < minimum:
        raise InputError(f"{noun} must be {minimum} or more and whole, not {value!r}")
    return int(value)


def check_mapping(noun: str, mapping: Any) -> None:
    """Raise an `InputError` unless a value is a mapping from names to numbers."""
    check_type(noun, mapping, Mapping, "numbers by name, {NAME: NUMBER}")
    for name, value in mapping.items():
        if not isinstance(value, Real):
            raise InputError(f"{name} must be a number, not {value!r}")


def as_float_array(noun: str, values: Any) -> NDArray[np.float64]:
    """Return an array of numbers; raise an `InputError` for texts and rows of unequal length."""
    import numpy as np

    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{noun} must be numbers, in rows of one length") from None
