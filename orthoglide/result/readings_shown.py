"""The readings of a fit, setup by setup, with what three machines predict of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.result.codec import SHORT, Key

_PLACES = 12  # decimals of an SI unit: a picometre is rounding

Rows = Annotated[Array, Key(places=_PLACES)]
Numbers = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class Mounting:
    """One setup."""

    setup: str  # its name
    name: str  # the same, its campaign before it where there are several
    title: str  # name, leg and direction
    label: str  # of the scale across
    rows: Numbers  # of all readings (m,)
    # travel of the touched leg's carriage in millimetres, or place in the file (m,)
    x: Annotated[Array, Key(digits=SHORT)]
    side: Annotated[Array, Key(digits=1)]  # of the approach of that leg's own axis (m,)
    unit: str  # in which people read it


@dataclass(frozen=True, eq=False, repr=False)
class ReadingsShown:
    """All readings that count, metres or radians."""

    mountings: tuple[Mounting, ...]  # in the order of the files
    file: Numbers  # whose readings of the request each is of (n,)
    row: Numbers  # within them (n,)
    station: Numbers  # number of the setup's posture that it was read at (n,)
    measured: Rows  # (n,)
    sigma: Rows  # standard deviation of each by itself (n,)
    common: Rows  # of what the readings of a station share (n,)
    nominal: Rows  # predicted for the machine as it was (n,)
    before: Rows  # predicted by the base model (n,)
    after: Rows  # predicted by the last fit (n,)

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def turned(self) -> NDArray[np.bool_]:
        """Which of them are inclinations ``(n,)``."""
        found = np.zeros(len(self), dtype=bool)
        for one in self.mountings:
            found[one.rows] = one.unit == "mrad"
        return found

    @property
    def setups(self) -> list[Any]:
        """Name of the setup of each ``n``."""
        found = np.empty(len(self), dtype=object)
        for one in self.mountings:
            found[one.rows] = one.setup
        return list(found)
