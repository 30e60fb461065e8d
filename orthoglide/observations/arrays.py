"""Arrays of readings that their value holds: all of one length, read-only, of possible numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array


class Kind(NamedTuple):
    """What an array holds.

    Attributes:
        of: its type of numbers.
        shape: of one entry.
        empty: whether an entry may be nan.
    """

    of: type = np.float64
    shape: tuple[int, ...] = ()
    empty: bool = False


WHOLE, NUMBER, MAYBE = Kind(np.int64), Kind(), Kind(empty=True)
VECTOR, MAYBE_VECTOR = Kind(shape=(3,)), Kind(shape=(3,), empty=True)

OF_READINGS: Mapping[str, Kind] = {
    "setup": WHOLE,
    "command": VECTOR,
    "approach": VECTOR,
    "time": MAYBE,
    "temperature": MAYBE,
    "load": NUMBER,
    "repeat": WHOLE,
    "order": WHOLE,
    "reading": MAYBE,
    "sigma": MAYBE,
    "line": WHOLE,
}
"""What readings of every kind hold."""


def hold(owner: Any, what: str, kinds: Mapping[str, Kind], counted: str) -> None:
    """Put arrays of their kind in place of what a frozen value was made with.

    Args:
        owner: the value.
        what: it is, for a message.
        kinds: of its arrays, by name.
        counted: the array that says how many entries there are.

    Raises:
        InputError: naming the array, and its right shape or the first wrong entry.
    """
    n = len(np.asarray(getattr(owner, counted)))
    for name, kind in kinds.items():
        given = np.asarray(getattr(owner, name), dtype=np.float64)
        if given.shape != (n, *kind.shape):
            raise InputError(
                f"{what}: {name} must have shape {(n, *kind.shape)} as there are {n} readings, "
                f"not {given.shape}"
            )
        wrong = np.flatnonzero(_wrong(given, kind).any(axis=tuple(range(1, given.ndim))))
        if len(wrong):
            raise InputError(
                f"{what}: {name} of row {wrong[0]} (counted from 0) is "
                f"{given[wrong[0]].tolist()}, not {'a whole' if kind is WHOLE else 'a finite'} "
                "number: correct it"
            )
        values: NDArray[Any] = given.astype(kind.of)
        values.setflags(write=False)
        object.__setattr__(owner, name, values)
    if not np.isin(owner.approach, (-1.0, 0.0, 1.0)).all():
        raise InputError(f"{what}: approach is +1 or -1 for each axis, or 0 where it is not known")


def _wrong(given: Array, kind: Kind) -> NDArray[np.bool_]:
    if kind is WHOLE:
        return np.asarray(given != np.round(given))
    return np.asarray(np.isinf(given) if kind.empty else ~np.isfinite(given))


def check_setups(what: str, names: list[str], setup: NDArray[np.int64]) -> None:
    """Refuses mountings of one name, and readings ``(n,)`` of none.

    Raises:
        InputError: saying which.
    """
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{what}: two setups are called {name!r}: name each mounting apart")
    if len(setup) and (setup.min() < 0 or setup.max() >= len(names)):
        raise InputError(f"{what}: setup must index one of the {len(names)} setups")
