"""Readings as arrays that their value holds: all of one length, read-only, of possible numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.observations.approach import Ints


class ArraySpec(NamedTuple):
    """What an array holds."""

    dtype: type = np.float64  # its type of numbers
    shape: tuple[int, ...] = ()  # of one entry
    allows_nan: bool = False  # whether an entry may be nan
    default: float | None = None  # every entry of an array that is not given; None: it must be

    def default_array(self, n: int) -> Array:
        """Return the array of ``n`` entries that stands for one that is not given."""
        return np.full((n, *self.shape), self.default, dtype=float)


INTEGER, VECTOR = ArraySpec(np.int64), ArraySpec(shape=(3,))
OPTIONAL_NUMBER = ArraySpec(allows_nan=True, default=np.nan)

READING_ARRAYS: Mapping[str, ArraySpec] = {
    "setup": INTEGER,
    "command": VECTOR,
    "reading": OPTIONAL_NUMBER,
    "approach": VECTOR._replace(default=0),
    "time": OPTIONAL_NUMBER,
    "temperature": OPTIONAL_NUMBER,
    "load": ArraySpec(default=0),
    "repeat": INTEGER._replace(default=1),
    "order": INTEGER,
    "sigma": OPTIONAL_NUMBER,
    "line": INTEGER,
    "axis": INTEGER._replace(default=0),
    "sign": ArraySpec(default=1),
    "second": VECTOR._replace(allows_nan=True, default=np.nan),
}
"""Arrays of a table of readings, with one entry a reading."""


def group_ids(table: Array | Ints) -> Ints:
    """Numbers from 0 of equal rows of a table, or of equal entries ``(n,)``."""
    found = np.zeros(len(table), dtype=np.int64)
    for column in np.atleast_2d(np.transpose(table)):
        if (column != column[:1]).any():  # else it tells none apart; columns sort quicker than rows
            values, place = np.unique(column, return_inverse=True)
            found = np.unique(found * len(values) + place, return_inverse=True)[1]
    return found


def freeze_arrays(owner: Any, what: str, kinds: Mapping[str, ArraySpec], counted: str) -> None:
    """Put arrays of their kind in place of what a frozen value was made with, as many entries as
    the array ``counted`` has; ``what`` it is stands in messages.

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
        wrong = np.flatnonzero(_invalid_entries(given, kind).any(axis=tuple(range(1, given.ndim))))
        if len(wrong):
            number = "a whole number" if kind.dtype is np.int64 else "a finite number"
            raise InputError(
                f"{what}: {name} of row {wrong[0]} (counted from 0) is "
                f"{given[wrong[0]].tolist()}, not {number}: correct it"
            )
        values: NDArray[Any] = given.astype(kind.dtype)
        values.setflags(write=False)
        object.__setattr__(owner, name, values)
    if not np.isin(owner.approach, (-1.0, 0.0, 1.0)).all():
        raise InputError(f"{what}: approach is +1 or -1 for each axis, or 0 where it is not known")


def source(given: Any) -> str:
    """Where readings come from, for people: their file without its folder, or their name."""
    return str(given.file.rpartition("/")[2] or given.name)


def _invalid_entries(given: Array, kind: ArraySpec) -> NDArray[np.bool_]:
    if kind.dtype is np.int64:
        return np.asarray(given != np.round(given))
    return np.asarray(np.isinf(given) if kind.allows_nan else ~np.isfinite(given))
