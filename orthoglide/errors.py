"""Exceptions of the package, each with its evidence as attributes.

``InputError`` and its subclasses are mistakes of the caller (exit code 2 on the command line);
``NumericsError`` and its subclasses are failed computations (exit code 3).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class OrthoglideError(Exception):
    """Base class of the exceptions of this package."""


class InputError(OrthoglideError, ValueError):
    """An argument cannot be used; the message states the remedy."""


class FileError(InputError):
    """A file cannot be used.

    Args:
        message: the problem and its remedy, in one sentence.
        file: the file's name as the caller gave it.
        line: number of the line in question, if any, counted from 1 with the header as line 1.
    """

    def __init__(self, message: str, *, file: str = "", line: int | None = None) -> None:
        place = file if line is None else f"{file}, line {line}"
        super().__init__(f"{place}: {message}" if place else message)
        self.file = file
        self.line = line
        self.reason = message


class UnreachableError(InputError):
    """A command or pose is out of the legs' reach.

    Args:
        message: which leg, and by how much.
        leg: ``"x"``, ``"y"`` or ``"z"``, or ``""`` where no single leg is too short.
        excess: by how much, in metres (positive).
        index: index in the batch, ``()`` for a single pose.
    """

    def __init__(
        self, message: str, *, leg: str = "", excess: float = 0.0, index: tuple[int, ...] = ()
    ) -> None:
        super().__init__(message)
        self.leg = leg
        self.excess = excess
        self.index = index


class UnidentifiableError(InputError):
    """The readings cannot determine the requested parameters.

    Args:
        message: what cannot be determined, in words.
        directions: each a mapping from parameter name to its share in an undetermined direction.
    """

    def __init__(self, message: str, *, directions: tuple[Mapping[str, float], ...] = ()) -> None:
        super().__init__(message)
        self.directions = directions


class NumericsError(OrthoglideError, ArithmeticError):
    """A computation did not reach the accuracy it promises."""


class ClosureError(NumericsError):
    """The loops could not be closed.

    Args:
        message: what did not close, in words.
        residuals: the closure residual by loop, metres for points, and for the platform's frames
            the larger of metres and radians.
        index: index in the batch, ``()`` for a single posture.
    """

    def __init__(
        self,
        message: str,
        *,
        residuals: Mapping[str, float] | None = None,
        index: tuple[int, ...] = (),
    ) -> None:
        super().__init__(message)
        self.residuals = dict(residuals or {})
        self.index = index


class SolverError(NumericsError):
    """An optimiser stopped without a solution that passes the checks of this package.

    Args:
        message: which check failed, and by how much.
        evidence: the figures behind it.
    """

    def __init__(self, message: str, *, evidence: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.evidence = dict(evidence or {})


class CrossCheckError(NumericsError):
    """Two independent derivations disagree beyond what rounding or theory allow.

    Args:
        message: which two, and by how much.
        difference: the largest difference, in metres.
    """

    def __init__(self, message: str, *, difference: float = float("nan")) -> None:
        super().__init__(message)
        self.difference = difference


def check_choice(noun: str, value: object, choices: Iterable[str]) -> None:
    """Raise an `InputError`, which lists the choices, for a value that is none of them."""
    choices = tuple(choices)
    if value not in choices:
        raise InputError(f"there is no {noun} {value!r}: it is one of {', '.join(choices)}")


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
    if not isinstance(path, str | PathLike):
        raise InputError(f"a {type(path).__name__} is no path: give the name of a file or folder")
    return Path(path)


def check_integer(noun: str, value: object, minimum: int) -> int:
    """Return a whole number; raise an `InputError` where it is less than the minimum."""
    if not isinstance(value, Integral) or value < minimum:
        raise InputError(f"{noun} must be {minimum} or more and whole, not {value!r}")
    return int(value)


def check_mapping(noun: str, mapping: object) -> None:
    """Raise an `InputError` unless a value is a mapping from names to numbers."""
    if not isinstance(mapping, Mapping):
        raise InputError(
            f"{noun} go by name: give {{NAME: NUMBER}}, not a {type(mapping).__name__}"
        )
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
