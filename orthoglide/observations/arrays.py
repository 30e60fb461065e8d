"""Arrays of a table of readings: checked, of equal length and read-only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.observations.approach import Ints


class ArraySpec(NamedTuple):
    """Type, shape and default of an array."""

    dtype: type = np.float64
    shape: tuple[int, ...] = ()  # of one entry
    allows_nan: bool = False
    default: float | None = None  # of every entry; None if the array must be given


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
    """Return an index from 0 for each distinct row of a table, or distinct entry ``(n,)``."""
    ids = np.zeros(len(table), dtype=np.int64)
    count = 1
    for column in np.atleast_2d(np.transpose(table)):
        if count == len(ids):
            break  # all rows differ
        if (column != column[:1]).any():  # constant columns do not count; columns sort faster
            values, inverse = np.unique(column, return_inverse=True)
            if count > 1:
                pairs = ids * len(values) + inverse
                values, inverse = np.unique(pairs, return_inverse=True)
            ids, count = inverse, len(values)
    return ids


def equal_rows(table: Array | Ints) -> Ints:
    """Return an index ``(n,)`` that equal rows of a table share, in order of occurrence."""
    numbers: dict[bytes, int] = {}
    rows = (row.tobytes() for row in np.ascontiguousarray(table))
    return np.array([numbers.setdefault(row, len(numbers)) for row in rows], dtype=np.int64)


def checked_array(values: Any, spec: ArraySpec, n: int, name: str) -> NDArray[Any]:
    """Return ``n`` values as a read-only array; a single value counts for all.

    Raises:
        InputError: naming the array, and its right shape or the first wrong entry.
    """
    given = np.asarray(spec.default if values is None else values, dtype=np.float64)
    if given.shape in ((), spec.shape):
        given = np.broadcast_to(given, (n, *spec.shape))
    if given.shape != (n, *spec.shape):
        raise InputError(
            f"{name} must have shape {(n, *spec.shape)} as there are {n} readings, not "
            f"{given.shape}"
        )
    if spec.dtype is np.int64:
        number, invalid = "a whole number", given != np.round(given)
    else:
        number, invalid = "a finite number", ~np.isfinite(given)
        invalid &= ~np.isnan(given) if spec.allows_nan else True
    wrong = np.flatnonzero(invalid.any(axis=tuple(range(1, given.ndim))))
    if len(wrong):
        raise InputError(
            f"{name} of row {wrong[0]} (counted from 0) is {given[wrong[0]].tolist()}, not "
            f"{number}: correct it"
        )
    checked: NDArray[Any] = given.astype(spec.dtype)
    checked.setflags(write=False)
    return checked


def source(readings: Any) -> str:
    """Return the origin of readings in words: their label, their file without its folder, or their
    name.
    """
    return str(readings.label or readings.file.rpartition("/")[2] or readings.name)
