"""A campaign in memory: readings, the conditions they were taken under, and their setups.

Arrays hold one entry a reading. Nothing here reads files; units are SI throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError
from orthoglide.frames import html_table
from orthoglide.geometry import LEGS, Array
from orthoglide.observations.approach import Ints, Moves, built_up, derive_approach, planned_moves
from orthoglide.observations.arrays import OF_READINGS, check_setups, hold

_THREE = (0, 1, 2)


@dataclass(frozen=True)
class Setup:
    """One mounting of one dial; all its readings share one unknown datum.

    Attributes:
        name: label, unique within its campaign.
        leg: 0, 1 or 2: the leg touched.
        axis: 0, 1 or 2: the base axis along which the dial reads, not the leg's own.
        sign: +1, or -1 where the dial counts against the axis.
        gauge: where the dial stands along the leg's own axis, metres, r removed.
        bar: 1 or 2 for a bar, 0 for the leg's median line.
    """

    name: str
    leg: int
    axis: int
    sign: int
    gauge: float
    bar: int = 0

    def __post_init__(self) -> None:
        if self.leg not in _THREE or self.axis not in _THREE or self.leg == self.axis:
            raise InputError(
                f"setup {self.name!r}: legs and axes are 0, 1 or 2, and a dial reads across its leg"
            )
        if self.sign not in (1, -1) or self.bar not in _THREE or not np.isfinite(self.gauge):
            raise InputError(
                f"setup {self.name!r}: its sign is 1 or -1, its bar 0, 1 or 2, and its gauge a "
                "length in metres"
            )

    @property
    def direction(self) -> str:
        """The axis with its sign as files write it: ``"y"`` or ``"-y"``."""
        return ("-" if self.sign < 0 else "") + LEGS[self.axis]


@dataclass(frozen=True, eq=False)
class Campaign:
    """Dial readings of one file, with a free datum for every setup.

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
        reading: the dial ``(n,)``, metres; nan in a sheet not yet filled in.
        sigma: declared standard deviation of each reading ``(n,)``, metres, nan where none is.
        line: line in the file ``(n,)``, header line 1.
        file: the file's name as the caller gave it, or ``""``.
        sha256: digest of the file, or ``""``.
        warnings: what was noticed on reading and is no error.
        reference_temperature: what `temperature_rise` counts from; nan: the first one recorded.
        moves: commands gone through between the readings.
        from_frame: a campaign from a data frame with the columns of a campaign file.
        to_frame: the rows of its file as a data frame.
    """

    from_frame: ClassVar[Callable[..., Campaign]]
    to_frame: ClassVar[Callable[..., Any]]

    name: str
    setups: tuple[Setup, ...]
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
    warnings: tuple[str, ...] = ()
    reference_temperature: float = float("nan")
    moves: Moves = field(default_factory=Moves)

    def __post_init__(self) -> None:
        hold(self, "campaign", OF_READINGS, "reading")
        if len(self.posture) != len(self):
            raise InputError(f"campaign: {len(self)} readings need {len(self)} posture labels")
        check_setups("campaign", [s.name for s in self.setups], self.setup)

    def __len__(self) -> int:
        return len(self.reading)

    def __repr__(self) -> str:
        missing = int(np.isnan(self.reading).sum())
        left = f", {missing} of them to be taken" if missing else ""
        return f"<Campaign {self.name!r}: {len(self)} readings in {len(self.setups)} setups{left}>"

    def _repr_html_(self) -> str:
        setups = [self.setups[k] for k in self.setup]
        columns = {
            "setup": [s.name for s in setups],
            "leg": [LEGS[s.leg] for s in setups],
            "direction": [s.direction for s in setups],
            "posture": self.posture,
            "reading_mm": (self.reading * 1e3).tolist(),
        }
        return html_table(repr(self)[1:-1], columns)

    @property
    def leg(self) -> Ints:
        """Leg touched, by reading ``(n,)``."""
        return np.array([s.leg for s in self.setups], dtype=np.int64)[self.setup]

    @property
    def temperature_rise(self) -> Array:
        """Temperature against the campaign's first ``(n,)``, kelvin; 0 where not recorded."""
        return np.nan_to_num(self.temperature - self._reference())

    @property
    def derived_approach(self) -> Array:
        """Approach as the order of readings and moves gives it ``(n, 3)``."""
        return derive_approach(self.command, self.order, self.moves)

    def built_up(self, lengths: Sequence[float]) -> Array:
        """Lost motion of each drive that builds up over some lengths, metres: ``(K, n, 3)``."""
        asked = tuple(lengths)
        if asked not in self._built_up:  # row by row in Python: half a second for 100 000 readings
            self._built_up[asked] = built_up(self.command, self.order, asked, self.moves)
        return self._built_up[asked]

    @cached_property
    def _built_up(self) -> dict[tuple[float, ...], Array]:
        """What was asked of :meth:`built_up` so far."""
        return {}

    def subset(self, rows: ArrayLike) -> Campaign:
        """Some of the readings, with the setups they need.

        Args:
            rows: booleans ``(n,)`` or indices.

        Returns:
            A campaign whose temperatures still count from this one's first row.
        """
        chosen = np.arange(len(self))[np.asarray(rows, dtype=_index_type(rows))]
        used, setup = np.unique(self.setup[chosen], return_inverse=True)
        arrays = {name: getattr(self, name)[chosen] for name in OF_READINGS}
        return replace(
            self,
            **(arrays | {"setup": setup.reshape(-1)}),
            setups=tuple(self.setups[k] for k in used),
            posture=tuple(self.posture[k] for k in chosen),
            reference_temperature=self._reference(),
        )

    def with_readings(self, reading: ArrayLike) -> Campaign:
        """The same campaign with other dial values ``(n,)``, metres."""
        return replace(self, reading=np.asarray(reading, dtype=float))

    def with_moves(self) -> Campaign:
        """The same readings in the order of their rows, with the moves that their approach takes.

        Two dials that are read at one visit were mounted together.
        """
        begins = np.zeros(len(self), dtype=bool)
        begins[np.unique(self.setup, return_index=True)[1]] = True
        begins[1:] &= (np.diff(self.command, axis=0) != 0).any(axis=1)
        moves, order = planned_moves(self.command, self.approach, begins)
        return replace(self, moves=moves, order=order, line=order + 2)

    def relabelled(self) -> Campaign:
        """The campaign of the machine with its legs renamed x -> y -> z -> x.

        Raises:
            InputError: under a load, as gravity does not turn with the labels.
        """
        if np.any(self.load):
            raise InputError("a campaign under load cannot be relabelled: its weight acts along z")
        turned = (replace(s, leg=(s.leg + 1) % 3, axis=(s.axis + 1) % 3) for s in self.setups)
        return replace(
            self,
            setups=tuple(turned),
            command=np.roll(self.command, 1, axis=1),
            approach=np.roll(self.approach, 1, axis=1),
            moves=replace(self.moves, command=np.roll(self.moves.command, 1, axis=1)),
        )

    def same_as(self, other: Campaign) -> bool:
        """Whether both hold exactly the same readings; file, lines and warnings aside."""
        return (
            (self.name, self.setups, self.posture) == (other.name, other.setups, other.posture)
            and self.moves.same_as(other.moves)
            and all(
                np.array_equal(getattr(self, name), getattr(other, name), equal_nan=True)
                for name in OF_READINGS
                if name != "line"
            )
        )

    def _reference(self) -> float:
        recorded = self.temperature[np.isfinite(self.temperature)]
        if np.isfinite(self.reference_temperature) or not len(recorded):
            return self.reference_temperature
        return float(recorded[0])


def _index_type(rows: ArrayLike) -> type:
    return bool if np.asarray(rows).dtype == bool else np.int64  # an empty list is of floats
