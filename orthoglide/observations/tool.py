"""Readings of where the tool is: a plate it touches, distances, a ball bar, an inclination.

What each instrument reads stands in `instruments`. The setups of a file are mountings of one
instrument each, as those of dials are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import check_word
from orthoglide.frames import html_table
from orthoglide.geometry import Array
from orthoglide.instruments import INSTRUMENTS, Instrument
from orthoglide.observations.approach import Ints, derive_approach, planned_moves
from orthoglide.observations.arrays import MAYBE_VECTOR, NUMBER, OF_READINGS, WHOLE, Recorded


@dataclass(frozen=True)
class ToolSetup:
    """One mounting of one instrument.

    Attributes:
        name: label, unique within its file.
        kind: of its readings, a key of `INSTRUMENTS`.
        beside: where it is taken: from the point of the tool that is commanded, along x, y and z
            of the platform, metres; below it, of a longer tool, z is negative.
        turned: of a plate, how far it was turned on its seat, counter-clockwise from above,
            degrees: its shape turns with it.
    """

    name: str
    kind: str
    beside: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turned: float = 0.0

    def __post_init__(self) -> None:
        check_word("kind of reading", self.kind, INSTRUMENTS)

    @property
    def instrument(self) -> Instrument:
        """What reads."""
        return INSTRUMENTS[self.kind]


@dataclass(frozen=True, eq=False, kw_only=True)
class ToolCampaign(Recorded):
    """Readings of the tool, one file's.

    Attributes:
        axis: base axis that is read ``(n,)``; 0 where the kind has none.
        sign: +1, or -1 where the instrument counts against it ``(n,)``.
        second: the other command of a distance ``(n, 3)``, metres; nan for other kinds.
        from_frame: readings from a data frame with the columns of their file.
    """

    from_frame: ClassVar[Callable[..., ToolCampaign]]
    _arrays: ClassVar = {**OF_READINGS, "axis": WHOLE, "sign": NUMBER, "second": MAYBE_VECTOR}

    setups: tuple[ToolSetup, ...]
    axis: Ints
    sign: Array
    second: Array

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(s.kind for s in self.setups))
        return f"<ToolCampaign {self.name!r}: {len(self)} readings ({kinds})>"

    def _repr_html_(self) -> str:
        columns = {
            "kind": self.kind,
            "setup": [self.setups[k].name for k in self.setup],
            "posture": self.posture,
            "reading, mm or mrad": (self.reading * 1e3).tolist(),
        }
        return html_table(repr(self)[1:-1], columns)

    @property
    def angular(self) -> NDArray[np.bool_]:
        """Which readings are turns, in radians ``(n,)``, booleans; others are lengths."""
        return self._which(lambda instrument: instrument.angular)

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Which readings are touches of a plate ``(n,)``, booleans."""
        return self._which(lambda instrument: instrument.touches)

    @property
    def paired(self) -> NDArray[np.bool_]:
        """Which readings have a second command ``(n,)``, booleans."""
        return self._which(lambda instrument: instrument.paired)

    @property
    def about_ball(self) -> NDArray[np.bool_]:
        """Which readings are about a fixed ball ``(n,)``, booleans."""
        return self._which(lambda instrument: instrument.about_ball)

    def _which(self, test: Callable[[Instrument], bool]) -> NDArray[np.bool_]:
        return np.array([test(s.instrument) for s in self.setups], dtype=bool)[self.setup]

    @property
    def places(self) -> Array:
        """What is read where: setup, axis and both commands ``(n, 8)``."""
        second = np.nan_to_num(self.second)
        return np.column_stack([self.setup, self.axis, self.command, second])

    @property
    def beside(self) -> Array:
        """Where each reading is taken, from the tool's point on the platform ``(n, 3)``, metres."""
        return np.array([s.beside for s in self.setups]).reshape(-1, 3)[self.setup]

    @property
    def turned_by(self) -> Array:
        """How far the plate of each reading was turned on its seat ``(n,)``, degrees."""
        return np.array([s.turned for s in self.setups])[self.setup]

    def in_order(self) -> ToolCampaign:
        """The same rows gone through one after the other: their order from 1, the sides that they
        are come to from, and the moves that this takes.

        Places are come to as the row before leads to them: the first of each setup from below on
        every axis, one that was visited before from the same side again, as only such visits show
        what the instrument scatters by. A plate is touched from above, whatever came before. Which
        end of a distance the machine goes to first is not known, and no more is its side.
        """
        count, begins = len(self), np.zeros(len(self), dtype=bool)
        begins[np.unique(self.setup, return_index=True)[1]] = True
        approach = derive_approach(self.command, np.arange(count))
        approach[begins] = 1.0
        _, first, visit = np.unique(
            np.column_stack([self.setup, self.command]),
            axis=0, return_index=True, return_inverse=True,
        )  # fmt: skip
        told = ~(self.touching | self.paired)
        approach = approach[first[visit.reshape(-1)]] * told[:, None]
        moves, order = planned_moves(self.command, approach, begins & told, self.moves.beyond)
        approach[self.touching] = -1.0
        return replace(
            self, order=order + 1, approach=approach, moves=replace(moves, order=moves.order + 1),
            line=order + 2,
        )  # fmt: skip
