"""Measured readings by setup, with the predictions of three machines: before, base and last fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.result.codec import SHORT, Key

_PLACES = 12  # decimals of an SI unit: a picometre is rounding

Rows = Annotated[Array, Key(places=_PLACES)]
Numbers = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class Mounting:
    """The readings of one setup, as a panel of a figure shows them."""

    setup: str  # name of the setup
    name: str  # name of the setup, with its campaign before it if there are several
    title: str  # of the panel: name, leg and direction
    label: str  # of the horizontal axis
    rows: Numbers  # rows of `ReadingsShown` that belong to it (m,)
    # travel of the touched leg's carriage in millimetres, or place in the file (m,)
    x: Annotated[Array, Key(digits=SHORT)]
    side: Annotated[Array, Key(digits=1)]  # of the approach of that leg's own axis (m,)
    unit: str  # unit for display: mm or mrad


@dataclass(frozen=True, eq=False, repr=False)
class ReadingsShown:
    """All readings that were fitted, measured and predicted, metres or radians."""

    mountings: tuple[Mounting, ...]  # in the order of the files
    file: Numbers  # number of the readings within the request (n,)
    row: Numbers  # row within these readings (n,)
    station: Numbers  # number of the station: a posture of a setup (n,)
    measured: Rows  # (n,)
    sigma: Rows  # standard deviation of the noise that is independent in each reading (n,)
    common: Rows  # standard deviation of the noise that all readings of a station share (n,)
    nominal: Rows  # predicted for the machine as it was (n,)
    before: Rows  # predicted by the base model (n,)
    after: Rows  # predicted by the last fit (n,)

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def turned(self) -> NDArray[np.bool_]:
        """Whether each reading is an inclination ``(n,)``."""
        found = np.zeros(len(self), dtype=bool)
        for one in self.mountings:
            found[one.rows] = one.unit == "mrad"
        return found

    @property
    def setups(self) -> list[str]:
        """Name of the setup of each reading, ``n`` of them."""
        found = np.empty(len(self), dtype=object)
        for one in self.mountings:
            found[one.rows] = one.setup
        return list(found)
