"""Readings as arrays that their value holds: all of one length, read-only, of possible numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.layout import ORTHOGLIDE, LegNames
from orthoglide.observations.approach import Ints, Moves


class Kind(NamedTuple):
    """What an array holds."""

    of: type = np.float64  # its type of numbers
    shape: tuple[int, ...] = ()  # of one entry
    empty: bool = False  # whether an entry may be nan


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


def numbered(table: Array | Ints) -> Ints:
    """Numbers from 0 of equal rows of a table, or of equal entries ``(n,)``."""
    return np.unique(table, axis=0, return_inverse=True)[1].reshape(-1)


def hold(owner: Any, what: str, kinds: Mapping[str, Kind], counted: str) -> None:
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


def source(given: Any) -> str:
    """Where readings come from, for people: their file without its folder, or their name."""
    return str(given.file.rpartition("/")[2] or given.name)


def _wrong(given: Array, kind: Kind) -> NDArray[np.bool_]:
    if kind is WHOLE:
        return np.asarray(given != np.round(given))
    return np.asarray(np.isinf(given) if kind.empty else ~np.isfinite(given))


@dataclass(frozen=True, eq=False)
class Recorded:
    """Readings of one file, with the conditions they were taken under and their mountings.

    Attributes:
        name: file stem; parameters own to the campaign carry it.
        setups: the mountings, in order of appearance.
        setup: index into ``setups``, shape ``(n,)``.
        command: commanded joint coordinates ``(n, 3)``, metres, r removed.
        approach: direction of each axis' last move ``(n, 3)``: +1, -1, or 0 where unknown.
        time: seconds since the start ``(n,)``, nan where not recorded.
        temperature: degrees Celsius ``(n,)``, nan where not recorded.
        load: weight at the TCP along base -z ``(n,)``, newtons.
        repeat: number of the repetition ``(n,)``, from 1.
        order: place in the sequence the machine went through ``(n,)``.
        posture: labels for people, never used in a computation.
        reading: ``(n,)``, metres, of an inclination radians; nan in a sheet not yet filled in.
        sigma: declared standard deviation of each reading ``(n,)``, nan where none is.
        line: line in the file ``(n,)``, header line 1.
        file: the file's name as the caller gave it, or ``""``.
        sha256: digest of the file, or ``""``.
        warnings: what was noticed on reading and is no error.
        reference_temperature: what `temperature_rise` counts from; nan: the first one recorded.
        legs: how the machine's legs and commands are called.
        moves: commands gone through between the readings.
        to_frame: the rows of the file as a data frame, in the coordinates of a machine's controller
            where that is given.
    """

    to_frame: ClassVar[Callable[..., Any]]
    _arrays: ClassVar[Mapping[str, Kind]] = OF_READINGS

    name: str
    setups: tuple[Any, ...]
    setup: Ints
    command: Array
    approach: Array
    time: Array
    temperature: Array
    load: Array
    repeat: Ints
    order: Ints
    posture: tuple[str, ...]
    reading: Array
    sigma: Array
    line: Ints
    file: str = ""
    sha256: str = ""
    warnings: tuple[Any, ...] = ()
    reference_temperature: float = float("nan")
    legs: LegNames = ORTHOGLIDE.names
    moves: Moves = field(default_factory=Moves)

    def __post_init__(self) -> None:
        hold(self, self.name, self._arrays, "reading")
        if len(self.posture) != len(self):
            raise InputError(f"{self.name}: {len(self)} readings need {len(self)} posture labels")
        names = [s.name for s in self.setups]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    f"{self.name}: two setups are called {name!r}: name each mounting apart"
                )
        if len(self) and (self.setup.min() < 0 or self.setup.max() >= len(names)):
            raise InputError(f"{self.name}: setup must index one of the {len(names)} setups")

    def __len__(self) -> int:
        return len(self.reading)

    @property
    def kind(self) -> tuple[str, ...]:
        """Of each reading: ``leg`` of a dial, else that of its instrument at the tool."""
        return tuple(self.setups[k].kind for k in self.setup)

    def of_kind(self, kind: str) -> NDArray[np.bool_]:
        """Which readings are of a kind ``(n,)``, booleans."""
        return np.array([s.kind == kind for s in self.setups], dtype=bool)[self.setup]

    @property
    def angular(self) -> NDArray[np.bool_]:
        """Which readings are turns, in radians ``(n,)``, booleans; others are lengths."""
        return np.zeros(len(self), dtype=bool)

    @property
    def temperature_rise(self) -> Array:
        """Temperature against the campaign's first ``(n,)``, kelvin; 0 where not recorded."""
        return np.nan_to_num(self.temperature - self._reference())

    @property
    def places(self) -> Array:
        """What is read where: setup and command ``(n, 4)``."""
        return np.column_stack([self.setup, self.command])

    @property
    def stations(self) -> Array:
        """What makes visits the same: places, approach of all axes, load ``(n, k)``."""
        return np.column_stack([self.places, self.approach, self.load])

    def subset(self, rows: ArrayLike) -> Self:
        """Some of the readings, with the setups they need.

        Args:
            rows: booleans ``(n,)`` or indices.

        Returns:
            A campaign whose temperatures still count from this one's first row.
        """
        kind = bool if np.asarray(rows).dtype == bool else np.int64  # an empty list is of floats
        chosen = np.arange(len(self))[np.asarray(rows, dtype=kind)]
        used, setup = np.unique(self.setup[chosen], return_inverse=True)
        arrays = {name: getattr(self, name)[chosen] for name in self._arrays}
        return replace(
            self,
            **(arrays | {"setup": setup.reshape(-1)}),
            setups=tuple(self.setups[k] for k in used),
            posture=tuple(self.posture[k] for k in chosen),
            reference_temperature=self._reference(),
        )

    def _reference(self) -> float:
        recorded = self.temperature[np.isfinite(self.temperature)]
        if np.isfinite(self.reference_temperature) or not len(recorded):
            return self.reference_temperature
        return float(recorded[0])
