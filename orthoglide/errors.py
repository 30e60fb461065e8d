"""The errors of the package: one root, each kind carrying its evidence.

``InputError`` and its kinds are the caller's to mend (exit code 2 on the command line);
``NumericsError`` and its kinds say that a computation failed (exit code 3).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class OrthoglideError(Exception):
    """Root of everything this package raises on purpose."""


class InputError(OrthoglideError, ValueError):
    """Something that was passed in cannot be used; the message says what would be right."""


class FileError(InputError):
    """A file cannot be used.

    Args:
        message: what is wrong and what would be right, in one sentence.
        file: the file's name as the caller gave it.
        line: the line in question, counted from 1 with the header as line 1, where one is to blame.
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
        leg: ``"x"``, ``"y"`` or ``"z"``, or ``""`` where the three legs miss each other together.
        excess: by how much, in metres (positive).
        index: place in the batch, ``()`` for a single pose.
    """

    def __init__(
        self, message: str, *, leg: str = "", excess: float = 0.0, index: tuple[int, ...] = ()
    ) -> None:
        super().__init__(message)
        self.leg = leg
        self.excess = excess
        self.index = index


class UnidentifiableError(InputError):
    """The readings cannot determine what was asked.

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
        index: place in the batch, ``()`` for a single posture.
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
    """An optimiser stopped without an answer that passes our own checks.

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


def check_choice(what: str, given: object, known: Iterable[str]) -> None:
    """Refuses a word that is none of those known, and says which there are.

    Raises:
        InputError: naming what the word is for.
    """
    known = tuple(known)
    if given not in known:
        raise InputError(f"there is no {what} {given!r}: it is one of {', '.join(known)}")


def check_list(what: str, given: object) -> None:
    """Refuses a single text where names are listed, which would be taken letter by letter.

    Raises:
        InputError: naming what the names are for.
    """
    if isinstance(given, str):
        raise InputError(f"{what} is a list of names: give [{given!r}], not {given!r}")


def as_path(given: str | PathLike[str]) -> Path:
    """A path; a number is none, which the system takes for a file that is open.

    Raises:
        InputError: for what is none, naming its type.
    """
    if not isinstance(given, str | PathLike):
        raise InputError(f"a {type(given).__name__} is no path: give the name of a file or folder")
    return Path(given)


def check_integer(what: str, given: object, least: int) -> int:
    """A whole number that is at least so large.

    Raises:
        InputError: naming what it is.
    """
    if not isinstance(given, Integral) or given < least:
        raise InputError(f"{what} must be {least} or more and whole, not {given!r}")
    return int(given)


def check_mapping(what: str, given: object) -> None:
    """Refuses what are no numbers by name.

    Raises:
        InputError: naming what they are, or the first that is no number.
    """
    if not isinstance(given, Mapping):
        raise InputError(f"{what} go by name: give {{NAME: NUMBER}}, not a {type(given).__name__}")
    for name, value in given.items():
        if not isinstance(value, Real):
            raise InputError(f"{name} must be a number, not {value!r}")


def as_float_array(what: str, given: Any) -> NDArray[np.float64]:
    """An array of numbers, of any shape.

    Raises:
        InputError: for texts, and rows of unequal length.
    """
    import numpy as np

    try:
        return np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers, in rows of one length") from None
