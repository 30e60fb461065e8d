"""A campaign in memory: readings, the conditions they were taken under, and their setups.

Arrays hold one entry a reading. Nothing here reads files; units are SI throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import InputError
from orthoglide.frames import html_table
from orthoglide.geometry import LEGS, Array
from orthoglide.observations.approach import Ints, built_up, derive_approach, planned_moves
from orthoglide.observations.arrays import OF_READINGS, Recorded

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

    kind: ClassVar = "leg"

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
class Campaign(Recorded):
    """Dial readings of one file, with a free datum for every setup; metres.

    Attributes:
        from_frame: a campaign from a data frame with the columns of a campaign file.
    """

    from_frame: ClassVar[Callable[..., Campaign]]

    setups: tuple[Setup, ...]

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
    def axis(self) -> Ints:
        """Base axis along which is read, by reading ``(n,)``."""
        return np.array([s.axis for s in self.setups], dtype=np.int64)[self.setup]

    @property
    def sign(self) -> Array:
        """+1, or -1 where the dial counts against its axis, by reading ``(n,)``."""
        return np.array([float(s.sign) for s in self.setups])[self.setup]

    @property
    def gauge(self) -> Array:
        """Where the dial stands along its leg's axis, by reading ``(n,)``, metres, r removed."""
        return np.array([s.gauge for s in self.setups])[self.setup]

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
        moves, order = planned_moves(self.command, self.approach, begins, self.moves.beyond)
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
        """Whether both hold exactly the same readings; files, lines, plans and warnings aside."""
        return (
            (self.name, self.setups, self.posture) == (other.name, other.setups, other.posture)
            and np.array_equal(self.moves.command, other.moves.command)
            and np.array_equal(self.moves.order, other.moves.order)
            and all(
                np.array_equal(getattr(self, name), getattr(other, name), equal_nan=True)
                for name in OF_READINGS
                if name != "line"
            )
        )
